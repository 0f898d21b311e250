"""Constants for other programs and back: Voigt order, poling axis, sign of loss, stiffness against compliance form.

Orders of the six components of stress and strain (engineering shear in all):

- IEEE 176, COMSOL Multiphysics ("ordering: xx, yy, zz, yz, xz, xy" in its settings of a piezoelectric material):
  the order of `femu_piezo.material.voigt`;
- ANSYS (x, y, z, xy, yz, xz; its piezoelectric matrix has six rows and three columns);
- Abaqus (11, 22, 33, 12, 13, 23).

Sources are listed in tutorials/notation.md. Losses are entered there as positive loss factors; under the time factor
exp(+jωt) a lossy stiffness is c(1 + jη), a lossy e, d, s, ε is value(1 − jη).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.material.constants import EPS0, ElasticForm, PiezoConstants
from femu_piezo.material.voigt import (
    axes_with_poling,
    piezoelectric_matrix,
    piezoelectric_tensor,
    stiffness_matrix,
    stiffness_tensor,
)

Order = Literal["ieee", "comsol", "ansys", "abaqus"]

#: For each order, the position of its components in the IEEE order 11, 22, 33, 23, 13, 12.
ORDERS: Mapping[str, tuple[int, ...]] = {
    "ieee": (0, 1, 2, 3, 4, 5),
    "comsol": (0, 1, 2, 3, 4, 5),
    "ansys": (0, 1, 2, 5, 3, 4),
    "abaqus": (0, 1, 2, 5, 4, 3),
}
#: Largest relative difference from 6mm symmetry that counts as rounding.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class StressCharge:
    """Stress-charge form (e-form) in full matrices, for any order of components and any poling axis.

    Attributes
    ----------
    stiffness : (6, 6) complex c^E, Pa
    piezoelectric : (3, 6) complex e, C/m², one row for each electric component
    permittivity : (3, 3) complex ε^S, F/m
    order : of the six components
    """

    stiffness: np.ndarray
    piezoelectric: np.ndarray
    permittivity: np.ndarray
    order: Order = "ieee"

    @property
    def relative_permittivity(self) -> np.ndarray:
        """(3, 3) ε^S/ε0, complex."""
        return self.permittivity / EPS0

    @property
    def loss_factors(self) -> dict[str, np.ndarray]:
        """Loss factors, positive for loss, of "stiffness" (6, 6), "piezoelectric" (3, 6), "permittivity" (3, 3).

        They are factors of the real parts, element by element: c = Re c (1 + jη), e = Re e (1 − jη), ε = Re ε (1 − jη);
        0 where the real part is zero.
        """
        return {
            "stiffness": -_tangent(self.stiffness),
            "piezoelectric": _tangent(self.piezoelectric),
            "permittivity": _tangent(self.permittivity),
        }

    def reordered(self, order: Order) -> StressCharge:
        """The same material in another order of components."""
        return StressCharge(
            reorder(self.stiffness, self.order, order),
            reorder(self.piezoelectric, self.order, order),
            self.permittivity,
            order,
        )


def _tangent(matrix: np.ndarray) -> np.ndarray:
    """−Im/Re of every element, 0 where the real part is zero."""
    values = np.asarray(matrix, dtype=complex)
    return np.where(values.real != 0, -values.imag / np.where(values.real != 0, values.real, 1.0), 0.0)


def reorder(matrix: np.ndarray, source: Order, target: Order) -> np.ndarray:
    """A matrix with all axes of length six rearranged from one order of components to another.

    Parameters
    ----------
    matrix : (6, 6), (3, 6), (6, 3) or (6,)

    Raises
    ------
    InputError : an order is unknown, or no axis has length six
    """
    for order in (source, target):
        if order not in ORDERS:
            raise InputError(f"the order {order!r} of components is not known; give one of {', '.join(ORDERS)}")
    matrix = np.asarray(matrix)
    if 6 not in matrix.shape:
        raise InputError(f"a matrix of shape {matrix.shape} has no axis of six components")
    index = [ORDERS[source].index(component) for component in ORDERS[target]]
    for axis, size in enumerate(matrix.shape):
        if size == 6:
            matrix = np.take(matrix, index, axis=axis)
    return matrix


def stress_charge(
    constants: PiezoConstants, order: Order = "ieee", poling: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> StressCharge:
    """Full e-form matrices of a ceramic poled along a direction, in a given order of components.

    Parameters
    ----------
    poling : direction in the axes of the other program, (0, 1, 0) for plane models of ANSYS
    """
    e_form = constants.to_e_form()
    turn = axes_with_poling(np.array(poling, dtype=float))
    c = np.einsum("ai,bj,ck,dl,abcd->ijkl", turn, turn, turn, turn, stiffness_tensor(e_form.stiffness()))
    e = np.einsum("ai,bj,ck,abc->ijk", turn, turn, turn, piezoelectric_tensor(e_form.piezoelectric()))
    eps = turn.T @ e_form.permittivity() @ turn
    return StressCharge(stiffness_matrix(c), piezoelectric_matrix(e), eps).reordered(order)


def from_stress_charge(material: StressCharge, poling: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> PiezoConstants:
    """The ten constants of full e-form matrices: the inverse of `stress_charge`.

    Raises
    ------
    InputError : the matrices are not those of a 6mm (4mm with c66 = (c11 − c12)/2) material poled along `poling`
    """
    given = material.reordered("ieee")
    back = axes_with_poling(np.array(poling, dtype=float)).T
    c = stiffness_matrix(np.einsum("ai,bj,ck,dl,abcd->ijkl", back, back, back, back, stiffness_tensor(given.stiffness)))
    e = piezoelectric_matrix(
        np.einsum("ai,bj,ck,abc->ijk", back, back, back, piezoelectric_tensor(given.piezoelectric))
    )
    eps = back.T @ given.permittivity @ back
    form = ElasticForm(
        c[0, 0], c[0, 1], c[0, 2], c[2, 2], c[3, 3], e[2, 0], e[2, 2], e[0, 4], eps[0, 0], eps[2, 2]
    )  # fmt: skip
    for words, found, expected in (
        ("stiffness", c, form.stiffness()),
        ("piezoelectric", e, form.piezoelectric()),
        ("permittivity", eps, form.permittivity()),
    ):
        if np.max(np.abs(found - expected)) > _ROUNDING * np.max(np.abs(expected)):
            raise InputError(
                f"the {words} matrix is not that of a 6mm material poled along {tuple(poling)} in {material.order} "
                "order; check the order of components and the poling axis"
            )
    return form.to_d_form()


def to_ansys(
    constants: PiezoConstants, poling: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Complex c (6, 6) Pa, e (6, 3) C/m², ε^S/ε0 (3, 3) in the order x, y, z, xy, yz, xz of ANSYS, e transposed."""
    material = stress_charge(constants, "ansys", poling)
    return material.stiffness, material.piezoelectric.T, material.relative_permittivity


def from_ansys(
    stiffness: np.ndarray,
    piezoelectric: np.ndarray,
    relative_permittivity: np.ndarray,
    poling: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> PiezoConstants:
    """The ten constants of c (6, 6), e (6, 3), ε^S/ε0 (3, 3) in ANSYS order; errors as `from_stress_charge`."""
    material = StressCharge(
        np.asarray(stiffness, dtype=complex),
        np.asarray(piezoelectric, dtype=complex).T,
        np.asarray(relative_permittivity, dtype=complex) * EPS0,
        "ansys",
    )
    return from_stress_charge(material, poling)
