"""Integrals over electrodes, whichever way they face."""

import numpy as np
import pytest
import skfem
from scipy.spatial.transform import Rotation

from femu_piezo.forward.electrodes import electrode_faces, electrode_film, electrode_membrane
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.domain import Domain

SIZE = np.array([8e-3, 3e-3, 2e-3])
TURNS = {
    "z": np.eye(3),
    "x": Rotation.from_euler("y", 90, degrees=True).as_matrix(),
    "y": Rotation.from_euler("x", -90, degrees=True).as_matrix(),
    "askew": Rotation.from_rotvec([0.4, -0.9, 1.3]).as_matrix(),
}


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_film_and_membrane_turn_with_the_body(turn: np.ndarray) -> None:
    """∫ ε_xx² + ε_yy² + 2ν ε_xx ε_yy + (1 − ν)/2 γ_xy² dS of a uniform strain, ∫ v·u dS of a shift."""
    straight = skfem.MeshHex.init_tensor(*(np.linspace(0, length, 3) for length in SIZE)).with_boundaries(
        {"hot": lambda x: x[2] > SIZE[2] * (1 - 1e-9), "ground": lambda x: x[2] < SIZE[2] * 1e-9}
    )
    mesh = skfem.MeshHex(turn @ straight.p, straight.t, _boundaries=straight.boundaries)
    model = ElectroelasticModel(Domain(mesh, ("hot",), ("ground",), poling=tuple(turn[:, 2])), 7500.0)
    faces, area, poisson = electrode_faces(model), 2 * SIZE[0] * SIZE[1], 0.35

    def form(matrix, displacement: np.ndarray) -> float:
        u = np.concatenate([displacement.ravel(), np.zeros(model.basis.N)])
        return u @ matrix @ u

    slopes = np.random.default_rng(3).standard_normal((3, 3))  # in the axes of the straight body
    strain = (slopes + slopes.T) / 2
    energy = strain[0, 0] ** 2 + strain[1, 1] ** 2 + 2 * poisson * strain[0, 0] * strain[1, 1]
    energy += (1 - poisson) / 2 * (2 * strain[0, 1]) ** 2
    found = form(electrode_membrane(faces, poisson), turn @ slopes @ turn.T @ model.basis.doflocs)
    assert found == pytest.approx(area * energy, rel=1e-9, abs=0)
    shift = np.array([1.0, -2.0, 0.5])
    moved = np.tile((turn @ shift)[:, None], model.basis.N)
    assert form(electrode_film(faces), moved) == pytest.approx(area * shift @ shift, rel=1e-9, abs=0)
    assert form(electrode_film(faces, (2,)), moved) == pytest.approx(area * shift[2] ** 2, rel=1e-9, abs=0)
    assert form(electrode_film(faces, (0, 1)), moved) == pytest.approx(area * shift[:2] @ shift[:2], rel=1e-9, abs=0)
