"""How far the parameters of a fit may be off: the Fisher information, or the delete-a-block jackknife."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from femu_piezo.extraction.fit import Fit, SweepData, fit
from femu_piezo.extraction.model import RationalModel

PARTITIONS = (8, 12)
MIN_BLOCK = 3


@dataclass(frozen=True)
class Spread:
    """Second moments of the errors of p complex parameters.

    Attributes
    ----------
    factor : (p, q) complex F. Circular: F Fᴴ = E[δθ δθᴴ] and E[δθ δθᵀ] = 0, as white circular noise gives.
        Otherwise the columns are a sample: E over the columns of any product of Re and Im parts
    circular : which of both
    """

    factor: np.ndarray
    circular: bool

    def size(self, gradient: np.ndarray) -> float:
        """sqrt(E|δ|²) of δ = gradient · δθ."""
        return float(np.linalg.norm(gradient @ self.factor))

    def covariance(self, gradients: np.ndarray) -> np.ndarray:
        """(2k, 2k) real covariance over (Re, Im) pairs of δ = gradients · δθ, gradients (k, p) (delta method)."""
        moved = gradients @ self.factor
        if not self.circular:
            parts = np.empty((2 * moved.shape[0], moved.shape[1]))
            parts[0::2], parts[1::2] = moved.real, moved.imag
            return parts @ parts.T
        hermitian = moved @ moved.conj().T
        out = np.empty((2 * hermitian.shape[0],) * 2)
        out[0::2, 0::2] = out[1::2, 1::2] = hermitian.real / 2
        out[1::2, 0::2] = hermitian.imag / 2
        out[0::2, 1::2] = -hermitian.imag / 2
        return out


def fisher_spread(model: RationalModel, data: SweepData, scale: float = 1.0) -> Spread:
    """scale²·(JᴴJ)⁻¹, the Cramér-Rao bound where `scale` is the rms of the residual (1: weights are true).

    The bound is for this model class: the complex residues and the complex background coefficients are nuisance
    parameters. J is complex because the model is holomorphic; circular noise gives circular errors.
    """
    jac = (data.weight / data.charge)[:, None] * model.jacobian(data.x)
    size = np.linalg.norm(jac, axis=0)
    return Spread(scale * np.linalg.inv(np.linalg.qr(jac / size)[1]) / size[:, None], circular=True)


def jackknife_spread(best: Fit, data: SweepData, partitions: tuple[int, ...] = PARTITIONS) -> Spread | None:
    """Delete-a-block jackknife (Künsch 1989): the fit repeated with one block of the sweep left out at a time.

    cov = (B − 1)/B Σ_b (θ_b − θ̄)(θ_b − θ̄)ᵀ for B blocks, averaged over two partitions because the length over
    which a systematic error keeps its sign is not known. It asks the data how far such an error moves the answer,
    where the Fisher information would count correlated errors as independent; with so few blocks it is itself
    known to a factor of about 1.5. None where a block would have fewer than 3 points or the rest fewer than the
    parameters.
    """
    n, columns = len(data), []
    for blocks in partitions:
        if n < MIN_BLOCK * blocks or n - n // blocks - 1 < best.model.size:
            return None
        edges = np.linspace(0, n, blocks + 1).astype(int)
        found = []
        for low, high in pairwise(edges):
            keep = np.r_[0:low, high:n]
            rest = replace(data, x=data.x[keep], charge=data.charge[keep], weight=data.weight[keep])
            found.append(fit(best.model, rest).model.parameters)
        moved = np.array(found) - np.mean(found, axis=0)
        columns.append(np.sqrt((blocks - 1) / blocks / len(partitions)) * moved.T)
    return Spread(np.hstack(columns), circular=False)
