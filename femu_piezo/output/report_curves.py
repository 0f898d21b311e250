"""The charts of a report of an update: curves, residuals in σ, sensitivities."""

from __future__ import annotations

import numpy as np

from femu_piezo.material.constants import D_FORM
from femu_piezo.output.chart import Axis, Band, Chart, Series
from femu_piezo.output.curves import BASELINE, MEASURED, UPDATED, frequency_axis
from femu_piezo.output.impedance_charts import Curve, impedance_charts, view
from femu_piezo.output.sensitivity import COLOURS
from femu_piezo.study.results import Outcome

#: Constants whose sensitivity is below this share of the strongest are left out of the picture.
_SEEN = 1e-3
#: Root mean square of a residual over the noise above which it is told to be more than noise.
_LOUD = 1.3


def curve_charts(outcome: Outcome) -> list[Chart]:
    """|Z|, phase and the residual of the updated model in σ, zoomed together."""
    measured = outcome.measured
    spectrum = measured.spectrum
    factor, label, scale = frequency_axis(spectrum.frequency)
    x, name = spectrum.frequency * factor, measured.problem.specimen.name
    axis, group = Axis(label, log=scale == "log"), f"curves of {name}"
    curves = (
        Curve("measured", spectrum.impedance, MEASURED["color"], "points"),
        Curve("baseline", outcome.base_curve, BASELINE["color"], "dashed"),
        Curve("updated", outcome.updated_curve, UPDATED["color"], "line"),
    )
    held_out = measured.problem.specimen.measurement.held_out
    bands = () if held_out is None else (Band("x", held_out[0] * factor, held_out[1] * factor, "not used by the fit"),)
    residual = residual_in_sigma(outcome)
    return [
        *impedance_charts(x, axis, curves, group, bands, _views(outcome, factor)),
        Chart(
            axis,
            Axis("residual (σ)"),
            (
                Series("residual of log |Z|", x, residual.real, "#34495e", "points"),
                Series("residual of the phase", x, residual.imag, "#b07d2b", "points"),
            ),
            group,
            (*bands, Band("y", -1.96, 1.96, "95 % of noise alone", "#e8e8e8")),
            height=240,
            caption=_residual_words(outcome, residual),
        ),
    ]


def _views(outcome: Outcome, factor: float) -> dict[str, tuple[float, float]]:
    """The range around the fundamental, where the sweep reaches it."""
    pair, frequency = outcome.measured.pair, outcome.measured.spectrum.frequency
    span = pair.zero.frequency_Hz - pair.pole.frequency_Hz
    low, high = pair.pole.frequency_Hz - span, pair.zero.frequency_Hz + span
    return view("around the fundamental", low, high, frequency, factor)


def residual_in_sigma(outcome: Outcome) -> np.ndarray:
    """(n,) complex (log Z_updated − log Z_measured)/σ; Re and Im have unit variance where model and noise are right."""
    measured = outcome.measured
    sigma = measured.relative_noise_of(measured.spectrum)
    return np.sqrt(2.0) * np.log(outcome.updated_curve / measured.spectrum.impedance) / sigma


def _residual_words(outcome: Outcome, residual: np.ndarray) -> str:
    measured = outcome.measured
    if measured.noise_known:
        origin = "σ is the noise given with the data"
    elif measured.fitted.noise is not None:
        origin = "σ is estimated from the roughness of the readings"
    elif measured.extraction.noise is not None:
        origin = "σ is the noise that the extraction found, without any model of the body"
    else:
        origin = "the noise is unknown; σ is taken as 0.1 % of |Z|"
    rms, memory = np.sqrt(np.mean(np.abs(residual) ** 2) / 2), outcome.noise_memory
    if memory:
        origin += (
            f", whose correlation between neighbouring points ({memory.correlations[0]:.2f}) the fit takes into account"
        )
        residual = memory.whitened(residual)
    neighbours = float(np.sum((residual[1:] * residual[:-1].conj()).real) / np.sum(np.abs(residual) ** 2))
    if neighbours > max(0.2, 4 / np.sqrt(2 * residual.size)):
        verdict = (
            f"and neighbouring points are correlated {'beyond that ' * bool(memory)}({neighbours:.2f}): this is not "
            "noise but an error of the model or of the instrument that is smooth in frequency"
        )
    else:
        verdict = uncorrelated_words(rms)
    return f"{origin}. Root mean square of this residual: {rms:.3g} σ, {verdict}."


def uncorrelated_words(rms: float) -> str:
    """What a residual of uncorrelated points is, by its root mean square over the noise."""
    if rms > _LOUD:
        return "more than noise alone, without correlation of neighbouring points"
    return "compatible with noise alone"


def sensitivity_chart(outcome: Outcome) -> Chart:
    """|∂log Z/∂log θ| of each constant over the sweep (the paper's figure 3)."""
    result = outcome.sensitivity
    factor, label, scale = frequency_axis(result.frequency)
    size = np.abs(result.values)
    series = tuple(
        Series(name, result.frequency * factor, size[:, D_FORM.index(name)], COLOURS[name])
        for name in result.strongest()
        if size[:, D_FORM.index(name)].max() > _SEEN * size.max()
    )
    return Chart(
        Axis(label, log=scale == "log"),
        Axis("|∂ log Z / ∂ log θ|", log=True, limits=(float(_SEEN * size.max()), float(1.5 * size.max()))),
        series,
        f"sensitivity of {result.title}",
        views=_views(outcome, factor),
        height=360,
        caption="Relative change of Z for a relative change of each constant, at the updated constants: 2 means that "
        "a change of the constant by 1 % changes Z by 2 %. A constant without a curve has no visible effect.",
    )
