"""Material files of other programs read back: the matrices and the density that each of them states."""

from __future__ import annotations

import ast
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from femu_piezo.material.constants import EPS0
from femu_piezo.material.conversion import StressCharge

_TRIANGLE = [(i, j) for i in range(6) for j in range(i, 6)]
_COLUMNS = [(i, j) for j in range(6) for i in range(j + 1)]
_SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def _symmetric(values: Sequence[complex], places: Sequence[tuple[int, int]], size: int) -> np.ndarray:
    matrix = np.zeros((size, size), dtype=complex)
    for value, (i, j) in zip(values, places, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def _numbers(lines: Sequence[str]) -> list[float]:
    return [float(cell) for line in lines for cell in line.split(",") if cell.strip()]


def _density(pattern: str, text: str) -> float:
    """The number that a pattern captures, kg/m³."""
    found = re.search(pattern, text, re.MULTILINE)
    if found is None:
        raise ValueError("the text has no density")
    return float(found[1])


def _read_comsol(text: str) -> tuple[StressCharge, float]:
    number = r"[+-]?[\d.]+(?:[eE][+-]?\d+)?"
    found = {
        key: complex(float(real), float(imag))
        for key, real, imag in re.findall(
            rf"^(\w+) ({number})(?:\[[^\]]*\])?({number})(?:\[[^\]]*\])?\*i", text, re.MULTILINE
        )
    }
    c = _symmetric([found[f"cE{i + 1}{j + 1}"] for i, j in _TRIANGLE], _TRIANGLE, 6)
    e = np.array([[found[f"e{i + 1}{j + 1}"] for j in range(6)] for i in range(3)])
    pairs = [(min(pair), max(pair)) for pair in _SIX]
    eps = _symmetric([found[f"epsr{i + 1}{j + 1}"] for i, j in pairs], pairs, 3)
    density = _density(rf"^rho ({number})", text)
    return StressCharge(c, e, eps * EPS0, "comsol"), density


def _read_ansys(text: str) -> tuple[StressCharge, float]:
    tables: dict[str, list[float]] = {}
    current = ""
    for line in text.splitlines():
        if line.startswith("TB,"):
            current = line.split(",")[1]
            tables[current] = []
        elif line.startswith("TBDATA,"):
            tables[current] += [float(cell) for cell in line.split(",")[2:]]
    density = _density(r"^MP,DENS,1,(\S+)", text)
    c, eps = _symmetric(tables["ANEL"], _TRIANGLE, 6), _symmetric(tables["DPER"], _SIX, 3)
    return StressCharge(c, np.reshape(tables["PIEZ"], (6, 3)).T.astype(complex), eps * EPS0, "ansys"), density


def _read_abaqus(text: str) -> tuple[StressCharge, float]:
    blocks: dict[str, list[str]] = {}
    current = ""
    for line in text.splitlines():
        if line.startswith("**"):
            continue
        if line.startswith("*"):
            current = line[1:].split(",")[0]
            blocks[current] = []
        else:
            blocks[current].append(line)
    c = _symmetric(_numbers(blocks["ELASTIC"]), _COLUMNS, 6)
    eps = _symmetric(_numbers(blocks["DIELECTRIC"]), [(i, j) for i, j in _COLUMNS if j < 3], 3)
    e = np.reshape(_numbers(blocks["PIEZOELECTRIC"]), (3, 6)).astype(complex)
    return StressCharge(c, e, eps, "abaqus"), _numbers(blocks["DENSITY"])[0]


def _read_opencfs(text: str) -> tuple[StressCharge, float]:
    root = ET.fromstring(text)

    def numbers(path: str) -> list[float]:
        return [float(value) for value in root.findtext(path, "").split()]

    def tensor(path: str) -> np.ndarray:
        columns = 3 if "permittivity" in path else 6
        real, imag = (np.reshape(numbers(f"{path}/linear/tensor/{part}"), (-1, columns)) for part in ("real", "imag"))
        return real + 1j * imag

    c, eps, e = (tensor(p) for p in ("mechanical/elasticity", "electric/permittivity", "piezo/piezoCouplingTensor"))
    return StressCharge(c, e, eps, "ieee"), numbers("mechanical/density/linear/real")[0]


def _read_sfepy(text: str) -> tuple[StressCharge, float]:
    found = {
        target.id: ast.literal_eval(node.value)
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    c, e, eps = (
        np.array(found[f"{key}_real"]) + 1j * np.array(found[f"{key}_imag"])
        for key in ("stiffness", "coupling", "permittivity")
    )
    return StressCharge(c, e, eps, "abaqus"), float(found["density"])


def _read_json(text: str) -> tuple[StressCharge, float]:
    found = json.loads(text)
    c, e, eps = (
        np.array(found[f"{key}_real"]) + 1j * np.array(found[f"{key}_imag"])
        for key in ("stiffness_Pa", "piezoelectric_C_m2", "permittivity_F_m")
    )
    return StressCharge(c, e, eps, "ieee"), float(found["density_kg_m3"])


#: Programs that take complex constants, so that every element has its own loss; the others take real parts.
COMPLEX = ("comsol", "opencfs", "sfepy", "json")
#: Program → function of the text of a file.
READERS = {
    "comsol": _read_comsol,
    "ansys": _read_ansys,
    "abaqus": _read_abaqus,
    "opencfs": _read_opencfs,
    "sfepy": _read_sfepy,
    "json": _read_json,
}
