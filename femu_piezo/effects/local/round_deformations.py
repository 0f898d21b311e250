"""What a small deformation adds to the forms of a disk or ring: a thickness that varies across it, or an oval outline.

A deformation of size ε that turns gradients and volumes into

    ∇ → (1 − ε T₁ + ε² T₂) ∇,    dV → (1 + ε v) dV,    T₁ = Tc cos mθ + Ts sin mθ,  v ∝ cos mθ

couples order 0 to order m in first order, and order 0 to itself in second order:

    F₁(l, r) = v lᵗHr − (T₁l)ᵗHr − lᵗH(T₁r)
    F₂(l, r) = (T₁l)ᵗH(T₁r) + (T₂l)ᵗHr + lᵗH(T₂r) − v [(T₁l)ᵗHr + lᵗH(T₁r)]    (mean over θ)

of gradients l, r and the tensor H of the crystal. Fields of order 0 are even about every half plane through the axis,
and H couples no even field to an odd one: so Tc meets cosines only and Ts sines only, and Tc + Ts stands for both.

    wedge: thickness t (1 + ε x/R), the map z → z (1 + ε x/R), with q = z/R:
    m = 1,  T₁ = (x/R) ẑẑᵗ + q x̂ẑᵗ,  T₂ = (x/R) T₁,  v = x/R

    oval: diameters D e^ε and D e^−ε, the map x → e^ε x, y → e^−ε y:
    m = 2,  T₁ = x̂x̂ᵗ − ŷŷᵗ,  T₂ = (x̂x̂ᵗ + ŷŷᵗ)/2,  v = 0

x̂ = r̂ cos θ − θ̂ sin θ in the frame of the axis. Couplings within order m and between m and further orders are left
out: they shift modes that the terminals drive only through ε, by a share of ε².
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.forward.revolution import FourierOrder

#: Sector of the local response to a deformation → the order m that it couples.
WEDGE, OVAL = "wedge", "oval"
COUPLED = {WEDGE: 1, OVAL: 2}
#: (r/R, z/R), each (q,) → Tc + Ts and the mean of T₂ over θ, each (3, 3, q) along r, θ, z, and v/cos mθ (q,).
_Map = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def _wedge(rho: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    first, second = np.zeros((2, 3, 3, rho.size))
    first[:, 2] = q, -q, rho
    second[0, 2], second[2, 2] = rho * q / 2, rho**2 / 2
    return first, second, rho


def _oval(rho: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    first, second = np.zeros((2, 3, 3, rho.size))
    first[0, 0], first[1, 1], first[0, 1], first[1, 0] = 1.0, -1.0, -1.0, -1.0
    second[0, 0] = second[1, 1] = 0.5
    return first, second, np.zeros_like(rho)


_MAPS: dict[str, _Map] = {WEDGE: _wedge, OVAL: _oval}


@dataclass(frozen=True)
class RoundDeformation:
    """One deformation at the Gauss points of a section.

    Attributes
    ----------
    order_0, order_m : the orders 0 and m
    first, second : (3, 3, q) Tc + Ts, and the mean of T₂ over θ, along r, θ, z
    volume : (q,) factor of cos mθ in v
    """

    order_0: FourierOrder
    order_m: FourierOrder
    first: np.ndarray
    second: np.ndarray
    volume: np.ndarray

    @classmethod
    def of(cls, kind: str, orders: Callable[[int], FourierOrder]) -> RoundDeformation:
        """The deformation of a kind in `COUPLED`; orders : number → the Fourier order of a body."""
        order_0, order_m = orders(0), orders(COUPLED[kind])
        outer = order_0.section.radial.ends[-1]
        return cls(order_0, order_m, *_MAPS[kind](order_0.radii / outer, order_0.heights / outer))

    def first_order_forms(self, driven: np.ndarray, others: np.ndarray, tensors: Sequence[np.ndarray]) -> np.ndarray:
        """F₁ (n_tensors, k, l) of extended tensors between fields (4n, k) of order 0 and (4n, l) of order m."""
        left, right = self.order_0.at_points(driven), self.order_m.at_points(others)
        whole = self.volume[:, None] * left - _turned(self.first, left)
        join = self.order_m.joined
        return join(whole, right, tensors) - join(left, _turned(self.first, right), tensors)

    def second_order_forms(self, driven: np.ndarray, tensors: Sequence[np.ndarray]) -> np.ndarray:
        """F₂ (n_tensors, k, k) on fields (4n, k) of order 0."""
        plain = self.order_0.at_points(driven)
        once, twice = _turned(self.first, plain), _turned(self.second, plain)
        half = twice - self.volume[:, None] / 2 * once  # the mean of cos² mθ
        join = self.order_0.joined
        across = join(half, plain, tensors)
        return across + across.transpose(0, 2, 1) + join(once, once, tensors) / 2

    def inertia(self, driven: np.ndarray, others: np.ndarray) -> np.ndarray:
        """(k, l) mass of first order in ε between fields (4n, k) of order 0 and (4n, l) of order m, kg."""
        return self.order_m.momentum(driven, self.volume).T @ others

    def loads(self, states: np.ndarray, tensor: np.ndarray) -> np.ndarray:
        """(4n, 2k) loads of first order on order m by states (4n, k) of order 0: of the tensor, then of inertia."""
        left = self.order_0.at_points(states)

        def flow(gradients: np.ndarray) -> np.ndarray:
            return np.einsum("fagb,faqk->gbqk", tensor, gradients)

        whole = flow(self.volume[:, None] * left - _turned(self.first, left))
        back = _turned(self.first.transpose(1, 0, 2), flow(left))
        return np.hstack([self.order_m.load(whole - back), self.order_m.momentum(states, self.volume)])


def _turned(matrix: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """(4, 3, q, k) matrix (3, 3, q) times gradients."""
    return np.einsum("abq,fbqk->faqk", matrix, gradients)
