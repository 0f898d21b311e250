"""The ten complex material parameters (CMPs) of a 4mm/6mm piezoceramic, in d-form and in e-form.

The d-form (s^E, d, ε^T) is canonical: it is what the paper updates and what data sheets print. The e-form
(c^E, e, ε^S) is what the weak form needs, because every operator is linear in it. Conversion is exact, complex
and differentiable (Cong et al. 2022, eqs 1-7):

    c^E = (s^E)^-1,    e = d c^E,    ε^S = ε^T − e dᵗ.

Poling axis 3, Voigt order of `femu_piezo.material.voigt`. A lossy constant is value·(1 − j tan) for s^E, d and
ε^T (eqs 8-10) under the time factor e^{jωt}.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Literal

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.threads import made_once
from femu_piezo.units import EPS0 as EPS0

D_FORM = ("s11", "s12", "s13", "s33", "s44", "d31", "d33", "d15", "eps11T", "eps33T")
KINDS = (D_FORM[:5], D_FORM[5:8], D_FORM[8:])  #: names of s, d and ε
E_FORM = ("c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "eps11S", "eps33S")

_ELASTIC = ((0, 0), (0, 1), (0, 2), (2, 2), (3, 3))  #: positions of 11, 12, 13, 33, 44 in a 6 × 6 matrix
_COUPLING = ((2, 0), (2, 2), (0, 4))  #: positions of 31, 33, 15 in a 3 × 6 matrix


def _elastic_matrix(v11, v12, v13, v33, v44, v66) -> np.ndarray:
    """(6, 6) transversely isotropic matrix of compliances or stiffnesses."""
    matrix = np.zeros((6, 6), dtype=complex)
    matrix[:3, :3] = [[v11, v12, v13], [v12, v11, v13], [v13, v13, v33]]
    matrix[3, 3] = matrix[4, 4] = v44
    matrix[5, 5] = v66
    return matrix


def _piezoelectric_matrix(v31, v33, v15) -> np.ndarray:
    """(3, 6) matrix of d or e constants."""
    matrix = np.zeros((3, 6), dtype=complex)
    matrix[2, :3] = v31, v31, v33
    matrix[0, 4] = matrix[1, 3] = v15
    return matrix


@dataclass(frozen=True)
class _Constants:
    """Base of both forms: the ten constants as a mapping and as a vector in the order of the fields."""

    @classmethod
    @cache
    def names(cls) -> tuple[str, ...]:
        return tuple(field.name for field in fields(cls))

    @classmethod
    def from_vector(cls, values: np.ndarray):
        """From (10,) complex values in the order of `names()`."""
        return cls(*(complex(value) for value in values))

    def vector(self) -> np.ndarray:
        """(10,) complex values in the order of `names()`, SI units."""
        return self._values.copy()

    @made_once
    def _values(self) -> np.ndarray:
        return np.array([getattr(self, name) for name in self.names()], dtype=complex)

    def as_dict(self) -> dict[str, complex]:
        return {name: complex(getattr(self, name)) for name in self.names()}

    def lossless(self):
        """The same constants without imaginary parts."""
        return self.from_vector(self.vector().real)


@dataclass(frozen=True)
class ElasticForm(_Constants):
    """e-form constants: stiffness c^E (Pa), piezoelectric e (C/m²), clamped permittivity ε^S (F/m).

    c66 = (c11 − c12)/2 follows from the symmetry about the poling axis.
    """

    c11: complex
    c12: complex
    c13: complex
    c33: complex
    c44: complex
    e31: complex
    e33: complex
    e15: complex
    eps11S: complex
    eps33S: complex

    @property
    def c66(self) -> complex:
        """(c11 − c12)/2, Pa."""
        return (self.c11 - self.c12) / 2

    def stiffness(self) -> np.ndarray:
        """c^E, (6, 6) complex, Pa."""
        return _elastic_matrix(self.c11, self.c12, self.c13, self.c33, self.c44, self.c66)

    def piezoelectric(self) -> np.ndarray:
        """e, (3, 6) complex, C/m²."""
        return _piezoelectric_matrix(self.e31, self.e33, self.e15)

    def permittivity(self) -> np.ndarray:
        """ε^S, (3, 3) complex, F/m."""
        return np.diag([self.eps11S, self.eps11S, self.eps33S]).astype(complex)

    def to_d_form(self) -> PiezoConstants:
        """Exact inverse of `PiezoConstants.to_e_form`: s = c^-1, d = e s, ε^T = ε^S + d eᵗ (eqs 4-7)."""
        s = np.linalg.inv(self.stiffness())
        d = self.piezoelectric() @ s
        eps = self.permittivity() + d @ self.piezoelectric().T
        return PiezoConstants(
            s[0, 0], s[0, 1], s[0, 2], s[2, 2], s[3, 3], d[2, 0], d[2, 2], d[0, 4], eps[0, 0], eps[2, 2]
        )


@dataclass(frozen=True)
class MaterialFault:
    """A reason why constants belong to no passive, stable material.

    Attributes
    ----------
    kind : "sign" of a constant that must be positive, "unstable", or "active": the losses would create energy
    message : one sentence with names and numbers
    """

    kind: Literal["sign", "unstable", "active"]
    message: str

    def __str__(self) -> str:
        return self.message


@dataclass(frozen=True)
class PiezoConstants(_Constants):
    """d-form constants: compliance s^E (1/Pa), piezoelectric d (C/N), free permittivity ε^T (F/m), all complex.

    The ten complex material parameters; s66 = 2(s11 − s12).
    """

    s11: complex
    s12: complex
    s13: complex
    s33: complex
    s44: complex
    d31: complex
    d33: complex
    d15: complex
    eps11T: complex
    eps33T: complex

    @classmethod
    def from_real(cls, values: Mapping[str, float], tangents: Mapping[str, float] | None = None) -> PiezoConstants:
        """From real values and loss tangents, value·(1 − j tan) (eqs 8-10).

        Raises InputError for a missing or unknown name.
        """
        tangents = dict(tangents or {})
        unknown = (set(values) | set(tangents)) - set(D_FORM)
        missing = set(D_FORM) - set(values)
        if unknown or missing:
            raise InputError(f"material constants: unknown {sorted(unknown)}, missing {sorted(missing)}")
        return cls(**{name: values[name] * (1 - 1j * tangents.get(name, 0.0)) for name in D_FORM})

    @property
    def s66(self) -> complex:
        """2(s11 − s12), 1/Pa."""
        return 2 * (self.s11 - self.s12)

    def tangent(self, name: str) -> float:
        """Loss tangent of one constant, −Im/Re (eqs 8-10); 0 for a constant that is zero."""
        value = complex(getattr(self, name))
        return -value.imag / value.real if value.real != 0 else 0.0

    def with_values(self, **values: complex) -> PiezoConstants:
        """A copy with some constants replaced (complex values)."""
        return replace(self, **values)

    def compliance(self) -> np.ndarray:
        """s^E, (6, 6) complex, 1/Pa."""
        return _elastic_matrix(self.s11, self.s12, self.s13, self.s33, self.s44, self.s66)

    @made_once
    def _stiffness(self) -> np.ndarray:
        """c^E = (s^E)^-1, (6, 6) complex, Pa."""
        return np.linalg.inv(self.compliance())

    def piezoelectric(self) -> np.ndarray:
        """d, (3, 6) complex, C/N."""
        return _piezoelectric_matrix(self.d31, self.d33, self.d15)

    def permittivity(self) -> np.ndarray:
        """ε^T, (3, 3) complex, F/m."""
        return np.diag([self.eps11T, self.eps11T, self.eps33T]).astype(complex)

    def to_e_form(self) -> ElasticForm:
        """c^E = (s^E)^-1, e = d c^E, ε^S = ε^T − e dᵗ (eqs 1-7), exact for complex values."""
        c = self._stiffness
        e = self.piezoelectric() @ c
        eps = self.permittivity() - e @ self.piezoelectric().T
        return ElasticForm(c[0, 0], c[0, 1], c[0, 2], c[2, 2], c[3, 3], e[2, 0], e[2, 2], e[0, 4], eps[0, 0], eps[2, 2])

    def e_form_jacobian(self) -> np.ndarray:
        """∂(e-form)/∂(d-form), (10, 10) complex: row an e-form, column a d-form constant; holomorphic.

        dc = −c ds c,  de = dd c + d dc,  dε^S = dε^T − de dᵗ − e ddᵗ.
        """
        c, d = self._stiffness, self.piezoelectric()
        e = d @ c
        ds, dd, deps = _UNIT_MATRICES
        dc = -c @ ds @ c
        de = dd @ c + d @ dc
        deps = deps - de @ d.T - e @ dd.transpose(0, 2, 1)
        rows = [*(dc[:, i, j] for i, j in _ELASTIC), *(de[:, i, j] for i, j in _COUPLING), deps[:, 0, 0], deps[:, 2, 2]]
        return np.array(rows)

    @made_once
    def coupling(self) -> dict[str, complex]:
        """Coupling factors of IEEE 176: k31, k33, k15, kp (planar), dimensionless complex."""
        return {
            "k31": np.sqrt(self.d31**2 / (self.s11 * self.eps33T)),
            "k33": np.sqrt(self.d33**2 / (self.s33 * self.eps33T)),
            "k15": np.sqrt(self.d15**2 / (self.s44 * self.eps11T)) if self.eps11T else 0j,
            "kp": np.sqrt(2 * self.d31**2 / ((self.s11 + self.s12) * self.eps33T)),
        }

    def physical_faults(self, tolerance: float = 1e-9, *, passive: bool = True) -> list[MaterialFault]:
        """The reasons why this is no passive, stable material; empty where it is one.

        Stable: the real part of the d-form matrix [[s, dᵗ], [d, ε^T]] is positive semidefinite (ε11T = 0 of the
        paper's simplification is allowed). Passive (Holland 1967): its negative imaginary part is positive
        semidefinite, e.g. Im s11 ≤ 0 and Im s11 · Im ε33T ≥ (Im d31)². `tolerance` is relative to the scaled
        matrix (`energy_block`); with `passive` False, losses are not checked.
        """
        faults = [
            MaterialFault("sign", f"{name} = {getattr(self, name).real:.6g} must be positive")
            for name in ("s11", "s33", "s44", "eps33T")
            if not getattr(self, name).real > 0
        ]
        if self.eps11T.real < 0:
            faults.append(MaterialFault("sign", f"eps11T = {self.eps11T.real:.6g} must not be negative"))
        if faults:
            return faults
        for index, (_, names, _) in enumerate(_BLOCKS):
            blocks = np.stack([self.energy_block(index), self.loss_block(index)])
            energy, loss = np.linalg.eigvalsh(blocks)[:, 0]
            if energy < -tolerance:
                message = f"{', '.join(names)} together are not positive definite: no stable material has them"
                faults.append(MaterialFault("unstable", message))
            if passive and loss < -tolerance:
                without = self._lacking_tangents(index, tolerance)
                message = f"the imaginary parts of {', '.join(names)} would create energy (Holland 1967): " + (
                    f"{', '.join(without)} have no loss tangent, as the others have; give one of each"
                    if without
                    else "a loss tangent is negative or that of d is too large for those of s and eps"
                )
                faults.append(MaterialFault("active", message))
        return faults

    def _lacking_tangents(self, index: int, tolerance: float) -> list[str]:
        """Constants of a block without a loss tangent, where that of the others would make the block passive."""
        values = {name: getattr(self, name) for name in _BLOCKS[index][1]}
        without = [name for name, value in values.items() if value.imag == 0 and value.real != 0]
        others = [-value.imag / value.real for value in values.values() if value.imag]
        if not without or not others:
            return []
        tangent = float(np.median(others))
        filled = self.with_values(**{name: values[name].real * (1 - 1j * tangent) for name in without})
        return without if np.linalg.eigvalsh(filled.loss_block(index))[0] >= -tolerance else []

    def check(self, where: str = "material", *, passive: bool = True) -> PiezoConstants:
        """Return self, or raise InputError naming the unphysical constants; passive : as in `physical_faults`."""
        faults = self.physical_faults(passive=passive)
        if faults:
            raise InputError(f"{where}: {'; '.join(map(str, faults))}")
        return self

    @property
    def block_count(self) -> int:
        """Number of independent blocks of the d-form matrix."""
        return len(_BLOCKS)

    def energy_block(self, index: int) -> np.ndarray:
        """(n, n) real part of a block of the d-form matrix, scaled by its diagonal; must be positive semidefinite.

        The row of ε11T is scaled by ε33T.
        """
        return self._scaled[index].real

    def loss_block(self, index: int) -> np.ndarray:
        """(n, n) −Im of a block of the d-form matrix, scaled as its real part; must be positive semidefinite."""
        return -self._scaled[index].imag

    def block_slopes(self, index: int, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m, n, n) derivatives of `energy_block` and `loss_block` along complex changes (m, 10) of the constants.

        The change of the scaling constants is included.
        """
        scales = self._values.real[_BLOCK_SCALES[index]]
        share, size = directions[:, _BLOCK_SCALES[index]].real / scales / 2, np.abs(scales)
        unscaled = np.tensordot(directions, _UNIT_BLOCKS[index], axes=1) / np.sqrt(np.outer(size, size))
        slopes = unscaled - self._scaled[index] * (share[:, :, None] + share[:, None, :])
        return slopes.real, -slopes.imag

    @made_once
    def _scaled(self) -> tuple[np.ndarray, ...]:
        """Each block of the d-form matrix, scaled by |Re| of the material's s11, s33, s44 and ε33T."""
        sizes = [np.abs(self._values.real[scales]) for scales in _BLOCK_SCALES]
        return tuple(
            (self._values @ unit.reshape(len(unit), -1)).reshape(unit.shape[1:]) / np.sqrt(size[:, None] * size)
            for unit, size in zip(_UNIT_BLOCKS, sizes, strict=True)
        )


#: Independent blocks of the d-form matrix: rows, the constants in the block, and the constants that scale its rows.
_BLOCKS = (
    ((0, 1, 2, 8), ("s11", "s12", "s13", "s33", "d31", "d33", "eps33T"), ("s11", "s11", "s33", "eps33T")),
    ((4, 6), ("s44", "d15", "eps11T"), ("s44", "eps33T")),
)
_BLOCK_SCALES = tuple([D_FORM.index(name) for name in scales] for _, _, scales in _BLOCKS)


_UNITS = [PiezoConstants.from_vector(unit) for unit in np.eye(len(D_FORM))]
#: s (10, 6, 6), d (10, 3, 6) and ε^T (10, 3, 3) per unit of every constant.
_UNIT_MATRICES = tuple(
    np.array([matrix(constants) for constants in _UNITS])
    for matrix in (PiezoConstants.compliance, PiezoConstants.piezoelectric, PiezoConstants.permittivity)
)


def _unit_block(rows: tuple[int, ...]) -> np.ndarray:
    """(10, n, n) one block of the d-form matrix per unit of every constant."""
    s, d, eps = _UNIT_MATRICES
    full = np.block([[s, d.transpose(0, 2, 1)], [d, eps]])
    return full[:, rows][:, :, rows].real


_UNIT_BLOCKS = tuple(_unit_block(rows) for rows, _, _ in _BLOCKS)
