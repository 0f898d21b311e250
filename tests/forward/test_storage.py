"""A reduced model comes back as it was; a stale, foreign or broken file is refused in one sentence."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from femu_piezo.errors import InputError
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.forward.storage import load_reduced, save_reduced
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.library import library_material

PZT = library_material("pzt-5h").constants
PLATE = Plate(8e-3, 5e-3, 1e-3)


@pytest.fixture(scope="module")
def pair():
    model = ElectroelasticModel(PLATE.domain((3, 2, 1)), 7500.0)
    return model, reduce_model(model, [PZT], 200e3)


def test_round_trip(pair, tmp_path):
    model, reduced = pair
    save_reduced(tmp_path / "plate.npz", reduced, model)
    again = load_reduced(tmp_path / "plate.npz", model)
    frequency = np.linspace(1e3, 200e3, 50)
    e_form = PZT.to_e_form()
    np.testing.assert_array_equal(again.impedance(e_form, frequency), reduced.impedance(e_form, frequency))
    np.testing.assert_array_equal(again.training, reduced.training)
    assert (again.terms, again.band_Hz) == (reduced.terms, reduced.band_Hz)
    assert list(tmp_path.iterdir()) == [tmp_path / "plate.npz"]


def test_a_stale_basis_is_refused(pair, tmp_path):
    model, reduced = pair
    file = tmp_path / "plate.npz"
    save_reduced(file, reduced, model)
    spring = sp.eye(4 * model.basis.N)
    others = [
        ElectroelasticModel(PLATE.domain((3, 2, 2)), 7500.0),
        ElectroelasticModel(Plate(8.001e-3, 5e-3, 1e-3).domain((3, 2, 1)), 7500.0),
        ElectroelasticModel(PLATE.domain((3, 2, 1)), 7501.0),
        ElectroelasticModel(PLATE.domain((3, 2, 1)), 7500.0, order=1),
        ElectroelasticModel(Plate(8e-3, 5e-3, 1e-3, "length").domain((3, 2, 1)), 7500.0),
        ElectroelasticModel(PLATE.domain((3, 2, 1)), 7500.0, extra_terms={"spring": spring}),
    ]
    for other in others:
        with pytest.raises(InputError, match="another mesh"):
            load_reduced(file, other)
    load_reduced(file, ElectroelasticModel(PLATE.domain((3, 2, 1)), 7500.0))


def test_what_is_no_reduced_model_is_refused(pair, tmp_path):
    model, reduced = pair
    with pytest.raises(InputError, match="no such file"):
        load_reduced(tmp_path / "none.npz", model)
    (tmp_path / "text.npz").write_text("frequency_Hz\n1\n")
    np.savez(tmp_path / "other.npz", a=np.arange(3))
    np.savez(tmp_path / "pickle.npz", format=np.array({"a": 1}, dtype=object))
    np.savez(tmp_path / "later.npz", format=99)
    save_reduced(tmp_path / "plate.npz", reduced, model)
    whole = (tmp_path / "plate.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    for name in ("text", "other", "pickle", "later", "half"):
        with pytest.raises(InputError, match="reduced model"):
            load_reduced(tmp_path / f"{name}.npz", model)
    with pytest.raises(InputError, match="written"):
        save_reduced(tmp_path / "missing" / "plate.npz", reduced, model)
