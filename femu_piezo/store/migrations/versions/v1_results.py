"""Version 1: specimens, sweeps, lots, results with estimates and budgets, diagnoses with causes."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision, down_revision = "1", None

_JSON = sa.JSON().with_variant(JSONB(), "postgresql")


def _of_result() -> sa.Column:
    return sa.Column("result_id", sa.Integer, sa.ForeignKey("results.id", ondelete="CASCADE"), primary_key=True)


def upgrade() -> None:
    """Make all tables of version 1."""
    op.create_table(
        "lots", sa.Column("id", sa.Integer, primary_key=True), sa.Column("name", sa.Text, nullable=False, unique=True)
    )
    op.create_table(
        "specimens",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("hash", sa.String(64), nullable=False, unique=True),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("description", _JSON),
    )
    op.create_table(
        "sweeps",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("hash", sa.String(64), nullable=False, unique=True),
        sa.Column("file", sa.Text, nullable=False),
        sa.Column("measured", sa.DateTime, nullable=False),
    )
    op.create_table(
        "results",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("piece", sa.String(64), nullable=False),
        sa.Column("assumed", sa.String(64), nullable=False),
        sa.Column("step", sa.Text, nullable=False),
        sa.Column("program", sa.Text, nullable=False),
        sa.Column("lot_id", sa.Integer, sa.ForeignKey("lots.id")),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("status", sa.Text, nullable=False),
        sa.Column("reason", sa.Text, nullable=False),
        sa.Column("written", sa.DateTime, nullable=False),
        sa.Column("columns", _JSON, nullable=False),
        sa.Column("record", _JSON),
        sa.UniqueConstraint("piece", "assumed", "step", "program"),
    )
    op.create_table(
        "inputs",
        _of_result(),
        sa.Column("position", sa.Integer, primary_key=True),
        sa.Column("specimen_id", sa.Integer, sa.ForeignKey("specimens.id"), nullable=False),
        sa.Column("sweep_id", sa.Integer, sa.ForeignKey("sweeps.id")),
    )
    op.create_table(
        "estimates",
        _of_result(),
        sa.Column("quantity", sa.Text, primary_key=True),
        sa.Column("value", sa.Double, nullable=False),
        sa.Column("std", sa.Double),
    )
    op.create_table(
        "budgets",
        _of_result(),
        sa.Column("quantity", sa.Text, primary_key=True),
        sa.Column("source", sa.Text, primary_key=True),
        sa.Column("std", sa.Double, nullable=False),
    )
    op.create_table("diagnoses", _of_result(), sa.Column("verdict", sa.Text, nullable=False))
    op.create_table(
        "causes",
        _of_result(),
        sa.Column("position", sa.Integer, primary_key=True),
        sa.Column("effect", sa.Text, nullable=False),
        sa.Column("specimen", sa.Text),
        sa.Column("probability", sa.Double, nullable=False),
        sa.Column("parameters", _JSON, nullable=False),
    )
