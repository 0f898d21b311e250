"""`Circuit`: the branches of the modes, and elements for the rest of Y: C0, its loss, modes outside the sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.optimize import nnls

from femu_piezo.circuits.branch import UNITS, Branch
from femu_piezo.files import as_json
from femu_piezo.measurement.spectrum import evenly
from femu_piezo.units import hertz

#: Most points at which the rest of Y is fitted, and share of |Y| below which an element of it is dropped.
_POINTS, _SMALL = 400, 1e-9
#: Share of the direct current of the branches that stays, so that rounding makes no circuit a source.
_STAYS = 1e-6
#: Relative misfit beyond which a note says why, and rms beyond which elements that are not passive follow the rest:
#: constant loss tangents alone cause (2/π) tan δ per e-fold, 2 % for a soft ceramic over a decade.
_MISSED, _PASSIVE = 1e-3, 0.02
#: Corner frequencies of relaxations per decade, and the factor by which they reach beyond the band.
_PER_DECADE, _REACH = 3, 10.0
#: Resonances of modes outside the sweep, over its highest frequency; the lowest frequency over those below it. Modes
#: farther off are part of C0: as branches they would take its place, and cancel relaxations of 10 times its size.
_OUTSIDE = (1.02, 1.05, 1.1, 1.2, 1.35, 1.6, 2.0)
#: Share to which modes below the sweep must bring a misfit above `_MISSED`: most sweeps begin below all modes.
_BELOW = 1 / 3
#: Numbers of broad resonances of either sign that are tried, and how far they reach beyond the band, as a share of its
#: width in log f.
_BROAD, _BEYOND = (8, 12, 16, 24, 32), 0.25


@dataclass(frozen=True)
class Static:
    """One element or pair that holds no mode of the sweep.

    Attributes
    ----------
    kind : "C", "R", "RC" in series, "mode", L, R and C in series for a mode outside the sweep, or "RLC" in series, a
        broad resonance of either sign that follows the rest of the curve and is no mode
    values : SI: C, R or L
    """

    kind: Literal["C", "R", "RC", "mode", "RLC"]
    values: dict[str, float]

    def admittance(self, omega: np.ndarray) -> np.ndarray:
        """Y (n,) in siemens at ω (n,) in rad/s."""
        s = 1j * omega
        if self.kind == "R":
            return np.full(omega.shape, 1 / self.values["R"], dtype=complex)
        capacitance = 1 / (s * self.values["C"])
        return 1 / (capacitance + self.values.get("R", 0.0) + s * self.values.get("L", 0.0))


#: A resistor of 1 ohm.
_OHM = Static("R", {"R": 1.0})


@dataclass(frozen=True)
class Circuit:
    """An equivalent circuit: all parts in parallel between the two terminals.

    Attributes
    ----------
    name : of the sweep or specimen
    branches : one for each mode, in order of frequency;  static : C0, its loss, modes outside the sweep
    frequency : (n,) Hz, of the curve that the circuit stands for;  curve : (n,) its impedance, ohm
    sweep : (n,) measured impedance that the curve was fitted to; None of a computed one
    notes : sentences
    """

    name: str
    branches: tuple[Branch, ...]
    static: tuple[Static, ...]
    frequency: np.ndarray = field(repr=False)
    curve: np.ndarray = field(repr=False)
    sweep: np.ndarray | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()

    def admittance(self, omega: np.ndarray) -> np.ndarray:
        """Y (n,) in siemens of all elements at ω (n,) in rad/s."""
        return sum((part.admittance(omega) for part in (*self.branches, *self.static)), np.zeros(omega.shape, complex))

    @property
    def impedance(self) -> np.ndarray:
        """(n,) Z of the circuit at `frequency`, ohm."""
        return 1 / self.admittance(2 * np.pi * self.frequency)

    @property
    def misfit(self) -> tuple[float, float]:
        """(rms, largest) of |Z_circuit/Z − 1| against the curve that it stands for."""
        return _relative_misfit(self.impedance, self.curve)

    @property
    def misfit_of_sweep(self) -> tuple[float, float] | None:
        """(rms, largest) of |Z_circuit/Z − 1| against the measured sweep, noise included; None for a computed curve."""
        return None if self.sweep is None else _relative_misfit(self.impedance, self.sweep)

    @property
    def static_capacitance(self) -> float:
        """C0, F: the capacitor without other elements in series; 0 where there is none."""
        return sum(part.values["C"] for part in self.static if part.kind == "C")

    def to_json(self) -> dict:
        """JSON types only, SI; None for what is infinite."""
        found = {
            "name": self.name,
            "branches": [
                {
                    "frequency_Hz": branch.frequency_Hz,
                    "quality_factor": branch.quality_factor,
                    "residue_phase": branch.residue_phase,
                    "doubtful": branch.doubtful,
                    "elements": {
                        key: {
                            "value": value,
                            "std": branch.std.get(key),
                            "unit": UNITS[key],
                        }
                        for key, value in branch.elements.items()
                    },
                }
                for branch in self.branches
            ],
            "static": [{"kind": part.kind, **part.values} for part in self.static],
            "band_Hz": [float(self.frequency[0]), float(self.frequency[-1])],
            "misfit": dict(zip(("rms", "largest"), self.misfit, strict=True)),
            "misfit_of_sweep": self.misfit_of_sweep
            and dict(zip(("rms", "largest"), self.misfit_of_sweep, strict=True)),
            "notes": list(self.notes),
        }
        return as_json(found)


def _relative_misfit(found: np.ndarray, curve: np.ndarray) -> tuple[float, float]:
    """(rms, largest) of |found/curve − 1|."""
    wrong = np.abs(found / curve - 1)
    return float(np.sqrt(np.mean(wrong**2))), float(np.max(wrong))


def fit_circuit(
    name: str,
    branches: Sequence[Branch],
    frequency: np.ndarray,
    curve: np.ndarray,
    sweep: np.ndarray | None = None,
) -> Circuit:
    """The circuit of given branches and of further elements that follow the rest of a curve.

    The branches keep their residues. The rest is smooth and is followed by a capacitor, relaxations (R and C in series)
    and modes outside the sweep, with the median quality factor of the branches, all of them nonnegative, and by a
    resistor, which is negative where it takes back the direct current through the Rp of the branches, but no more than
    that: a circuit that gives direct current is a source, and its voltage grows with open terminals; by least squares
    relative to |Y| (nonnegative: Lawson and Hanson 1974). Modes below the sweep are there only where the misfit asks
    for them (`_BELOW`). A circuit of R, L and C is causal, so that its C falls by (2/π) tan δ per e-fold of frequency
    (Kramers and Kronig), which a model of constant complex moduli does not do: over a wide band they differ by that.
    Where the rms misfit is larger (`_PASSIVE`), as for a sweep that no passive body has, a capacitor, a
    resistor and broad resonances of either sign (`Static`) replace these elements: as many as bring the misfit below
    a quarter of that between curve and sweep, to which it then adds a thirtieth, or below `_MISSED`.

    Parameters
    ----------
    frequency : (n,) Hz;  curve : (n,) impedance that the circuit stands for, ohm, without noise
    sweep : (n,) measured, ohm
    """
    ordered = tuple(sorted(branches, key=lambda one: one.frequency_Hz))
    omega = 2 * np.pi * frequency
    loss = _loss(ordered)
    units = _relaxations(omega) + _modes([omega[-1] * factor for factor in _OUTSIDE], loss)
    circuit = Circuit(name, ordered, _rest(ordered, units, omega, curve), frequency, curve, sweep)
    if circuit.misfit[0] > _MISSED:
        units += _modes([omega[0] / factor for factor in _OUTSIDE], loss)
        with_modes_below = replace(circuit, static=_rest(ordered, units, omega, curve))
        if circuit.misfit[0] > _PASSIVE or with_modes_below.misfit[0] < _BELOW * circuit.misfit[0]:
            circuit = with_modes_below
    if circuit.misfit[0] > _PASSIVE:
        enough = max(_MISSED, 0.0 if sweep is None else _relative_misfit(curve, sweep)[0] / 4)
        for count in _BROAD:
            static = _rest(ordered, _broad(omega, count), omega, curve, signed=True)
            circuit = min(circuit, replace(circuit, static=static), key=lambda one: one.misfit[0])
            if circuit.misfit[0] < enough:
                break
    return replace(circuit, notes=tuple(_notes(circuit)))


def _rest(
    branches: Sequence[Branch], units: list[Static], omega: np.ndarray, curve: np.ndarray, *, signed: bool = False
) -> tuple[Static, ...]:
    """Multiples of unit elements that, together with the branches, come nearest to the curve.

    Points count by the share of the band that they stand for, on a linear and on a logarithmic scale alike.
    """
    at = evenly(omega.size, _POINTS)
    omega, y = omega[at], 1 / curve[at]
    weight = _weights(omega) / np.abs(y)
    remainder = (y - sum((one.section(omega) for one in branches), np.zeros(omega.shape, complex))) * weight
    matrix = np.array([unit.admittance(omega) * weight for unit in units]).T
    size = np.linalg.norm(matrix, axis=0)
    rows, right = np.vstack([matrix.real, matrix.imag]) / size, np.concatenate([remainder.real, remainder.imag])
    resistor, others = units.index(_OHM), np.flatnonzero([unit.kind != "R" for unit in units])

    def fitted(which: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Amounts of some of the units, 0 of the others."""
        found = np.zeros(len(units))
        if signed:
            found[which] = np.linalg.lstsq(rows[:, which], right, rcond=None)[0]
        else:
            found[which] = nnls(rows[:, which], right, maxiter=100 * len(units))[0]
        return found / size

    amounts = fitted(np.arange(len(units)), right)
    direct = sum(1 / (one.elements["R"] + one.elements["Rp"]) for one in branches)
    least = _STAYS * abs(direct) - direct
    if sum(amount / unit.values["R"] for amount, unit in zip(amounts, units, strict=True) if unit.kind == "R") < least:
        amounts = fitted(others, right - least * size[resistor] * rows[:, resistor])  # the misfit is convex
        amounts[resistor] = least
    shares = np.max(np.abs(matrix / weight[:, None] / y[:, None]), axis=0) * np.abs(amounts)
    return tuple(_scaled(unit, n) for unit, n, share in zip(units, amounts, shares, strict=True) if share > _SMALL)


def _broad(omega: np.ndarray, count: int) -> list[Static]:
    """A capacitor of 1 F, a resistor of 1 ohm, and resonances of 1 H whose half-width is the distance to the next."""
    reach = (omega[-1] / omega[0]) ** _BEYOND
    places = np.geomspace(omega[0] / reach, omega[-1] * reach, count)
    widths = places * float(places[1] / places[0] - 1)
    return [
        Static("C", {"C": 1.0}),
        _OHM,
        *(
            Static("RLC", {"L": 1.0, "R": float(2 * width), "C": float(1 / (place**2 + width**2))})
            for place, width in zip(places, widths, strict=True)
        ),
    ]


def _weights(omega: np.ndarray) -> np.ndarray:
    """(n,) square roots of the shares of the band that points stand for, linear and logarithmic."""
    shares = [np.gradient(scale) / (scale[-1] - scale[0]) for scale in (omega, np.log(omega))]
    return np.sqrt(shares[0] + shares[1])


def _loss(branches: Sequence[Branch]) -> float:
    """Median of the reciprocal quality factors of the branches, without doubtful ones; 0 where there are none."""
    losses = [1 / one.quality_factor for one in branches if not one.doubtful]
    return max(0.0, float(np.median(losses))) if losses else 0.0


def _relaxations(omega: np.ndarray) -> list[Static]:
    """A capacitor of 1 F, resistors of 1 and −1 ohm, and relaxations of 1 F over the band and beyond."""
    low, high = float(omega[0]), float(omega[-1])
    count = int(np.ceil(_PER_DECADE * np.log10(high * _REACH**2 / low))) + 1
    corners = np.geomspace(low / _REACH, high * _REACH, count)
    return [
        Static("C", {"C": 1.0}),
        _OHM,
        _scaled(_OHM, -1.0),
        *(Static("RC", {"R": float(1 / corner), "C": 1.0}) for corner in corners),
    ]


def _modes(places: Sequence[float], loss: float) -> list[Static]:
    """Modes of 1 F at angular frequencies; loss : reciprocal of their quality factor."""
    return [Static("mode", {"L": float(1 / at**2), "R": float(loss / at), "C": 1.0}) for at in places]


def _scaled(unit: Static, amount: float) -> Static:
    """An element with its admittance times `amount`."""
    return Static(unit.kind, {key: float(v * amount if key == "C" else v / amount) for key, v in unit.values.items()})


def _notes(circuit: Circuit) -> list[str]:
    found = []
    negative = [one for one in circuit.branches if min(one.elements["R"], one.elements["Rp"]) < 0]
    if negative:
        places = ", ".join(f"{hertz(one.frequency_Hz)} Hz" for one in negative)
        found.append(
            f"the residue at {places} has a phase that makes a resistance of its branch negative: the circuit is right "
            "with it, in SPICE too, but cannot be built from passive components"
        )
    if doubtful := [f"{hertz(one.frequency_Hz)} Hz" for one in circuit.branches if one.doubtful]:
        found.append(
            f"the sweep hardly determines the branch at {', '.join(doubtful)}: the curve needs it, but it may not be a "
            "mode of the body"
        )
    broad = sum(part.kind == "RLC" for part in circuit.static)
    if broad:
        found.append(
            f"the rest of this curve, without the branches, is not that of passive elements: it is fitted by {broad} "
            "broad resonances, a C and an R of either sign, which are valid only together and only in this band"
        )
    elif any(one.values["R"] < 0 for one in circuit.static if one.kind == "R"):
        found.append("the negative resistor cancels the direct current through the Rp of the branches")
    rms, largest = circuit.misfit
    found.append(f"the circuit follows its curve within {100 * rms:.2g} % rms and {100 * largest:.2g} % at most")
    if circuit.misfit_of_sweep is not None:
        rms, most = circuit.misfit_of_sweep
        found[-1] += (
            f", and the measured sweep, with its noise, within {100 * rms:.2g} % rms and {100 * most:.2g} % at most"
        )
    if largest > _MISSED and not broad:
        found.append(
            "a circuit of R, L and C is causal; it cannot follow loss tangents that are constant over a wide band "
            "(Kramers and Kronig), nor the errors of a sweep"
        )
    return found
