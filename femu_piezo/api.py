"""What `import femu_piezo` offers: the commands as functions of specimens and sweeps, in files or in memory.

    import femu_piezo as fp

    specimen = fp.read_specimen("plate.toml")
    sweep = fp.ImpedanceSpectrum.from_magnitude_phase(frequency_Hz, magnitude_ohm, phase_deg)
    result = fp.update(specimen, sweep)
    result.parameters["s11"].value

A specimen is a `Specimen` or the path of its file, a sweep an `ImpedanceSpectrum` or the path of its file. Results
print as the terminal's table and have `plot`, `to_dataframe` and `save` (`femu_piezo.output.results.result.Result`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

from femu_piezo.errors import InputError
from femu_piezo.measurement.readers import accept_spectrum, read_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Specimen, read_specimens, with_measurement
from femu_piezo.units import real_number, whole_number

if TYPE_CHECKING:
    from femu_piezo.diagnosis.rules import Rules
    from femu_piezo.effects.library import Maker
    from femu_piezo.output.results.circuit import EquivalentCircuit
    from femu_piezo.output.results.diagnosed import Diagnosed
    from femu_piezo.output.results.extracted import Extracted
    from femu_piezo.output.results.figures import Figures
    from femu_piezo.output.results.identified import Identified
    from femu_piezo.output.results.modes import Modes
    from femu_piezo.output.results.simulated import Simulated
    from femu_piezo.output.results.updated import Updated
    from femu_piezo.study.model_cache import Bases
    from femu_piezo.study.progress import Progress

AnySpecimen = Specimen | Path | str
AnySweep = ImpedanceSpectrum | Path | str
_Item = TypeVar("_Item")


def simulate(specimen: AnySpecimen, *, full_order: bool = False, effects: Iterable[Maker] | None = None) -> Simulated:
    """Poles, zeros and a sweep of the specimen as described.

    Parameters
    ----------
    full_order : solve the full model at every frequency instead of the reduced one (slow, for checking)
    effects : further effects, besides those of the library, that its [effects] may name
    """
    from femu_piezo.output.results.simulated import Simulated
    from femu_piezo.study import simulate as study

    return Simulated.of_study(study.simulate(_one(specimen), full_order=full_order, effects=effects))


def extract(
    spectrum: AnySweep,
    *,
    correct_phase: bool = False,
    mask_faults: bool = False,
    mask: Sequence[tuple[float, float]] = (),
    method: Literal["maximum_likelihood", "prony_ss"] = "maximum_likelihood",
) -> Extracted:
    """Poles and zeros of a measured sweep with uncertainties, without any model.

    Parameters
    ----------
    correct_phase : turn the phase of the sweep by 180°
    mask_faults : leave out spikes, mains lines and stretches in another range
    mask : bands (low, high), Hz, whose points are left out
    method : "prony_ss" for the paper's method in the time domain (evenly spaced points, no deviations)
    """
    from femu_piezo.extraction import extract as find
    from femu_piezo.output.results.extracted import Extracted

    given = _sweep(spectrum)
    accept = read_spectrum if isinstance(given, Path) else accept_spectrum
    accepted = accept(given, correct_phase=correct_phase, mask_faults=mask_faults, mask=mask)
    return Extracted.of_study(find(accepted, method=method))


def circuit(
    source: AnySweep | Specimen,
    *,
    correct_phase: bool = False,
    mask_faults: bool = False,
    connection: Literal["reflection", "series", "shunt"] | None = None,
    columns: Sequence[str] | None = None,
) -> EquivalentCircuit:
    """An equivalent circuit (Butterworth and Van Dyke) of a measured sweep, or of a specimen as described.

    One branch for each mode from its residue, elements for C0, its loss and the modes outside.

    Parameters
    ----------
    source : a sweep, or a specimen; a path that ends in .toml is that of a specimen
    correct_phase, mask_faults : for a sweep, as in `extract`
    connection, columns : for the file of a sweep, as in `read_spectrum`

    Raises
    ------
    InputError : a file or a sweep cannot serve, or holds no resonance; an option is given that has no meaning for it
    """
    from femu_piezo.output.results.circuit import EquivalentCircuit
    from femu_piezo.study.circuit import circuit_of_specimen, circuit_of_sweep

    wishes = {"correct_phase": correct_phase, "mask_faults": mask_faults}
    layout = {"connection": connection, "columns": columns}
    if isinstance(source, Specimen) or (isinstance(source, (str, Path)) and Path(source).suffix.lower() == ".toml"):
        _refuse_given(wishes | layout, "a measured sweep", "the circuit is that of a specimen as its file describes it")
        return EquivalentCircuit.of_study(circuit_of_specimen(_one(source)))
    given = _sweep(source)
    if isinstance(given, Path):
        spectrum = read_spectrum(given, **wishes, **layout)
    else:
        _refuse_given(layout, "the file of a sweep", "the sweep is given in memory")
        spectrum = accept_spectrum(given, **wishes)
    return EquivalentCircuit.of_study(circuit_of_sweep(spectrum))


def export(
    result: Updated | Path | str,
    to: str,
    *,
    density: float | None = None,
    poling: tuple[float, float, float] = (0.0, 0.0, 1.0),
    folder: Path | str | None = None,
) -> str:
    """The material of an update for another program, as text.

    Parameters
    ----------
    result : what `update` returns, or the path of an update.json
    to : "comsol", "ansys", "abaqus", "opencfs", "sfepy" or "json"
    density : kg/m³; that of the first specimen where None
    poling : direction of the poling in the axes of the other program
    folder : into which the text is also written, as material.txt, material.inp, …; None to write no file

    Raises
    ------
    InputError : the file is no update.json, the program is not known, or the density is missing
    """
    from femu_piezo.study.export import constants_of_record, export_text
    from femu_piezo.study.results import UpdateResult

    if isinstance(result, (Path, str)):
        constants, known, name, found = constants_of_record(Path(result))
    elif not isinstance(result, UpdateResult):
        raise InputError(
            f"export takes what update returns or the path of an update.json, not a {type(result).__name__}"
        )
    else:
        constants, known, name = result.constants, result.outcomes[0].measured.problem.density, result.name
        found = tuple(result.parameters)
    density = known if density is None else real_number(density, "density")
    text = export_text(constants, density, name, to, poling, found)
    if folder is not None:
        from femu_piezo.files import write_atomically
        from femu_piezo.material.programs.writers import program
        from femu_piezo.output.folder import prepare_folder

        write_atomically(prepare_folder(folder) / f"material.{program(to).suffix}", text)
    return text


def standard_figures(spectrum: AnySweep, specimen: AnySpecimen | None = None) -> Figures:
    """Standard figures of a measured sweep (IEEE 176-1987, EN 50324-2): fs, fp, k, Qm, C^T, N, d, s.

    Without a specimen, the figures that need no dimensions. With one, also those by the formulas of its shape, each
    with its value by the finite element model of the specimen as its file describes it, and the errors of the formulas
    for this piece. `result.figures` of `fp.update` has the values of the updated model instead.

    Raises
    ------
    InputError : a file, a key or a sweep cannot serve, or no pole with its zero is in the sweep
    """
    from femu_piezo.output.results.figures import Figures

    if specimen is None:
        found = extract(spectrum)
        if found.figures is None:
            raise InputError(
                f"{found.spectrum.source}: no pole with its zero was found, so there are no standard figures; measure "
                "a band that holds both"
            )
        return Figures((found.figures,))
    from femu_piezo.study.standard_figures import figures_of_specimen

    return Figures(figures_of_specimen(_one(specimen), _sweep(spectrum)))


def update(
    specimens: AnySpecimen | Sequence[AnySpecimen],
    spectra: AnySweep | Sequence[AnySweep] | None = None,
    *,
    correct_phase: bool = False,
    mask_faults: bool = False,
    effects: Iterable[Maker] | None = None,
    samples: int = 0,
    progress: Progress | None = None,
    bases: Bases | None = None,
) -> Updated:
    """The constants that explain the measured sweeps; several specimens of one material are fitted together.

    Parameters
    ----------
    specimens : one or several; the tables [material] and [update] of the first one apply to all
    spectra : their sweeps in the same order; those that the specimens name where None. To a sweep given here all of
        [measurement] except the file applies: held_out, noise, accuracy, residue, correct_phase, mask_faults
    correct_phase, mask_faults : as in [measurement], for all sweeps
    effects : further effects, besides those of the library, that the [effects] of the files may name
    samples : number of samples of the posterior, 50 or more, for where it may not be Gaussian; 0 for none
    progress : called with the name of each step
    bases : where models and reduced bases come from; made for these specimens alone where None

    Raises
    ------
    InputError : a file, a key or a sweep cannot serve
    ConvergenceError : the computation does not converge; the message says what to try
    """
    from femu_piezo.output.results.updated import Updated
    from femu_piezo.study import update as study

    samples = whole_number(samples, "samples")
    wanted, sweeps = _measured(specimens, spectra, correct_phase, mask_faults)
    return Updated.of_study(study.update(wanted, progress, bases, spectra=sweeps, effects=effects, samples=samples))


def diagnose(
    specimens: AnySpecimen | Sequence[AnySpecimen],
    spectra: AnySweep | Sequence[AnySweep] | None = None,
    *,
    correct_phase: bool = False,
    mask_faults: bool = False,
    effects: Iterable[Maker] | None = None,
    rules: Rules | None = None,
    progress: Progress | None = None,
    bases: Bases | None = None,
) -> Diagnosed:
    """What the simulation of the specimens gets wrong, the named cause, and the gain.

    Parameters
    ----------
    effects : the candidates: effects, or functions of an `EffectContext` that return effects;
        `femu_piezo.effects.library` where None, `[*femu_piezo.effects.library, mine]` for one more
    rules : prior probabilities and thresholds

    The other parameters and the errors are those of `update`.
    """
    from femu_piezo.output.results.diagnosed import Diagnosed
    from femu_piezo.study import diagnose as study

    wanted, sweeps = _measured(specimens, spectra, correct_phase, mask_faults)
    found = study.diagnose(wanted, progress, bases, rules=rules, spectra=sweeps, effects=effects)
    return Diagnosed.of_study(found)


def identify(
    specimens: AnySpecimen | Sequence[AnySpecimen],
    noise: float | None = None,
    *,
    recommend: bool = True,
    study: int = 0,
    plan: int = 0,
    progress: Progress | None = None,
) -> Identified:
    """Which constants sweeps of the specimens can determine, and how well, before or without measuring.

    `result.expected` has the deviations that an update would state with the tolerances of the files, and those that it
    would state with one tolerance halved, for each of them.

    Parameters
    ----------
    noise : relative standard deviation of every point; the one that the files state where None, else 0.001
    recommend : compute what further measurements would add, which takes longer than the rest
    study : number of specimens, 20 or more, drawn and updated for each of several noises and numbers of points
    plan : number of points, 16 or more, of a sweep whose frequencies are chosen: `result.plan.frequency`
    """
    from femu_piezo.output.results.identified import Identified
    from femu_piezo.study import identify as planned

    noise = None if noise is None else real_number(noise, "noise")
    study, plan = whole_number(study, "study"), whole_number(plan, "plan")
    wanted = _many(specimens)
    return Identified.of_study(planned.identify(wanted, noise, progress, recommend=recommend, study=study, plan=plan))


def modes(
    specimen: AnySpecimen,
    *,
    band: tuple[float, float] | None = None,
    count: int | None = None,
    effects: Iterable[Maker] | None = None,
) -> Modes:
    """The driven modes of the specimen.

    Parameters
    ----------
    band : (low, high) Hz; where None from zero to 3.5 times the expected fundamental, or to the end of the sweep that
        the file simulates where that is lower and not below all modes
    count : number of modes, the lowest ones; all of the band where None
    effects : further effects, besides those of the library, that its [effects] may name
    """
    from femu_piezo.output.results.modes import Modes
    from femu_piezo.study import modes as study

    count = None if count is None else whole_number(count, "count")
    return Modes.of_study(study.modes(_one(specimen), band=band, count=count, effects=effects))


def _refuse_given(options: dict[str, object], needed: str, but: str) -> None:
    """InputError where one of the options is given."""
    for name, value in options.items():
        if value is not None and value is not False:
            raise InputError(f"{name} is for {needed}, and {but}; leave it out")


def _one(specimen: AnySpecimen) -> Specimen:
    found = _many(specimen)
    if len(found) != 1:
        raise InputError(f"{len(found)} specimens are given where one is needed; give them one after another")
    return found[0]


def _many(specimens: AnySpecimen | Sequence[AnySpecimen]) -> list[Specimen]:
    """Specimens, read where they are files; a study file stands for several."""
    found: list[Specimen] = []
    for one in _listed(specimens, (Specimen, str, Path)):
        if isinstance(one, Specimen):
            found.append(one)
        elif isinstance(one, (str, Path)):
            found += read_specimens([one])
        else:
            raise InputError(f"a specimen is a Specimen or the path of its file, not a {type(one).__name__}")
    return found


def _measured(specimens, spectra, correct_phase: bool, mask_faults: bool):
    """Specimens, and the sweeps given for them or their paths; None where none are given."""
    wanted = with_measurement(_many(specimens), correct_phase=correct_phase, mask_faults=mask_faults)
    if spectra is None:
        return wanted, None
    return wanted, [_sweep(one) for one in _listed(spectra, (ImpedanceSpectrum, str, Path))]


def _sweep(spectrum: object) -> ImpedanceSpectrum | Path:
    if isinstance(spectrum, (str, Path)):
        return Path(spectrum)
    if not isinstance(spectrum, ImpedanceSpectrum):
        raise InputError(
            f"a sweep is an ImpedanceSpectrum or the path of its file, not a {type(spectrum).__name__}; "
            "ImpedanceSpectrum.from_impedance(frequency_Hz, impedance_ohm) makes one of arrays"
        )
    return spectrum


def _listed(items: _Item | Sequence[_Item], single: tuple[type, ...]) -> list[_Item]:
    return list(items) if isinstance(items, Sequence) and not isinstance(items, single) else [items]
