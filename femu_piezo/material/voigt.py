"""Voigt order 11, 22, 33, 23, 13, 12 with engineering shear, in one place (IEEE 176)."""

from __future__ import annotations

import numpy as np

#: Cartesian index pair of each Voigt index.
PAIRS: tuple[tuple[int, int], ...] = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def stiffness_tensor(c: np.ndarray) -> np.ndarray:
    """c_IJ (6, 6) → c_ijkl (3, 3, 3, 3); same unit. Valid for stiffness (stress = c · engineering strain)."""
    tensor = np.zeros((3, 3, 3, 3), dtype=np.result_type(c))
    for row, (i, j) in enumerate(PAIRS):
        for column, (k, m) in enumerate(PAIRS):
            for a, b in ((i, j), (j, i)):
                tensor[a, b, k, m] = tensor[a, b, m, k] = c[row, column]
    return tensor


def stiffness_matrix(tensor: np.ndarray) -> np.ndarray:
    """c_ijkl (3, 3, 3, 3) → c_IJ (6, 6); the inverse of `stiffness_tensor`."""
    rows, columns = np.array(PAIRS).T
    return tensor[rows[:, None], columns[:, None], rows[None, :], columns[None, :]]


def piezoelectric_tensor(e: np.ndarray) -> np.ndarray:
    """e_iJ (3, 6) → e_ijk (3, 3, 3), first index electric; same unit."""
    tensor = np.zeros((3, 3, 3), dtype=np.result_type(e))
    for column, (j, k) in enumerate(PAIRS):
        tensor[:, j, k] = tensor[:, k, j] = e[:, column]
    return tensor


def piezoelectric_matrix(tensor: np.ndarray) -> np.ndarray:
    """e_ijk (3, 3, 3) → e_iJ (3, 6); the inverse of `piezoelectric_tensor`."""
    rows, columns = np.array(PAIRS).T
    return tensor[:, rows, columns]


def axes_with_poling(direction: np.ndarray) -> np.ndarray:
    """Rotation whose third row is the poling `direction`: x_crystal = R x_specimen.

    Parameters
    ----------
    direction : (3,) any length; for +z the identity is returned

    Returns
    -------
    (3, 3) proper rotation. About the poling axis a 4mm/6mm ceramic is isotropic, so the other two rows are free.
    """
    third = np.asarray(direction, float) / np.linalg.norm(direction)
    seed = np.eye(3)[0] if abs(third[0]) < 0.9 else np.eye(3)[1]
    first = seed - third * (seed @ third)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third])
