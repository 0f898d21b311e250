"""`EquivalentCircuit`: branches for the modes of a sweep or a specimen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group
from rich.table import Table

from femu_piezo.circuits.circuit import Circuit
from femu_piezo.circuits.spice import spice_text
from femu_piezo.files import write_atomically
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.touchstone import touchstone_text
from femu_piezo.output.curves import GRID, MEASURED, UPDATED, draw_impedance, frequency_axis
from femu_piezo.output.folder import prepare_folder, write_figure, write_json
from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.output.results.result import Result
from femu_piezo.output.tables import note_lines, text_of
from femu_piezo.units import hertz, number

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

_PRINTED = {"L": (1e3, "L (mH)"), "R": (1.0, "R (Ω)"), "C": (1e12, "C (pF)"), "Rp": (1e-3, "Rp (kΩ)")}


class EquivalentCircuit(Result, Circuit):
    """What `circuit` returns: `branches`, `static` and the `impedance` of both together."""

    def table(self) -> RenderableType:
        """The elements of every branch with their deviations, the static elements parallel to them, and notes."""
        table = Table(title=f"{self.name}: equivalent circuit", title_justify="left")
        for heading in ("mode (Hz)", "Q", *(heading for _, heading in _PRINTED.values())):
            table.add_column(heading, justify="right")
        for branch in self.branches:
            cells = [f"{hertz(branch.frequency_Hz)}{' ?' if branch.doubtful else ''}", f"{branch.quality_factor:.5g}"]
            for key, (factor, _) in _PRINTED.items():
                std = branch.std.get(key)
                cells.append(number(branch.elements[key] * factor, None if std is None else std * factor))
            table.add_row(*cells)
        kinds = [part.kind for part in self.static]
        words = {"R": "R", "RC": "RC", "mode": "RLC of modes outside", "RLC": "RLC"}
        counts = ", ".join(f"{kinds.count(kind)} {word}" for kind, word in words.items() if kind in kinds)
        counts += ", of either sign" if "RLC" in kinds else ""
        static = ", ".join(filter(None, [f"C0 = {1e12 * self.static_capacitance:.6g} pF", counts]))
        static_words = f"beside the branches: {static} (circuit.cir)"
        return Group(table, text_of([static_words, *note_lines(self.notes)]))

    def plot(self, number: int | None = None) -> Figure:
        """|Z| and phase of the curve and of the circuit, and their difference."""
        figure = Picture(figsize=(8.0, 7.0), layout="constrained")
        magnitude, phase, misfit = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
        factor, label, scale = frequency_axis(self.frequency)
        x = self.frequency * factor
        draw_impedance(magnitude, phase, x, ((self.curve, "curve", MEASURED), (self.impedance, "circuit", UPDATED)))
        misfit.semilogy(x, 100 * np.abs(self.impedance / self.curve - 1), **UPDATED, label="from its curve")
        if self.sweep is not None:
            misfit.semilogy(x, 100 * np.abs(self.impedance / self.sweep - 1), **MEASURED, label="from the sweep")
            misfit.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)  # hides no point
        magnitude.set(xscale=scale, title=f"{as_it_stands(self.name)}: equivalent circuit")
        misfit.set(ylabel="difference (%)", xlabel=label)
        figure.legend(*magnitude.get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
        misfit.grid(True, **GRID)
        return figure

    def rows(self) -> list[dict[str, Any]]:
        """One row for each branch, SI."""
        return [
            {
                "frequency_Hz": one.frequency_Hz,
                "quality_factor": one.quality_factor,
                "residue_phase": one.residue_phase,
                "doubtful": one.doubtful,
                **one.elements,
                **{f"std_{key}": one.std.get(key) for key in one.elements},
            }
            for one in self.branches
        ]

    def save(self, folder: Path | str) -> Path:
        """Write circuit.json, circuit.cir (SPICE), circuit.s1p, circuit.csv (its curve), circuit.png; the folder."""
        out = prepare_folder(folder)
        write_figure(out / "circuit.png", self.plot())
        write_atomically(out / "circuit.cir", spice_text(self))
        write_spectrum(ImpedanceSpectrum(self.frequency, self.impedance), out / "circuit.csv")
        write_atomically(out / "circuit.s1p", touchstone_text(self.frequency, self.impedance))
        write_json(out / "circuit.json", self.to_json())
        return out
