"""Touchstone files of network analysers (version 1 and 2, read by scikit-rf) as impedances.

Z follows from the reflection S11 = (Z − Z0)/(Z + Z0) of a one-port, or from the transmission of a piece between two
ports: in series S21 = 2 sqrt(Z1 Z2)/(Z + Z1 + Z2), in shunt S21 = 2 sqrt(Z1 Z2) Z/(Z1 Z2 + Z (Z1 + Z2)), with the
reference resistances Z1 and Z2 (Pozar, Microwave Engineering, 4th ed., section 4.3 and table 4.1).

The error of S is about the same at all points of a sweep; that of Z is |dZ/dS| times as large, |Z + Z0|²/(2 Z0) for a
reflection, so that |Z| far from the reference is known badly. The noise of the sweep contains it.
"""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path
from typing import Literal

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.measurement.noise import estimate_noise
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

Connection = Literal["reflection", "series", "shunt"]
#: Median difference of S11 from that of a piece in series or shunt, from which on the connection is not accepted.
_UNLIKE = 0.2
#: Noise of S below which no instrument measured it: what is seen is the rounding of the file.
_COMPUTED = 1e-8
#: Fewest points from which the noise can be estimated.
_FEWEST = 8


def is_touchstone(path: Path) -> bool:
    """Whether the name is that of a Touchstone file: .s1p, .s2p, .y1p, .z1p, .ts."""
    return re.fullmatch(r"\.([syzgh]\d+p|ts)", path.suffix.lower()) is not None


def read_touchstone(text: str, source: str, connection: Connection | None = None) -> ImpedanceSpectrum:
    """The sweep of a Touchstone file; of a file of S with a noise estimated from its roughness and a note on errors.

    Parameters
    ----------
    text : of the file
    connection : how the piece was connected; None finds it out: reflection of a one-port, series or shunt of two ports

    Raises
    ------
    InputError : scikit-rf is missing or does not understand the file, or the ports do not tell the connection
    """
    frequency, s, reference = _parse(text, source)
    ports = s.shape[1]
    if ports > 2:
        raise InputError(f"{source}: the file has {ports} ports; export the one or two to which the piece is connected")
    if not np.all(np.isfinite(frequency)):
        raise InputError(f"{source}: a frequency of the file is not a finite number; export the sweep again")
    keep = frequency > 0
    frequency, s, reference = frequency[keep], s[keep], reference[keep]
    if not frequency.size:
        raise InputError(f"{source}: the file holds no points above 0 Hz; export the sweep again")
    kind = connection or ("reflection" if ports == 1 else _connection(s, reference, source))
    if kind != "reflection" and ports == 1:
        raise InputError(f'{source}: connection = "{kind}" needs a file of two ports, and this one has one')
    seen = s[:, 0, 0] if kind == "reflection" else s[:, 1, 0]
    impedance, slope = impedance_of(seen, kind, reference[:, 0], reference[:, -1])
    if not np.all(np.isfinite(impedance)) or np.any(impedance == 0):
        bad = frequency[np.argmax(~np.isfinite(impedance) | (impedance == 0))]
        raise InputError(f"{source}: S at {bad:g} Hz is exactly that of an open or a short circuit; remove such points")
    order = np.argsort(frequency, kind="stable")
    frequency, impedance, slope, seen = (values[order] for values in (frequency, impedance, slope, seen))
    if np.any(np.diff(frequency) == 0):
        raise InputError(f"{source}: frequencies repeat; export one sweep")
    if _parameter(text) != "S":  # of what the instrument saw nothing is known
        return ImpedanceSpectrum(frequency, impedance, source=source)
    noise, note = _noise(frequency, seen, impedance, slope, kind, float(np.real(reference[0, 0])), source)
    return ImpedanceSpectrum(frequency, impedance, noise, source, (note,), noise_estimated=noise is not None)


def impedance_of(
    s: np.ndarray, connection: Connection, first: np.ndarray | float, second: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Z (n,) in ohm and |dZ/dS| (n,) from S11 of a reflection, or S21 of a piece in series or shunt.

    first, second : reference resistances of both ports, ohm
    """
    root, total, product = 2 * np.sqrt(np.real(first * second)), first + second, first * second
    with np.errstate(divide="ignore", invalid="ignore"):
        if connection == "reflection":
            return first * (1 + s) / (1 - s), np.abs(2 * first / (1 - s) ** 2)
        if connection == "series":
            return root / s - total, np.abs(root / s**2)
        return product * s / (root - total * s), np.abs(product * root / (root - total * s) ** 2)


def touchstone_text(frequency_Hz: np.ndarray, impedance: np.ndarray, reference: float = 50.0) -> str:
    """A Touchstone 1 file of the reflection of Z (n,) in ohm at frequencies (n,) against a resistance, all digits."""
    s = (impedance - reference) / (impedance + reference)
    rows = (f"{f!r} {v.real!r} {v.imag!r}" for f, v in zip(frequency_Hz.tolist(), s.tolist(), strict=True))
    return "\n".join([f"# HZ S RI R {reference:g}", *rows, ""])


def _parse(text: str, source: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (n,) Hz, S (n, p, p) and reference resistances (n, p), ohm."""
    try:
        from skrf import Network
        from skrf.network import y2s
    except ImportError:
        raise InputError(
            f"{source}: Touchstone files are read by scikit-rf, which is not installed: pip install "
            "'femu-piezo[touchstone]'"
        ) from None
    admittances = _as_impedances(text)
    stream = io.StringIO(text if admittances is None else admittances)
    stream.name = Path(source).name
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            network = Network(stream)
            s, reference = np.asarray(network.s), np.asarray(network.z0)
            if admittances is not None:
                s = y2s(network.z / reference[:, :, None] ** 2, reference)
            return np.asarray(network.f, float), s, reference
    except Exception as error:  # scikit-rf has no error of its own: whatever a damaged file meets
        reason = str(error).strip().splitlines()[0][:120] if str(error).strip() else type(error).__name__
        raise InputError(
            f"{source}: scikit-rf does not understand this Touchstone file ({reason}); export it again"
        ) from None


def _as_impedances(text: str) -> str | None:
    """The text of a version 1 file of Y with Z in place of Y in its option line; None for any other file.

    Its numbers are y = Y R (Touchstone 1.1), but scikit-rf 2.2 takes them for Y/R and multiplies by R, which is right
    only for z = Z/R. Read as Z they are multiplied by R as well, and `_parse` divides by R².
    """
    options = _options(text)
    if options is None or "[version]" in text.lower() or _parameter(text) != "Y":
        return None
    return text[: options.start()] + re.sub(r"\bY\b", "Z", options[0], flags=re.I) + text[options.end() :]


def _options(text: str) -> re.Match | None:
    """The option line."""
    return re.search(r"^\s*#[^!\n]*", text, re.MULTILINE)


def _parameter(text: str) -> str:
    """What the file holds: S, where the option line says nothing, Z, Y …"""
    options = _options(text)
    found = None if options is None else re.search(r"\b[SYZGH]\b", options[0], re.IGNORECASE)
    return "S" if found is None else found[0].upper()


def _connection(s: np.ndarray, reference: np.ndarray, source: str) -> Connection:
    """Series or shunt, whichever reflection implied by S21 is nearer to S11."""
    first, second = reference[:, 0], reference[:, 1]
    misfit = {}
    for kind in ("series", "shunt"):
        z, _ = impedance_of(s[:, 1, 0], kind, first, second)
        with np.errstate(all="ignore"):
            seen = z + second if kind == "series" else z * second / (z + second)
            misfit[kind] = float(np.nanmedian(np.abs((seen - first) / (seen + first) - s[:, 0, 0])))
    best = min(misfit, key=misfit.__getitem__)
    if not misfit[best] < min(_UNLIKE, 0.3 * max(misfit.values())):
        raise InputError(
            f"{source}: S11 and S21 are neither those of a piece in series between the ports nor of one in shunt "
            f'(median differences {misfit["series"]:.2g} and {misfit["shunt"]:.2g}); write connection = "series", '
            '"shunt" or "reflection" in [measurement]'
        )
    return best


def _noise(frequency, s, impedance, slope, kind: str, reference: float, source: str) -> tuple[np.ndarray | None, str]:
    """Standard deviation of Z (n,), ohm, from that of S, None for few points; and a note on the error of |Z|."""
    relative = slope / np.abs(impedance)
    worst = int(np.argmax(relative))
    words = (
        f"{kind} against {reference:g} ohm: |Z| is {np.abs(impedance).min():.3g} to {np.abs(impedance).max():.3g} ohm, "
        f"and an error of 0.001 in S is one of {0.1 * relative.min():.2g} % of |Z| at best and of "
        f"{0.1 * relative[worst]:.2g} % at {frequency[worst]:.6g} Hz"
    )
    if frequency.size < _FEWEST:
        return None, words
    sigma = estimate_noise(ImpedanceSpectrum(frequency, s, source=source)).std(s)
    if np.median(sigma) < _COMPUTED:
        return None, f"{words}; S has no noise, as in a file that was computed"
    return sigma * slope, f"{words}; the noise of Z is computed from that of S, {np.median(sigma):.1e}"
