"""Specimen files: the schema, its messages, the round trip, and faulty input of every kind."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from femu_piezo.errors import InputError
from femu_piezo.specimen.file import (
    CONSTANTS,
    Geometry,
    Material,
    Measurement,
    Simulation,
    Specimen,
    Update,
    read_specimen,
    read_specimens,
    write_specimen,
)
from femu_piezo.study.measured import measure
from femu_piezo.units import EPS0

PLATE = """name = "plate 07"
[geometry]
shape = "plate"
length = "40 mm"
width = "5 mm"
thickness = "1 mm"
density = "7900 kg/m^3"
poling = "thickness"
[material]
base = "tj52-hd"
s11 = 16.5e-12
eps33T = "3400 eps0"
tan_s11 = 0.0
free = ["s11", "d31", "eps33T"]
simplified = false
[measurement]
file = "impedance.csv"
held_out = ["90 kHz", "120 kHz"]
"""

IN_ONE_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=150)


def read_text(folder: Path, text: str | bytes) -> Specimen:
    path = folder / "plate.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_specimen(path)


def test_the_contract_example(tmp_path: Path) -> None:
    specimen = read_text(tmp_path, PLATE)
    assert specimen.name == "plate 07"
    geometry = specimen.geometry
    assert (geometry.shape, geometry.length, geometry.width, geometry.thickness) == ("plate", 0.04, 0.005, 0.001)
    assert (geometry.density, geometry.poling) == (7900, "thickness")
    assert specimen.material.values == {"s11": 16.5e-12, "eps33T": pytest.approx(3400 * EPS0, rel=1e-15, abs=0)}
    assert specimen.material.tangents == {"s11": 0.0}
    assert specimen.material.free == ("s11", "d31", "eps33T")
    assert specimen.measurement.file == tmp_path / "impedance.csv"
    assert specimen.measurement.held_out == (90e3, 120e3)
    assert specimen.path == tmp_path / "plate.toml"


def test_defaults_follow_the_poling_and_the_file_name(tmp_path: Path) -> None:
    free = 'free = ["s11", "d31", "eps33T"]\n'
    thickness = read_text(tmp_path, PLATE.replace(free, "").replace('name = "plate 07"\n', ""))
    assert thickness.name == "plate"
    assert thickness.material.free == ("s11", "d31", "eps33T")
    length = read_text(tmp_path, PLATE.replace(free, "").replace('poling = "thickness"', 'poling = "length"'))
    assert length.material.free == ("s33", "d33", "eps33T")
    for direction, expected in (("[0, 0, -1]", ("s11", "d31", "eps33T")), ("[1, 0, 0]", ("s44", "d15", "eps11T"))):
        along = read_text(tmp_path, PLATE.replace(free, "").replace('poling = "thickness"', f"poling = {direction}"))
        assert along.material.free == expected


def test_variables_and_absolute_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = PLATE.replace("impedance.csv", "${FEMU_DATA}/x.txt")
    without = read_text(tmp_path, text)
    write_specimen(without, tmp_path / "again.toml")
    assert read_specimen(tmp_path / "again.toml").measurement == without.measurement
    with pytest.raises(InputError, match=r"FEMU_DATA is not set"):  # only commands that need the sweep fail
        measure(without)
    monkeypatch.setenv("FEMU_DATA", "/data")
    assert read_text(tmp_path, text).measurement.file == Path("/data/x.txt")
    assert read_text(tmp_path, PLATE.replace("impedance.csv", "/a/b.csv")).measurement.file == Path("/a/b.csv")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("length =", "lenght =", "geometry.lenght is not a key that is known; did you mean 'length'?"),
        ("[geometry]", "[geometri]", "geometri is not a key that is known; did you mean 'geometry'?"),
        ('length = "40 mm"', "", "geometry.length is missing; a plate needs length, width, thickness"),
        ('"40 mm"', "40", "geometry.length: 40 is outside 1e-06 … 0.5 m; is the unit right (mm taken for m)?"),
        ('"40 mm"', '"0 mm"', "geometry.length"),
        ('"1 mm"', '"0.01 mm"', "geometry.thickness = 1e-05 m is less than 1/1000 of length = 0.04 m; is the unit"),
        ('"40 mm"', '"-40 mm"', "geometry.length"),
        ('"40 mm"', '"40 kg"', "wrong dimension"),
        ('name = "', 'name = "prior"\n# "', "known beforehand; give another name"),
        ('"7900 kg/m^3"', '"7.9 kg/m^3"', "geometry.density"),
        ('shape = "plate"', 'shape = "plat"', "'disk', 'ring' or 'mesh'"),
        ('shape = "plate"', 'shape = "disk"', "geometry.length does not belong to a disk"),
        ("16.5e-12", "16.5", "material.s11"),
        ('"3400 eps0"', "3400", 'or as "3400 eps0"'),
        ("tan_s11 = 0.0", "tan_s11 = -0.01", "material.tan_s11"),
        ("tan_s11 = 0.0", "tan_s11 = nan", "not a finite number"),
        ("tan_s11 = 0.0", "tan_s66 = 0.0", "material.tan_s66 is not a key"),
        ('base = "tj52-hd"', "", "lacks s12, s13, s33, s44, d31, d33, d15, eps11T"),
        ('"d31", ', '"d66", ', "material.free"),
        ('"d31", ', '"s11", ', "twice"),
        ("simplified = false", 'simplified = "no"', "true or false"),
        ('"90 kHz", ', "", "measurement.held_out"),
        ('"90 kHz", ', '"190 kHz", ', "lower frequency first"),
        ("held_out =", 'mask = ["61 kHz", 62e3]\nheld_out =', 'two frequencies; write mask = [["61 kHz", 62000.0]]'),
        ("held_out =", 'mask = [["61 kHz"]]\nheld_out =', 'two frequencies; write mask = [["61 kHz", "62 kHz"]]'),
        ("held_out =", 'mask = "61 kHz"\nheld_out =', 'measurement.mask: "61 kHz" cannot be used, since each band is'),
        ("held_out =", 'mask = [["62 kHz", "61 kHz"]]\nheld_out =', "measurement.mask holds [62000, 61000] Hz, not a"),
        ("held_out =", 'columns = "f, R, X"\nheld_out =', "cannot be used; input should be a list"),
        ('file = "impedance.csv"', "file = 7", "measurement.file"),
        ("[measurement]", "[measurement]\nnoise = 0", "measurement.noise"),
        ("[measurement]", "[simulation]\npoints = 1\n[measurement]", "simulation.points"),
        ("[measurement]", "[simulation]\nstart = 2\nstop = 1\n[measurement]", "simulation.start"),
        ("[measurement]", '[simulation]\nstop = "50 Hz"\n[measurement]', "simulation.stop = 50 Hz is not above"),
        ("[measurement]", '[update]\nmethod = "best"\n[measurement]', "update.method"),
        ("[measurement]", "[update]\naccuracy = 2\n[measurement]", "update.accuracy"),
        ("[material]", "[material", "line 9"),
        ("name =", "path = 'x'\nname =", "path is not a key"),
        ('"plate 07"', '"\\u0000"', "name"),
        ("[geometry]", "[[geometry]]", "not a table"),
        ('poling = "thickness"', f"poling = [1{'0' * 400}, 0, 0]", "geometry.poling"),
        ("[measurement]", f'[[sweep]]\nfile = "a.csv"\ntemperature = 1{"0" * 400}\n[measurement]', "sweep.temperature"),
        ('"40 mm"', "9" * 5000, "too long"),
        ('"40 mm"', "[" * 5000, "too long"),
    ],
)
def test_wrong_values_are_refused_in_one_sentence(tmp_path: Path, old: str, new: str, told: str) -> None:
    assert old in PLATE
    with pytest.raises(InputError) as caught:
        read_text(tmp_path, PLATE.replace(old, new, 1))
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'plate.toml'}: ")
    assert told in message
    assert "\n" not in message


def test_files_that_are_no_specimens_are_refused(tmp_path: Path) -> None:
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    (tmp_path / "large").write_bytes(b"#" * 1_100_000)
    for name, told in (("absent", "no such file"), ("", "directory"), ("binary", "text"), ("large", "MB")):
        with pytest.raises(InputError, match=told):
            read_specimen(tmp_path / name)
    with pytest.raises(InputError, match="regular"):
        read_specimen("/dev/zero")


def test_models_built_in_python_check_as_files_do() -> None:
    assert Geometry(shape="disk", diameter="35 mm", thickness=0.002).diameter == 0.035
    with pytest.raises(InputError, match=r"geometry\.inner_diameter"):
        Geometry(shape="ring", diameter=0.01, inner_diameter=0.02, thickness=0.001)
    with pytest.raises(InputError, match="poled along"):
        Geometry(shape="disk", diameter=0.01, thickness=0.001, poling="length")
    with pytest.raises(InputError, match="lacks"):
        Material(s11=1e-11)
    with pytest.raises(ValidationError):
        Geometry(shape="disk", diameter=0.01, thickness=0.001).thickness = 3


MATERIALS = st.builds(
    Material,
    base=st.sampled_from(["tj52-hd", "PZT-5A", 'quoted "µ" \\ name']),
    s11=st.none() | st.floats(1e-13, 1e-10),
    s12=st.none() | st.floats(-1e-10, 1e-10),
    d31=st.none() | st.floats(-1e-9, 1e-9),
    eps33T=st.none() | st.floats(1e-10, 1e-6),
    tan_s11=st.none() | st.floats(0, 1),
    tan_d31=st.none() | st.floats(-1, 1),
    free=st.lists(st.sampled_from(CONSTANTS), unique=True, max_size=10).map(tuple),
    simplified=st.booleans(),
)
LENGTHS = st.floats(1e-3, 0.5)
GEOMETRIES = st.one_of(
    st.builds(
        Geometry,
        shape=st.just("plate"),
        length=LENGTHS,
        width=LENGTHS,
        thickness=LENGTHS,
        density=st.none() | st.floats(100, 30000),
        poling=st.sampled_from(["thickness", "length"]),
    ),
    st.builds(Geometry, shape=st.just("disk"), diameter=LENGTHS, thickness=LENGTHS),
    st.builds(Geometry, shape=st.just("mesh"), file=st.just(Path("/meshes/x y.msh"))),
)
PATHS = st.text(st.characters(exclude_characters="/\0~", exclude_categories=["Cs"]), min_size=1, max_size=20).filter(
    lambda name: name.strip() and "${" not in name and name not in (".", "..")
)
MEASUREMENTS = st.builds(
    Measurement,
    file=PATHS.map(lambda name: Path("/data") / name),
    held_out=st.none() | st.floats(1, 1e6).map(lambda low: (low, 2 * low)),
    correct_phase=st.booleans(),
    noise=st.none() | st.floats(1e-9, 1),
)
SPECIMENS = st.builds(
    Specimen,
    name=st.text(st.characters(categories=["L", "N", "P", "S"]), min_size=1, max_size=50),
    geometry=GEOMETRIES,
    material=MATERIALS,
    measurement=st.none() | MEASUREMENTS,
    simulation=st.none() | st.builds(Simulation, start=st.none() | st.floats(1, 1e6), points=st.integers(2, 10**6)),
    update=st.none() | st.builds(Update, accuracy=st.floats(1e-9, 0.1), method=st.sampled_from(["auto", "curve"])),
)


@IN_ONE_FOLDER
@given(SPECIMENS)
def test_what_is_written_reads_back(tmp_path: Path, specimen: Specimen) -> None:
    path = tmp_path / "copy.toml"
    write_specimen(specimen, path)
    assert read_specimen(path) == specimen.model_copy(update={"path": path})
    assert [entry.name for entry in tmp_path.iterdir()] == ["copy.toml"]


def test_a_moved_folder_keeps_its_data(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    specimen = read_text(here, PLATE)
    write_specimen(specimen, here / "extended.toml")
    here.rename(there)
    assert read_specimen(there / "extended.toml").measurement.file == there / "impedance.csv"


def test_writing_fails_in_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    specimen = read_text(tmp_path, PLATE)
    with pytest.raises(InputError, match="cannot be written"):
        write_specimen(specimen, tmp_path / "absent" / "x.toml")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_specimen(specimen, tmp_path / "folder")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["folder", "plate.toml"]


@IN_ONE_FOLDER
@given(st.data())
@example(data=None)
def test_mutated_files_read_or_are_refused(tmp_path: Path, data: st.DataObject | None) -> None:
    raw = bytearray(PLATE.encode())
    if data is not None:
        for _ in range(data.draw(st.integers(1, 3))):
            start = data.draw(st.integers(0, len(raw)))
            stop = data.draw(st.integers(start, min(len(raw), start + 20)))
            raw[start:stop] = data.draw(
                st.binary(max_size=6) | st.sampled_from([b"nan", b"1e999", b"[[", b'"""', b"{}"])
            )
    try:
        specimen = read_text(tmp_path, bytes(raw))
        assert specimen.geometry.thickness > 0
    except InputError as error:
        assert "\n" not in str(error)


def test_files_that_a_result_depends_on(tmp_path):
    """The sweeps and the files that compensate them: a job is computed again if any of them changes."""
    body = '[geometry]\nshape = "plate"\nlength = 0.02\nwidth = 0.004\nthickness = 0.001\n[material]\nbase = "pzt-5h"\n'
    fixture = '[measurement]\nopen = "open.csv"\nshort = "short.csv"\nload = { file = "load.csv", resistance = 100 }\n'
    path = tmp_path / "plate.toml"
    path.write_text(body + fixture + '[[sweep]]\nfile = "up.csv"\n[[sweep]]\nfile = "down.csv"\n', encoding="utf-8")
    names = ("plate.toml", "open.csv", "short.csv", "load.csv", "up.csv", "down.csv")
    assert read_specimen(path).files == tuple(tmp_path / name for name in names)


def test_a_file_read_for_several_sweeps_is_read_anew_where_it_or_the_folder_changes(tmp_path, monkeypatch):
    """Its content is kept for the sweeps of a lot, each specimen with a sweep and tables of its own."""
    lines = [
        'name = "plate"',
        "[geometry]",
        'shape = "plate"',
        'length = "40 mm"',
        'width = "5 mm"',
        'thickness = "1 mm"',
        'density = "7900 kg/m^3"',
        'poling = "thickness"',
        "[material]",
        'base = "pzt-5h"',
        "[effects.series_resistance]",
        "resistance = 2.0",
    ]
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "plate.toml").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.chdir(tmp_path / "a")
    first, second = (read_specimens(["plate.toml"], name)[0] for name in ("one.csv", "two.csv"))
    assert [one.measurement.file for one in (first, second)] == [tmp_path / "a" / "one.csv", tmp_path / "a" / "two.csv"]
    first.effects["series_resistance"]["resistance"] = 5.0
    assert read_specimens(["plate.toml"], "one.csv")[0].effects["series_resistance"]["resistance"] == 2.0
    monkeypatch.chdir(tmp_path / "b")
    assert read_specimens(["plate.toml"], "one.csv")[0].measurement.file == tmp_path / "b" / "one.csv"
    (tmp_path / "b" / "plate.toml").write_text("\n".join(lines).replace("40 mm", "30 mm"), encoding="utf-8")
    assert read_specimens(["plate.toml"], "one.csv")[0].geometry.length == 30e-3
