"""The results of a production line in a database: SQLite in a folder, or PostgreSQL for several stations.

job or result → entry (hashes of what was measured and assumed) → database → pieces → lots, control charts, Parquet
"""

from importlib.util import find_spec

from femu_piezo.errors import InputError

if not (find_spec("sqlalchemy") and find_spec("alembic")):
    raise InputError("--store needs SQLAlchemy and Alembic, which are not installed; pip install 'femu-piezo[store]'")
