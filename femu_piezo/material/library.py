"""A small library of published, lossless piezoceramic constants: starting values for an update, not exact ones."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from femu_piezo.errors import InputError
from femu_piezo.material.constants import EPS0, ElasticForm, PiezoConstants


@dataclass(frozen=True)
class LibraryMaterial:
    """A named material: constants, density (kg/m³) and their source."""

    name: str
    constants: PiezoConstants
    density: float
    source: str


def _d_form(name, density, source, s, d, eps_r) -> LibraryMaterial:
    """s in 1e-12 1/Pa (11 12 13 33 44), d in 1e-12 C/N (31 33 15), relative ε^T (11 33); no loss."""
    values = [value * 1e-12 for value in (*s, *d)] + [value * EPS0 for value in eps_r]
    return LibraryMaterial(name, PiezoConstants(*(complex(value) for value in values)), density, source)


def _e_form(name, density, source, c, e, eps) -> LibraryMaterial:
    """c in Pa (11 12 13 33 44), e in C/m² (31 33 15), ε^S in F/m (11 33); no loss."""
    constants = ElasticForm(*c, *e, *eps).to_d_form()
    return LibraryMaterial(name, constants, density, source)


_MORGAN = "Berlincourt, Krueger, Near, Properties of piezoelectricity ceramics, TP-226, Morgan Electro Ceramics"
_LIBRARY = {
    material.name: material
    for material in (
        _d_form(
            "tj52-hd",
            7900.0,
            "Cong, Hu, Li, Smart Mater. Struct. 31 (2022) 125010, Table 1 (isotropic baseline, d33 = d15 = eps11T = 0)",
            (14.4, -4.5, -4.5, 14.4, 37.8),
            (-255.0, 0.0, 0.0),
            (0.0, 3230.0),
        ),
        _d_form(
            "pzt-5h",
            7500.0,
            _MORGAN,
            (16.5, -4.78, -8.45, 20.7, 43.5),
            (-274.0, 593.0, 741.0),
            (3130.0, 3400.0),
        ),
        _d_form(
            "pzt-5a",
            7750.0,
            _MORGAN,
            (16.4, -5.74, -7.22, 18.8, 47.5),
            (-171.0, 374.0, 584.0),
            (1730.0, 1700.0),
        ),
        _d_form(
            "pzt-4",
            7500.0,
            _MORGAN,
            (12.3, -4.05, -5.31, 15.5, 39.0),
            (-123.0, 289.0, 496.0),
            (1475.0, 1300.0),
        ),
        _d_form(
            "pzt-8",
            7600.0,
            _MORGAN,
            (11.5, -3.7, -4.8, 13.5, 31.9),
            (-97.0, 225.0, 330.0),
            (1290.0, 1000.0),
        ),
        _d_form(
            "pz27",
            7700.0,
            "Ferroperm Piezoceramics A/S, material data based on typical values",
            (16.9555, -6.5991, -8.6119, 23.2008, 43.4537),
            (-169.9915, 425.0, 505.9634),
            (1795.99, 1802.77),
        ),
        _e_form(
            "pic255",
            7800.0,
            "constants of PI Ceramic PIC255 as distributed with the simulation tool plutho",
            (119e9, 84e9, 83e9, 117e9, 21e9),
            (-6.03, 15.49, 12.09),
            (8.15e-9, 6.58e-9),
        ),
        _e_form(
            "pic181",
            7850.0,
            "constants of PI Ceramic PIC181 at 20 °C as distributed with the simulation tool plutho",
            (140.99e9, 81.96e9, 80.36e9, 137.12e9, 29.77e9),
            (-5.0732, 14.073, 12.9483),
            (1.3019e-8, 5.2963e-9),
        ),
        _e_form(
            "pzt-4-vm175",
            7500.0,
            "Boucher, Lagier, Maerfeld, IEEE Trans. Sonics Ultrason. 28 (1981) 318; ANSYS verification VM175",
            (132e9, 71e9, 73e9, 115e9, 26e9),
            (-4.1, 14.1, 10.5),
            (804.6 * EPS0, 659.7 * EPS0),
        ),
    )
}


def library_names() -> tuple[str, ...]:
    """Names that `library_material` knows, sorted."""
    return tuple(sorted(_LIBRARY))


def library_material(name: str) -> LibraryMaterial:
    """The material of a name; InputError with the nearest name and all known ones where there is none."""
    try:
        return _LIBRARY[name.lower()]
    except KeyError:
        near = difflib.get_close_matches(name.lower(), _LIBRARY, n=1)
        hint = f'; did you mean "{near[0]}"?' if near else ""
        known = ", ".join(library_names())
        raise InputError(f'no library material is called "{name}"{hint} (known: {known})') from None
