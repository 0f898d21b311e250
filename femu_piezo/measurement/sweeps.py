"""The measured sweeps of a fit, their noise, and the difference of log Z from a model in units of the noise."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from femu_piezo.measurement.autoregression import WHITE, Autoregression, autoregression
from femu_piezo.threads import made_once

#: Bands of each sweep in the leave-band-out prediction.
_BANDS = 10
#: Standard deviation of the logarithm of a noise level that was given, and of one estimated from the roughness of the
#: sweep (tests/measurement/test_noise.py).
_GIVEN, _ESTIMATED = 0.02, 0.15
#: Standard deviations of the noise level within which a residual counts as noise.
_ALIKE = 3.0


@dataclass(frozen=True)
class SweepData:
    """Impedances of one or more sweeps, one after another.

    Attributes
    ----------
    frequency : (k,) Hz
    impedance : (k,) measured Z, ohm
    relative_noise : (k,) sqrt(E|δZ/Z|²), including the error of the reduced basis
    noise_known : whether it came with the data (else it was estimated from the sweep alone)
    sizes : number of points of each sweep; empty for a single sweep
    model_share : (k,) share of the variance that is error of the reduced basis; none where empty
    mesh_error : (k,) relative error of eigenvalues that the mesh may have at each frequency; none where empty
    mesh_capacitance : (k,) error of the capacitance of the body that the mesh may have, F; none where empty
    bodies : number of the body of each sweep; sweeps of one share the error of its mesh. Each has its own where empty
    noise_memory : autoregression of the noise of each sweep; white noise where empty
    """

    frequency: np.ndarray = field(repr=False)
    impedance: np.ndarray = field(repr=False)
    relative_noise: np.ndarray = field(repr=False)
    noise_known: bool
    sizes: tuple[int, ...] = ()
    model_share: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)
    mesh_error: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)
    mesh_capacitance: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)
    bodies: tuple[int, ...] = ()
    noise_memory: tuple[Autoregression, ...] = ()

    @made_once
    def sweeps(self) -> list[np.ndarray]:
        """Indices of the points of each sweep."""
        return np.split(np.arange(self.impedance.size), np.cumsum(self.sizes)[:-1])

    @property
    def weight(self) -> np.ndarray:
        """(k,) √2/σ of the relative noise: Re and Im of log Z have half of its variance each."""
        return np.sqrt(2.0) / self.relative_noise

    def over_noise(self, errors: np.ndarray) -> np.ndarray:
        """(k, …) complex errors of log Z, whitened: over their deviation, and less what earlier points predict."""
        found = errors * self.weight.reshape(-1, *[1] * (errors.ndim - 1))
        for memory, sweep in self._correlated:
            found[sweep] = memory.whitened(found[sweep])
        return found

    def over_noise_transposed(self, values: np.ndarray) -> np.ndarray:
        """Wᵗ v (k, …) of complex values (k, …), with W the real matrix of `over_noise`."""
        found = np.array(values)
        for memory, sweep in self._correlated:
            found[sweep] = memory.transposed(values[sweep])
        return found * self.weight.reshape(-1, *[1] * (values.ndim - 1))

    def from_noise(self, whitened: np.ndarray) -> np.ndarray:
        """(k,) errors of log Z of whitened ones: the inverse of `over_noise`."""
        found = np.array(whitened)
        for memory, sweep in self._correlated:
            found[sweep] = memory.coloured(whitened[sweep])
        return found / self.weight

    def log_error(self, residual: np.ndarray) -> np.ndarray:
        """(k,) complex log Z_model − log Z of whitened residuals (2k,), Re then Im."""
        k = residual.size // 2
        return self.from_noise(residual[:k] + 1j * residual[k:])

    def modelled(self, residual: np.ndarray) -> np.ndarray:
        """(k,) Z of a model, ohm, with these whitened residuals (2k,)."""
        return self.impedance * np.exp(self.log_error(residual))

    @property
    def _correlated(self) -> list[tuple[Autoregression, np.ndarray]]:
        """Noise and points of the sweeps whose noise is not white."""
        return [(memory, sweep) for memory, sweep in zip(self.noise_memory, self.sweeps, strict=False) if memory]

    @property
    def level_std(self) -> float:
        """Prior standard deviation of the logarithm of the noise level."""
        return level_std(self.noise_known)

    def bands(self) -> list[np.ndarray]:
        """Indices of the points of contiguous bands, `_BANDS` of each sweep."""
        return [part for sweep in self.sweeps for part in np.array_split(sweep, _BANDS)]

    def select(self, keep: np.ndarray) -> SweepData:
        """The data at the points `keep` (bool, or indices in order) alone."""
        kept = np.arange(self.impedance.size)[keep]
        sizes = tuple(int(np.count_nonzero(np.isin(sweep, kept))) for sweep in self.sweeps) if self.sizes else ()
        return replace(
            self,
            frequency=self.frequency[kept],
            impedance=self.impedance[kept],
            relative_noise=self.relative_noise[kept],
            sizes=sizes,
            model_share=self.model_share[kept] if self.model_share.size else self.model_share,
            mesh_error=self.mesh_error[kept] if self.mesh_error.size else self.mesh_error,
            mesh_capacitance=self.mesh_capacitance[kept] if self.mesh_capacitance.size else self.mesh_capacitance,
        )

    def mesh_misses(self, log_slope: np.ndarray) -> np.ndarray:
        """(2k, m) whitened errors of log Z, one standard deviation each, that the mesh may make.

        With C = 1/(jω Z), a relative error ε of eigenvalues shifts C along frequency, independently in each band of the
        sweeps of a body: ½ ε (1 + ∂log Z/∂log f), log_slope (k,) complex. An error δC of the capacitance is −jω Z δC.
        """
        size, bodies = self.impedance.size, self.bodies or range(len(self.sweeps))
        found = np.zeros((size, max(bodies) + 1, _BANDS + 1), dtype=complex)
        if self.mesh_error.size:
            shifted = 0.5 * self.mesh_error * (1 + log_slope)
            for number, band in enumerate(self.bands()):
                sweep, place = divmod(number, _BANDS)
                found[band, bodies[sweep], place] = shifted[band]
        if self.mesh_capacitance.size:
            charged = -2j * np.pi * self.frequency * self.impedance * self.mesh_capacitance
            for body, points in zip(bodies, self.sweeps, strict=True):
                found[points, body, _BANDS] = charged[points]
        acting = found.reshape(size, -1)
        return stacked(self.over_noise(acting[:, np.any(acting, axis=0)]))

    def whitened(self, impedance: np.ndarray, tangents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (2k,) = (log Z_model − log Z)/σ as Re, Im, and its Jacobian (2k, n_x).

        Parameters
        ----------
        impedance : (k,) of a model, ohm;  tangents : (k, n_x) its slopes
        """
        difference, slopes = np.log(impedance / self.impedance), tangents / impedance[:, None]
        return stacked(self.over_noise(difference)), stacked(self.over_noise(slopes))


def level_std(noise_known: bool) -> float:
    """Standard deviation of the logarithm of the noise level of a sweep, given with the data or estimated."""
    return _GIVEN if noise_known else _ESTIMATED


def noise_memory(residual: np.ndarray, parameters: int, noise_known: bool) -> tuple[Autoregression, float]:
    """The autoregression of a residual that may be noise, and its rms over the noise; white noise and 1 for others.

    It may be noise if it is as large as the noise that was given, or, without what neighbours predict, as the roughness
    of the sweep.

    Parameters
    ----------
    residual : (k,) complex, over sqrt(E|δZ/Z|²);  parameters : complex ones that were fitted
    """
    freedom, memory = residual.size - parameters, autoregression(residual)
    if not memory or freedom <= 0:
        return WHITE, 1.0
    size = float(np.sqrt(np.sum(np.abs(residual) ** 2) / freedom))
    alone = size if noise_known else size * memory.predictor(len(memory.correlations))[1]
    if abs(np.log(alone)) > _ALIKE * np.hypot(level_std(noise_known), 1 / np.sqrt(freedom)):
        return WHITE, 1.0
    return memory, size


def stacked(values: np.ndarray) -> np.ndarray:
    """(2k, n) or (2k,): Re of complex values (k, n) or (k,), then Im."""
    return np.concatenate([values.real, values.imag])
