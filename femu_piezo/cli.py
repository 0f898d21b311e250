"""The command line: parse, call, write, print."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from femu_piezo import steps
from femu_piezo.errors import InputError
from femu_piezo.terminal import Commands, Folder, Quantity, StoreAddress

if TYPE_CHECKING:
    from femu_piezo.output.results.result import Result
    from femu_piezo.specimen.file import Specimen
    from femu_piezo.study.adaptive import Wish

_STARTED = time.perf_counter()
# Dense algebra here is on small matrices, where more BLAS threads only wait for each other; read when numpy loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_MANUAL = """Complex material parameters of piezoceramic plates from impedance sweeps.

Give a specimen file (TOML: geometry, start material, the measured sweep) and get the complex elastic,
piezoelectric and dielectric constants of the piece, by pole-zero finite element model updating (Cong, Hu, Li,
Smart Mater. Struct. 31, 2022, 125010).

\b
  femu-piezo simulate SPEC       poles, zeros and a sweep of the specimen
  femu-piezo extract SWEEP       poles and zeros of a measured sweep, no model
  femu-piezo circuit SWEEP       an equivalent circuit of a sweep, for SPICE
  femu-piezo update SPEC         the constants that explain the measured sweep
  femu-piezo datasheet SPEC      one page: constants, standard figures, curves
  femu-piezo export UPDATE.json  the material for another program
  femu-piezo diagnose SPEC       what the simulation gets wrong, and the cause
  femu-piezo identify SPEC       which constants a sweep determines, how well
  femu-piezo modes SPEC          pictures of the driven modes
  femu-piezo measure SPEC        take the sweep at the best frequencies
  femu-piezo analyser SPEC       a simulated analyser, to try `measure`
  femu-piezo batch DIR           every specimen of a folder, with a lot report
  femu-piezo lots --store URL    lots of a database: control charts and drift
  femu-piezo serve FOLDER        all of this as a page in the browser

\b
  femu-piezo update plate.toml --out results
  femu-piezo update --help       what it writes, and its options

Terms: a pole is a pole of the admittance (series resonance, short circuit); a zero is a zero of the admittance
(parallel resonance, open circuit). A constant is written value (1 − j tan), tan being its loss tangent. Every
command that takes --out writes machine-readable results (JSON, CSV) and pictures (PNG) into that folder.

\b
Exit codes: 0 done · 2 the input is wrong (one sentence says what and where)
3 a computation did not converge · 4 an instrument failed
"""


@click.group(
    cls=Commands, help=_MANUAL, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 118}
)
@click.version_option(package_name="femu-piezo")
def main() -> None:
    pass


_specimen = click.argument("specimen", type=click.Path(path_type=Path), metavar="SPEC")
_out = click.option("--out", required=True, type=Folder(), help="folder for the results")
_data = click.option(
    "--data",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="measured sweep, instead of that named in SPEC",
)
_correct_phase = click.option(
    "--correct-phase", is_flag=True, help="turn the phase of the sweep by 180° (where its resistance is negative)"
)
_mask_faults = click.option(
    "--mask-faults", is_flag=True, help="leave out spikes, mains lines and stretches in another range in the sweep"
)
_connection = click.option(
    "--connection",
    type=click.Choice(["reflection", "series", "shunt"]),
    help="how the piece was connected, for a Touchstone file  [default: detected from the data]",
)
_columns = click.option(
    "--columns", metavar="NAMES", help='names of the columns, instead of the header: "f (Hz), R (Ohm), X (Ohm)"'
)
_report = click.option(
    "--report", is_flag=True, help="also write report.html: all results on one page that needs no network"
)

_store = click.option(
    "--store",
    type=StoreAddress(),
    is_flag=False,
    flag_value="sqlite",
    envvar="FEMU_PIEZO_STORE",
    metavar="[URL]",
    help="also keep the results in a database: postgresql://user@host/name or an SQLite file; without URL, "
    "store.sqlite in the folder of the results; needs pip install 'femu-piezo[store]'  [default: the URL in the "
    "environment variable FEMU_PIEZO_STORE]",
)
_lot = click.option("--lot", metavar="NAME", help="lot in the --store that the specimens belong to")


def _names(columns: str | None) -> list[str] | None:
    """The names of --columns."""
    return None if columns is None else [name.strip() for name in columns.split(",")]


def _prepare(out: Path) -> None:
    """Make the result folder before the work, so that a wrong place is told at once."""
    from femu_piezo.output.folder import prepare_folder

    prepare_folder(out)


def _save(result: Result, out: Path, **options: bool) -> None:
    """Save a result, and tell what an earlier run of the command has left beside it."""
    from femu_piezo.output.folder import older_files

    began = time.time()
    result.save(out, **options)
    if older := older_files(out, result.files, began):
        words = "belongs to" if len(older) == 1 else "belong to"
        click.echo(f"note: {', '.join(older)} in {out} {words} an earlier run", err=True)


def _check_lot(store: str | None, lot: str | None) -> None:
    """Refuse a lot that nothing would be kept in."""
    if lot is not None and store is None:
        raise InputError(f"--lot {lot}: lots are kept in a store; give --store as well, or set FEMU_PIEZO_STORE")


def _keeper(store: str | None, out: Path, lot: str | None) -> Callable:
    """What keeps a result in the --store; it does nothing, and imports nothing, where none is asked for."""
    _check_lot(store, lot)
    if store is None:
        return lambda specimens, result: None
    from femu_piezo.store.write import keeper

    return keeper(store, out, lot)


def _show(result: Result) -> None:
    from femu_piezo.output.tables import console

    console().print(result.table())


@contextmanager
def _steps_shown() -> Iterator[Callable[[str], None]]:
    """Progress on a terminal: the current step on one line of stderr; each on its own where a program asks for it."""
    shown = sys.stdout.isatty() and sys.stderr.isatty()

    def tell(step: str) -> None:
        if steps.wanted():
            steps.write(step)
        elif shown:
            click.echo(f"\r\033[K{step} …", nl=False, err=True)

    try:
        yield tell
    finally:
        if shown:
            click.echo("\r\033[K", nl=False, err=True)


@main.command()
@_specimen
@_out
@click.option("--full-order", is_flag=True, help="solve the unreduced model at every frequency (slow, for checking)")
def simulate(specimen: Path, out: Path, full_order: bool) -> None:
    """Simulate the specimen SPEC: poles, zeros and an impedance sweep.

    Writes simulation.json, impedance.csv and impedance.png. The table [simulation] of SPEC describes the sweep (start,
    stop, points, spacing, noise, seed), by default from 100 Hz to 3.5 times the fundamental. Effects in the tables
    [effects] are included; the values of the tables [fitted], if there are any, replace those of the other tables.
    """
    from femu_piezo.api import simulate as run
    from femu_piezo.specimen.file import read_specimen

    wanted = read_specimen(specimen)
    _prepare(out)
    result = run(wanted, full_order=full_order)
    _save(result, out)
    _show(result)
    click.echo(f"{len(result.spectrum)} points, {result.unknowns} unknowns → {out / 'impedance.csv'}")


@main.command()
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@_out
@_correct_phase
@_mask_faults
@_connection
@_columns
@click.option(
    "--mask",
    nargs=2,
    type=float,
    multiple=True,
    metavar="LOW HIGH",
    help="ignore the points between two frequencies, Hz; may be given several times",
)
@click.option(
    "--method",
    type=click.Choice(["maximum-likelihood", "prony-ss"]),
    default="maximum-likelihood",
    show_default=True,
    help="prony-ss: the paper's method, in the time domain; needs evenly spaced points, gives no standard deviations",
)
def extract(
    file: Path,
    out: Path,
    correct_phase: bool,
    mask_faults: bool,
    connection: str | None,
    columns: str | None,
    mask: tuple[tuple[float, float], ...],
    method: str,
) -> None:
    """Extract poles and zeros with uncertainties from the sweep FILE.

    Reads CSV and delimited text whose header names the columns (|Z| and phase, R and X, G and B, Cp and D; decimal
    points or commas), such as Bode 100, WaveForms and LCR meters write, HP 4294A, Keysight E4990A and E5061B exports,
    and Touchstone of one or two ports (.s1p, .s2p in series or shunt). Writes extraction.json and extraction.png. Both
    contain the standard figures that do not depend on the body (fs, fp, fm, fn, fr, fa, k_eff, Qm, capacitance, tan δ;
    IEEE 176-1987, EN 50324-2). With --method prony-ss also prony_ss.png: impulse responses, singular values and
    stabilization diagrams of poles and zeros. A sweep without any loss, or of too few points, has nothing to extract:
    extraction.json and extraction.png say so, and there is no prony_ss.png.
    """
    from femu_piezo.api import extract as run
    from femu_piezo.measurement.readers import read_spectrum

    spectrum = read_spectrum(
        file,
        correct_phase=correct_phase,
        mask_faults=mask_faults,
        mask=mask,
        connection=connection,
        columns=_names(columns),
    )
    _prepare(out)
    result = run(spectrum, method=method.replace("-", "_"))
    _save(result, out)
    _show(result)


@main.command()
@click.argument("source", type=click.Path(path_type=Path), metavar="SWEEP|SPEC")
@_out
@_correct_phase
@_mask_faults
@_connection
@_columns
def circuit(
    source: Path, out: Path, correct_phase: bool, mask_faults: bool, connection: str | None, columns: str | None
) -> None:
    """Make an equivalent circuit of a measured sweep, or of the specimen that a specimen file (*.toml) describes.

    The circuit has one branch (Butterworth, Van Dyke) for each mode: L, R and C with a resistance across C, which
    reproduce its complex residue exactly, with standard deviations. A capacitor, relaxations for its loss, and modes
    outside the sweep represent the rest. Writes circuit.cir (a SPICE subcircuit for ngspice and LTspice), circuit.json,
    circuit.png, and the curve of the circuit as circuit.s1p (Touchstone) and circuit.csv.
    """
    from femu_piezo.api import circuit as run

    result = run(
        source,
        correct_phase=correct_phase,
        mask_faults=mask_faults,
        connection=connection,
        columns=_names(columns),
    )
    _prepare(out)
    _save(result, out)
    _show(result)


@main.command()
@click.argument("specimens", type=click.Path(path_type=Path), metavar="SPEC [SPEC …]", nargs=-1, required=True)
@_out
@_data
@_report
@_correct_phase
@_mask_faults
@click.option("--timings", is_flag=True, help="print the seconds of every step")
@click.option(
    "--method",
    type=click.Choice(["curve", "pole-zero"]),
    help="replaces update.method of the file; pole-zero: the paper's method, from poles and zeros alone",
)
@click.option(
    "--sample",
    type=click.IntRange(50),
    metavar="N",
    help="also draw N samples of the posterior, one fit each, such as 400",
)
@_store
@_lot
def update(
    specimens: tuple[Path, ...],
    out: Path,
    data: Path | None,
    report: bool,
    correct_phase: bool,
    mask_faults: bool,
    timings: bool,
    method: str | None,
    sample: int | None,
    store: str | None,
    lot: str | None,
) -> None:
    """Update the free constants of SPEC from its measured sweep.

    Several SPEC files, or a study file with specimens = ["a.toml", "b.toml"], are specimens of one material, fitted
    together with the tables [material] and [update] of the first file. Writes update.json, budget.png, temperature.png
    (for sweeps at several temperatures) and, numbered for several sweeps, impedance.png (measured, baseline and
    updated), iterations.png (where there were pole-zero iterations), sensitivity.png and updated.csv (the updated model
    at the measured frequencies). The standard figures (k31, Qm, N, s, d by the formulas of IEEE 176-1987 for the shape)
    are shown with the finite element values and the errors of the formulas for this piece. With --report also
    report.html, which contains all results. With --sample also samples.csv (every unknown, SI), corner.png, and
    intervals in update.json that do not assume a Gaussian posterior. With --method pole-zero the constants follow from
    the extracted poles and zeros: from those of the fundamental of one specimen at a known eps33T as in the paper, else
    from all modes, for all free constants and specimens together (its appendix A).
    """
    from femu_piezo.api import update as run
    from femu_piezo.specimen.file import read_specimens, with_measurement, with_method

    wanted = read_specimens(specimens, data)
    wanted = with_measurement(wanted, correct_phase=correct_phase, mask_faults=mask_faults)
    if method is not None:
        wanted = with_method(wanted, method.replace("-", "_"))
    _prepare(out)
    keep = _keeper(store, out, lot)
    with _steps_shown() as progress:
        result = run(wanted, samples=sample or 0, progress=progress)
    drawing = time.perf_counter()
    imported = drawing - _STARTED - sum(result.seconds.values())
    _save(result, out, report=report)
    _show(result)
    keep(wanted, result)
    if timings:
        seconds = {"imports": imported, **result.seconds, "pictures and files": time.perf_counter() - drawing}
        for step, value in seconds.items():
            click.echo(f"{step:24s} {value:7.3f} s")
        click.echo(f"{'sum':24s} {sum(seconds.values()):7.3f} s")


@main.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@_out
@click.option("--specimen", type=click.Path(path_type=Path), metavar="SPEC", help="DIR holds sweeps of this specimen")
@click.option("--workers", type=click.IntRange(1, 1024), help="processes on this machine [default: number of cores]")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler of a cluster, such as tcp://host:8786")
@click.option(
    "--time-limit",
    default=900.0,
    show_default=True,
    type=click.FloatRange(1, 1e6),
    help="seconds after which one specimen is abandoned",
)
@click.option("--diagnose", "diagnosed", flag_value="all", help="also diagnose every specimen")
@click.option("--diagnose-outliers", "diagnosed", flag_value="outliers", help="also diagnose the outliers of the lot")
@_correct_phase
@_mask_faults
@_store
@click.option("--lot", metavar="NAME", help="name of the lot in the --store  [default: the name of the folder DIR]")
def batch(
    folder: Path,
    out: Path,
    specimen: Path | None,
    workers: int | None,
    scheduler: str | None,
    time_limit: float,
    diagnosed: str | None,
    correct_phase: bool,
    mask_faults: bool,
    store: str | None,
    lot: str | None,
) -> None:
    """Update every specimen file (*.toml) in DIR, or with --specimen every sweep in DIR.

    Writes table.csv and table.parquet (one row per file; where there is no result, the reason), lot.json, lot.txt
    and lot.png (distributions, control limits, outliers, drift over serial number), and the full results in the folder
    records, those of diagnoses in the folder diagnoses. Each result is saved when it is finished: after an
    interruption the same command continues; only new and changed files are computed.
    """
    _check_lot(store, lot)
    if scheduler is not None and workers is not None:
        raise InputError("--workers is for processes of this machine; leave it out where --scheduler is given")
    if folder.resolve() == out.resolve():
        raise InputError(
            f"--out {out}: the results cannot go into the folder of the lot; give another, such as {out}/out"
        )
    _prepare(out)
    if scheduler is None:
        from femu_piezo.batch.pool import load_program

        load_program()  # while this process reads the lot
    from femu_piezo.batch.command import run_batch

    with ExitStack() as stack:
        keep = None
        if store is not None:
            from femu_piezo.store.write import lot_keeper

            keep = stack.enter_context(lot_keeper(store, out, lot or folder.resolve().name))
        text, code = run_batch(
            folder, out, specimen, workers, scheduler, time_limit, correct_phase, mask_faults, diagnosed, keep
        )
        click.echo(text, nl=False, err=code == 130)
        if code == 3:
            click.echo(f"femu-piezo: no specimen has a result; the reasons are in {out / 'table.csv'}", err=True)
    if code:
        click.get_current_context().exit(code)


@main.command()
@click.argument("specimens", type=click.Path(path_type=Path), metavar="SPEC [SPEC …]", nargs=-1, required=True)
@_out
@click.option(
    "--noise",
    type=float,
    help="relative standard deviation of the noise  [default: that of the specimen file, else 0.001]",
)
@click.option(
    "--study",
    type=click.IntRange(20),
    metavar="N",
    help="also update N random specimens for each of several noise levels and numbers of points, such as 200",
)
@click.option(
    "--plan",
    type=click.IntRange(16, 100_000),
    metavar="N",
    help="also choose the N frequencies that determine the free constants best",
)
def identify(specimens: tuple[Path, ...], out: Path, noise: float | None, study: int | None, plan: int | None) -> None:
    """Predict which constants a sweep of SPEC can determine, before or without measuring.

    The table [simulation] describes the sweep. The first part has all ten constants free and counts noise alone: which
    of them the sweep determines, and which further measurement would determine the rest. The second part has the free
    constants and the tolerances of the file: the standard deviation that `update` would state for each constant, its
    sources, which tolerance (a dimension, density or mass, a held constant, the instrument, the fixture, noise) to
    improve first, and the gain. Several SPEC files are specimens of one material, taken together.

    Writes identifiability.json, budget.png and sensitivity.png; with --study also study.png: the errors of such
    updates, and how often the true constants are within the stated intervals. With --plan also plan.csv, a list of
    frequencies for the analyser, half of them equally spaced over the band and half where they reduce the standard
    deviations most (plan_segments.csv: segments to type in; plan_e4990a.scpi: commands for an E4990A), and the gain
    over the same number of equally spaced points.
    """
    from femu_piezo.api import identify as run
    from femu_piezo.specimen.file import read_specimens

    wanted = read_specimens(specimens)
    _prepare(out)
    with _steps_shown() as progress:
        result = run(wanted, noise, study=study or 0, plan=plan or 0, progress=progress)
    _save(result, out)
    _show(result)


@main.command()
@click.argument("specimens", type=click.Path(path_type=Path), metavar="SPEC [SPEC …]", nargs=-1, required=True)
@_out
@_data
@_report
@_correct_phase
@_mask_faults
@_store
@_lot
def diagnose(
    specimens: tuple[Path, ...],
    out: Path,
    data: Path | None,
    report: bool,
    correct_phase: bool,
    mask_faults: bool,
    store: str | None,
    lot: str | None,
) -> None:
    """Say what the simulation of SPEC gets wrong, and name the cause.

    Fits the free constants, then every candidate effect together with them (leads, losses, held constants, dimensions,
    electrodes). Writes diagnosis.json, diagnosis.png (residuals without and with the named effects), curves.csv (the
    measured curve and those of both models) and extended.toml, a specimen file with the named effects, from which
    `simulate` reproduces the fitted curve. With --report also report.html, whose first page answers in plain words.

    Several SPEC files, or a study file with specimens = ["a.toml", "b.toml"], are specimens of one material: constants
    and fixture are common, a wrong dimension or a defect belongs to one specimen. Pictures, reports and extended
    specimen files are then numbered, and extended.toml is a study file that names these.
    """
    from femu_piezo.api import diagnose as run
    from femu_piezo.specimen.file import read_specimens, with_measurement

    wanted = read_specimens(specimens, data)
    wanted = with_measurement(wanted, correct_phase=correct_phase, mask_faults=mask_faults)
    _prepare(out)
    keep = _keeper(store, out, lot)
    with _steps_shown() as progress:
        result = run(wanted, progress=progress)
    _save(result, out, report=report)
    _show(result)
    keep(wanted, result)


@main.command()
@_specimen
@_out
@_data
@_correct_phase
@_mask_faults
def datasheet(specimen: Path, out: Path, data: Path | None, correct_phase: bool, mask_faults: bool) -> None:
    """Make a data sheet of the specimen SPEC from its measured sweep: one page, A4.

    Updates the free constants as `update` does and writes datasheet.pdf and datasheet.png (constants with standard
    deviations, standard figures by IEEE 176-1987 and EN 50324-2 with the finite element values and the errors of the
    formulas for this piece, curves) and update.json.
    """
    from femu_piezo.api import update as run
    from femu_piezo.specimen.file import read_specimens

    wanted = read_specimens([specimen], data)
    _prepare(out)
    with _steps_shown() as progress:
        result = run(wanted, correct_phase=correct_phase, mask_faults=mask_faults, progress=progress)
    result.save_data_sheet(out)
    _show(result)


@main.command()
@click.argument("file", type=click.Path(path_type=Path), metavar="UPDATE.json")
@click.option(
    "--to",
    required=True,
    type=click.Choice(["comsol", "ansys", "abaqus", "opencfs", "sfepy", "json"]),
    help="program that will use the material",
)
@_out
@click.option("--density", type=click.FloatRange(1, 1e5), help="kg/m³  [default: that of the specimen]")
@click.option(
    "--poling",
    nargs=3,
    type=float,
    default=(0.0, 0.0, 1.0),
    metavar="X Y Z",
    help="direction of poling in the axes of the other program  [default: 0 0 1]",
)
def export(file: Path, to: str, out: Path, density: float | None, poling: tuple[float, float, float]) -> None:
    """Write the constants of UPDATE.json, which `update` wrote, as a material of another program.

    Writes material.txt (COMSOL parameters), .mac (ANSYS), .inp (Abaqus), .xml (openCFS), .py (SfePy) or .json: the full
    stress-charge matrices with notes on order, sign and loss. COMSOL, openCFS, SfePy and JSON get complex constants,
    ANSYS and Abaqus real constants and the loss factors that they accept.
    """
    from femu_piezo.api import export as run
    from femu_piezo.material.programs.writers import program
    from femu_piezo.study.export import cautions, constants_of_record

    run(file, to, density=density, poling=poling, folder=out)
    for caution in cautions(constants_of_record(file)[0]):
        click.echo(f"note: {caution}")
    click.echo(f"the material of {file} for {to} is in {out / f'material.{program(to).suffix}'}")


@main.command()
@_specimen
@_out
@click.option("--count", type=click.IntRange(1, 200), help="largest number of modes, from the lowest on")
@click.option(
    "--band",
    nargs=2,
    type=float,
    metavar="LOW HIGH",
    help="only modes with poles in this band, Hz  [default: to 3.5 times the fundamental or a lower simulation.stop]",
)
@click.option("--animate", is_flag=True, help="also write an animated GIF of every mode")
@click.option("--html", "scene", is_flag=True, help="also write an interactive scene (one HTML file, no network)")
@click.option("--vtu", is_flag=True, help="also write every mode of the whole body for ParaView (VTU)")
@click.option("--mesh", is_flag=True, help="also write the mesh with its electrodes (gmsh .msh and Abaqus .inp)")
def modes(
    specimen: Path,
    out: Path,
    count: int | None,
    band: tuple[float, float] | None,
    animate: bool,
    scene: bool,
    vtu: bool,
    mesh: bool,
) -> None:
    """Draw the driven modes of the specimen SPEC: poles and zeros, mode shapes, k_eff.

    Writes modes.json, mode_01.png, mode_02.png … and modes.png with all of them; with --animate mode_01.gif …, with
    --html modes.html, with --vtu mode_01.vtu …, with --mesh mesh.msh and mesh.inp. Constants, dimensions and
    density are those of the specimen with its [effects]; the values of the tables [fitted], if there are any, replace
    those of the other tables.
    """
    from femu_piezo.api import modes as run
    from femu_piezo.specimen.file import read_specimen

    wanted = read_specimen(specimen)
    _prepare(out)
    result = run(wanted, band=band, count=count)
    _save(result, out, animate=animate, scene=scene, vtu=vtu, mesh=mesh)
    _show(result)
    click.echo(f"{len(result.modes)} modes, {result.model.size} unknowns → {out / 'modes.png'}")


@main.command()
@_specimen
@_out
@click.option("--instrument", metavar="ADDRESS", help="VISA address, such as TCPIP::10.0.0.7::5025::SOCKET")
@click.option(
    "--points",
    type=click.IntRange(32, 100_000),
    default=200,
    show_default=True,
    help="largest number of points, with those that --out holds already",
)
@click.option(
    "--deviation",
    "deviations",
    nargs=2,
    type=(str, Quantity("1", "deviation")),
    multiple=True,
    metavar="NAME STD",
    help='standard deviation at which to stop: s11 "0.5 %", tan_s11 1e-4; may be given several times',
)
@click.option(
    "--time",
    "seconds",
    type=Quantity("s", "time"),
    metavar="TIME",
    help="time after which no new round begins, such as '5 min'",
)
@click.option(
    "--band",
    nargs=2,
    type=Quantity("Hz", "band"),
    metavar="LOW HIGH",
    help="lowest and highest frequency  [default: those of [simulation]]",
)
@click.option(
    "--voltage",
    type=Quantity("V", "voltage"),
    metavar="V",
    help="drive, rms  [default: 0.5 V, or limits.voltage if that is less]",
)
@click.option("--bias", type=Quantity("V", "bias"), default=0.0, metavar="V", help="DC bias  [default: none]")
@click.option(
    "--speed",
    type=click.IntRange(1, 5),
    default=5,
    show_default=True,
    help="bandwidth of the analyser, 1 (fast) to 5 (low noise)",
)
@click.option(
    "--averages", type=click.IntRange(1, 256), default=1, show_default=True, help="number of readings of every point"
)
@click.option(
    "--timeout",
    type=click.FloatRange(0.1, 3600),
    default=10.0,
    show_default=True,
    help="seconds to wait for a reply, in addition to the time of the sweep",
)
@click.option("--diagnose", is_flag=True, help="also diagnose, and take the further sweeps that it recommends")
@click.option("--separate", is_flag=True, help="choose points that separate the two best causes of a diagnosis")
@click.option(
    "--plan",
    is_flag=True,
    help="no instrument: only write the frequencies to measure; with --data, those to measure next",
)
@click.option(
    "--data", type=click.Path(path_type=Path), metavar="FILE", help="with --plan: the sweep that was measured so far"
)
@_store
@_lot
def measure(
    specimen: Path,
    out: Path,
    instrument: str | None,
    points: int,
    deviations: tuple[tuple[str, float], ...],
    seconds: float | None,
    band: tuple[float, float] | None,
    voltage: float | None,
    bias: float,
    speed: int,
    averages: int,
    timeout: float,
    diagnose: bool,
    separate: bool,
    plan: bool,
    data: Path | None,
    store: str | None,
    lot: str | None,
) -> None:
    """Measure the specimen SPEC with an impedance analyser, at the frequencies that determine the free constants best.

    A coarse sweep of the band finds the resonances, with half of the points; each further round updates with the points
    so far and measures where this reduces the standard deviations most, with all tolerances of the file counted, until
    the standard deviations of --deviation, the time or the number of points are reached. Where points depart from the
    model, further points are measured near them. With --separate every round diagnoses and measures where the two best
    causes differ most, until they are separated; then the measurement goes on for --deviation, if given. Known
    analysers: Keysight E4990A, HP/Agilent 4294A. The program never sets more than the voltage, bias and frequency of
    the table [limits] of SPEC (by default 0.5 V, no bias), and the output is off at the end, after an error and
    after Ctrl-C. Points are written to points.csv as the analyser sends them; after an interruption the same command
    continues from there, and with larger --points a finished measurement goes on.

    Writes piece.toml (what is measured), live.png after every round, sweep.csv, measure.json, measured.toml (SPEC with
    this sweep) and the files of `update`; with --diagnose or --separate the folder diagnosis, with --diagnose also
    sweeps in the opposite direction and at a third of the voltage where the diagnosis recommends them. With --plan
    nothing is measured: plan.csv, plan_segments.csv and plan_e4990a.scpi hold the frequencies for an analyser without a
    connection. Needs pip install 'femu-piezo[measure]'.
    """
    from femu_piezo.specimen.file import read_specimen
    from femu_piezo.study.adaptive import Wish

    wanted = read_specimen(specimen)
    wish = Wish(points, dict(deviations), seconds, band, separate)
    if plan:
        _refuse_at_the_analyser()
        _plan_only(wanted, wish, data, out)
        return
    if data is not None:
        raise InputError("--data goes with --plan; points that were measured already are read from --out")
    if instrument is None:
        raise InputError(
            "--instrument is missing; give its VISA address, or --plan for an analyser without a connection"
        )
    from femu_piezo.instruments.analyser import Settings, usual_drive
    from femu_piezo.instruments.measure import measure as run

    drive = usual_drive(wanted.limits) if voltage is None else voltage
    settings = Settings(drive, bias, speed, averages, timeout)
    _prepare(out)
    keep = _keeper(store, out, lot)
    with _steps_shown() as progress:
        result = run(
            wanted, instrument, out, wish, settings, diagnose=diagnose, keep=keep, tell=_line, progress=progress
        )
    _show(result.updated)
    if result.diagnosed is not None:
        _show(result.diagnosed)
    click.echo(result.adapted.sentence)


def _line(text: str) -> None:
    """A line that stays, where the current step may stand on the terminal."""
    click.echo(("\r\033[K" if sys.stdout.isatty() else "") + text)


#: Parameters of `measure` that concern an analyser at work.
_AT_THE_ANALYSER = frozenset(
    ("instrument", "voltage", "bias", "speed", "averages", "timeout", "seconds", "diagnose", "store", "lot")
)


def _refuse_at_the_analyser() -> None:
    """InputError where an option is given that has no meaning without an analyser."""
    context = click.get_current_context()
    for one in context.command.params:
        given = context.get_parameter_source(one.name) is click.core.ParameterSource.COMMANDLINE
        if given and one.name in _AT_THE_ANALYSER:
            raise InputError(f"--plan is for an analyser without a connection; leave {one.opts[0]} out")


def _plan_only(specimen: Specimen, wish: Wish, data: Path | None, out: Path) -> None:
    """Write where to measure, from what is expected or after the points of a file."""
    from femu_piezo.measurement.readers import read_spectrum
    from femu_piezo.output.plan_files import write_plan
    from femu_piezo.study.adaptive import first_frequencies, next_frequencies

    if data is None:
        if wish.separate:
            raise InputError("--separate needs a sweep whose causes it can separate; give the sweep by --data")
        frequency = first_frequencies(specimen, wish)
    else:
        frequency = next_frequencies(specimen, read_spectrum(data), wish)
    if not frequency.size:
        click.echo(
            "nothing more to measure: the goal is reached, the points are used up, or more points would not help"
        )
        return
    _prepare(out)
    write_plan(out, frequency)
    click.echo("\n".join(["frequency_Hz", *(f"{one:.3f}" for one in frequency)]))


@main.command()
@_specimen
@click.option(
    "--port", type=click.IntRange(0, 65535), default=5025, show_default=True, help="TCP port; 0: any free port"
)
@click.option(
    "--model",
    type=click.Choice(["E4990A", "4294A"]),
    default="E4990A",
    show_default=True,
    help="analyser whose commands it understands",
)
@click.option(
    "--drift",
    type=float,
    default=0.0,
    show_default=True,
    help="relative rise of the resonance frequencies per second",
)
@click.option("--seed", type=int, default=0, show_default=True, help="seed of gain error and noise")
@click.option(
    "--fail",
    "faults",
    multiple=True,
    metavar="KIND@N",
    help="simulate a fault at sweep N: timeout, half, error, overload or unplugged",
)
@click.option("--log", type=click.Path(path_type=Path), help="file that records every command received")
def analyser(
    specimen: Path, port: int, model: str, drift: float, seed: int, faults: tuple[str, ...], log: Path | None
) -> None:
    """Simulate an impedance analyser with the specimen SPEC connected to it, on a socket of this machine.

    Use it to try `measure` without an instrument. It answers as an E4990A or a 4294A does, from the model of SPEC with
    its [effects], with noise and gain error by the accuracy chart, ringing of sharp resonances, drift, and, with
    [effects.drive_level], a shift of the resonances that grows with the square of the drive. It listens at 127.0.0.1
    only, until Ctrl-C.
    """
    from femu_piezo.instruments.simulated import Fault, serve
    from femu_piezo.specimen.file import read_specimen

    def ready(own: int) -> None:
        click.echo(f"{model} with {wanted.name} at TCPIP::127.0.0.1::{own}::SOCKET")

    wanted = read_specimen(specimen)
    found = tuple(Fault.parse(text) for text in faults)
    serve(wanted, port, model=model, drift=drift, seed=seed, faults=found, log=log, ready=ready)


@main.command()
@click.option(
    "--store",
    required=True,
    envvar="FEMU_PIEZO_STORE",
    metavar="URL",
    help="URL of the database, the SQLite file, or the folder that holds store.sqlite",
)
@click.option("--out", type=click.Path(path_type=Path), help="folder for lots.parquet, lots.json and lots.png")
@click.option("--lot", "names", multiple=True, metavar="NAME", help="only this lot; may be given several times")
@click.option(
    "--quantity",
    "quantities",
    multiple=True,
    metavar="NAME",
    help="column to chart, such as s11, s11_tan or pole_Hz; may be given several times  [default: constants, loss "
    "tangents, k_eff and misfit]",
)
def lots(store: str, out: Path | None, names: tuple[str, ...], quantities: tuple[str, ...]) -> None:
    """List, compare and chart over time the lots that `batch`, `update`, `measure` and `diagnose` kept in a --store.

    For every constant: mean, control limits of single pieces and of lots (ISO 7870-2), scatter within and between lots,
    and its drift per month with the standard deviation. The time of a piece is the time of its sweep file when the
    store first kept it. With --out also lots.parquet (one row for each piece: its last update and diagnosis, with lot,
    time, station and program version), lots.json and lots.png. Needs pip install 'femu-piezo[store]'.
    """
    from femu_piezo.output.tables import console
    from femu_piezo.store.command import show_lots

    console().print(show_lots(store, out, names, quantities))


@main.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="[FOLDER]", default=Path("."))
@click.option("--port", type=click.IntRange(1, 65535), default=8080, show_default=True, help="TCP port of the page")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="address to listen at; if other machines can reach it, visitors need the token that the terminal shows",
)
@_store
def serve(folder: Path, port: int, host: str, store: str | None) -> None:
    """Show sweeps, specimens and results of FOLDER as a page in the browser, and run the commands from there.

    Results go to FOLDER/results as the commands write them; FOLDER/.femu-piezo holds unsaved edits and jobs of the
    page. Nothing is fetched from or sent to other machines. Needs pip install 'femu-piezo[web]'.
    """
    from femu_piezo.web.server import serve as run

    run(folder, host, port, store)


if __name__ == "__main__":
    main()
