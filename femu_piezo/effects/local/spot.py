"""A spot of a body that yields in the plane of its faces: mean strains over parts of a disk, all through the thickness.

A disk of radius a is taken as four disks of half the radius, each with a quarter of its area and strains of its own,
since strains vary over a spot: their centres, a √3/4 away in x and in y, give it the second moments a²/4. Over a disk
of radius b, with n the outward normal of its edge, at any height

    S_xx = ⟨2 n_x u_x⟩/b,   S_yy = ⟨2 n_y u_y⟩/b,   2 S_xy = ⟨2 (n_x u_y + n_y u_x)⟩/b      (means along the edge).

Faces and middle plane stand for shares of the thickness. Fields that are even in z have no energy in common with those
that are odd, so that each parity has strains of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from femu_piezo.effects.local.faces import Face
from femu_piezo.effects.local.patch import spread_points
from femu_piezo.effects.local.plane_stress import unstressed

#: Points along the edge of a part: means are exact for polynomials up to this degree less two.
_POINTS = 8
_TURNS = 2 * np.pi * (np.arange(_POINTS) + 0.5) / _POINTS
_NORMAL = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])
#: Radius of the parts and places of their centres, over the radius of the spot.
_PART = 0.5
_CENTRES = np.sqrt(3) / 4 * np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
#: Number of parts, which are equal.
PARTS = len(_CENTRES)


def spot_strains(
    levels: Sequence[tuple[float, Face]], x: float, y: float, radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean S_xx, S_yy, 2 S_xy of the unknowns over `PARTS` parts of a spot at l heights.

    Returns the means (l, PARTS, 3, u), their slopes in x, y and radius (3, l, PARTS, 3, u), and shares (l,).

    levels : heights with their shares of the thickness (`femu_piezo.effects.local.sectors.Fields.levels`); one whose
        unknowns are even or odd in z counts as two heights
    """
    weights = np.zeros((3, _POINTS, 2))
    weights[0, :, 0], weights[1, :, 1] = _NORMAL.T
    weights[2] = _NORMAL[:, ::-1]
    weights *= 2 / (_PART * radius * _POINTS)
    outward = (_CENTRES[:, None] + _PART * _NORMAL).reshape(-1, 2)  # of every point, by the radius
    shares, strains, slopes = [], [], []
    for share, face in levels:
        value, along = (
            found.reshape(PARTS, _POINTS, *found.shape[1:]) for found in spread_points(face, x, y, radius, outward)
        )
        strain = np.einsum("vpf,mpfu->mvu", weights, value[..., :2, :])
        slope = np.einsum("vpf,mpdfu->dmvu", weights, along[..., :2, :])
        slope[2] -= strain / radius
        for part in [1.0] if face.bends is None else [~face.bends, face.bends]:
            if np.any(part):
                shares.append(share)
                strains.append(strain * part)
                slopes.append(slope * part)
    return np.array(strains), np.stack(slopes, axis=1), np.array(shares)


def in_plane_stiffness(whole: np.ndarray) -> np.ndarray:
    """(3, 3) c̄ for S_xx, S_yy, 2 S_xy: c^E at T_xz = T_yz = T_zz = 0, no field, of an extended tensor."""
    pairs, free = ((0, 0), (1, 1), (0, 1)), unstressed(whole, 2)
    return np.array([[free[i, a, j, b] for j, b in pairs] for i, a in pairs])
