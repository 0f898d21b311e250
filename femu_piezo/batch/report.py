"""The report of a lot: statistics and figure."""

from __future__ import annotations

from pathlib import Path

from femu_piezo.batch.lot import Lot, lot_of, lot_text
from femu_piezo.batch.lot_figure import lot_figure
from femu_piezo.batch.run import LotResult
from femu_piezo.files import write_atomically
from femu_piezo.output.folder import write_figure, write_json


def write_report(result: LotResult, out: Path) -> Lot:
    """Write lot.json, lot.txt and lot.png; returns the statistics of the rows."""
    lot = lot_of(result.rows, result.same)
    write_json(out / "lot.json", lot.to_json())
    write_atomically(out / "lot.txt", lot_text(lot))
    write_figure(out / "lot.png", lot_figure(lot), dots_per_inch=110)
    return lot
