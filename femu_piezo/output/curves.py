"""Pictures of impedance curves and of the iteration (matplotlib, no display)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from femu_piezo.material.constants import EPS0
from femu_piezo.output.picture import Picture, as_it_stands

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from femu_piezo.study.results import Outcome
    from femu_piezo.study.simulate import SimulationResult

MEASURED = {"color": "#222222", "marker": ".", "linestyle": "none", "markersize": 3.5}
BASELINE = {"color": "#8c8c8c", "linewidth": 1.2, "linestyle": "--"}
UPDATED = {"color": "#c0392b", "linewidth": 1.3}
GRID = {"color": "#e6e6e6", "linewidth": 0.6}

#: How each constant is printed: factor from SI, unit.
PRINTED = {
    **{name: (1e12, "10⁻¹² m²/N") for name in ("s11", "s12", "s13", "s33", "s44")},
    **{name: (1e12, "10⁻¹² C/N") for name in ("d31", "d33", "d15")},
    **{name: (1 / EPS0, "ε₀") for name in ("eps11T", "eps33T")},
}


def frequency_axis(frequency: np.ndarray) -> tuple[float, str, str]:
    """Factor, label and scale of a frequency axis: logarithmic over more than two decades."""
    scale = "log" if frequency[-1] > 100 * frequency[0] else "linear"
    if frequency[-1] >= 2e6:
        return 1e-6, "frequency (MHz)", scale
    return 1e-3, "frequency (kHz)", scale


def draw_impedance(
    magnitude: Axes, phase: Axes, x: np.ndarray, curves: Iterable[tuple[np.ndarray, str, Mapping]]
) -> None:
    """|Z| and phase of curves (impedance (k,) in ohm, name, style of the line) over x (k,)."""
    for impedance, name, style in curves:
        magnitude.semilogy(x, np.abs(impedance), label=name, **style)
        phase.plot(x, np.degrees(np.angle(impedance)), **style)
    magnitude.set(ylabel="|Z| (Ω)")
    phase.set(ylabel="phase of Z (°)", yticks=[-90, -45, 0, 45, 90])
    for axes in (magnitude, phase):
        axes.grid(True, **GRID)


def impedance_figure(outcome: Outcome) -> Figure:
    """Measured, baseline and updated |Z| and phase, and the relative misfit of both models."""
    figure = Picture(figsize=(8.0, 8.0), layout="constrained")
    magnitude, phase, misfit = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
    spectrum, specimen = outcome.measured.spectrum, outcome.measured.problem.specimen
    factor, label, scale = frequency_axis(spectrum.frequency)
    x = spectrum.frequency * factor
    curves = (
        (spectrum.impedance, "measured", MEASURED),
        (outcome.base_curve, "baseline", BASELINE),
        (outcome.updated_curve, "updated", UPDATED),
    )
    draw_impedance(magnitude, phase, x, curves)
    for impedance, name, style in curves[1:]:
        misfit.semilogy(x, 100 * np.abs(np.log(impedance / spectrum.impedance)), label=name, **style)
    held_out = specimen.measurement.held_out
    if held_out is not None:
        for axes in (magnitude, phase, misfit):
            axes.axvspan(held_out[0] * factor, held_out[1] * factor, color="#f3e6c4", zorder=0)
    magnitude.set(xscale=scale, title=f"{as_it_stands(specimen.name)}: impedance, measured and simulated")
    misfit.set(ylabel="|Δ log Z| (%)", xlabel=label)
    figure.legend(*magnitude.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    misfit.grid(True, **GRID)
    return figure


def iteration_figure(outcome: Outcome, names: tuple[str, ...]) -> Figure:
    """Distance of the model's pole and zero from the measured ones, and the constants, over the iterations."""
    figure = Picture(figsize=(8.0, 6.0), layout="constrained")
    distance, values = figure.subplots(2, 1, sharex=True)
    steps = np.arange(len(outcome.history))
    pair = outcome.measured.pair
    measured = np.array([pair.pole.eigenvalue, pair.zero.eigenvalue])
    error = np.array([np.abs(step.eigenvalues / measured - 1) for step in outcome.history])
    for column, (name, marker) in enumerate((("pole", "o-"), ("zero", "s-"))):
        distance.semilogy(steps, error[:, column], marker, label=name, markersize=4)
    for number, name in enumerate(names):
        moving, style = np.array([getattr(step.constants, name) for step in outcome.history]), {"color": f"C{number}"}
        values.plot(steps, moving.real / moving[-1].real, "o-", label=f"Re {name}", markersize=4, **style)
        if moving[-1].imag:
            values.plot(steps, moving.imag / moving[-1].imag, "s:", label=f"Im {name}", markersize=4, **style)
    title = f"{as_it_stands(outcome.measured.problem.specimen.name)}: pole-zero iteration, λ = ω²(1 + jη)"
    distance.set(ylabel="|λ − λ measured| / |λ|", title=title)
    values.set(ylabel="constant / its final value", xlabel="iteration")
    for axes in (distance, values):
        axes.grid(True, **GRID)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    values.xaxis.get_major_locator().set_params(integer=True)
    return figure


def simulation_figure(result: SimulationResult) -> Figure:
    """Simulated |Z| and phase with poles and zeros marked."""
    figure = Picture(figsize=(8.0, 5.5), layout="constrained")
    magnitude, phase = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    spectrum = result.spectrum
    factor, label, scale = frequency_axis(spectrum.frequency)
    magnitude.semilogy(spectrum.frequency * factor, np.abs(spectrum.impedance), **UPDATED)
    phase.plot(spectrum.frequency * factor, np.degrees(np.angle(spectrum.impedance)), **UPDATED)
    for resonances, marker, name in ((result.poles, "v", "poles"), (result.zeros, "^", "zeros")):
        frequency = np.array([resonance.frequency_Hz for resonance in resonances])
        height = np.interp(frequency, spectrum.frequency, np.abs(spectrum.impedance))
        magnitude.plot(frequency * factor, height, marker, color="#1f4e79", markersize=6, label=name, linestyle="none")
    magnitude.set(ylabel="|Z| (Ω)", xscale=scale, title=f"{as_it_stands(result.specimen.name)}: simulated impedance")
    phase.set(ylabel="phase of Z (°)", xlabel=label, yticks=[-90, -45, 0, 45, 90])
    figure.legend(*magnitude.get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    for axes in (magnitude, phase):
        axes.grid(True, **GRID)
    return figure
