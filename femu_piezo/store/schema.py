"""The tables of the database. A change here is a new file in `migrations/versions` and another `VERSION`.

Times are UTC without a zone. Values are SI.

    specimens, sweeps ─< inputs >─ results >─ lots      results ─< estimates, budgets, causes      results ─ diagnoses
"""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    Column,
    DateTime,
    Double,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
)
from sqlalchemy.dialects.postgresql import JSONB

#: Revision of the newest migration, and the table that holds the revision of a database.
VERSION, VERSION_TABLE = "2", "femu_piezo_version"

metadata = MetaData()
_JSON = JSON().with_variant(JSONB(), "postgresql")


def _of_result(**options) -> Column:
    return Column("result_id", ForeignKey("results.id", ondelete="CASCADE"), **options)


lots = Table(
    "lots", metadata, Column("id", Integer, primary_key=True), Column("name", Text, nullable=False, unique=True)
)
#: hash : SHA-256 of the description, which holds all that a fit takes from the specimen file except the sweep.
specimens = Table(
    "specimens",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("hash", String(64), nullable=False, unique=True),
    Column("name", Text, nullable=False),
    Column("description", _JSON),
)
#: hash : SHA-256 of the file; measured : when the file was written, as of the first result that used it.
sweeps = Table(
    "sweeps",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("hash", String(64), nullable=False, unique=True),
    Column("file", Text, nullable=False),
    Column("measured", DateTime, nullable=False, index=True),
)
#: piece, assumed : SHA-256 of all sweeps and of all descriptions; one result for each step and program.
#: written : when a command last came to it; columns : the row of a lot's table; record : update.json or diagnosis.json.
results = Table(
    "results",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("piece", String(64), nullable=False),
    Column("assumed", String(64), nullable=False),
    Column("step", Text, nullable=False),
    Column("program", Text, nullable=False),
    Column("lot_id", ForeignKey("lots.id"), index=True),
    Column("name", Text, nullable=False),
    Column("status", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("written", DateTime, nullable=False),
    Column("station", Text),
    Column("columns", _JSON, nullable=False),
    Column("record", _JSON),
    UniqueConstraint("piece", "assumed", "step", "program"),
    Index("ix_results_step_piece", "step", "piece"),
)
inputs = Table(
    "inputs",
    metadata,
    _of_result(primary_key=True),
    Column("position", Integer, primary_key=True),
    Column("specimen_id", ForeignKey("specimens.id"), nullable=False),
    Column("sweep_id", ForeignKey("sweeps.id"), index=True),
)
#: quantity : column of the lot's table, such as s11, s11_tan, k_eff.
estimates = Table(
    "estimates",
    metadata,
    _of_result(primary_key=True),
    Column("quantity", Text, primary_key=True),
    Column("value", Double, nullable=False),
    Column("std", Double),
)
budgets = Table(
    "budgets",
    metadata,
    _of_result(primary_key=True),
    Column("quantity", Text, primary_key=True),
    Column("source", Text, primary_key=True),
    Column("std", Double, nullable=False),
)
diagnoses = Table("diagnoses", metadata, _of_result(primary_key=True), Column("verdict", Text, nullable=False))
#: parameters : name → value, std, unit.
causes = Table(
    "causes",
    metadata,
    _of_result(primary_key=True),
    Column("position", Integer, primary_key=True),
    Column("effect", Text, nullable=False),
    Column("specimen", Text),
    Column("probability", Double, nullable=False),
    Column("parameters", _JSON, nullable=False),
)
