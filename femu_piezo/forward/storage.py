"""Saving and loading of reduced models (npz, no pickle); a basis of another mesh, operator or range is refused."""

from __future__ import annotations

import hashlib
import io
import os
import secrets
import zipfile
from pathlib import Path

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel

_FORMAT = 1


def fingerprint(model: ElectroelasticModel) -> str:
    """Digest of all that a projection depends on: mesh, element, density, electrodes, symmetry, orientation, terms."""
    digest = hashlib.sha256()
    mesh, prolongation = model.domain.mesh, model.prolongation
    parts = [mesh.p, mesh.t, model.tensors, prolongation.indptr, prolongation.indices, prolongation.data]
    for matrix in model.extra_terms.values():
        parts += [matrix.indptr, matrix.indices, matrix.data]
    for part in parts:
        digest.update(np.ascontiguousarray(part).tobytes())
    words = (type(mesh).__name__, model.order, model.density, model.domain.admittance_factor)
    digest.update(repr((*words, model.terms, model.size)).encode())
    return digest.hexdigest()


def save_reduced(path: Path, reduced: ReducedModel, model: ElectroelasticModel) -> None:
    """Write a reduced model with the fingerprint of its full model; whole or not at all.

    Raises InputError where the folder does not exist or cannot be written to.
    """
    path, stream = Path(path), io.BytesIO()
    np.savez_compressed(
        stream,
        format=_FORMAT,
        fingerprint=fingerprint(model),
        terms=np.array(reduced.terms),
        matrices=reduced.matrices,
        displacements=reduced.displacements,
        admittance_factor=reduced.admittance_factor,
        basis=reduced.basis,
        estimated_error=reduced.estimated_error,
        band_Hz=reduced.band_Hz,
        training=reduced.training,
    )
    beside = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        beside.write_bytes(stream.getvalue())
        os.replace(beside, path)
    except OSError as error:
        raise InputError(f"{path}: the reduced model cannot be written ({error.strerror or error})") from None
    finally:
        beside.unlink(missing_ok=True)


def load_reduced(path: Path, model: ElectroelasticModel) -> ReducedModel:
    """Read a reduced model of exactly this full model; its `training` says for which constants it was made.

    Raises
    ------
    InputError : the file cannot be read, is no reduced model, or belongs to another mesh, density, electrode or term
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
        known = int(content["format"])
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; make the reduced model with reduce_model") from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise InputError(f"{path}: this is not a saved reduced model ({error}); make it anew") from None
    if known != _FORMAT:
        raise InputError(f"{path}: the reduced model has format {known}, this version reads {_FORMAT}; make it anew")
    if str(content["fingerprint"]) != fingerprint(model):
        raise InputError(
            f"{path}: the reduced model belongs to another mesh, density, electrode, orientation or set of terms than "
            "the model at hand; make it anew"
        )
    return ReducedModel(
        terms=tuple(str(name) for name in content["terms"]),
        matrices=content["matrices"],
        displacements=int(content["displacements"]),
        admittance_factor=float(content["admittance_factor"]),
        basis=content["basis"],
        estimated_error=float(content["estimated_error"]),
        band_Hz=float(content["band_Hz"]),
        training=content["training"],
    )
