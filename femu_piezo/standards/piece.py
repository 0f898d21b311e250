"""A body as the standards see it: one dimension that counts, and the formulas of that kind of body.

Every formula is that of `femu_piezo.standards.formulas`; N are the frequency constants of EN 50324-2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.material.constants import PiezoConstants
from femu_piezo.standards.formulas import (
    disk_root,
    longitudinal_coupling,
    longitudinal_share,
    planar_coupling,
    planar_share,
    single_mode_share,
    transverse_coupling,
    transverse_share,
)

Kind = Literal["k31 bar", "k33 bar", "disk", "ring", "thickness plate", "shear plate", "other", "higher mode"]

#: How each kind is spoken of, and the clause of IEEE Std 176-1987 with its formulas.
WORDS: dict[str, str] = {
    "k31 bar": "bar poled across its length (IEEE 176-1987, 6.4.1)",
    "k33 bar": "bar poled along its length (IEEE 176-1987, 6.4.2)",
    "disk": "thin disk, radial mode (IEEE 176-1987, 4.1.3 and 6.4)",
    "ring": "narrow ring, breathing mode (IRE Standards on Piezoelectric Crystals, 1961)",
    "thickness plate": "wide plate, thickness extension (IEEE 176-1987, 6.4.3)",
    "shear plate": "wide plate, thickness shear (IEEE 176-1987, 6.4.3)",
    "other": "any body: frequencies, quality and capacitance by their definitions (IEEE 176-1987, EN 50324-2)",
    "higher mode": "a mode above the fundamental: frequencies and quality by their definitions (IEEE 176-1987)",
}


@dataclass(frozen=True)
class Piece:
    """What the formulas need of a body.

    Attributes
    ----------
    kind : of the body, whose formulas hold
    extent : length of a bar, diameter of a disk, mean diameter of a ring, thickness of a plate, m
    gap, area : distance of the electrodes, m, and area of one, m²; None where the field is not uniform
    density : kg/m³
    poisson : σ = −s12/s11, which one mode of a disk does not determine
    aspect : the ratio that the formulas take as large, in words and as a number: ("length/width", 8.0)
    """

    kind: Kind
    extent: float
    gap: float | None
    area: float | None
    density: float
    poisson: float = 0.31
    aspect: tuple[str, float] | None = None

    def coupling(self, fs: float, fp: float) -> float:
        """k² of the material by the formula of this kind of body; that of `k_eff` for others."""
        if self.kind == "k31 bar":
            return transverse_coupling(fs, fp)
        if self.kind in ("k33 bar", "thickness plate", "shear plate"):
            return longitudinal_coupling(fs, fp)
        if self.kind == "disk":
            return planar_coupling(self.poisson, fs, fp)
        return 1 - (fs / fp) ** 2

    def share(self, frequency: float, fs: float, fp: float) -> float:
        """C(f)/C^T at a frequency f below fs, Hz, by the formula of this kind of body."""
        k2 = self.coupling(fs, fp)
        if self.kind == "k31 bar":
            return transverse_share(np.pi / 2 * frequency / fs, k2)
        if self.kind in ("k33 bar", "shear plate"):
            return longitudinal_share(np.pi / 2 * frequency / fp, k2)
        if self.kind == "disk":
            return planar_share(disk_root(self.poisson) * frequency / fs, self.poisson, k2)
        return single_mode_share(frequency / fs, 1 - (fs / fp) ** 2)

    def figures(self, fs: float, fp: float, capacitance: float | None) -> dict[str, float]:
        """Name → value, SI: coupling, frequency constant, s, d, ε by the formulas; `capacitance` is C^T, F."""
        k2 = self.coupling(fs, fp)
        if self.kind in ("other", "higher mode") or not 0 < k2 < 1:
            return {}
        k, rho, size = float(np.sqrt(k2)), self.density, self.extent
        eps = None if capacitance is None or self.area is None else capacitance * self.gap / self.area
        if self.kind == "k31 bar":
            return {"k31": k, "N1": fs * size, **_across(1 / (4 * rho * size**2 * fs**2), k, eps)}
        if self.kind == "ring":
            return {"k31": k, "N_ring": fs * size, **_across(1 / (rho * (np.pi * fs * size) ** 2), k, eps)}
        if self.kind == "disk":
            slow = (disk_root(self.poisson) / (np.pi * fs * size)) ** 2 / rho
            s11, k31 = slow / (1 - self.poisson**2), k * float(np.sqrt((1 - self.poisson) / 2))
            return {"kp": k, "k31": k31, "poisson": self.poisson, "Np": fs * size, **_across(s11, k31, eps)}
        if self.kind == "k33 bar":
            s33 = 1 / (4 * rho * size**2 * fp**2 * (1 - k2))
            found = {"k33": k, "N3": fp * size, "s33": s33, "s33D": s33 * (1 - k2)}
            return found if eps is None else {**found, "d33": k * float(np.sqrt(s33 * eps)), "eps33T": eps}
        stiff = 4 * rho * size**2 * fp**2
        if self.kind == "thickness plate":
            return {"kt": k, "Nt": fp * size, "c33D": stiff, "c33": stiff * (1 - k2)}
        s44 = 1 / (stiff * (1 - k2))
        found = {"k15": k, "N15": fp * size, "c44D": stiff, "s44": s44}
        return found if eps is None else {**found, "d15": k * float(np.sqrt(s44 * eps)), "eps11T": eps}


def _across(s11: float, k31: float, eps: float | None) -> dict[str, float]:
    found = {"s11": float(s11)}
    return found if eps is None else {**found, "d31": -k31 * float(np.sqrt(s11 * eps)), "eps33T": eps}


def material_figures(constants: PiezoConstants) -> dict[str, float]:
    """Name → value as of `Piece.figures`, computed from the constants, which are included; real parts, SI."""
    e_form, coupling = constants.to_e_form(), constants.coupling
    c33_open = e_form.c33 + e_form.e33**2 / e_form.eps33S
    shear = 1 - coupling["k15"] ** 2
    values = {name: value for name, value in constants.as_dict().items()} | dict(coupling)
    values |= {
        "poisson": -constants.s12 / constants.s11,
        "s33D": constants.s33 * (1 - coupling["k33"] ** 2),
        "kt": np.sqrt(e_form.e33**2 / (e_form.eps33S * c33_open)),
        "c33D": c33_open,
        "c33": e_form.c33,
        "c44D": 1 / (constants.s44 * shear),
    }
    return {name: float(np.real(value)) for name, value in values.items()}
