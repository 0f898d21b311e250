"""`femu-piezo lots`: what a database holds, lots compared, control charts, drift; all of it as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table

from femu_piezo.batch.table import as_parquet, columns_of
from femu_piezo.errors import InputError
from femu_piezo.files import write_atomically
from femu_piezo.output.curves import PRINTED
from femu_piezo.output.folder import prepare_folder, write_figure, write_json
from femu_piezo.store.control import FEWEST, Control, controls
from femu_piezo.store.database import Database
from femu_piezo.store.figure import lots_figure
from femu_piezo.store.read import STORE_COLUMNS, read_pieces
from femu_piezo.units import signed

#: Drift, scatter and differences of lots are printed in % of the mean.
_PERCENT = 100.0
#: Quantities in one table of lots.
_COLUMNS = 5


def show_lots(
    store: str, out: Path | None = None, lots: Sequence[str] = (), quantities: Sequence[str] = ()
) -> RenderableType:
    """The tables of the lots of a database, for rich; with `out` also lots.parquet, lots.json and lots.png there.

    Parameters
    ----------
    store : address, see `Database`
    lots : names of those wanted, all where there are none
    quantities : columns to chart; constants, tangents, k_eff and misfit where there are none

    Raises
    ------
    InputError : the database cannot be read, or has no such lot or quantity
    """
    database = Database(store, Path.cwd(), make=False)
    try:
        rows = read_pieces(database, lots)
    finally:
        database.close()
    _check(database.shown, rows, lots, quantities)
    charts = controls(rows, quantities)
    if out is not None:
        prepare_folder(out)
        write_atomically(out / "lots.parquet", as_parquet(rows, [*STORE_COLUMNS, *columns_of(rows)]))
        found = {name: _counted(members) for name, members in _by_lot(rows).items()}
        write_json(out / "lots.json", {"lots": found, "quantities": {one.quantity: one.to_json() for one in charts}})
        write_figure(out / "lots.png", lots_figure(charts), dots_per_inch=110)
    compared = [_comparison(charts[start : start + _COLUMNS]) for start in range(0, len(charts), _COLUMNS)]
    return Group(_lots_table(rows), *compared, _charts_table(charts))


def _check(store: str, rows: list[dict[str, Any]], lots: Sequence[str], quantities: Sequence[str]) -> None:
    missing = set(lots) - {row["lot"] for row in rows}
    if not rows and not lots:
        raise InputError(
            f"--store {store}: the store holds no piece yet; run batch, update, measure or diagnose with this --store"
        )
    if missing:
        raise InputError(
            f"--lot {sorted(missing)[0]}: the store {store} has no such lot; femu-piezo lots without --lot lists them"
        )
    numbers = {name for row in rows for name, value in row.items() if isinstance(value, (int, float))}
    for name in quantities:
        if name not in numbers:
            raise InputError(
                f"--quantity {name}: no piece has a quantity of this name; give one such as s11, s11_tan or k_eff"
            )


def _by_lot(rows: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Lot → its rows, the lots in the order of their first piece."""
    found: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(row["lot"], []).append(row)
    return found


def _counted(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Numbers of pieces, times, stations and programs of a lot, JSON types."""
    times = [row["measured"] for row in rows]
    return {
        "pieces": len(rows),
        "ok": sum(row["status"] == "ok" for row in rows),
        "failed": sum(row["status"] != "ok" for row in rows),
        "diagnosed": sum(row.get("verdict") is not None for row in rows),
        "first": min(times).isoformat(),
        "last": max(times).isoformat(),
        "stations": sorted({row["station"] for row in rows if row["station"]}),
        "programs": sorted({row["program"] for row in rows}),
    }


def _lots_table(rows: Sequence[dict[str, Any]]) -> Table:
    """One row for each lot: numbers of pieces, days, stations and programs."""
    table = Table(title="lots", title_justify="left")
    table.add_column("lot")
    for heading in ("pieces", "refused", "diagnosed", "measured (UTC)"):
        table.add_column(heading, justify="right")
    for heading in ("stations", "programs"):
        table.add_column(heading)
    for name, members in _by_lot(rows).items():
        one = _counted(members)
        days = " … ".join(dict.fromkeys((one["first"][:10], one["last"][:10])))
        numbers = [str(one[key]) for key in ("pieces", "failed", "diagnosed")]
        table.add_row(name, *numbers, days, ", ".join(one["stations"]), ", ".join(one["programs"]))
    return table


def _comparison(charts: Sequence[Control]) -> Table:
    """One row for each lot: how far its mean is from that of all pieces, with the deviation of the mean."""
    title = "difference of a lot from the mean of all pieces, % (* beyond 3 σ of the scatter within lots)"
    table = Table(title=title, title_justify="left")
    table.add_column("lot")
    for one in charts:
        table.add_column(one.quantity, justify="right")
    for name in dict.fromkeys(name for one in charts for name in one.means.lots):
        table.add_row(name, *(_difference(one, name) for one in charts))
    return table


def _difference(control: Control, lot: str) -> str:
    means = control.means
    if lot not in means.lots or not means.centre:
        return "-"
    index = means.lots.index(lot)
    to_percent = _PERCENT / means.centre  # of a negative constant, its magnitude counts
    difference = signed(to_percent * (means.mean[index] - means.centre), ".2f")
    if means.within is None:
        return difference
    mark = "*" if index in means.beyond else ""
    return f"{difference} ± {abs(to_percent) * means.within / np.sqrt(means.count[index]):.2f}{mark}"


def _charts_table(charts: Sequence[Control]) -> Table:
    title = "control limits of single pieces, scatter within and between lots, drift (* significant)"
    table = Table(title=title, title_justify="left")
    for heading in ("quantity", "unit"):
        table.add_column(heading)
    for heading in ("mean", "limits", "beyond", "within", "between", "per month"):
        table.add_column(heading, justify="right")
    for control in charts:
        factor, unit = PRINTED.get(control.quantity, (1.0, ""))
        single, means, drift = control.individuals, control.means, control.drift
        limits = "-" if single is None else " … ".join(f"{factor * limit:.4g}" for limit in single.limits)
        table.add_row(
            control.quantity,
            unit,
            f"{factor * means.centre:.5g}",
            limits,
            f"needs {FEWEST}" if single is None else f"{len(single.beyond)} of {control.values.size}",
            _in_percent(means.within, means.centre),
            _in_percent(drift.between if drift is not None and drift.of_lots else None, means.centre),
            "-" if drift is None or not means.centre else drift.in_percent(means.centre) + "*" * drift.significant,
        )
    return table


def _in_percent(size: float | None, centre: float) -> str:
    """A deviation in % of the mean, "-" where either is missing or the mean is zero."""
    return "-" if size is None or not centre else f"{_PERCENT * size / abs(centre):.2g} %"
