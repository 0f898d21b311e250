"""Every number is an unknown with a prior: means, deviations, causes that are lifted tolerances, priors in the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laboratory import CONSTANTS, FREE, FREQUENCY, TOLERANCES, shifted

from femu_piezo.inference.fit import fit
from femu_piezo.inference.unknowns import FreeConstants, MaterialParameters, Unknowns, material_prior


def column(unknowns: Unknowns, name: str) -> int:
    return unknowns.names.index(name)


def test_priors_are_those_of_the_file_wherever_the_fit_starts(lab):
    """The scale of an unknown is its start; its prior is about the file's value, a tangent's 0.02 if not known."""
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
    """Each tolerance stands once, with its own deviation and its mean at rest; leakage and laws have none."""
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
    assert found["series_inductance.inductance"] == pytest.approx(10e-9)
    assert found["stray_capacitance.capacitance"] == pytest.approx(0.1e-12)
    bells = [value for name, value in found.items() if name.startswith("instrument.")]
    assert bells and bells == [1.0] * len(bells)
    assert not {name.partition(":")[2].partition(".")[0] for name in names} & set(FREE)
    assert not [name for name in names if name.startswith(("leakage", "dielectric", "frequency", "electrode"))]
    assert np.all(lab.unknowns.prior_mean[lab.unknowns.of_material :] == 0)


def test_the_instrument_errs_by_its_accuracy_and_smoothly(lab):
    """Standard deviation of log |Z| and phase at every frequency, and how neighbours go together, over the prior."""
    number = lab.unknowns.index("instrument")
    own = lab.unknowns.columns(number)
    _, slopes = lab.evaluation.with_jacobian(lab.unknowns, lab.unknowns.prior_mean)
    z = lab.evaluation.impedance(lab.unknowns, lab.unknowns.prior_mean)
    rows = slopes[:, own] / z[:, None] * lab.unknowns.prior_std[own]
    for part in (rows.real, rows.imag):
        covariance = part @ part.T / 8e-4**2
        decades = np.log10(FREQUENCY)
        assert np.max(np.abs(covariance - np.exp(-0.5 * (decades[:, None] - decades) ** 2))) < 0.03


def test_a_cause_is_a_tolerance_that_is_lifted(lab):
    """wrong_length in the place of the length, at its usual size; taken back it is the calliper's again."""
    effect = lab.library["wrong_length"]
    lifted = lab.unknowns.with_candidate(effect)
    assert lifted.names == lab.unknowns.names and lifted.candidates == ("wrong_length",)
    own = lifted.columns(lifted.index("wrong_length"))
    changed = np.flatnonzero(lifted.prior_std != lab.unknowns.prior_std)
    assert changed.tolist() == [own.start]
    assert lifted.prior_std[own] * effect.scale == pytest.approx(effect.spread)
    back = lifted.without_candidate("wrong_length")
    assert back.names == lab.unknowns.names and back.candidates == ()
    np.testing.assert_array_equal(back.prior_std, lab.unknowns.prior_std)


def test_a_cause_without_a_tolerance_comes_and_goes(lab):
    leak = lab.library["leakage"]
    more = lab.unknowns.with_candidate(leak)
    assert more.names == (*lab.unknowns.names, "leakage.conductance") and more.causes == (leak,)
    x = np.arange(lab.unknowns.count, dtype=float)
    np.testing.assert_array_equal(more.carried(lab.unknowns, x), [*x, 0.0])
    less = more.without_candidate("leakage")
    assert less.names == lab.unknowns.names
    np.testing.assert_array_equal(less.carried(more, np.append(x, 7.0)), x)


def test_only_the_value_of_a_held_constant_is_lifted(lab):
    """The tangent keeps its tolerance where the constant is a cause."""
    effect = lab.library["wrong_insensitive_parameter:s12"]
    lifted = lab.unknowns.with_candidate(effect)
    own = lifted.columns(lifted.index(effect.key))
    assert lifted.prior_std[own] * effect.scale == pytest.approx([0.12, 0.003])


def test_data_that_say_nothing_leave_the_prior(lab):
    """Where the noise is a factor of e^100000 the fit is the prior."""
    z = lab.evaluation.impedance(lab.unknowns, lab.truth(1))
    data = replace(lab.measured(z, 1), relative_noise=np.full(z.size, 1e5))
    found = fit(lab.evaluation, data, lab.unknowns, [lab.truth(2)])
    assert np.max(np.abs(found.x - lab.unknowns.prior_mean) / lab.unknowns.prior_std) < 1e-4
    np.testing.assert_allclose(found.std, lab.unknowns.prior_std, rtol=1e-4)
    assert found.determined < 1e-4


def test_a_prior_pulls_by_its_weight_and_data_by_theirs(lab):
    """A known s11 that is three of its deviations beside what the data say: between the two, by the precisions."""
    truth = lab.truth(5)
    data = lab.measured(lab.evaluation.impedance(lab.unknowns, truth), 5)
    free = fit(lab.evaluation, data, lab.unknowns, [lab.unknowns.prior_mean])
    name = "s11"
    own, size = column(lab.unknowns, name), free.std[0]
    wish = free.x[own] + 3 * size
    mean, std = wish * lab.material.scale[0], 0.5 * size * lab.material.scale[0]
    known = replace(lab.unknowns, prior={**lab.unknowns.prior, name: (mean, std)})
    held = fit(lab.evaluation, data, known, [free.x])
    before, after = 1 / size**2 - 1 / lab.unknowns.prior_std[own] ** 2, 1 / (0.5 * size) ** 2
    assert held.std[own] == pytest.approx((before + after) ** -0.5, rel=2e-2)
    data_alone = (free.x[own] / size**2 - lab.unknowns.prior_mean[own] / lab.unknowns.prior_std[own] ** 2) / before
    assert held.x[own] == pytest.approx((before * data_alone + after * wish) / (before + after), abs=0.02 * size)


def test_a_shifted_prior_mean_is_that_of_the_unknown(lab):
    """The helper of other tests: one mean moves, by deviations; nothing else does."""
    for index in (0, 3, 6, 9, lab.unknowns.count - 1):
        other = shifted(lab.unknowns, index, 2.0)
        moved = (other.prior_mean - lab.unknowns.prior_mean) / lab.unknowns.prior_std
        assert moved == pytest.approx(2.0 * np.eye(lab.unknowns.count)[index], abs=1e-9)
        np.testing.assert_allclose(other.prior_std, lab.unknowns.prior_std)
