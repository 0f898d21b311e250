"""Tolerances and other uncertainties in a specimen file: every key is documented, checked, and read back as written."""

from __future__ import annotations

from pathlib import Path

import pytest

from femu_piezo.specimen.file import (
    CONSTANTS,
    Geometry,
    Material,
    Measurement,
    Residue,
    Specimen,
    Update,
    read_specimen,
    write_specimen,
)
from tests.commands import invoked

#: Lines of [geometry] for each shape, to which a key is added.
PLATE = 'shape = "plate"\nlength = "40 mm"\nwidth = "5 mm"\nthickness = "1 mm"\n'
DISK = 'shape = "disk"\ndiameter = "20 mm"\nthickness = "1 mm"\n'
RING = 'shape = "ring"\ndiameter = "20 mm"\ninner_diameter = "8 mm"\nthickness = "1 mm"\n'
TRAPEZOID = 'shape = "trapezoid"\nlength = "20 mm"\nwidth = "6 mm"\nwidth_end = "3 mm"\nthickness = "1 mm"\n'
#: Key → (lines of [geometry], right value with its unit, the same in SI, value of another dimension).
GEOMETRY = {
    "std_length": (PLATE, "20 um", 20e-6, "1 kg"),
    "std_width": (PLATE, "0.02 mm", 20e-6, "1 %"),
    "std_thickness": (PLATE, "5 um", 5e-6, "1 Hz"),
    "std_diameter": (DISK, "0.02 mm", 20e-6, "1 kg"),
    "std_inner_diameter": (RING, "0.05 mm", 50e-6, "1 kg"),
    "std_width_end": (TRAPEZOID, "10 um", 10e-6, "1 %"),
    "std_density": (PLATE, "0.3 %", 0.003, "10 kg/m^3"),
    "mass": (PLATE, "1.58 g", 1.58e-3, "7900 kg/m^3"),
    "std_mass": (PLATE + "mass = 1.58e-3\n", "1 mg", 1e-6, "0.1 %"),
}
MATERIAL = {f"std_{name}": ("5 %", 0.05, "1e-12 m^2/N") for name in CONSTANTS}
MATERIAL |= {f"std_tan_{name}": ("0.5 %", 0.005, "1 mrad/Hz") for name in CONSTANTS}
MEASUREMENT = {"accuracy": ("0.08 %", 8e-4, "1 ohm"), "phase_accuracy": ("0.8 mrad", 8e-4, "1 ohm")}
RESIDUE = {
    "resistance": ("20 mohm", 0.02, "10 nH"),
    "inductance": ("10 nH", 10e-9, "20 mohm"),
    "capacitance": ("0.1 pF", 1e-13, "1 nH"),
}


def text(key: str, value: str) -> tuple[str, str]:
    """A specimen file with one key, and the name of that key in messages."""
    geometry = GEOMETRY[key][0] if key in GEOMETRY else PLATE
    lines = {name: "" for name in ("geometry", "material", "measurement")}
    for table, keys in (("geometry", GEOMETRY), ("material", MATERIAL), ("measurement", MEASUREMENT)):
        if key in keys:
            lines[table], where = f"{key} = {value}\n", f"{table}.{key}"
    if key in RESIDUE:
        lines["measurement"], where = f"residue = {{ {key} = {value} }}\n", f"measurement.residue.{key}"
    return (
        f'[geometry]\n{geometry}{lines["geometry"]}[material]\nbase = "pzt-5h"\n{lines["material"]}'
        f"[measurement]\n{lines['measurement']}",
        where,
    )


EVERY = {
    **{key: row[1:] for key, row in GEOMETRY.items()},
    **MATERIAL,
    **MEASUREMENT,
    **RESIDUE,
}


def test_no_key_of_the_schema_is_left_out():
    fields = {name for table in (Geometry, Material) for name in table.model_fields if name.startswith("std_")}
    fields |= {"mass", "accuracy", "phase_accuracy", *Residue.model_fields}
    assert fields == set(EVERY)


@pytest.mark.parametrize("key", EVERY)
def test_a_value_is_read_with_its_unit_and_comes_back(key, tmp_path):
    right, si, _ = EVERY[key]
    path = tmp_path / "plate.toml"
    path.write_text(text(key, f'"{right}"')[0], encoding="utf-8")
    one = read_specimen(path)
    tables = (one.geometry, one.material, one.measurement, one.measurement.residue)
    assert next(getattr(table, key) for table in tables if hasattr(table, key)) == pytest.approx(si, rel=1e-12, abs=0)
    write_specimen(one, tmp_path / "copy.toml")
    assert read_specimen(tmp_path / "copy.toml") == one.model_copy(update={"path": tmp_path / "copy.toml"})


@pytest.mark.parametrize("key", EVERY)
def test_a_wrong_value_is_one_sentence(key, tmp_path):
    """Values of another dimension, negative, not finite, no number or a truth value: file, key and what would be
    right.
    """
    path = tmp_path / "plate.toml"
    for value in (f'"{EVERY[key][2]}"', "-0.001", "nan", '"five"', "true", "[1, 2]"):
        content, where = text(key, value)
        path.write_text(content, encoding="utf-8")
        answer = invoked("update", path, "--out", tmp_path / "out")
        assert answer.exit_code == 2, (value, answer.output)
        assert f"{path}: {where}" in answer.output and answer.output.strip().count("\n") == 0, answer.output
        assert ";" in answer.output or "write" in answer.output or "such as" in answer.output, answer.output


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"geometry": DISK + "std_length = 1e-5\n"}, "geometry.std_length is given, but a disk has no length"),
        ({"geometry": PLATE + "mass = 1.58e-3\ndensity = 7900\n"}, "geometry.mass and geometry.density are both given"),
        ({"geometry": PLATE + "mass = 1.58e-3\nstd_density = 0.01\n"}, "geometry.std_density is given beside"),
        (
            {"geometry": PLATE + "std_width = 0.02\n"},
            "geometry.std_width = 0.02 m is 400 % of width = 0.005 m; is the unit",
        ),
        ({"geometry": PLATE + "mass = 1.58e-3\nstd_mass = 1e-3\n"}, "geometry.std_mass = 0.001 kg is 63.3 % of mass"),
        ({"geometry": PLATE + "std_mass = 1e-6\n"}, "geometry.std_mass is given without geometry.mass"),
        (
            {"update": "[update]\nnoise_only = 1\n"},
            "update.noise_only = 1 cannot be used; input should be true or false",
        ),
        ({"update": "[update]\nloss = 'square'\n"}, "update.loss"),
        ({"material": "std_s66 = 0.1\n"}, "material.std_s66 is not a key that is known"),
        ({"measurement": "residue = 0.02\n"}, "measurement.residue = 0.02 is not a table"),
        ({"measurement": "residue = { impedance = 1 }\n"}, "measurement.residue.impedance is not a key"),
    ],
)
def test_keys_that_do_not_go_together_are_one_sentence(given, told, tmp_path):
    parts = {"geometry": PLATE, "material": "", "measurement": "", "update": ""} | given
    path = tmp_path / "plate.toml"
    path.write_text(
        f'[geometry]\n{parts["geometry"]}[material]\nbase = "pzt-5h"\n{parts["material"]}'
        f"[measurement]\n{parts['measurement']}{parts['update']}",
        encoding="utf-8",
    )
    answer = invoked("update", path, "--out", tmp_path / "out")
    assert answer.exit_code == 2 and told in answer.output, answer.output
    assert answer.output.strip().count("\n") == 0


def test_what_a_diagnosis_writes_is_read_back(tmp_path):
    """[effects] with free parameters, [fitted], noise_only and the residue together."""
    one = Specimen(
        name="plate",
        geometry=Geometry(shape="plate", length=0.04, width=0.005, thickness=0.001, mass=1.58e-3, std_mass=1e-6),
        material=Material(base="pzt-5h", std_s11=0.01, std_tan_s11=0.002, std_d31=0.1),
        measurement=Measurement(residue=Residue(resistance=0.01, capacitance=2e-13), accuracy=5e-4),
        update=Update(noise_only=True, loss="huber"),
        effects={"point_mass": {"mass": 2e-6, "x": 4.1e-3, "y": 1e-3, "radius": 0.0, "free": ("mass", "x")}},
        fitted={
            "material": {"s11": 1.6472126915410817e-11, "tan_s11": -3.3e-7},
            "wrong_length": {"relative_error": 1e-4 / 3},
            "instrument": {"magnitude_1e5": -0.1, "phase_1e5": 2.5e-17},
        },
    )
    write_specimen(one, tmp_path / "plate.toml")
    assert read_specimen(tmp_path / "plate.toml") == one.model_copy(update={"path": tmp_path / "plate.toml"})


def test_every_key_is_documented():
    """The pages of docs/explanation and the docstrings of the tables name each key, or the first key of its family."""
    folder = Path(__file__).resolve().parents[2] / "docs" / "explanation"
    pages = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.md"))
    schema = "".join(table.__doc__ for table in (Geometry, Material, Measurement, Residue, Update, Specimen))
    for key in (*GEOMETRY, *MEASUREMENT, *RESIDUE, "residue", "noise_only", "std_s11", "std_tan_s11", "free", "fitted"):
        assert key in pages, key
        family = "std_length" if key in ("std_width", "std_thickness", "std_diameter") else key
        assert family in schema, key
