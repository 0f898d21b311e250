"""What is computed for one job: each step turns specimens into columns of the table and a full record.

A new step (a diagnosis, say) is one function here and its name in `STEPS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from femu_piezo.output.records import update_record
from femu_piezo.specimen import CONSTANTS, Specimen
from femu_piezo.study.bases import Bases
from femu_piezo.study.update import update

Value = float | int | str | None
#: Specimens of one job, and where bases come from → columns of the table, record in JSON types.
Step = Callable[[list[Specimen], Bases], tuple[dict[str, Value], dict]]

#: Columns that `update` fills, in the order of the table; of the constants those that some job frees.
CONSTANT_COLUMNS = tuple(f"{name}{part}" for name in CONSTANTS for part in ("", "_std", "_tan", "_tan_std"))
UPDATE_COLUMNS = (
    *CONSTANT_COLUMNS,
    "pole_Hz",
    "pole_loss",
    "zero_Hz",
    "zero_loss",
    "k_eff",
    "rms_log_error",
    "iterations",
    "method",
    "notes",
)


def _update(specimens: list[Specimen], bases: Bases) -> tuple[dict[str, Value], dict]:
    """The constants with their standard deviations (SI), the fundamental of the first specimen, the misfit."""
    result = update(specimens, bases=bases)
    first = result.outcomes[0]
    columns: dict[str, Value] = {}
    for name, estimate in result.parameters.items():
        columns |= {name: estimate.value, f"{name}_std": estimate.std}
        columns |= {f"{name}_tan": estimate.tan, f"{name}_tan_std": estimate.tan_std}
    pair = first.measured.pair
    columns |= {"pole_Hz": pair.pole.frequency_Hz, "pole_loss": pair.pole.loss}
    columns |= {"zero_Hz": pair.zero.frequency_Hz, "zero_loss": pair.zero.loss, "k_eff": pair.k_eff}
    columns |= {"rms_log_error": first.rms_after, "iterations": result.iterations, "method": result.method}
    columns["notes"] = " · ".join(result.notes)
    return {name: finite(value) for name, value in columns.items()}, finite(update_record(result))


STEPS: dict[str, Step] = {"update": _update}


def finite(value):
    """The same JSON value with None for NaN and infinity, and plain numbers for those of numpy."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
