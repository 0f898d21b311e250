"""Unknowns and their priors: means and deviations, causes as tolerances whose prior is widened, and priors in the
fit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laboratory import CONSTANTS, FREE, FREQUENCY, TOLERANCES, shifted

from femu_piezo.inference.fit import fit
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior


def column(unknowns: Unknowns, name: str) -> int:
    """Place of a named unknown in x."""
    return unknowns.names.index(name)


def test_priors_are_those_of_the_file_wherever_the_fit_starts(lab):
    """The start of the fit scales an unknown, but its prior is centred on the value of the file.

    A tangent without a stated accuracy has the prior 0.02 ± 0.05.
    """
    file = FreeConstants.of(CONSTANTS, FREE)
    away = file.at(file.start * np.array([1.2, 0.8, 1.1]))
    prior = material_prior(file, {"s11": 0.02}, {"d31": 0.004})
    unknowns = Unknowns(MaterialParameters.around(away, away.start), prior)
    scale = unknowns.material.scale
    np.testing.assert_allclose(unknowns.prior_mean[0::2] * scale, file.start.real, rtol=1e-12)
    np.testing.assert_allclose(
        unknowns.prior_std[0::2] * np.abs(scale), np.abs(file.start.real) * [0.02, 0.5, 0.5], rtol=1e-12
    )
    np.testing.assert_allclose(unknowns.prior_mean[1::2], [0.02, CONSTANTS.tangent("d31"), 0.02], rtol=1e-12)
    np.testing.assert_allclose(unknowns.prior_std[1::2], [0.05, 0.004, 0.05], rtol=1e-12)


def test_what_has_a_tolerance_is_in_every_fit_and_nothing_else(lab):
    """Each quantity with a tolerance is an unknown once, with that deviation and a prior mean of zero; leakage and
    laws have none.
    """
    names = lab.unknowns.names
    assert len(set(names)) == len(names) == lab.unknowns.count
    std = lab.unknowns.prior_std[lab.unknowns.of_material :] * lab.unknowns.scale
    found = dict(zip(names[lab.unknowns.of_material :], std, strict=True))
    for name in ("length", "width", "thickness", "density"):
        assert found[f"wrong_{name}.relative_error"] == pytest.approx(TOLERANCES[name])
    for constant in ("s12", "s44", "eps11T"):
        key = f"wrong_insensitive_parameter:{constant}"
        assert found[f"{key}.{constant}"] == pytest.approx(0.03)
        assert found[f"{key}.tan_{constant}"] == pytest.approx(0.003)
    assert found["series_resistance.resistance"] == pytest.approx(0.02)
    assert found["series_inductance.inductance"] == pytest.approx(10e-9, rel=1e-6, abs=0)
    assert found["stray_capacitance.capacitance"] == pytest.approx(0.1e-12, rel=1e-6, abs=0)
    bells = [value for name, value in found.items() if name.startswith("instrument.")]
    assert bells and bells == [1.0] * len(bells)
    assert not {name.partition(":")[2].partition(".")[0] for name in names} & set(FREE)
    assert not [name for name in names if name.startswith(("leakage", "dielectric", "frequency", "electrode"))]
    assert np.all(lab.unknowns.prior_mean[lab.unknowns.of_material :] == 0)


def test_the_instrument_errs_by_its_accuracy_and_smoothly(lab):
    """Prior covariance of log |Z| and of phase between all frequencies: variance of the stated accuracy, correlation
    exp(−½ (difference in decades)²).
    """
    number = lab.unknowns.index("instrument")
    columns = lab.unknowns.columns(number)
    _, slopes = lab.evaluation.with_jacobian(lab.unknowns, lab.unknowns.prior_mean)
    z = lab.evaluation.impedance(lab.unknowns, lab.unknowns.prior_mean)
    rows = slopes[:, columns] / z[:, None] * lab.unknowns.prior_std[columns]
    for part in (rows.real, rows.imag):
        covariance = part @ part.T / 8e-4**2
        decades = np.log10(FREQUENCY)
        assert np.max(np.abs(covariance - np.exp(-0.5 * (decades[:, None] - decades) ** 2))) < 0.03


def test_a_cause_replaces_the_tolerance_by_its_usual_size(lab):
    """wrong_length as a candidate has its usual size as prior deviation in place of the calliper's; without it the
    calliper's is back.
    """
    effect = lab.library["wrong_length"]
    widened = lab.unknowns.with_candidate(effect)
    assert widened.names == lab.unknowns.names and widened.candidates == ("wrong_length",)
    columns = widened.columns(widened.index("wrong_length"))
    changed = np.flatnonzero(widened.prior_std != lab.unknowns.prior_std)
    assert changed.tolist() == [columns.start]
    assert widened.prior_std[columns] * effect.scale == pytest.approx(effect.spread)
    back = widened.without_candidate("wrong_length")
    assert back.names == lab.unknowns.names and back.candidates == ()
    np.testing.assert_array_equal(back.prior_std, lab.unknowns.prior_std)


def test_a_cause_without_a_tolerance_adds_an_unknown(lab):
    """And takes it away again; the other unknowns keep their values."""
    leak = lab.library["leakage"]
    with_leak = lab.unknowns.with_candidate(leak)
    assert with_leak.names == (*lab.unknowns.names, "leakage.conductance") and with_leak.causes == (leak,)
    x = np.arange(lab.unknowns.count, dtype=float)
    np.testing.assert_array_equal(with_leak.carried(lab.unknowns, x), [*x, 0.0])
    without_leak = with_leak.without_candidate("leakage")
    assert without_leak.names == lab.unknowns.names
    np.testing.assert_array_equal(without_leak.carried(with_leak, np.append(x, 7.0)), x)


def test_a_held_constant_as_a_cause_keeps_the_tolerance_of_its_tangent(lab):
    """Only the value gets the wide prior of a cause."""
    effect = lab.library["wrong_insensitive_parameter:s12"]
    widened = lab.unknowns.with_candidate(effect)
    columns = widened.columns(widened.index(effect.key))
    assert widened.prior_std[columns] * effect.scale == pytest.approx([0.12, 0.003])


def test_data_without_information_leave_the_prior(lab):
    """With relative noise of 1e5, the fit returns means and deviations of the prior."""
    z = lab.evaluation.impedance(lab.unknowns, lab.truth(1))
    data = replace(lab.measured(z, 1), relative_noise=np.full(z.size, 1e5))
    found = fit(lab.evaluation, data, lab.unknowns, [lab.truth(2)])
    assert np.max(np.abs(found.x - lab.unknowns.prior_mean) / lab.unknowns.prior_std) < 1e-4
    np.testing.assert_allclose(found.std, lab.unknowns.prior_std, rtol=1e-4)
    assert found.determined < 1e-4


def test_a_prior_and_the_data_are_weighted_by_their_precisions(lab):
    """A prior of s11 three deviations from what the data say, half as wide: the estimate is the mean weighted by
    precisions.
    """
    truth = lab.truth(5)
    data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), 5)
    free = fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean])
    name = "s11"
    place, size = column(lab.unknowns, name), free.std[0]
    wanted = free.x[place] + 3 * size
    mean, std = wanted * lab.material.scale[0], 0.5 * size * lab.material.scale[0]
    known = replace(lab.unknowns, prior={**lab.unknowns.prior, name: (mean, std)})
    held = fit(lab.evaluation, data, known, [free.x])
    of_data, of_prior = 1 / size**2 - 1 / lab.unknowns.prior_std[place] ** 2, 1 / (0.5 * size) ** 2
    assert held.std[place] == pytest.approx((of_data + of_prior) ** -0.5, rel=2e-2)
    data_alone = (
        free.x[place] / size**2 - lab.unknowns.prior_mean[place] / lab.unknowns.prior_std[place] ** 2
    ) / of_data
    assert held.x[place] == pytest.approx(
        (of_data * data_alone + of_prior * wanted) / (of_data + of_prior), abs=0.02 * size
    )


def test_a_shifted_prior_mean_is_that_of_the_unknown(lab):
    """The helper `shifted` moves one prior mean by the given number of deviations and changes nothing else."""
    for index in (0, 3, 6, 9, lab.unknowns.count - 1):
        other = shifted(lab.unknowns, index, 2.0)
        moved = (other.prior_mean - lab.unknowns.prior_mean) / lab.unknowns.prior_std
        assert moved == pytest.approx(2.0 * np.eye(lab.unknowns.count)[index], abs=1e-9)
        np.testing.assert_allclose(other.prior_std, lab.unknowns.prior_std)
