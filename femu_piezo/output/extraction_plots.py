"""The picture of an extraction: curve and fit, residual in σ, stabilization diagrams of poles and zeros."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from femu_piezo.extraction.prony_ss import prony_ss
from femu_piezo.extraction.stabilization import StabilizationDiagram, rational_stabilization
from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.output.tables import with_deviations
from femu_piezo.units import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from femu_piezo.extraction import Extraction
    from femu_piezo.extraction.noise_level import NoiseUsed

DATA = {"color": "#222222", "marker": ".", "linestyle": "none", "markersize": 3.5}
FIT = {"color": "#c0392b", "linewidth": 1.3}
POLE, ZERO = "#1f6fb4", "#2a8a4a"
LABELLED = 6  # most resonances in the text
_LINE = 0.145  # inches of a line of the text


def extraction_figure(extraction: Extraction) -> Figure:
    """|Z| and phase with the fit, the residual in σ, and one stabilization diagram each for poles and zeros.

    Where nothing could be fitted, only the sweep and the reason. Blue marks poles, green zeros. The diagrams are those
    of the method used: Prony-SS, or rational least-squares fits of growing order for the maximum-likelihood method.
    """
    fitted, (factor, label) = extraction.model is not None, _frequency_unit(extraction)
    places = [["magnitude", "poles"], ["phase", "zeros"], ["residual", "text"]]
    if not fitted:
        places = [["magnitude", "text"], ["phase", "text"]]
    summary = _summary(extraction)
    heights = [3.2, 3.2, max(2.6, _LINE * (summary.count("\n") + 1))] if fitted else [3.0, 3.0]
    figure = Picture(figsize=(11.5, sum(heights)), layout="constrained")
    axes = figure.subplot_mosaic(places, gridspec_kw={"height_ratios": heights})
    for name in axes.keys() - {"magnitude", "text"}:
        axes[name].sharex(axes["magnitude"])
        axes[name].set_xlabel(label)
    _curves(extraction, axes["magnitude"], axes["phase"], factor)
    if fitted:
        _residual(extraction, axes["residual"], factor)
        for name, diagram in zip(("poles", "zeros"), _diagrams(extraction), strict=True):
            _stabilization(extraction, axes[name], diagram, name, factor)
    axes["magnitude"].set_xscale("log" if _is_wide(extraction) else "linear")
    axes["text"].axis("off")
    axes["text"].text(0.0, 1.0, summary, va="top", family="monospace", fontsize=8.5, transform=axes["text"].transAxes)
    words = f"poles and zeros ({extraction.method.replace('_', ' ')})" if fitted else "nothing could be extracted"
    figure.suptitle(f"{as_it_stands(Path(extraction.spectrum.source).name)}: {words}")
    return figure


def _frequency_unit(extraction: Extraction) -> tuple[float, str]:
    if extraction.spectrum.frequency[-1] >= 2e6:
        return 1e-6, "frequency (MHz)"
    return 1e-3, "frequency (kHz)"


def _is_wide(extraction: Extraction) -> bool:
    frequency = extraction.spectrum.frequency
    return bool(frequency[-1] > 100 * frequency[0])


def _mark(extraction: Extraction, axes: Axes, factor: float) -> None:
    for resonances, colour in ((extraction.resonances.poles, POLE), (extraction.resonances.zeros, ZERO)):
        for resonance in resonances:
            axes.axvline(resonance.frequency_Hz * factor, color=colour, linewidth=0.8, zorder=0)
    for doubtful in extraction.doubtful:
        colour = POLE if doubtful.kind == "pole" else ZERO
        axes.axvline(doubtful.frequency_Hz * factor, color=colour, linewidth=0.8, linestyle=":", zorder=0)


def _curves(extraction: Extraction, magnitude: Axes, phase: Axes, factor: float) -> None:
    spectrum = extraction.spectrum
    used = extraction.used if extraction.model is not None else np.ones(len(spectrum), bool)
    x = spectrum.frequency * factor
    magnitude.semilogy(x[used], np.abs(spectrum.impedance[used]), label="measured", **DATA)
    phase.plot(x[used], np.degrees(np.angle(spectrum.impedance[used])), **DATA)
    if not np.all(used):
        magnitude.semilogy(
            x[~used], np.abs(spectrum.impedance[~used]), "x", color="#e67e22", markersize=4, label="left out"
        )
    if extraction.model is not None:
        magnitude.semilogy(x, np.abs(extraction.impedance), label="fit", **FIT)
        phase.plot(x, np.degrees(np.angle(extraction.impedance)), **FIT)
        for axes in (magnitude, phase):
            _mark(extraction, axes, factor)
        magnitude.plot([], [], color=POLE, label="pole")
        magnitude.plot([], [], color=ZERO, label="zero")
    if extraction.doubtful:
        magnitude.plot([], [], color="#777777", linewidth=0.8, linestyle=":", label="doubtful")
    magnitude.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=6, frameon=False, fontsize=9)
    magnitude.set_ylabel("|Z| (Ω)")
    phase.set(ylabel="phase of Z (°)", yticks=np.arange(-180, 181, 90))


def _residual(extraction: Extraction, axes: Axes, factor: float) -> None:
    x = extraction.spectrum.frequency * factor
    for part, colour, name in (
        (extraction.residual.real, "#34495e", "real"),
        (extraction.residual.imag, "#b07d2b", "imaginary"),
    ):
        axes.plot(x, np.sqrt(2) * part, ".", color=colour, markersize=2.5, label=name)
    axes.axhspan(-1.96, 1.96, color="#e8e8e8", zorder=0, label="95 %")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8, markerscale=3)
    axes.set_ylabel("residual of Z (σ)")


def _diagrams(extraction: Extraction) -> tuple[StabilizationDiagram, StabilizationDiagram]:
    sweep = extraction.spectrum.select(extraction.used)
    if extraction.method == "prony_ss":
        return prony_ss(sweep, "pole").diagram, prony_ss(sweep, "zero").diagram
    return rational_stabilization(sweep)


def prony_figure(extraction: Extraction) -> Figure:
    """The steps of Prony-SS, as the paper's figures 10 to 13: the impulse responses whose exponentials are the poles
    and the zeros, the singular values of their Hankel matrices, and the stabilization diagrams.

    A response of a band away from zero frequency is complex; its magnitude is drawn.
    """
    figure = Picture(figsize=(13.5, 7.6), layout="constrained")
    axes = figure.subplots(2, 3, gridspec_kw={"width_ratios": [3, 1.6, 3]})
    sweep, (factor, label) = extraction.spectrum.select(extraction.used), _frequency_unit(extraction)
    for row, (kind, words) in enumerate((("pole", "Y/(jω)"), ("zero", "jωZ"))):
        decomposition, (impulse, singular, stable) = prony_ss(sweep, kind), axes[row]
        real, colour = np.isrealobj(decomposition.signal), POLE if kind == "pole" else ZERO
        for values, style in ((decomposition.signal, DATA), (decomposition.modelled, FIT)):
            shown = values if real else np.abs(values)
            impulse.plot(1e3 * decomposition.time, shown / np.max(np.abs(decomposition.signal)), **style)
        impulse.set(xlabel="time (ms)", ylabel=f"impulse response of {words}" + ("" if real else ", magnitude"))
        modes = len(decomposition.diagram.columns)
        impulse.set_title(
            f"{decomposition.signal.size} samples, {modes} mode{'s' * (modes != 1)} (line)", fontsize="medium"
        )
        singular.semilogy(decomposition.singular_values[:60] / decomposition.singular_values[0], ".", color=colour)
        singular.set(xlabel="number", ylabel="singular values of the Hankel matrix")
        _stabilization(extraction, stable, decomposition.diagram, f"{kind}s", factor)
        stable.set_xlabel(label)
    figure.suptitle(f"{as_it_stands(Path(extraction.spectrum.source).name)}: Prony-SS")
    return figure


def _stabilization(extraction: Extraction, axes: Axes, diagram: StabilizationDiagram, name: str, factor: float) -> None:
    spectrum, colour = extraction.spectrum, POLE if name == "poles" else ZERO
    frequency = np.sqrt(diagram.eigenvalue.real) / (2 * np.pi)
    low, high = spectrum.frequency[0], spectrum.frequency[-1]
    seen = (frequency >= low) & (frequency <= high)
    curve = axes.twinx()
    response = spectrum.admittance if name == "poles" else spectrum.impedance
    curve.semilogy(spectrum.frequency * factor, np.abs(response), color="#cccccc", linewidth=1.0)
    curve.set_ylabel("|Y| (S)" if name == "poles" else "|Z| (Ω)", color="#999999")
    axes.set_zorder(curve.get_zorder() + 1)
    axes.patch.set_visible(False)
    for chosen, style, legend in (
        (seen & ~diagram.stable, {"marker": "x", "color": "#b0b0b0", "markersize": 3.5}, "new"),
        (seen & diagram.stable, {"marker": "o", "color": colour, "markersize": 3.5}, "stable"),
    ):
        axes.plot(frequency[chosen] * factor, diagram.order[chosen], linestyle="none", label=legend, **style)
    for column in diagram.columns:
        at = np.sqrt(column.eigenvalue.real) / (2 * np.pi) * factor
        axes.axvline(at, color=colour, linewidth=0.8, linestyle="--", zorder=0)
    axes.plot([], [], color=colour, linewidth=0.8, linestyle="--", label="column")
    axes.set_ylabel(f"model order ({name})")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=9)


def _summary(extraction: Extraction) -> str:
    lines = [f"{'':5}{'frequency (Hz)':>22}{'loss η':>24}{'Q':>9}"] if extraction.model is not None else []
    every = extraction.resonances.poles + extraction.resonances.zeros + extraction.doubtful
    found = sorted(every, key=lambda r: r.frequency_Hz)
    for r in found[:LABELLED]:
        frequency, loss = (f"{r.frequency_Hz:.1f}", f"{r.loss:.5f}") if r.std_Hz is None else with_deviations(r)
        mark = "?" if r in extraction.doubtful else ""
        lines.append(f"{r.kind + mark:5}{frequency:>22}{loss:>24}{r.quality_factor:>9.1f}")
    if len(found) > LABELLED:
        lines.append(f"and {len(found) - LABELLED} more")
    for p in extraction.pairs[: LABELLED // 2]:
        if np.isfinite(p.k_eff):
            coupling = number(p.k_eff, None if np.isnan(p.std_k_eff) else p.std_k_eff)
            lines.append(f"k_eff {coupling}  ({p.pole.frequency_Hz:.0f} – {p.zero.frequency_Hz:.0f} Hz)")
    if extraction.noise is not None:
        lines.append(_noise_words(extraction.noise))
    lines += [line for note in extraction.notes for line in _wrapped(note, "! ")]
    lines += [line for remark in extraction.remarks for line in _wrapped(remark, "· ")]
    return "\n".join(lines)


def _noise_words(noise: NoiseUsed) -> str:
    if noise.origin == "misfit":
        return f"misfit of the fit, used as weight of the points: {100 * noise.relative:.2g} % of |Z|"
    return f"noise: {100 * noise.relative:.2g} % of |Z| and {noise.additive:.2g} Ω (from the {noise.origin})"


def _wrapped(sentence: str, mark: str) -> list[str]:
    return textwrap.wrap(sentence, 74, initial_indent=mark, subsequent_indent="  ")
