"""The hidden effects: each by the meaning of its name, with its variants.

An entry takes (build, random generator, variant) and changes the build; the specimen file keeps the assumed values.
Real effects never follow a formula exactly: with `variant` the entry draws another law, shape or place. It returns the
key of the effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from hidden_effects.body import Surface
from hidden_effects.build import Build

NAMES = ("s11", "s12", "s13", "s33", "s44", "d31", "d33", "d15", "eps11T", "eps33T")
#: Poling axis → held constants for which a wrong value is drawn: those that a sweep of a k31 plate or k33 bar can show.
WRONG = {2: ("s12", "s13", "s33", "d33"), 0: ("s11", "s13", "s44", "d31")}


@dataclass(frozen=True)
class Hidden:
    """The key of one effect: what is true and hidden from the code under test.

    Attributes
    ----------
    effect, detail : name as in results; the constant that is meant
    sizes : parameter → true value, SI
    variant : in words, empty where the effect follows the library's law
    sized : whether its sizes can be judged: the law is the library's, or the meaning is plain all the same
    along : effects that come with it, so that their names are true as well
    """

    effect: str
    sizes: Mapping[str, float] = field(default_factory=dict)
    detail: str = ""
    variant: str = ""
    sized: bool = True
    along: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Name, with the constant where there is one, as the diagnosis gives it."""
        return f"{self.effect}:{self.detail}" if self.detail else self.effect


Entry = Callable[[Build, np.random.Generator, bool], Hidden]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A positive number, uniform in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def series_resistance(build, rng, variant) -> Hidden:
    """A resistance in series. Variant: a fifth of it is skin effect."""
    value, anchor = log_uniform(rng, 1.0, 8.0), 2 * np.pi * build.fundamental
    share = 0.2 if variant else 0.0
    build.circuits.append(lambda w, z: z + value * (1 - share + share * np.sqrt(w / anchor)))
    return Hidden("series_resistance", {"resistance": value}, variant="skin effect" * variant, sized=not variant)


def series_inductance(build, rng, variant) -> Hidden:
    """An inductance in series. Variant: damped by a resistor in parallel."""
    value = log_uniform(rng, 2e-6, 12e-6)
    damping = 8 * 2 * np.pi * 240e3 * value if variant else np.inf
    build.circuits.append(lambda w, z: z + 1 / (1 / (1j * w * value) + 1 / damping))
    return Hidden("series_inductance", {"inductance": value}, variant="damped" * variant)


def stray_capacitance(build, rng, variant) -> Hidden:
    """A capacitance in parallel. Variant: the insulation of the leads has a relaxation."""
    value, tau = log_uniform(rng, 5e-12, 40e-12), 1 / (2 * np.pi * 150e3)
    share = 0.06 if variant else 0.0
    build.circuits.append(lambda w, z: 1 / (1 / z + 1j * w * value * (1 + share / (1 + 1j * w * tau))))
    return Hidden("stray_capacitance", {"capacitance": value}, variant="relaxing" * variant, sized=not variant)


def leakage(build, rng, variant) -> Hidden:
    """A conductance in parallel. Variant: it grows with a weak power of frequency."""
    value, anchor = log_uniform(rng, 3e-6, 3e-5) * build.admittance, 2 * np.pi * build.fundamental
    power = 0.25 if variant else 0.0
    build.circuits.append(lambda w, z: 1 / (1 / z + value * (w / anchor) ** power))
    return Hidden("leakage", {"conductance": value}, variant="power of frequency" * variant, sized=not variant)


def frequency_dependent_elastic_loss(build, rng, variant) -> Hidden:
    """Elastic losses with a power of frequency. Variants: linear in frequency; a Debye peak."""
    size = log_uniform(rng, 0.3, 0.9) * float(rng.choice([-1, 1]))
    words = str(rng.choice(["linear", "Debye peak"])) if variant else ""
    peak = float(rng.uniform(60e3, 200e3)) / build.fundamental

    def grown(share: float) -> float:
        if words == "linear":
            return 1 + size * (share - 1)
        if words == "Debye peak":
            return 1 + size * (2 * peak * share / (peak**2 + share**2) - 2 * peak / (peak**2 + 1))
        return share**size

    def law(theta, frequency):
        found = theta.copy()
        found[:5] = theta[:5].real + 1j * theta[:5].imag * grown(frequency / build.fundamental)
        return found

    build.laws.append(law)
    return Hidden("frequency_dependent_elastic_loss", {"exponent": size}, variant=words, sized=not variant)


def dielectric_dispersion(build, rng, variant) -> Hidden:
    """ε33T falls with the logarithm of frequency. Variant: the fall steepens with frequency."""
    size, bend = log_uniform(rng, 0.01, 0.05), 0.4 if variant else 0.0

    def law(theta, frequency):
        found, decades = theta.copy(), np.log10(frequency / build.fundamental)
        found[9] *= 1 - size * decades * (1 + bend * decades)
        return found

    build.laws.append(law)
    return Hidden("dielectric_dispersion", {"fall_per_decade": size}, variant="steeper" * variant, sized=not variant)


def relaxation(build, rng, variant) -> Hidden:
    """A relaxation of ε33T by Cole and Cole. Variant: skewed as by Havriliak and Negami."""
    size, width = log_uniform(rng, 0.02, 0.15), float(rng.uniform(0.15, 0.45))
    centre, skew = float(rng.uniform(60e3, 150e3)), 0.7 if variant else 1.0

    def share(frequency):
        return (1 + (1j * frequency / centre) ** (1 - width)) ** -skew

    def law(theta, frequency):
        found = theta.copy()
        found[9] *= 1 + size * (share(frequency) - share(build.fundamental).real)
        return found

    build.relaxations.append(law)
    sizes = {"strength": size, "relaxation_frequency": centre}
    return Hidden("relaxation", sizes, variant="skewed" * variant, sized=not variant)


def contact_gap(build, rng, variant) -> Hidden:
    """A capacitance in series. Variant: the gap leaks."""
    value, anchor = log_uniform(rng, 1e-8, 2e-7), 2 * np.pi * build.fundamental
    loss = 0.05 * anchor * value if variant else 0.0
    build.circuits.append(lambda w, z: z + 1 / (1j * w * value + loss))
    sizes = {"inverse_capacitance": 1 / value} | ({"corner_frequency": 0.05 * build.fundamental} if variant else {})
    return Hidden("contact_gap", sizes, variant="leaking" * variant)


def cable(build, rng, variant) -> Hidden:
    """A line of ten pieces of inductance and capacitance. Variant: with the resistance of its core."""
    length, wave_impedance = log_uniform(rng, 0.3, 3.0), float(rng.choice([50.0, 75.0]))
    delay, pieces = length / (0.66 * 299792458.0), 10
    core = 0.2 * length if variant else 0.0

    def circuit(w, z):
        for _ in range(pieces):
            half = (core + 1j * w * wave_impedance * delay) / pieces / 2
            z = half + 1 / (1 / (z + half) + 1j * w * delay / wave_impedance / pieces)
        return z

    build.circuits.append(circuit)
    return Hidden("cable", {"length": length}, variant="lossy" * variant)


def temperature_drift(build, rng, variant) -> Hidden:
    """Compliances drift linearly with frequency from 20 to 240 kHz. Variant: the drift saturates."""
    size, early = log_uniform(rng, 5e-4, 5e-3) * float(rng.choice([-1, 1])), float(rng.uniform(60e3, 120e3))

    def time(frequency):
        if variant:
            return (1 - np.exp(-(frequency - 20e3) / early)) / (1 - np.exp(-220e3 / early))
        return (frequency - 20e3) / 220e3

    def law(theta, frequency):
        found = theta.copy()
        found[:5] /= (1 + size * (time(frequency) - time(build.fundamental))) ** 2
        return found

    build.laws.append(law)
    return Hidden("temperature_drift", {"drift": size}, variant="saturating" * variant, sized=not variant)


def film_stiffness(build, rng, variant) -> Hidden:
    """Stiff layers with mass on both faces. Variant: a layer of glue on one face."""
    thickness, modulus = log_uniform(rng, 10e-6, 60e-6), log_uniform(rng, 5e9, 5e10)
    loss, heavy, faces = float(rng.uniform(0.01, 0.08)), 1200.0 * thickness, (-1,) if variant else (1, -1)
    stiff = modulus * thickness / (1 - 0.35**2)
    build.surfaces.append(
        Surface(*build.whole_face, faces, lambda w: stiff * (1 + 1j * loss) * np.ones_like(w), membrane=0.35)
    )
    build.surfaces.append(Surface(*build.whole_face, faces, lambda w: -(w**2) * heavy))
    along = ("electrode_mass", *(["unequal_electrode_mass"] * variant))
    sizes = {"membrane_stiffness": stiff}
    return Hidden("film_stiffness", sizes, variant="one face" * variant, sized=not variant, along=along)


def fluid_load(build, rng, variant) -> Hidden:
    """Oil on both faces. Variant: on one face."""
    shear, pressure = log_uniform(rng, 5.0, 30.0), log_uniform(rng, 1e4, 2e5)
    faces, face = (1,) if variant else (1, -1), build.whole_face
    build.surfaces.append(Surface(*face, faces, lambda w: 1j * w * (1 + 1j) * np.sqrt(w / 2) * shear, (0, 1)))
    build.surfaces.append(Surface(*face, faces, lambda w: 1j * w * pressure, (2,)))
    return Hidden("fluid_load", {"shear_load": shear}, variant="one face" * variant, sized=not variant)


def wrong_insensitive_parameter(build, rng, variant) -> Hidden:
    """A held constant is 1 + p times the assumed one. Variant: a second one is wrong by a fifth of that."""
    size = log_uniform(rng, 0.03, 0.12) * float(rng.choice([-1, 1]))
    first, second = (str(name) for name in rng.choice(WRONG[build.poling], 2, replace=False))
    build.theta[NAMES.index(first)] *= 1 + size
    if variant:
        build.theta[NAMES.index(second)] *= 1 + size / 5
    return Hidden(
        "wrong_insensitive_parameter",
        {"relative_error": size},
        first,
        f"{second} as well" if variant else "",
        not variant,
    )


def _wrong(name: str, axis: int, low: float, high: float) -> Entry:
    def entry(build, rng, variant) -> Hidden:
        """A wrong dimension. It has no variant: sides that are not parallel are another effect, and a dimension
        follows no law.
        """
        size = log_uniform(rng, low, high) * float(rng.choice([-1, 1]))
        build.size[axis] *= 1 + size
        return Hidden(f"wrong_{name}", {"relative_error": size})

    return entry


def tapered_width(build, rng, variant) -> Hidden:
    """The width grows along the length."""
    size = log_uniform(rng, 0.005, 0.04)
    build.taper += size
    return Hidden("tapered_width", {"taper": size})


def wedge(build, rng, variant) -> Hidden:
    """The thickness grows along the length."""
    size = log_uniform(rng, 0.015, 0.08)
    build.wedge += size
    return Hidden("wedge", {"wedge": size})


def electrode_mass(build, rng, variant) -> Hidden:
    """Films of mass on both faces. Variant: unequal films, of which the size is the mean."""
    size, share = log_uniform(rng, 0.02, 0.2), 0.3 if variant else 0.0
    for side in (1, -1):
        mass = size * (1 + side * share)
        build.surfaces.append(Surface(*build.whole_face, (side,), lambda w, mass=mass: -(w**2) * mass))
    if not variant:
        build.surfaces[-2:] = [Surface(*build.whole_face, (1, -1), lambda w: -(w**2) * size)]
    return Hidden("electrode_mass", {"mass_per_area": size}, variant="unequal films" * variant)


def point_mass(build, rng, variant) -> Hidden:
    """A mass on a square patch of the upper face. Variants: a large patch; a patch elongated along the width or the
    length.
    """
    mass = log_uniform(rng, 0.0003, 0.005) * float(np.prod(build.size)) * build.density
    words = str(rng.choice(["large patch", "long patch"])) if variant else ""
    sides = {"large patch": (2.4e-3, 2.0e-3), "long patch": (2.6e-3, 0.8e-3)}.get(words, (1.3e-3, 1.3e-3))
    sides = sides if rng.integers(2) else sides[::-1]
    x, y = (
        float(rng.uniform(0.1, 0.98) * (length / 2 - side / 2))
        for length, side in zip(build.size[:2], sides, strict=True)
    )
    area = sides[0] * sides[1]
    ends = [(centre - side / 2, centre + side / 2) for centre, side in zip((x, y), sides, strict=True)]
    build.surfaces.append(Surface(ends[0], ends[1], (1,), lambda w: -(w**2) * mass / area))
    return Hidden("point_mass", {"mass": mass, "x": x, "y": y}, variant=words, sized=not variant)


def local_crack(build, rng, variant) -> Hidden:
    """A slice of softer material. Variant: the stiffness falls and rises linearly across the slice."""
    added, width = log_uniform(rng, 2e-6, 6e-5), log_uniform(rng, 0.1e-3, 0.4e-3)
    position = float(rng.uniform(0.03, 0.85) * build.size[0] / 2)
    if variant:
        width *= 2
        depth = _depth(added / width)
    else:
        depth = added / (width + added)

    def profile(x):
        inside = np.abs(x - position) / (width / 2)
        return 1 - depth * ((1 - inside) if variant else 1.0) * (inside < 1)

    build.stiffness.append(profile)
    build.elements += [position - width / 2, position + width / 2, *([position] if variant else [])]
    return Hidden(
        "local_crack",
        {"added_length": added, "position": position, "width": width},
        variant="gradual" * variant,
        sized=not variant,
    )


def _depth(compliance: float) -> float:
    """Depth k of a linear dent whose mean compliance, the mean of k s/(1 − k s) over s in 0 … 1 = −1 − ln(1 − k)/k,
    is as wished; by bisection.
    """
    low, high = 1e-9, 1 - 1e-9
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if -1 - np.log1p(-middle) / middle < compliance else (low, middle)
    return low


def poling_gradient(build, rng, variant) -> Hidden:
    """Piezoelectric constants that grow along the length. Variant: with a curvature as well.

    The sign of the gradient is always positive, since nobody has marked the direction of the axis.
    """
    size, half = log_uniform(rng, 0.04, 0.4), build.size[0] / 2
    curved = 0.4 * size * float(rng.choice([-1, 1])) if variant else 0.0
    build.piezoelectric.append(lambda x: 1 + size * x / half + curved * ((x / half) ** 2 - 1 / 3))
    return Hidden("poling_gradient", {"gradient": size}, variant="curved" * variant, sized=not variant)


def mounting(build, rng, variant) -> Hidden:
    """A clamp across the width, on both faces. Variants: on one face only; off the middle; very narrow."""
    stiffness, damping = log_uniform(rng, 2e5, 5e6), log_uniform(rng, 0.3, 6.0)
    width = float(rng.uniform(0.5e-3, 1.2e-3))
    words = str(rng.choice(["one face", "off the middle", "narrow"])) if variant else ""
    centre = float(rng.uniform(0.3e-3, 0.9e-3)) if words == "off the middle" else 0.0
    width = 0.1e-3 if words == "narrow" else width
    faces = (-1,) if words == "one face" else (1, -1)
    area = len(faces) * width * build.size[1]
    ends = (centre - width / 2, centre + width / 2)
    build.surfaces.append(Surface(ends, build.whole_face[1], faces, lambda w: (stiffness + 1j * w * damping) / area))
    return Hidden("mounting", {"stiffness": stiffness, "damping": damping}, variant=words, sized=not variant)


def electrode_margin(build, rng, variant) -> Hidden:
    """Bare strips at both ends. Variant: of unequal width, of which the size is the mean."""
    size, share = log_uniform(rng, 0.05e-3, 0.5e-3), 0.35 if variant else 0.0
    build.margins = (size * (1 - share), size * (1 + share))
    sizes = {"margin": size, "asymmetry": share} if variant else {"margin": size}
    return Hidden("electrode_margin", sizes, variant="unequal" * variant)


def depoled(distance: np.ndarray, reach: float, ramp: bool) -> np.ndarray:
    """Share (k,) of e that is left at distances (k,) from an edge: exponential, or a ramp with the same loss."""
    return np.minimum(distance / (2 * reach), 1.0) if ramp else -np.expm1(-distance / reach)


def edge_depoling(build, rng, variant) -> Hidden:
    """Lost poling along all four sides. Variant: a linear ramp in place of the exponential law."""
    reach = log_uniform(rng, 0.02e-3, 0.3e-3)
    axes = ((build.piezoelectric, build.elements), (build.piezoelectric_across, build.elements_across))
    for size, (profiles, elements) in zip(build.size, axes, strict=False):
        profiles.append(lambda x, half=size / 2: depoled(half - np.abs(x), reach, variant))
        elements += [side * (size / 2 - reach * away) for side in (-1, 1) for away in (2.0, 6.0)]
    return Hidden("edge_depoling", {"reach": reach}, variant="ramp" * variant, sized=not variant)


EFFECTS: Mapping[str, Entry] = {
    "series_resistance": series_resistance,
    "series_inductance": series_inductance,
    "stray_capacitance": stray_capacitance,
    "leakage": leakage,
    "frequency_dependent_elastic_loss": frequency_dependent_elastic_loss,
    "dielectric_dispersion": dielectric_dispersion,
    "relaxation": relaxation,
    "contact_gap": contact_gap,
    "cable": cable,
    "temperature_drift": temperature_drift,
    "film_stiffness": film_stiffness,
    "fluid_load": fluid_load,
    "wrong_insensitive_parameter": wrong_insensitive_parameter,
    "wrong_length": _wrong("length", 0, 0.003, 0.015),
    "wrong_width": _wrong("width", 1, 0.003, 0.015),
    "wrong_thickness": _wrong("thickness", 2, 0.01, 0.04),
    "tapered_width": tapered_width,
    "wedge": wedge,
    "electrode_mass": electrode_mass,
    "point_mass": point_mass,
    "local_crack": local_crack,
    "poling_gradient": poling_gradient,
    "mounting": mounting,
    "electrode_margin": electrode_margin,
    "edge_depoling": edge_depoling,
}
