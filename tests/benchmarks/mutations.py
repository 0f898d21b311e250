"""Thousands of damaged inputs: counts of right answers, clear refusals, silent changes, tracebacks and hangs.

    python tests/benchmarks/mutations.py [count of each of four kinds, default 3000] [seed]

Every input is a sound file with one to three mutations: bytes deleted, inserted, replaced or repeated; lines dropped,
doubled or exchanged; cut off; numbers made NaN, infinite, zero, negative, huge or of another unit; another encoding,
delimiter or decimal sign. "right" is the answer of the sound file (of a sweep: at most the damaged points differ);
"other" is a file that means something else and is sound by itself, such as a changed digit.
"""

from __future__ import annotations

import random
import re
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from femu_piezo.errors import FemuPiezoError
from femu_piezo.files import json_text
from femu_piezo.geometry.mesh_file import MeshFile
from femu_piezo.material.library import library_material
from femu_piezo.measurement.readers import read_spectrum
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.export import constants_of_record, export_text
from femu_piezo.study.problem import prepare

ROOT = Path(__file__).resolve().parents[2]
HANG_S = 20
#: Kinds of input that are neither specimen files nor tables.
SUFFIXES = {"text msh": ".msh", "binary msh": ".msh", "update.json": ".json", "touchstone": ".s1p"}
TOKENS = [b"nan", b"inf", b"-inf", b"1e999", b"1e-999", b"0", b"-1", b"", b"--", b"1,2", b"\0", b'"', b"[", b"]", b"="]
TOKENS += [b"9" * 400, b",", b";", b"\t", b"\n", b"\r", b"\xff\xfe", b"\xef\xbb\xbf", "Ω".encode(), b"${HOME}", b"../"]
TOKENS += [b"mm", b"kHz", b"true", b"{}", b"'''", b"#", b"$Nodes", b"$EndNodes", b"1_000", b"0x10", b"1e5", b"k", b"M"]


class Hang(BaseException):
    """Raised by the alarm. It is no Exception, so that no handler of the program takes it for a fault of the file."""


def damaged(raw: bytes, draw: random.Random) -> bytes:
    """One to three mutations of a file."""
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        raw = draw.choice(_MUTATIONS)(raw, draw)
    return raw


def _bytes(raw: bytes, draw: random.Random) -> bytes:
    """Bytes deleted, inserted, replaced or repeated."""
    start = draw.randrange(len(raw) + 1)
    stop = min(len(raw), start + draw.choice([0, 1, 2, 8, 100]))
    fresh = draw.choice([draw.choice(TOKENS), draw.randbytes(draw.choice([1, 4, 30]))])
    return raw[:start] + fresh + raw[stop:]


def _number(raw: bytes, draw: random.Random) -> bytes:
    """A number made NaN, infinite, zero, negative, huge, or something else."""
    numbers = list(re.finditer(rb"-?\d+\.?\d*(?:[eE][+-]?\d+)?", raw))
    if not numbers:
        return raw
    found = draw.choice(numbers)
    factor = draw.choice([b"e3", b"e-3", b"e30", b"e-30"])
    fresh = draw.choice([b"nan", b"inf", b"0", b"-" + found[0], found[0] + factor, found[0].replace(b".", b","), b""])
    return raw[: found.start()] + fresh + raw[found.end() :]


def _lines(raw: bytes, draw: random.Random) -> bytes:
    """Lines dropped, doubled or exchanged."""
    lines = raw.split(b"\n")
    one, other = draw.randrange(len(lines)), draw.randrange(len(lines))
    how = draw.randrange(4)
    if how == 0:
        del lines[one]
    elif how == 1:
        lines.insert(other, lines[one])
    elif how == 2:
        lines[one], lines[other] = lines[other], lines[one]
    else:
        del lines[min(one, other) : max(one, other)]
    return b"\n".join(lines)


def _cut(raw: bytes, draw: random.Random) -> bytes:
    """The file cut off."""
    return raw[: draw.randrange(len(raw) + 1)]


def _dialect(raw: bytes, draw: random.Random) -> bytes:
    """Another encoding, delimiter or decimal sign."""
    how = draw.randrange(6)
    if how == 0:
        return raw.decode("latin-1").encode("utf-16")
    if how == 1:
        return b"\xef\xbb\xbf" + raw
    old, new = [(b",", b";"), (b".", b","), (b"\n", b"\r\n"), (b",", b"\t")][how - 2]
    return raw.replace(old, new)


def _unit(raw: bytes, draw: random.Random) -> bytes:
    """A unit exchanged for another one."""
    old, new = draw.choice(
        [
            (b"Hz", b"kHz"),
            (b"mm", b"m"),
            (b"deg", b"rad"),
            (b"resistance", b"reactance"),
            (b"ohm", b"S"),
            (b"DEG", b"RAD"),
        ]
    )
    return raw.replace(old, new)


_MUTATIONS = [_bytes, _bytes, _number, _number, _lines, _cut, _dialect, _unit]


def sweeps() -> dict[str, tuple[bytes, Callable[[Path], str]]]:
    """Name → (sound sweep in one of four formats, function that gives the outcome for a file)."""
    sys.path.insert(0, str(ROOT))
    from tests.measurement.sweeps import SOFT, bar_impedance, columns_of, write_4294a, write_e4990a

    f = np.round(np.linspace(30e3, 50e3, 60), 3)
    z = bar_impedance(f, **SOFT)
    polar = columns_of(f, z, "z_deg")
    plain = "".join(f"{a!r},{b.real!r},{b.imag!r}\n" for a, b in zip(f.tolist(), z.tolist(), strict=True))
    comma = "".join(f"{a / 1e3:.6f};{b:.7e};{c:.6f}\r\n" for a, b, c in zip(f, *polar, strict=True)).replace(".", ",")
    texts = {
        "csv": "frequency_Hz,resistance_ohm,reactance_ohm\n" + plain,
        "decimal comma": "Frequency (kHz);|Z| (Ohm);theta (deg)\r\n" + comma,
        "4294A": write_4294a(f, *polar, "IMPEDANCE MAG PHASE (DEG)"),
        "E4990A": write_e4990a(f, *polar, "|Z|(Ohm)-data, theta-z(deg)-data"),
        "touchstone": "# Hz S RI R 50\n"
        + "".join(
            f"{a!r} {b.real!r} {b.imag!r}\n" for a, b in zip(f.tolist(), ((z - 50) / (z + 50)).tolist(), strict=True)
        ),
    }

    def outcome(path: Path) -> str:
        spectrum = read_spectrum(path)
        nearest = np.argmin(np.abs(spectrum.frequency[:, None] - f), axis=1)
        wrong = np.abs(spectrum.frequency / f[nearest] - 1) > 1e-6
        wrong |= np.abs(spectrum.impedance / z[nearest] - 1) > 1e-4
        if wrong.sum() <= 6:
            return "right"
        return "told" if spectrum.notes else "other"

    return {name: (text.encode(), outcome) for name, text in texts.items()}


def specimens() -> dict[str, tuple[bytes, Callable[[Path], str]]]:
    """Name → (sound specimen file, function that gives the outcome for a file: schema, geometry and material)."""
    plate = (ROOT / "tutorials/k31_plate/plate.toml").read_bytes()
    full = b"""name = "plate 07"
[geometry]
shape = "plate"
length = "12 mm"
width = "3 mm"
thickness = "1 mm"
density = "7500 kg/m^3"
poling = "length"
[material]
base = "pzt-5h"
s12 = -4.5e-12
tan_s11 = 0.01
std_s44 = "5 %"
free = ["s33", "d33"]
[measurement]
file = "sweep.csv"
held_out = ["90 kHz", "120 kHz"]
noise = 0.001
[simulation]
start = "1 kHz"
stop = "200 kHz"
points = 401
[update]
method = "curve"
accuracy = 1e-4
"""
    every = b"""name = "every table"
[geometry]
shape = "plate"
length = "40 mm"
width = "5 mm"
thickness = "1 mm"
mass = "1.58 g"
std_mass = "2 mg"
std_length = "0.02 mm"
std_width = "0.02 mm"
std_thickness = "5 um"
poling = [0, 0, 1]
[material]
base = "pzt-5h"
s11 = "16.5e-12 m^2/N"
d31 = "-274 pC/N"
eps33T = "3400 eps0"
tan_d31 = 0.013
std_s11 = 0.1
std_tan_s11 = 0.01
simplified = false
[measurement]
mask = [["61 kHz", "61.4 kHz"]]
correct_phase = true
mask_faults = true
accuracy = "0.08 %"
phase_accuracy = "0.8 mrad"
residue = { resistance = "20 mohm", inductance = "10 nH", capacitance = "0.1 pF" }
open = "open.csv"
short = "short.csv"
load = { file = "load.csv", resistance = "100 ohm", inductance = "1 nH", capacitance = "1 pF", std = 0.001 }
connection = "series"
columns = ["Frequency (Hz)", "R (Ohm)", "X (Ohm)"]
[[sweep]]
file = "up.csv"
name = "up"
direction = "up"
drive_voltage = "0.5 V"
temperature = "25 C"
fixture = "clips"
[[sweep]]
file = "down.csv"
direction = "down"
drive_voltage = "0.5 V"
temperature = "26 C"
fixture = "wires"
[readings]
capacitance = "6.02 nF"
std_capacitance = 0.01
d33 = "590 pC/N"
sound_velocity = "4560 m/s"
[simulation]
spacing = "log"
noise = 0.001
seed = 3
order = 4
[update]
loss = "huber"
noise_only = true
[effects.series_resistance]
resistance = "1.5 ohm"
free = ["resistance"]
[effects."stray_capacitance (clips)"]
capacitance = "1 pF"
[fitted.material]
s11 = 1.64e-11
tan_s11 = 0.01
"""
    disk = b'[geometry]\nshape = "disk"\ndiameter = "20 mm"\nthickness = "1 mm"\n[material]\nbase = "pzt-5h"\n'

    def outcome_of(raw: bytes) -> Callable[[Path], str]:
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "x.toml").write_bytes(raw)
            sound = read_specimen(Path(folder) / "x.toml").model_dump(exclude={"path", "measurement", "sweep"})

        def outcome(path: Path) -> str:
            specimen = read_specimen(path)
            prepare(specimen)
            return "right" if specimen.model_dump(exclude={"path", "measurement", "sweep"}) == sound else "other"

        return outcome

    files = {"plate.toml": plate, "all keys": full, "every table": every, "disk": disk}
    return {name: (raw, outcome_of(raw)) for name, raw in files.items()}


def meshes() -> dict[str, tuple[bytes, Callable[[Path], str]]]:
    """Name → (sound gmsh file of a small box, text or binary, function that gives the outcome for a file)."""
    from femu_piezo.geometry.gmsh_session import gmsh_session

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.msh"
        with gmsh_session("geo"):
            import gmsh

            gmsh.open(str(ROOT / "meshes/box_7x1x1.msh"))
            gmsh.option.setNumber("Mesh.Binary", 0)
            gmsh.write(str(path))
        found = {"text msh": path.read_bytes(), "binary msh": (ROOT / "meshes/box_7x1x1.msh").read_bytes()}
    found = {name: raw.replace(b'"z_max"', b'"hot"').replace(b'"z_min"', b'"ground"') for name, raw in found.items()}
    volume = {}

    def outcome(name: str) -> Callable[[Path], str]:
        def of(path: Path) -> str:
            mesh = MeshFile(path, 1e-2)
            size = float(mesh.domain_for().volume), mesh.electrode_area
            return "right" if np.allclose(size, volume.setdefault(name, size), rtol=1e-9) else "other"

        return of

    return {name: (raw, outcome(name)) for name, raw in found.items()}


def records() -> dict[str, tuple[bytes, Callable[[Path], str]]]:
    """Name → (sound update.json, function that gives the outcome of `export` for a file)."""
    pzt = library_material("pzt-5h").constants
    record = {
        "specimen": "plate 07",
        "parameters": {"s11": {"value": pzt.s11.real, "std": 1e-13, "tan": 0.01, "tan_std": 1e-3}},
        "constants": {name: {"value": value.real, "tan": 0.01} for name, value in pzt.as_dict().items()},
        "specimens": [{"density": 7500.0}],
    }
    raw = json_text(record).encode()

    def outcome(path: Path) -> str:
        constants, density, name, found = constants_of_record(path)
        text = export_text(constants, density, name, "json", found=found)
        sound = constants.s11 == pzt.s11 * (1 - 0.01j) and density == 7500.0 and name == "plate 07"
        return "right" if sound and len(text) > 1000 else "other"

    return {"update.json": (raw, outcome)}


def judge(path: Path, outcome: Callable[[Path], str]) -> str:
    """The outcome of a file: that of `outcome`, or "refused", "not one sentence", "traceback" or "hang"."""

    def alarm(number, frame):
        raise Hang

    before = signal.signal(signal.SIGALRM, alarm)
    signal.alarm(HANG_S)
    try:
        return outcome(path)
    except FemuPiezoError as error:
        return "refused" if "\n" not in str(error) and len(str(error)) > 20 else "not one sentence"
    except Hang:
        return "hang"
    except Exception:
        return "traceback"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def run(
    kinds: dict[str, tuple[bytes, Callable[[Path], str]]], count: int, seed: int, keep: Path | None = None
) -> Counter:
    """Outcomes of `count` damaged files; those with a traceback or hang are kept in `keep`."""
    draw, found, names = random.Random(seed), Counter(), sorted(kinds)
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            raw, outcome = kinds[names[number % len(names)]]
            suffix = SUFFIXES.get(names[number % len(names)], ".toml" if b"[geometry]" in raw else ".csv")
            path = Path(folder) / f"x{suffix}"
            if number < len(names):  # the first files are the sound ones themselves
                path.write_bytes(raw)
                assert judge(path, outcome) == "right", names[number]
                continue
            path.write_bytes(damaged(raw, draw))
            word = judge(path, outcome)
            found[word] += 1
            if word in ("traceback", "hang", "not one sentence") and keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{word}_{seed}_{number}{suffix}").write_bytes(path.read_bytes())
                if word == "traceback" and found[word] <= 5:
                    try:
                        outcome(path)
                    except Exception:
                        print(f"{names[number % len(names)]}, number {number}:", traceback.format_exc(limit=-3))
    return found


def million_lines() -> str:
    """Time and memory for reading a sweep of a million lines, as a sentence."""
    import resource

    with tempfile.TemporaryDirectory() as folder:
        path, f = Path(folder) / "x.csv", np.linspace(30e3, 50e3, 1_000_000)
        text = "".join(f"{a!r},{b!r},-1000.0\n" for a, b in zip(f.tolist(), (10 + f / 1e5).tolist(), strict=True))
        path.write_text("frequency_Hz,resistance_ohm,reactance_ohm\n" + text, encoding="utf-8")
        start = time.perf_counter()
        try:
            word = f"{len(read_spectrum(path))} points"
        except FemuPiezoError as error:
            word = f"refused: {error}"
        seconds = time.perf_counter() - start
    return (
        f"a million lines: {word}, {seconds:.1f} s, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB"
    )


def main(count: int, seed: int) -> None:
    warnings.simplefilter("ignore")
    words = ("right", "told", "other", "refused", "not one sentence", "traceback", "hang")
    print(f"{'':12s}" + "".join(f"{word:>18s}" for word in words) + f"{'ms each':>10s}")
    total = Counter()
    for name, kinds in (
        ("sweeps", sweeps()),
        ("specimens", specimens()),
        ("meshes", meshes()),
        ("records", records()),
    ):
        start = time.perf_counter()
        found = run(kinds, count, seed, Path(tempfile.gettempdir()) / "femu_mutations")
        total += found
        each = 1e3 * (time.perf_counter() - start) / count
        print(f"{name:12s}" + "".join(f"{found[word]:18d}" for word in words) + f"{each:10.2f}")
    print(f"{'sum':12s}" + "".join(f"{total[word]:18d}" for word in words))
    print(million_lines())


if __name__ == "__main__":
    main(*(int(item) for item in [*sys.argv[1:], *(3000, 1)[len(sys.argv) - 1 :]]))
