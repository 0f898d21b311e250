"""Version 2: which station wrote a result; indices for lists by lot, piece and time."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision, down_revision = "2", "1"


def upgrade() -> None:
    """Add the column and the indices; the station of older results is not known."""
    op.add_column("results", sa.Column("station", sa.Text))
    op.create_index("ix_results_lot_id", "results", ["lot_id"])
    op.create_index("ix_results_step_piece", "results", ["step", "piece"])
    op.create_index("ix_inputs_sweep_id", "inputs", ["sweep_id"])
    op.create_index("ix_sweeps_measured", "sweeps", ["measured"])
