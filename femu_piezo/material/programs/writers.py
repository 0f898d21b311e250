"""Material files of other programs: full stress-charge matrices, density, name, and notes on order, sign and loss.

Every writer turns a `StressCharge` into text. Losses follow s, d, ε = value (1 − j tan) under exp(+jωt): a lossy
stiffness has Im c > 0, a lossy e or ε has Im of opposite sign to Re.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.files import json_text
from femu_piezo.material.conversion import StressCharge

_TRIANGLE = [(i, j) for i in range(6) for j in range(i, 6)]
_COLUMNS = [(i, j) for j in range(6) for i in range(j + 1)]
_SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


@dataclass(frozen=True)
class Program:
    """A program that takes piezoelectric materials.

    Attributes
    ----------
    title : its name;  suffix : of its files
    write : (matrices, density in kg/m³, name, sentences on the origin of the constants) → text
    """

    title: str
    suffix: str
    write: Callable[[StressCharge, float, str, Sequence[str]], str]


def _notes(order: str, more: Sequence[str]) -> list[str]:
    return [
        "Made by femu-piezo. Stress-charge form: stiffness at constant field, e, permittivity at constant strain.",
        f"Order of components: {order}; engineering shear strain; SI units.",
        "Time factor exp(+j omega t): a lossy stiffness is c (1 + j eta), a lossy e or permittivity value (1 - j tan).",
        *more,
    ]


def _mean_loss(matrix: np.ndarray, sign: float) -> float:
    """Loss factor of a matrix (n, n): sign · Im/Re of its trace."""
    trace = np.trace(matrix)
    return float(sign * trace.imag / trace.real)


# COMSOL Multiphysics: a text file of parameters, one a line: name, expression without blanks, description


def _comsol(material: StressCharge, density: float, name: str, origin: Sequence[str] = ()) -> str:
    m = material.reordered("comsol")
    notes = _notes(
        "xx, yy, zz, yz, xz, xy, that of COMSOL's piezoelectric material (IEEE)",
        [
            "Load under Parameters (Load from File); enter cE11 ... in the elasticity matrix cE, e11 ... in the",
            "coupling matrix eES, epsr11 ... in the relative permittivity epsilonrS of the stress-charge form. The",
            "losses are in the imaginary parts: add no damping subnodes.",
            *origin,
        ],
    )
    rows = [f"% {line}" for line in (f"Material: {name}", *notes)]

    def line(key: str, value: complex, unit: str, words: str) -> str:
        return f"{key} {value.real!r}{unit}{value.imag:+.17g}{unit}*i {words}"

    for i, j in _TRIANGLE:
        rows.append(line(f"cE{i + 1}{j + 1}", complex(m.stiffness[i, j]), "[Pa]", "stiffness"))
    for i in range(3):
        rows += [line(f"e{i + 1}{j + 1}", complex(m.piezoelectric[i, j]), "[C/m^2]", "coupling") for j in range(6)]
    for i, j in _SIX:
        a, b = sorted((i, j))
        rows.append(line(f"epsr{a + 1}{b + 1}", complex(m.relative_permittivity[i, j]), "", "relative_permittivity"))
    return "\n".join([*rows, f"rho {density!r}[kg/m^3] density", ""])


# ANSYS Mechanical APDL


def _ansys(material: StressCharge, density: float, name: str, origin: Sequence[str] = ()) -> str:
    m = material.reordered("ansys")
    notes = _notes(
        "x, y, z, xy, yz, xz, that of ANSYS",
        [
            "Real parts; the program takes one loss factor for the stiffness (TB,SDAMP) and one tangent for the",
            "permittivity (MP,LSST), those of the traces. The loss of e has no place there: a harmonic response",
            "differs from that of the complex constants by it.",
            *origin,
        ],
    )
    rows = [f"! {line}" for line in (f"Material: {name}", *notes)]
    rows += [f"MP,DENS,1,{density!r}", "TB,ANEL,1,1,21,0"]
    rows += _table([float(m.stiffness[i, j].real) for i, j in _TRIANGLE])
    rows += ["TB,PIEZ,1,,18,0", *_table([float(v) for v in m.piezoelectric.real.T.ravel()])]
    rows += ["TB,DPER,1,,6,0", *_table([float(m.relative_permittivity[i, j].real) for i, j in _SIX])]
    rows += ["TB,SDAMP,1,1,1,STRU", f"TBDATA,1,{_mean_loss(m.stiffness, 1.0)!r}"]
    return "\n".join([*rows, f"MP,LSST,1,{_mean_loss(m.permittivity, -1.0)!r}", ""])


def _table(values: list[float]) -> list[str]:
    return [
        f"TBDATA,{start + 1},{','.join(map(repr, values[start : start + 6]))}" for start in range(0, len(values), 6)
    ]


# Abaqus


def _abaqus(material: StressCharge, density: float, name: str, origin: Sequence[str] = ()) -> str:
    m = material.reordered("abaqus")
    notes = _notes(
        "11, 22, 33, 12, 13, 23, that of Abaqus",
        [
            "Real parts; the program takes one structural loss factor (*DAMPING), that of the trace of the stiffness.",
            *origin,
        ],
    )
    rows = [f"** {line}" for line in notes]
    rows += [f"*MATERIAL, NAME={_label(name)}", "*DENSITY", repr(density)]
    rows += ["*ELASTIC, TYPE=ANISOTROPIC", *_eights([float(m.stiffness[i, j].real) for i, j in _COLUMNS])]
    rows += ["*PIEZOELECTRIC, TYPE=S", *_eights([float(v) for v in m.piezoelectric.real.ravel()])]
    three = [(i, j) for i, j in _COLUMNS if j < 3]
    rows += ["*DIELECTRIC, TYPE=ANISO", *_eights([float(m.permittivity[i, j].real) for i, j in three])]
    return "\n".join([*rows, f"*DAMPING, STRUCTURAL={_mean_loss(m.stiffness, 1.0)!r}", ""])


def _label(name: str) -> str:
    """A name as Abaqus takes it: letters, digits and underscores, a letter first, 80 at most."""
    text = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return (text if text[:1].isalpha() else f"PIEZO_{text}")[:80]


def _eights(values: list[float]) -> list[str]:
    return [", ".join(map(repr, values[start : start + 8])) for start in range(0, len(values), 8)]


# openCFS: a material of mat.xml, real and imaginary parts


def _opencfs(material: StressCharge, density: float, name: str, origin: Sequence[str] = ()) -> str:
    m = material.reordered("ieee")
    root = ET.Element("material", name=name)
    put = "Put this element into the materials file of the simulation."
    notes = _notes("xx, yy, zz, yz, xz, xy (IEEE)", [put, *origin])
    root.append(ET.Comment(" ".join(notes)))
    mechanical, electric, piezo = (ET.SubElement(root, key) for key in ("mechanical", "electric", "piezo"))
    ET.SubElement(ET.SubElement(ET.SubElement(mechanical, "density"), "linear"), "real").text = repr(density)
    for parent, key, matrix in (
        (mechanical, "elasticity", m.stiffness),
        (electric, "permittivity", m.permittivity),
        (piezo, "piezoCouplingTensor", m.piezoelectric),
    ):
        linear = ET.SubElement(ET.SubElement(parent, key), "linear")
        tensor = ET.SubElement(linear, "tensor", dim1=str(matrix.shape[0]), dim2=str(matrix.shape[1]))
        for part, values in (("real", matrix.real), ("imag", matrix.imag)):
            ET.SubElement(tensor, part).text = "\n".join(" ".join(map(repr, row)) for row in values.tolist())
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


# SfePy: a Python module of plain lists


def _sfepy(material: StressCharge, density: float, name: str, origin: Sequence[str] = ()) -> str:
    m = material.reordered("abaqus")
    notes = _notes(
        "11, 22, 33, 12, 13, 23, that of SfePy's symmetric storage",
        [
            "Use stiffness_real as D of dw_lin_elastic, coupling_real as g of dw_piezo_coupling, permittivity_real as",
            "K of dw_diffusion; SfePy computes with real materials, the imaginary parts are for terms of one's own.",
            *origin,
        ],
    )
    rows = [f"# {line}" for line in (f"Material: {name}", *notes)]
    rows.append(f"density = {density!r}")
    for key, matrix in (
        ("stiffness", m.stiffness),
        ("coupling", m.piezoelectric),
        ("permittivity", m.permittivity),
    ):
        for part, values in (("real", matrix.real), ("imag", matrix.imag)):
            inner = ",\n".join(f"    {row}" for row in values.tolist())
            rows.append(f"{key}_{part} = [\n{inner},\n]")
    return "\n".join([*rows, ""])


# JSON


def _json(material: StressCharge, density: float, name: str, origin: Sequence[str] = ()) -> str:
    m = material.reordered("ieee")
    record = {
        "name": name,
        "notes": _notes("11, 22, 33, 23, 13, 12 (IEEE 176)", origin),
        "density_kg_m3": density,
        **{
            f"{key}_{part}": values.tolist()
            for key, matrix in (
                ("stiffness_Pa", m.stiffness),
                ("piezoelectric_C_m2", m.piezoelectric),
                ("permittivity_F_m", m.permittivity),
            )
            for part, values in (("real", matrix.real), ("imag", matrix.imag))
        },
    }
    return json_text(record, indent=1)


PROGRAMS: dict[str, Program] = {
    "comsol": Program("COMSOL Multiphysics", "txt", _comsol),
    "ansys": Program("ANSYS Mechanical APDL", "mac", _ansys),
    "abaqus": Program("Abaqus", "inp", _abaqus),
    "opencfs": Program("openCFS", "xml", _opencfs),
    "sfepy": Program("SfePy", "py", _sfepy),
    "json": Program("JSON", "json", _json),
}


def program(name: str) -> Program:
    """A program by its name in `PROGRAMS`; InputError where there is none of that name."""
    if name not in PROGRAMS:
        raise InputError(f"materials are not written for {name!r}; give one of {', '.join(PROGRAMS)}")
    return PROGRAMS[name]
