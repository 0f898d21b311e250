"""Tensors of a 6mm crystal for unit constants of the e-form, poled along z or along x."""

from __future__ import annotations

import numpy as np

VOIGT = (((0, 0),), ((1, 1),), ((2, 2),), ((1, 2), (2, 1)), ((0, 2), (2, 0)), ((0, 1), (1, 0)))
#: Voigt and vector indices of the crystal's 1, 2, 3 where the poling lies along x
_ALONG_X = ([1, 2, 0, 4, 5, 3], [1, 2, 0])
#: e-form constants by kind; c66 = (c11 − c12)/2
ELASTIC, COUPLING, DIELECTRIC = ("c11", "c12", "c13", "c33", "c44"), ("e31", "e33", "e15"), ("eps11", "eps33")


def elastic(name: str, poling: int) -> np.ndarray:
    """c (6, 6) for one unit constant, the poling along z (2) or x (0)."""
    c = np.zeros((6, 6))
    one = {"c11": ((0, 0), (1, 1)), "c12": ((0, 1), (1, 0)), "c13": ((0, 2), (2, 0), (1, 2), (2, 1))}
    one |= {"c33": ((2, 2),), "c44": ((3, 3), (4, 4))}
    for i, j in one[name]:
        c[i, j] = 1.0
    c[5, 5] = {"c11": 0.5, "c12": -0.5}.get(name, 0.0)
    return c if poling == 2 else _moved(c, _ALONG_X[0], _ALONG_X[0])


def coupling(name: str, poling: int) -> np.ndarray:
    """e (3, 6) for one unit constant, the poling along z (2) or x (0)."""
    e = np.zeros((3, 6))
    for k, j in {"e31": ((2, 0), (2, 1)), "e33": ((2, 2),), "e15": ((0, 4), (1, 3))}[name]:
        e[k, j] = 1.0
    return e if poling == 2 else _moved(e, _ALONG_X[1], _ALONG_X[0])


def dielectric(name: str, poling: int) -> np.ndarray:
    """Diagonal (3,) of ε for one unit constant, the poling along z (2) or x (0)."""
    eps = np.array([1.0, 1.0, 0.0] if name == "eps11" else [0.0, 0.0, 1.0])
    found = np.empty(3)
    found[[0, 1, 2] if poling == 2 else _ALONG_X[1]] = eps
    return found


def _moved(matrix: np.ndarray, rows: list[int], columns: list[int]) -> np.ndarray:
    found = np.empty_like(matrix)
    found[np.ix_(rows, columns)] = matrix
    return found
