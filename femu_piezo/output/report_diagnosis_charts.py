"""The charts of a diagnosis: residuals in σ before and after, |Z| and phase, zoomed together."""

from __future__ import annotations

import numpy as np

from femu_piezo.output.chart import Axis, Band, Chart, Series
from femu_piezo.output.curves import BASELINE, MEASURED, UPDATED, frequency_axis
from femu_piezo.output.impedance_charts import Curve, impedance_charts, view
from femu_piezo.output.report_curves import uncorrelated_words
from femu_piezo.output.wording import names_of, sentence_case
from femu_piezo.study.diagnose import Diagnosis


def models(result: Diagnosis) -> tuple[Curve, ...]:
    """The curve of the base model and, where the verdict adds effects to it, that of the final model."""
    base = Curve("base model, updated", result.curves[0], BASELINE["color"], "dashed")
    if not result.verdict.extension:
        return (base,)
    return (base, Curve(f"with {names_of(result.verdict.extension)}", result.curves[1], UPDATED["color"], "line"))


def _axis(result: Diagnosis) -> tuple[np.ndarray, float, Axis, str]:
    """Frequencies (k,) in the unit of the axis, factor from Hz to it, the axis, and the group of the charts."""
    factor, label, scale = frequency_axis(result.spectrum.frequency)
    return result.spectrum.frequency * factor, factor, Axis(label, log=scale == "log"), "sweep"


def _bands(result: Diagnosis, factor: float) -> tuple[Band, ...]:
    unseen = result.spectrum.frequency[~result.fitted] * factor
    return (Band("x", float(unseen[0]), float(unseen[-1]), "not used by the fit"),) if unseen.size else ()


def _views(result: Diagnosis, factor: float) -> dict[str, tuple[float, float]]:
    """Ranges of frequency: around the fundamental, and where the misfit of the base model is largest."""
    frequency, views = result.spectrum.frequency, {}
    width = 0.15 * result.reference_Hz
    low, high = result.reference_Hz - width, result.reference_Hz + width
    views |= view("around the fundamental", low, high, frequency, factor)
    if result.verdict.before.worst_Hz:
        first, last = result.verdict.before.worst_Hz[0]
        room = 0.5 * (last - first)
        views |= view("where the base model fails most", first - room, last + room, frequency, factor)
    return views


def residual_charts(result: Diagnosis) -> list[Chart]:
    """log |Z| and phase of simulated over measured, in σ, before and after."""
    x, factor, axis, group = _axis(result)
    sigma, charts = result.relative_noise / np.sqrt(2), []
    for index, curve in enumerate(models(result)):
        error = np.log(curve.impedance / result.spectrum.impedance) / sigma
        remaining = (result.verdict.before, result.verdict.after)[index]
        rms = float(np.sqrt(np.mean(np.abs(error) ** 2) / 2))
        judged = uncorrelated_words(rms)
        if remaining.structured:
            judged = "beyond noise, in size or in correlation of neighbouring points"
        charts.append(
            Chart(
                axis,
                Axis("residual (σ)"),
                (
                    Series("log |Z|", x, error.real, "#1f4e79", "points"),
                    Series("phase", x, error.imag, "#d98032", "points"),
                ),
                group,
                (*_bands(result, factor), Band("y", -1.96, 1.96, "95 % of noise alone", "#e3ece3")),
                _views(result, factor) if index == 0 else {},
                height=250,
                caption=f"{sentence_case(curve.words)}: root mean square {rms:.3g} σ; {judged}.",
            )
        )
    return charts


def curve_charts(result: Diagnosis) -> list[Chart]:
    """|Z| and phase, measured and simulated."""
    x, factor, axis, group = _axis(result)
    curves = (Curve("measured", result.spectrum.impedance, MEASURED["color"], "points"), *models(result))
    return impedance_charts(x, axis, curves, group, _bands(result, factor))
