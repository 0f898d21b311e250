"""The paper's isotropic simplifications: two complex unknowns and one permittivity for a k31 plate or a k33 bar.

k31 (eqs 30-40): elastically isotropic with s11 and a known real s12, d33 = d15 = ε11T = 0.
k33 (eqs 66-74): elastically isotropic with s33 and a known real s13, d31 = d15 = ε11T = 0.

Both use the same two elastic relations with (s, s×) = (s11, s12) or (s33, s13):

    α = −s×/(s + s×)                                         (33, 67)
    c = (s + s×)/((s − s×)(s + 2 s×)),   c× = α c            (30, 66; 32)
    s = [1 − c s× + sqrt((3 c s×)² + 2 c s× + 1)]/(2c)       (34)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.material.constants import PiezoConstants

Poling = Literal["thickness", "length"]


def stiffness_from_compliance(s: complex, s_cross: complex) -> complex:
    """c = (s + s×)/((s − s×)(s + 2 s×)), Pa (eq 30, 66)."""
    return (s + s_cross) / ((s - s_cross) * (s + 2 * s_cross))


def stiffness_ratio(s: complex, s_cross: complex) -> complex:
    """α = c×/c = −s×/(s + s×), dimensionless (eq 33, 67)."""
    return -s_cross / (s + s_cross)


def compliance_from_stiffness(c: complex, s_cross: complex) -> complex:
    """s of given c and s×, 1/Pa (eq 34), the inverse of `stiffness_from_compliance`."""
    product = c * s_cross
    return (1 - product + np.sqrt((3 * product) ** 2 + 2 * product + 1)) / (2 * c)


def _isotropic(s: complex, s_cross: complex, *, d31: complex, d33: complex, eps33T: complex) -> PiezoConstants:
    return PiezoConstants(
        s11=s,
        s12=s_cross,
        s13=s_cross,
        s33=s,
        s44=2 * (s - s_cross),
        d31=d31,
        d33=d33,
        d15=0j,
        eps11T=0j,
        eps33T=eps33T,
    )


@dataclass(frozen=True)
class SimplifiedK31:
    """The k31 plate of the paper: s11, d31, ε33T complex, s12 known and real (eqs 30-40)."""

    s11: complex
    d31: complex
    eps33T: complex
    s12: float

    free = ("s11", "d31", "eps33T")
    poling: Poling = "thickness"

    @classmethod
    def of(cls, constants: PiezoConstants) -> SimplifiedK31:
        """The simplification that keeps s11, d31, ε33T and Re s12 of a full set."""
        return cls(constants.s11, constants.d31, constants.eps33T, constants.s12.real)

    def full(self) -> PiezoConstants:
        """The ten constants: s13 = s12, s33 = s11, s44 = s66, d33 = d15 = ε11T = 0."""
        return _isotropic(self.s11, self.s12, d31=self.d31, d33=0j, eps33T=self.eps33T)

    @property
    def c11(self) -> complex:
        """Pa (eq 30)."""
        return stiffness_from_compliance(self.s11, self.s12)

    @property
    def alpha(self) -> complex:
        """α (eq 33)."""
        return stiffness_ratio(self.s11, self.s12)

    @property
    def e31(self) -> complex:
        """e31 = d31 c11 (1 + α), C/m² (eq 36); e33 = 2 d31 c11 α = β e31 with β = 2α/(1 + α) (37-39)."""
        return self.d31 * self.c11 * (1 + self.alpha)

    @property
    def eps33S(self) -> complex:
        """ε33S = ε33T − 2 d31² c11 (1 + α), F/m (eq 35)."""
        return self.eps33T - 2 * self.d31**2 * self.c11 * (1 + self.alpha)

    @property
    def gamma(self) -> complex:
        """γ = e31²/ε33S, Pa (eq 52)."""
        return self.e31**2 / self.eps33S

    @classmethod
    def from_stiffness(cls, c11: complex, gamma: complex, eps33T: complex, s12: float) -> SimplifiedK31:
        """Back from (c11, γ): s11 (34), α (33), ε33S (63), e31 = −sqrt(γ ε33S) (62), d31 (40)."""
        s11 = compliance_from_stiffness(c11, s12)
        alpha = stiffness_ratio(s11, s12)
        eps33S = eps33T * c11 * (1 + alpha) / (c11 * (1 + alpha) + 2 * gamma)
        e31 = -np.sqrt(gamma * eps33S)
        return cls(complex(s11), complex(e31 / (c11 * (1 + alpha))), complex(eps33T), s12)


@dataclass(frozen=True)
class SimplifiedK33:
    """The k33 bar of the paper: s33, d33, ε33T complex, s13 known and real (eqs 66-74)."""

    s33: complex
    d33: complex
    eps33T: complex
    s13: float

    free = ("s33", "d33", "eps33T")
    poling: Poling = "length"

    @classmethod
    def of(cls, constants: PiezoConstants) -> SimplifiedK33:
        """The simplification that keeps s33, d33, ε33T and Re s13 of a full set."""
        return cls(constants.s33, constants.d33, constants.eps33T, constants.s13.real)

    def full(self) -> PiezoConstants:
        """The ten constants: s11 = s33, s12 = s13, s44 = s66, d31 = d15 = ε11T = 0."""
        return _isotropic(self.s33, self.s13, d31=0j, d33=self.d33, eps33T=self.eps33T)

    @property
    def c33(self) -> complex:
        """Pa (eq 66)."""
        return stiffness_from_compliance(self.s33, self.s13)

    @property
    def alpha(self) -> complex:
        """α = −s13/(s33 + s13) (eq 67)."""
        return stiffness_ratio(self.s33, self.s13)

    @property
    def e33(self) -> complex:
        """e33 = d33 c33, C/m² (eq 71); e31 = α e33 (72)."""
        return self.d33 * self.c33

    @property
    def eps33S(self) -> complex:
        """ε33S = ε33T − d33² c33, F/m."""
        return self.eps33T - self.d33**2 * self.c33

    @property
    def kappa(self) -> complex:
        """κ = e33²/ε33S, Pa (eq 74)."""
        return self.e33**2 / self.eps33S

    @classmethod
    def from_stiffness(cls, c33: complex, kappa: complex, eps33T: complex, s13: float) -> SimplifiedK33:
        """Back from (c33, κ): s33 (34), ε33S = ε33T c33/(c33 + κ), e33 = +sqrt(κ ε33S), d33 = e33/c33 (73)."""
        s33 = compliance_from_stiffness(c33, s13)
        eps33S = eps33T * c33 / (c33 + kappa)
        e33 = np.sqrt(kappa * eps33S)
        return cls(complex(s33), complex(e33 / c33), complex(eps33T), s13)


Simplified = SimplifiedK31 | SimplifiedK33


def simplify(constants: PiezoConstants, poling: Poling) -> Simplified:
    """The simplified material for a poling: `SimplifiedK31` for thickness, `SimplifiedK33` for length."""
    return SimplifiedK31.of(constants) if poling == "thickness" else SimplifiedK33.of(constants)
