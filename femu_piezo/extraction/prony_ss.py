"""Prony-SS: poles and zeros from the impulse response of a uniform sweep (paper section 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.linalg import hankel

from femu_piezo.errors import InputError
from femu_piezo.extraction.order import MAX_PHASE
from femu_piezo.extraction.stabilization import Column, StabilizationDiagram, inside, stabilize
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Kind

Extension = Literal["hermitian", "analytic"]
MIN_COLUMN = 8
UNIFORM = 1e-6  # relative tolerance of the frequency step
TAPER = 0.25  # fraction of the band over which the window rises or falls
NEAR_DC = 0.02  # a band that starts below this fraction of its end needs no rise at the low end
DEAD_TIME = 4.0
MIN_SIGNIFICANCE = 20.0  # amplitude of a column in units of its standard deviation
HANKEL_SIZE = 300
MAX_ORDER = 40
SINGULAR_FLOOR = 1e-13


@dataclass(frozen=True)
class PronySS:
    """Result of one Prony-SS run.

    Attributes
    ----------
    diagram : poles over order, stable columns
    signal : (K,) the part of the time signal that was decomposed (real for the hermitian extension)
    time_step : Δt, s
    start : time of the first sample of `signal`, s
    residues : (number of columns,) complex R of R/(λ − ω²) in Y/(jω) for poles, farad·rad²/s², and of
        R/(ω² − λ) in jωZ for zeros, ohm·rad³/s³, from the least-squares amplitudes of the signal
    singular_values : (min(rows, columns),) of the Hankel matrix H0, largest first
    shift : angular frequency ω0 by which all frequencies of the signal are lowered, rad/s; 0 for a real signal
    """

    diagram: StabilizationDiagram
    signal: np.ndarray
    time_step: float
    start: float
    residues: np.ndarray
    singular_values: np.ndarray
    shift: float = 0.0

    @property
    def time(self) -> np.ndarray:
        """(K,) of the samples of `signal`, s."""
        return self.start + self.time_step * np.arange(self.signal.size)

    @property
    def modelled(self) -> np.ndarray:
        """(K,) the signal of the columns alone: Σ R Δt/(2p) exp((p − jω0) t), ω0 the shift, p = j√λ; of a real signal
        with the conjugates."""
        p = 1j * np.sqrt(np.array([column.eigenvalue for column in self.diagram.columns], complex))
        sign = 1 if self.diagram.kind == "pole" else -1
        found = np.exp(np.outer(self.time, p - 1j * self.shift)) @ (sign * self.residues * self.time_step / (2 * p))
        return 2 * found.real if np.isrealobj(self.signal) else found


def prony_ss(
    spectrum: ImpedanceSpectrum,
    kind: Kind,
    *,
    band: tuple[float, float] | None = None,
    extension: Extension | None = None,
    dead_time: float = DEAD_TIME,
) -> PronySS:
    """Poles of Y (or Z) of a uniform sweep by Prony's method in state space, with growing order.

    y_k = Σ c_n z_n^k is read off Hankel matrices H0 (y_0 …) and H1 (shifted by one): H0 = U Σ Vᴴ cut at order
    m, A = Σ^-1/2 Uᴴ H1 V Σ^-1/2, eigenvalues z_n, μ_n = ln z_n/Δt, λ = −μ² (paper section 3). For growing m the
    physical μ_n form columns.

    What the choices do
    -------------------
    function : Y/(jω) for poles, jωZ for zeros, less a constant (its first value near DC, else the mean of both
        ends). Both have the same poles as Y and Z but tend to a constant, the capacitance; Y itself grows with
        ω and its transform does not exist.
    band : (low, high) Hz; sets Δt = 1/(2 high) (hermitian) or 1/(high − low) (analytic). A narrower band has
        fewer modes and a coarser Δt, so that the same Hankel size spans more of the decay: better under noise.
    window : it rises and falls smoothly over a quarter of the band (`TAPER`) at either end, near DC only at the upper
        one. A cut-off band would ring like 1/t through the whole signal; the window confines that to the first
        samples, which are skipped. Modes under its ends are seen weakly, those under their outer halves are left
        out. Near DC the constant taken out removes the jump of the imaginary part at ω = 0, which a hysteretic
        loss has and the extension Y(−ω) = Y(ω)* cannot follow; the remainder decays like 1/t³.
    dead_time : the time skipped at the start (and end) of the signal, in units of 1/(width of an end in Hz), until
        the window's own response has decayed. Longer: less leakage of the window, but weaker modes.
    extension : "hermitian" is the paper's Y'(−ω) = Y'(ω)*, a real signal and two exponentials per mode; it
        needs a grid through multiples of its step. "analytic" uses the positive frequencies alone: a complex
        signal, one exponential per mode, any offset. Default: hermitian from near DC, else analytic.
    size of H0 : `HANKEL_SIZE` rows and columns where the signal has as many. Larger: more noise averaged, cost grows
        with the cube; it should span the decay, 2·size·Δt ≳ 2/(ωη).
    highest order : `MAX_ORDER`, at least twice (hermitian: four times) the number of modes.

    Raises
    ------
    InputError : the grid is not uniform, or too short
    """
    frequency, response, step = _response(spectrum, kind, band)
    offset = frequency[0] / step
    aligned = abs(offset - round(offset)) < UNIFORM * max(offset, 1.0)
    near_dc = frequency[0] < NEAR_DC * frequency[-1]
    extension = extension or ("hermitian" if aligned and near_dc else "analytic")
    if extension == "hermitian" and not aligned:
        raise InputError(
            f"{spectrum.source}: the hermitian extension needs frequencies at multiples of the step "
            f"{step:.6g} Hz, the band starts at {frequency[0]:.6g} Hz; use extension 'analytic'"
        )
    response = response - (response[0] if near_dc else (response[0] + response[-1]) / 2)
    taper = ((0.0 if near_dc else TAPER), TAPER)
    windowed = response * _window(frequency.size, taper)
    if extension == "hermitian":
        half = np.concatenate([np.zeros(round(offset), complex), windowed])
        signal: np.ndarray = np.fft.irfft(half)
        shift = 0.0
        time_step = 1 / (2 * (half.size - 1) * step)
    else:
        signal, shift = np.fft.ifft(windowed), 2 * np.pi * frequency[0]
        time_step = 1 / (frequency.size * step)
    span = frequency[-1] - frequency[0]
    dead = int(np.ceil(dead_time / (TAPER * span * time_step)))
    size = min(HANKEL_SIZE, (signal.size - 2 * dead) // 2)
    if size < 8:
        raise InputError(
            f"{spectrum.source}: {frequency.size} points in the band leave {max(size, 0)} rows for Prony-SS, "
            "at least 8 are needed; take a finer step, or use the maximum-likelihood method"
        )
    used = signal[dead : dead + 2 * size]
    by_order, singular = _growing_order(used, size, time_step, shift)
    low, high = frequency[0] + taper[0] * span / 2, frequency[-1] - taper[1] * span / 2
    diagram = inside(stabilize(kind, by_order, min_column=MIN_COLUMN), low, high)
    start = dead * time_step
    columns, residues = _physical(used, diagram, time_step, start, shift)
    return PronySS(replace(diagram, columns=columns), used, time_step, start, residues, singular, shift)


def _response(
    spectrum: ImpedanceSpectrum, kind: Kind, band: tuple[float, float] | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Frequencies, the bounded function of the band, and the frequency step."""
    sweep = spectrum if band is None else spectrum.band(*band)
    if len(sweep) < 16:
        raise InputError(f"{spectrum.source}: Prony-SS needs at least 16 points in the band, got {len(sweep)}")
    steps = np.diff(sweep.frequency)
    step = float(np.mean(steps))
    if np.max(np.abs(steps - step)) > UNIFORM * sweep.frequency[-1]:
        raise InputError(
            f"{spectrum.source}: Prony-SS needs a uniform frequency grid, the step varies from "
            f"{steps.min():.6g} to {steps.max():.6g} Hz; use the maximum-likelihood method"
        )
    charge = sweep.admittance / (1j * sweep.omega)
    response = charge if kind == "pole" else 1 / charge
    return sweep.frequency, response, step


def _window(n: int, taper: tuple[float, float]) -> np.ndarray:
    """(n,) Planck taper: rises and falls infinitely smoothly over the given fractions of the band."""
    position = np.linspace(0, 1, n)
    window = np.ones(n)
    for width, distance in ((taper[0], position), (taper[1], 1 - position)):
        edge = distance < width
        t = distance[edge] / width if width > 0 else distance[edge]
        rise = np.zeros(t.size)
        open_ = t > 0
        exponent = 1 / t[open_] - 1 / (1 - t[open_])
        rise[open_] = 0.5 * (1 - np.tanh(exponent / 2))
        window[edge] *= rise
    return window


def _growing_order(
    signal: np.ndarray, size: int, time_step: float, shift: float
) -> tuple[dict[int, np.ndarray], np.ndarray]:
    """Order → λ (k,), rad²/s², and the singular values of H0.

    A of order m is the leading m × m block of A of the highest order, so one SVD serves all.
    """
    h0 = hankel(signal[:size], signal[size - 1 : 2 * size - 1])
    h1 = hankel(signal[1 : size + 1], signal[size : 2 * size])
    u, singular, vh = np.linalg.svd(h0)
    top = min(MAX_ORDER, int(np.count_nonzero(singular > SINGULAR_FLOOR * singular[0])))
    root = 1 / np.sqrt(singular[:top])
    a = root[:, None] * (u[:, :top].conj().T @ h1 @ vh[:top].conj().T) * root
    by_order = {}
    for order in range(1, top + 1):
        z = np.linalg.eigvals(a[:order, :order])
        mu = np.log(z[np.abs(z) > 0].astype(complex)) / time_step
        # an angle below zero of the analytic signal is a frequency in the upper half of its band
        angle = np.mod(mu.imag, 2 * np.pi / time_step) if shift else mu.imag
        mu = mu.real + 1j * (angle + shift)
        by_order[order] = -(mu[(mu.imag > 0) & (mu.real < 0)] ** 2)
    return by_order, singular


def _physical(
    signal: np.ndarray, diagram: StabilizationDiagram, time_step: float, start: float, shift: float
) -> tuple[tuple[Column, ...], np.ndarray]:
    """The columns whose least-squares amplitude stands out of the misfit and is passive, and their residues.

    Noise makes columns too, but weak ones of any phase. The weakest column that fails is removed first, so that a
    spurious neighbour does not widen the standard deviation of a true one. The sign of the sweep is that of the
    strongest column. The amplitude of R/(λ + s²) in e^{pt} is R/(2p).
    """
    columns = list(diagram.columns)
    while columns:
        p = np.array([1j * np.sqrt(c.eigenvalue) for c in columns])
        amplitude, significance = _amplitudes(signal, p - 1j * shift, time_step)
        residue = amplitude * 2 * p * np.exp(-(p - 1j * shift) * start) / time_step
        orientation = np.sign(residue[int(np.argmax(significance))].real)
        fails = (significance < MIN_SIGNIFICANCE) | (np.abs(np.angle(orientation * residue)) > MAX_PHASE)
        if not np.any(fails):
            return tuple(columns), residue if diagram.kind == "pole" else -residue
        del columns[int(np.argmin(np.where(fails, significance, np.inf)))]
    return (), np.zeros(0, complex)


def _amplitudes(signal: np.ndarray, mu: np.ndarray, time_step: float) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares c_n of signal = Σ c_n exp(μ_n t), conjugates included if real, and |c_n| over their std."""
    count = mu.size
    if np.isrealobj(signal):
        mu = np.concatenate([mu, mu.conj()])
    basis = np.exp(np.outer(np.arange(signal.size) * time_step, mu))
    q, r = np.linalg.qr(basis)
    projection = q.conj().T @ signal
    inverse = np.linalg.inv(r)
    amplitude = inverse @ projection
    level = np.linalg.norm(signal - q @ projection) / np.sqrt(signal.size - mu.size)
    return amplitude[:count], (np.abs(amplitude) / (level * np.linalg.norm(inverse, axis=1)))[:count]
