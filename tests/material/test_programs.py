"""Material files of other programs: orders checked on a rotated triclinic tensor by its indices, round trips, notes."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import femu_piezo as fp
from femu_piezo.files import SCHEMA
from femu_piezo.material.constants import EPS0, PiezoConstants
from femu_piezo.material.conversion import StressCharge, from_stress_charge, stress_charge
from femu_piezo.material.library import library_material
from femu_piezo.material.programs.writers import PROGRAMS, program
from femu_piezo.study.export import constants_of_record, export_text
from tests.commands import invoked, succeeded
from tests.material_files import COMPLEX, READERS

RNG = np.random.default_rng(7)


def rotation() -> np.ndarray:
    q = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    return q * np.linalg.det(q)


def _tensors():
    """Complex c_ijkl, e_ijk, eps_ij with all components different, turned by a random rotation."""
    c = RNG.normal(size=(3,) * 4) + 1j * 0.02 * RNG.normal(size=(3,) * 4)
    c = c + c.transpose(1, 0, 2, 3)
    c = c + c.transpose(0, 1, 3, 2)
    c = 1e10 * (c + c.transpose(2, 3, 0, 1))
    e = 10 * (RNG.normal(size=(3,) * 3) + 1j * 0.02 * RNG.normal(size=(3,) * 3))
    e = e + e.transpose(0, 2, 1)
    eps = 1e-8 * (RNG.normal(size=(3, 3)) + 3 * np.eye(3)) * (1 - 0.01j)
    eps, r = eps + eps.T, rotation()
    c = np.einsum("ai,bj,ck,dl,ijkl->abcd", r, r, r, r, c)
    return c, np.einsum("ai,bj,ck,ijk->abc", r, r, r, e), r @ eps @ r.T


C, E, EPS = _tensors()
IEEE = ("11", "22", "33", "23", "13", "12")
ORDERS = {"ansys": ("11", "22", "33", "12", "23", "13"), "abaqus": ("11", "22", "33", "12", "13", "23")}


def c_of(pair: str, other: str) -> complex:
    """c_ijkl by its indices, without any matrix or order of components."""
    return C[int(pair[0]) - 1, int(pair[1]) - 1, int(other[0]) - 1, int(other[1]) - 1]


def e_of(axis: int, pair: str) -> complex:
    return E[axis, int(pair[0]) - 1, int(pair[1]) - 1]


MATERIAL = StressCharge(
    np.array([[c_of(p, q) for q in IEEE] for p in IEEE]), np.array([[e_of(a, p) for p in IEEE] for a in range(3)]), EPS
)
RHO = 7654.321


def text(name: str) -> str:
    """The file of a program for the triclinic material."""
    return PROGRAMS[name].write(MATERIAL, RHO, "test piece 1")


def test_the_test_matrix_has_no_symmetry():
    """Components are different from each other and from zero, so that a wrong order would be seen."""
    upper = np.abs(MATERIAL.stiffness[np.triu_indices(6)])
    assert np.min(np.diff(np.sort(upper))) > 1e-4 * upper.max() and upper.min() > 0
    assert np.linalg.matrix_rank(MATERIAL.piezoelectric) == 3 and np.all(np.abs(MATERIAL.piezoelectric) > 0)


@pytest.mark.parametrize("name", PROGRAMS)
def test_round_trip_of_every_number(name):
    back, density = READERS[name](text(name))
    back = back.reordered("ieee")
    assert density == RHO
    for found, right in (
        (back.stiffness, MATERIAL.stiffness),
        (back.piezoelectric, MATERIAL.piezoelectric),
        (back.permittivity, MATERIAL.permittivity),
    ):
        wanted = right if name in COMPLEX else right.real
        np.testing.assert_allclose(found, wanted, rtol=1e-14, atol=0)


def test_ansys_rows_stand_where_its_manual_has_them():
    """TB,ANEL: D11, D21 … D61, D22 …; TB,PIEZ: rows x to xz of columns x, y, z; TB,DPER: xx yy zz xy yz xz."""
    lines = text("ansys").splitlines()

    def table(head: str) -> list[float]:
        start = next(i for i, line in enumerate(lines) if line.startswith(f"TB,{head}"))
        values = []
        for line in lines[start + 1 :]:
            if not line.startswith("TBDATA"):
                break
            values += [float(cell) for cell in line.split(",")[2:]]
        return values

    order = ORDERS["ansys"]
    assert table("ANEL") == [c_of(order[i], order[j]).real for i in range(6) for j in range(i, 6)]
    assert table("PIEZ") == [e_of(axis, pair).real for pair in order for axis in range(3)]
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
    assert table("DPER") == pytest.approx([EPS[i, j].real / EPS0 for i, j in pairs], rel=1e-14)
    assert table("SDAMP")[0] == pytest.approx(sum(c_of(p, p).imag for p in order) / sum(c_of(p, p).real for p in order))


def test_abaqus_columns_stand_where_its_manual_has_them():
    """*ELASTIC, TYPE=ANISOTROPIC: D1111, D1122, D2222, D1133, D2233, D3333, D1112, … eight a line."""
    lines = text("abaqus").splitlines()
    start = lines.index("*ELASTIC, TYPE=ANISOTROPIC")
    first = [float(cell) for line in lines[start + 1 : start + 4] for cell in line.split(",")]
    names = "1111 1122 2222 1133 2233 3333 1112 2212 3312 1212 1113 2213 3313 1213 1313 1123 2223 3323 1223 1323 2323"
    assert first == [c_of(name[:2], name[2:]).real for name in names.split()]
    start = lines.index("*PIEZOELECTRIC, TYPE=S")
    second = [float(cell) for line in lines[start + 1 : start + 4] for cell in line.split(",")]
    assert second == [e_of(axis, pair).real for axis in range(3) for pair in ORDERS["abaqus"]]
    start = lines.index("*DIELECTRIC, TYPE=ANISO")
    third = [float(cell) for cell in lines[start + 1].split(",")]
    assert third == [EPS[i, j].real for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]


@pytest.mark.parametrize("name", ["07 disk, blue", "Scheibe é 3", "a" * 120, "_"])
def test_names_are_labels_of_abaqus(name):
    """Abaqus, Input Syntax Rules: 1 to 80 characters, of which the first is a letter; here no others than ASCII."""
    lines = PROGRAMS["abaqus"].write(MATERIAL, RHO, name).splitlines()
    (found,) = (line.removeprefix("*MATERIAL, NAME=") for line in lines if line.startswith("*MATERIAL"))
    assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,79}", found)
    assert name[-4:] in found or len(name) > 80 or not name.isascii()


def test_comsol_and_opencfs_are_complex_in_ieee_order():
    comsol = text("comsol")
    for i, p in enumerate(IEEE):
        for j, q in list(enumerate(IEEE))[i:]:
            found = re.search(rf"^cE{i + 1}{j + 1} (.+?)\[Pa\]([+-].+?)\[Pa\]\*i ", comsol, re.MULTILINE)
            assert complex(float(found[1]), float(found[2])) == c_of(p, q)
    assert all(len(line.split()) == 3 for line in comsol.splitlines() if not line.startswith("%"))
    root = ET.fromstring(text("opencfs"))
    rows = root.find("piezo/piezoCouplingTensor/linear/tensor/imag").text.split()
    assert [float(cell) for cell in rows] == [e_of(axis, pair).imag for axis in range(3) for pair in IEEE]


def test_sfepy_file_is_a_python_module():
    names: dict = {}
    exec(compile(text("sfepy"), "material.py", "exec"), names)
    order = ORDERS["abaqus"]
    assert names["stiffness_real"] == [[c_of(p, q).real for q in order] for p in order]
    assert names["coupling_imag"] == [[e_of(axis, p).imag for p in order] for axis in range(3)]


@pytest.mark.parametrize("name", PROGRAMS)
def test_notes_state_order_sign_and_loss(name):
    assert all(word in text(name) for word in ("Order of components", "exp(+j omega t)", "engineering shear"))


PZT = library_material("pzt-5h").constants
RECORD = {
    "specimen": "plate 07",
    "constants": {name: {"value": value.real, "tan": 0.01} for name, value in PZT.as_dict().items()},
    "specimens": [{"density": 7500.0}],
}
NOTHING = {name: {"value": 0, "tan": 0} for name in PZT.as_dict()}


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_command_writes_the_constants_of_an_update(name, tmp_path):
    (tmp_path / "update.json").write_text(json.dumps(RECORD), encoding="utf-8")
    arguments = ["export", str(tmp_path / "update.json"), "--to", name, "--out", str(tmp_path / "out")]
    said = succeeded(*arguments, "--poling", "0", "1", "0").output
    written = tmp_path / "out" / f"material.{PROGRAMS[name].suffix}"
    assert said.endswith(f"is in {written}\n")
    material, density = READERS[name](written.read_text(encoding="utf-8"))
    assert density == 7500.0
    truth = PiezoConstants.from_vector(PZT.vector() * (1 - 0.01j))
    right = stress_charge(truth, "ieee", (0.0, 1.0, 0.0))
    if name in COMPLEX:
        back = from_stress_charge(material, (0.0, 1.0, 0.0))
        np.testing.assert_allclose(back.vector(), truth.vector(), rtol=1e-9)
    np.testing.assert_allclose(material.reordered("ieee").stiffness.real, right.stiffness.real, rtol=1e-9, atol=1)
    assert fp.export(tmp_path / "update.json", name, poling=(0.0, 1.0, 0.0)) == written.read_text(encoding="utf-8")


def test_an_update_is_exported(tmp_path):
    specimen = fp.read_specimen(Path(__file__).parents[2] / "tutorials" / "k31_plate" / "plate.toml")
    result = fp.update(specimen)
    material, density = READERS["json"](fp.export(result, "json"))
    assert density == 7900.0
    form = result.constants.to_e_form()
    assert material.stiffness[0, 0] == pytest.approx(form.c11, rel=1e-12)
    result.save(tmp_path)
    again, _ = READERS["json"](fp.export(tmp_path / "update.json", "json"))
    np.testing.assert_allclose(again.stiffness, material.stiffness, rtol=1e-9)


@pytest.mark.parametrize(
    ("content", "extra", "told"),
    [
        ("{}", [], "not the update.json of an update"),
        ("no json", [], "not the update.json of an update"),
        (json.dumps(RECORD).replace("7500.0", "NaN"), [], "not the update.json of an update"),
        (json.dumps(RECORD).replace("0.01", "1e999", 1), [], "not the update.json of an update"),
        (json.dumps({**RECORD, "specimens": [{}]}), [], "density is not known"),
        (json.dumps({**RECORD, "constants": NOTHING}), [], "no inverse"),
        (json.dumps(RECORD), ["--poling", "0", "0", "0"], "not all zero"),
        (json.dumps({**RECORD, "specimens": [{"density": -7500.0}]}), [], "density = -7500 is not above zero"),
    ],
)
def test_wrong_input_is_one_sentence(content, extra, told, tmp_path):
    (tmp_path / "update.json").write_text(content, encoding="utf-8")
    answer = invoked("export", tmp_path / "update.json", "--to", "comsol", "--out", tmp_path / "out", *extra)
    assert answer.exit_code == 2 and told in answer.output and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", PROGRAMS)
def test_constants_of_an_unstable_material_carry_a_note(name, tmp_path):
    """d31 three times too large, so k31² is above one: file and terminal carry a note, which a stable material does
    not have.
    """
    constants = {**RECORD["constants"], "d31": {"value": 3 * PZT.d31.real, "tan": 0.01}}
    (tmp_path / "update.json").write_text(json.dumps({**RECORD, "constants": constants}), encoding="utf-8")
    arguments = ["export", str(tmp_path / "update.json"), "--to", name, "--out", str(tmp_path / "out")]
    answer = invoked(*arguments)
    assert answer.exit_code == 0 and "note: " in answer.output and "no stable material" in answer.output
    text = (tmp_path / "out" / f"material.{PROGRAMS[name].suffix}").read_text(encoding="utf-8")
    assert "Caution: " in text and "not positive definite" in " ".join(text.split())
    assert READERS[name](text)[1] == 7500.0
    (tmp_path / "update.json").write_text(json.dumps(RECORD), encoding="utf-8")
    assert "note" not in invoked(*arguments).output and "Caution" not in fp.export(tmp_path / "update.json", name)


def test_an_unknown_program_is_refused():
    with pytest.raises(fp.InputError, match="not written for 'nastran'; give one of comsol"):
        program("nastran")


def test_a_schema_of_a_later_release_is_refused(tmp_path):
    """In one sentence; files without a schema are read."""
    (tmp_path / "update.json").write_text(json.dumps(RECORD), encoding="utf-8")
    assert constants_of_record(tmp_path / "update.json")[2] == RECORD["specimen"]
    (tmp_path / "update.json").write_text(json.dumps({"schema": SCHEMA + 1, **RECORD}), encoding="utf-8")
    answer = invoked("export", tmp_path / "update.json", "--to", "json", "--out", tmp_path / "out")
    assert answer.exit_code == 2 and answer.output.count("\n") == 1
    assert f"schema {SCHEMA + 1}" in answer.output and f"reads schema {SCHEMA}" in answer.output


def test_constants_without_a_stated_loss_are_named():
    """Of an update that found s11 alone: the held ones of a library without losses are lossless in any program."""
    constants = library_material("pzt-5h").constants
    found = constants.with_values(s11=constants.s11 * (1 - 0.01j))
    text = export_text(found, 7500.0, "a", "ansys", found=("s11",))
    assert "No loss was given for s12, s13, s33," in " ".join(text.replace("!", "").split())
    assert "No loss was given" not in export_text(found, 7500.0, "a", "ansys")
