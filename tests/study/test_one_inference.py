"""`update` and `diagnose` are the same inference, with the same numbers, priors and loss; no fit creates energy."""

from __future__ import annotations

import numpy as np
import pytest

import femu_piezo as fp
from femu_piezo.effects.library import circuits
from femu_piezo.inference.walls import Walls
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Specimen, read_specimen
from femu_piezo.units import number
from tests.noise import noisy_sweep
from tests.variants import variants

TRIO = ("s11", "d31", "eps33T")
NOISE = 5e-4


def constants_by(how: str, specimen: Specimen):
    """The free constants by `update`, or by `diagnose` where there is nothing to name."""
    return fp.update(specimen).parameters if how == "update" else fp.diagnose(specimen, effects=[]).parameters


#: Case → factors on constants of the file, lines of [material], lines of [measurement] and after it, true lead in ohm.
CASES = {
    "a laboratory": ({}, "", f"noise = {NOISE}", 0.0),
    "noise estimated": ({}, "", "", 0.0),
    "an ideal world": ({}, "", f"noise = {NOISE}\n[update]\nnoise_only = true", 0.0),
    "something else in the sweep": ({}, "", f"noise = {NOISE}", 60.0),
    "a known lead": ({}, "", f"noise = {NOISE}\n[effects.series_resistance]\nresistance = 60.0", 60.0),
    "a lead of unknown size": (
        {},
        "",
        f'noise = {NOISE}\n[effects.series_resistance]\nresistance = 50.0\nfree = ["resistance"]',
        60.0,
    ),
    "known constants and a robust loss": (
        {"s11": 1.004},
        'std_s11 = "0.2 %"\nstd_tan_s11 = 0.001\nstd_s12 = "1 %"',
        f'noise = {NOISE}\n[update]\nloss = "soft_l1"',
        0.0,
    ),
    "a held-out band": ({}, "", f'noise = {NOISE}\nheld_out = ["125 kHz", "130 kHz"]', 0.0),
    "a start far away": ({"s11": 0.85, "d31": 1.2, "eps33T": 0.8}, "", f"noise = {NOISE}", 0.0),
}


#: Cases that differ from others only in lines of the file; marked slow.
ALIKE = ("noise estimated", "an ideal world", "a held-out band")


@pytest.mark.parametrize("case", variants(CASES, slow=ALIKE))
def test_diagnose_without_candidates_is_update(sweeps, write_specimen_of, case):
    """Values and deviations agree to the last printed digit, budgets to 1e-6 and curves to 1e-9."""
    factors, extra, more, lead = CASES[case]
    sweep = noisy_sweep(ImpedanceSpectrum(sweeps["k31"].frequency, sweeps["k31"].impedance + lead), NOISE, 1)
    specimen = read_specimen(write_specimen_of("k31", sweep, TRIO, factors, extra=extra, more=more))
    updated, result = fp.update(specimen), fp.diagnose(specimen, effects=[])
    assert result.comparison.singles == () and result.causes == ()
    assert list(result.parameters_before) == list(result.parameters) == list(updated.parameters) == list(TRIO)
    for name, other in updated.parameters.items():
        for one in (result.parameters_before[name], result.parameters[name]):
            for scale in (1e12, 1.0):  # in pm²/N and pC/N as on the terminal
                assert number(scale * one.value, scale * one.std) == number(scale * other.value, scale * other.std)
            assert number(one.tan, one.tan_std) == number(other.tan, other.tan_std)
            assert one.budget == pytest.approx(other.budget, rel=1e-6, abs=0)
            assert one.tan_budget == pytest.approx(other.tan_budget, rel=1e-6, abs=0)
    np.testing.assert_allclose(result.curves[0], updated.outcomes[0].updated_curve, rtol=1e-9)


@pytest.mark.parametrize("how", ["update", "diagnose"])
def test_priors_of_the_file_count_and_are_about_the_file(sweeps, write_specimen_of, how):
    """With a tight prior about a wrong value of the file, s11 or its tangent is the mean weighted by precisions."""
    sweep = noisy_sweep(sweeps["k31"], NOISE, 1)
    path = write_specimen_of("k31", sweep, TRIO, {"s11": 1.01}, more=f"noise = {NOISE}", lossy=True)
    text = path.read_text(encoding="utf-8")

    def found(tan: float, known: str):
        path.write_text(text.replace("tan_s11 = 0.015", f"tan_s11 = {tan!r}\n{known}"), encoding="utf-8")
        specimen = read_specimen(path)
        return constants_by(how, specimen)["s11"], specimen.material

    free, file = found(0.015, "")
    known, _ = found(0.015, 'std_s11 = "0.1 %"')
    weight = (free.std / (1e-3 * file.s11)) ** 2  # precision of the prior over that of everything else
    assert weight > 2
    assert known.value == pytest.approx((free.value + weight * file.s11) / (1 + weight), abs=0.1 * free.std)
    assert known.std == pytest.approx(free.std / np.sqrt(1 + weight), rel=0.1, abs=0)
    off = free.tan + 2 * free.tan_std  # a larger difference would contradict the data, which widens the interval
    known, _ = found(off, f"std_tan_s11 = {0.5 * free.tan_std!r}")
    assert known.tan == pytest.approx((free.tan + 4 * off) / 5, abs=0.3 * free.tan_std)
    assert known.tan_std == pytest.approx(free.tan_std / np.sqrt(5), rel=0.1)


@pytest.mark.parametrize("how", ["update", "diagnose"])
def test_held_constants_are_as_uncertain_as_the_file_says(sweeps, write_specimen_of, how):
    """std_s12 of 0.1 %, of 3 % (the default) and of 10 %, more than the sweep allows: the part "held" of d31 and
    ε33T grows.
    """
    parts = []
    for extra in ('std_s12 = "0.1 %"', "", 'std_s12 = "10 %"'):
        rest = "\n".join(f'std_{name} = "0.01 %"' for name in ("s13", "s33", "s44", "d33", "d15", "eps11T"))
        sweep = noisy_sweep(sweeps["k31"], NOISE, 1)
        path = write_specimen_of("k31", sweep, TRIO, {}, f"{extra}\n{rest}", f"noise = {NOISE}")
        found = constants_by(how, read_specimen(path))
        parts.append([found[name].budget["held"] / abs(found[name].value) for name in TRIO])
    exact, usual, loose = np.array(parts)
    assert np.all(usual[1:] > 3 * exact[1:]) and np.all(loose[1:] > 1.1 * usual[1:])


@pytest.mark.parametrize("how", ["update", "diagnose"])
def test_the_loss_of_the_file_counts(sweeps, write_specimen_of, truth, how):
    """Five readings are 5 % off: with a Cauchy loss ε33T is right to 0.15 %, with the linear one it is not."""
    spoiled = noisy_sweep(sweeps["k31"], NOISE, 1)
    spoiled.impedance[[5, 17, 30, 41, 55]] *= 1.05
    away = {}
    for loss in ("linear", "cauchy"):
        more = f'noise = {NOISE}\n[update]\nloss = "{loss}"\nnoise_only = true'
        found = constants_by(how, read_specimen(write_specimen_of("k31", spoiled, TRIO, {}, more=more)))
        away[loss] = abs(found["eps33T"].value / truth.eps33T.real - 1)
    assert away["cauchy"] < 1.5e-3 < away["linear"]


LEAD = "[effects.series_resistance]\nresistance = 60.0\n"
#: Case → loss tangents of the free constants, resistance of the leads in ohm, tables of the file on the leads.
ACTIVE = {
    "tangents of s11, d31, eps33T that no body has": ((0.012, 0.03, 0.014), 0.0, ""),
    "the same behind a known lead": ((0.012, 0.03, 0.014), 60.0, LEAD),
    "the same behind a lead of unknown size": ((0.012, 0.03, 0.014), 60.0, LEAD + 'free = ["resistance"]\n'),
    "a compensation that takes 40 ohm too much": ((0.015, 0.013, 0.017), 20.0, LEAD),
}


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["linear", "cauchy"])
@pytest.mark.parametrize("case", ACTIVE)
def test_no_path_creates_energy(sweep_of, write_specimen_of, truth, case, loss):
    """Sweeps that ask for a material that creates energy: every fit ends within the tolerance of the wall."""
    tangents, lead, tables = ACTIVE[case]
    values = {n: getattr(truth, n).real * (1 - 1j * tan) for n, tan in zip(TRIO, tangents, strict=True)}
    bare = sweep_of("k31", truth.with_values(**values))
    sweep = noisy_sweep(ImpedanceSpectrum(bare.frequency, bare.impedance + lead), NOISE, 1)
    more = f'noise = {NOISE}\n[update]\nloss = "{loss}"\n{tables}'
    path = write_specimen_of("k31", sweep, TRIO, {}, more=more, lossy=True)
    specimen = read_specimen(path)
    diagnosed = fp.diagnose(specimen, effects=[circuits.candidates]).comparison
    walls = [Walls(fit.parameters, fit.x).rows for fit in (fp.update(specimen).fit, diagnosed.base)]
    assert all(0 < -wall.min() < 1 for wall in walls)  # behind the wall by less than its tolerance
    assert Walls(diagnosed.final.parameters, diagnosed.final.x).values.min() > -1


def test_known_effects_are_in_all_results_of_an_update(sweeps, write_specimen_of, truth):
    """A known lead, and a start 25 % off: constants, curve, poles and zeros are those with the lead."""
    lead, far = 60.0, {"s11": 1.25, "d31": 0.75, "eps33T": 1.25}
    sweep = noisy_sweep(ImpedanceSpectrum(sweeps["k31"].frequency, sweeps["k31"].impedance + lead), NOISE, 1)
    path = write_specimen_of("k31", sweep, TRIO, far, more=f"noise = {NOISE}\n{LEAD}")
    result = fp.update(read_specimen(path))
    for name, estimate in result.parameters.items():
        assert abs(estimate.value - getattr(truth, name).real) < 4 * estimate.std
    (outcome,) = result.outcomes
    assert outcome.rms_after < 1.2 * NOISE
    for measured, model in outcome.matched:
        assert abs(model.frequency_Hz - measured.frequency_Hz) < 4 * measured.std_Hz
        assert model.quality_factor == pytest.approx(measured.quality_factor, rel=0.02)
