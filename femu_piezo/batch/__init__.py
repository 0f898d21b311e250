"""A production lot: many specimens or sweeps, one table and a report; faults stay local and nothing done is lost.

jobs → pool (local processes or Dask) → worker → records on disk → table → lot report
"""
