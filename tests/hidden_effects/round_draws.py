"""Draws of disks and rings with hidden effects, in the way of `hidden_effects.draws` for plates and bars.

The diameter is 24 mm, so that the fundamental and the second radial mode lie in the band for which laws over frequency
are drawn. Everything is off by the tolerances of a laboratory. Effects on circuits or constants come from the catalogue
of plates, effects at a place from this module.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from hidden_effects import catalogue, draws
from hidden_effects.build import Swept
from hidden_effects.catalogue import NAMES, Hidden, log_uniform
from hidden_effects.draws import PZT5H, Draw
from hidden_effects.round_body import RoundBody, RoundSurface

ROUND = ("disk", "ring")
FREE = ("s11", "s12", "d31", "eps33T")
#: Standard deviations of diameters and thickness, m.
STD_DIAMETER, STD_THICKNESS = 20e-6, 5e-6
_DEGREE, _LAYERS, _ATTEMPTS = 18, 3, 60
#: Radius of the patches of a support, m.
_PAD = 0.9e-3


@dataclass
class RoundBuild(Swept):
    """A disk or ring to be made, changed by effects.

    Attributes
    ----------
    radii : inner (0 for a disk) and outer, m;  thickness : m
    theta : (10,) true d-form constants
    fundamental : Hz, where laws over frequency are anchored
    """

    radii: np.ndarray
    thickness: float
    density: float
    theta: np.ndarray
    fundamental: float
    profiles: dict[str, Callable] = field(default_factory=dict)
    wedge: float = 0.0
    oval: float = 0.0

    @property
    def mass(self) -> float:
        """Mass of the body, kg."""
        return float(np.pi * (self.radii[1] ** 2 - self.radii[0] ** 2) * self.thickness * self.density)

    def body(self) -> RoundBody:
        """The body without its surfaces."""
        outline = tuple(self.radii), self.thickness, self.density
        return RoundBody(*outline, _DEGREE, _LAYERS, self.profiles, self.wedge, self.oval)

    def face(self, side: int, coefficient, directions: tuple[int, ...] = (0, 1, 2)) -> RoundSurface:
        """A surface that covers all of one face."""
        x, y, weights = self.body().quadrature
        both = [np.concatenate([part, sign * part]) for part, sign in ((x, 1), (y, -1), (weights / 2, 1))]
        return RoundSurface(*both, (side,), coefficient, directions)


def point_mass(build: RoundBuild, rng, variant) -> Hidden:
    """A mass on a round patch of the upper face. Variant: a large patch."""
    mass = log_uniform(rng, 0.0005, 0.006) * build.mass
    radius = 1.8e-3 if variant else 0.9e-3
    inner, outer = build.radii
    place = float(inner + radius + rng.uniform(0.1, 0.98) * (outer - inner - 2 * radius))
    build.surfaces.append(RoundSurface.patch(place, radius, (1,), lambda w: -(w**2) * mass))
    return Hidden("point_mass", {"mass": mass, "r": place}, variant="large patch" * variant, sized=not variant)


def mounting(build: RoundBuild, rng, variant) -> Hidden:
    """A clamp on a circle on both faces. Variant: three patches on the lower face."""
    omega = 2 * np.pi * build.fundamental
    stiffness = log_uniform(rng, 0.01, 0.2) * build.mass * omega**2
    damping = log_uniform(rng, 0.003, 0.05) * build.mass * omega
    inner, outer = build.radii
    radius = float(rng.uniform(inner + 0.3 * (outer - inner), 0.98 * outer))

    def coefficient(w: np.ndarray) -> np.ndarray:
        return stiffness + 1j * w * damping

    if variant:
        radius = min(radius, float(outer) - _PAD)
        build.surfaces.append(RoundSurface.tripod(radius, _PAD, (-1,), coefficient))
    else:
        build.surfaces.append(RoundSurface.circle(radius, (1, -1), coefficient, 48))
    sizes = {"stiffness": stiffness, "damping": damping, "points_radius" if variant else "radius": radius}
    return Hidden("mounting", sizes, variant="three points" * variant)


def electrode_mass(build: RoundBuild, rng, variant) -> Hidden:
    """Films of mass on both faces. Variant: unequal films."""
    size, share = log_uniform(rng, 0.02, 0.2), 0.3 if variant else 0.0
    for side in (1, -1):
        mass_per_area = size * (1 + side * share)
        build.surfaces.append(build.face(side, lambda w, mass_per_area=mass_per_area: -(w**2) * mass_per_area))
    return Hidden("electrode_mass", {"mass_per_area": size}, variant="unequal films" * variant)


def unequal_electrode_mass(build: RoundBuild, rng, variant) -> Hidden:
    """Films on the two faces with a difference in mass and a mean of zero. No variant."""
    size = log_uniform(rng, 0.05, 0.4)
    for side in (1, -1):
        build.surfaces.append(build.face(side, lambda w, side=side: -(w**2) * side * size / 2))
    return Hidden("unequal_electrode_mass", {"difference": size})


def fluid_load(build: RoundBuild, rng, variant) -> Hidden:
    """Oil on both faces. Variant: on one face."""
    shear, pressure = log_uniform(rng, 5.0, 30.0), log_uniform(rng, 1e4, 2e5)
    for side in (1,) if variant else (1, -1):
        build.surfaces.append(build.face(side, lambda w: 1j * w * (1 + 1j) * np.sqrt(w / 2) * shear, (0, 1)))
        build.surfaces.append(build.face(side, lambda w: 1j * w * pressure, (2,)))
    return Hidden("fluid_load", {"shear_load": shear}, variant="one face" * variant, sized=not variant)


def poling_gradient(build: RoundBuild, rng, variant) -> Hidden:
    """Piezoelectric constants that vary with r². Variant: with r⁴."""
    size = log_uniform(rng, 0.04, 0.4) * float(rng.choice([-1, 1]))
    inner, outer = build.radii
    share, power = (inner / outer) ** 2, 4 if variant else 2
    middle = (1 - share ** (power / 2 + 1)) / (1 - share) / (power / 2 + 1)
    build.profiles["e"] = lambda x, y: 1 + size * (np.hypot(x, y) ** power / outer**power - middle)
    return Hidden("poling_gradient", {"gradient": size}, variant="steeper" * variant, sized=not variant)


def edge_depoling(build: RoundBuild, rng, variant) -> Hidden:
    """Lost poling along all rims. Variant: a linear ramp in place of the exponential law."""
    reach, rims = log_uniform(rng, 0.04e-3, 0.4e-3), build.radii[build.radii > 0]

    def left(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Share of e that is left."""
        return np.prod([catalogue.depoled(np.abs(np.hypot(x, y) - rim), reach, variant) for rim in rims], axis=0)

    build.profiles["e"] = left
    return Hidden("edge_depoling", {"reach": reach}, variant="ramp" * variant, sized=not variant)


def soft_volume(thickness: float, depth: float, radius: float) -> float:
    """t ∫ k/(1 − 0.66 k) dA, m³, for k = depth exp(−r²/radius²): the size of a soft spot as the library's law counts
    it, ring by ring.
    """
    r = np.linspace(0, 5, 2001)
    k = depth * np.exp(-(r**2))
    return float(thickness * radius**2 * np.trapezoid(2 * np.pi * r * k / (1 - 0.66 * k), r))


def local_crack(build: RoundBuild, rng, variant) -> Hidden:
    """A soft spot with a Gaussian profile. Variant: it has lost its poling too."""
    depth, radius = rng.uniform(0.15, 0.6), rng.uniform(0.8e-3, 1.2e-3)
    inner, outer = build.radii
    place = float(inner + rng.uniform(0.1, 0.95) * (outer - inner))

    def spot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1 - depth * np.exp(-((x - place) ** 2 + y**2) / radius**2)

    build.profiles["c"] = spot
    if variant:
        build.profiles["e"] = spot
    sizes = {"volume": soft_volume(build.thickness, depth, radius), "r": place}
    return Hidden("local_crack", sizes, variant="unpoled" * variant, sized=not variant)


def wedge(build: RoundBuild, rng, variant) -> Hidden:
    """The thickness grows along a diameter. No variant."""
    build.wedge = log_uniform(rng, 0.04, 0.25)
    return Hidden("wedge", {"wedge": build.wedge})


def ovality(build: RoundBuild, rng, variant) -> Hidden:
    """An oval outline; of a ring the inner rim has the same shape. No variant."""
    size = log_uniform(rng, 0.002, 0.015)
    build.oval = float(np.expm1(size))
    return Hidden("ovality", {"ovality": size})


def _wrong(name: str, low: float, high: float) -> catalogue.Entry:
    def entry(build: RoundBuild, rng, variant) -> Hidden:
        """A wrong diameter or thickness. No variant."""
        size = log_uniform(rng, low, high) * float(rng.choice([-1, 1]))
        if name == "diameter":
            build.radii = build.radii * (1 + size)
        else:
            build.thickness *= 1 + size
        return Hidden(f"wrong_{name}", {"relative_error": size})

    return entry


_SHARED = (
    "series_resistance",
    "series_inductance",
    "stray_capacitance",
    "leakage",
    "contact_gap",
    "cable",
    "frequency_dependent_elastic_loss",
    "dielectric_dispersion",
    "relaxation",
    "temperature_drift",
)
ROUND_EFFECTS: Mapping[str, catalogue.Entry] = {name: catalogue.EFFECTS[name] for name in _SHARED} | {
    "point_mass": point_mass,
    "mounting": mounting,
    "electrode_mass": electrode_mass,
    "unequal_electrode_mass": unequal_electrode_mass,
    "fluid_load": fluid_load,
    "poling_gradient": poling_gradient,
    "local_crack": local_crack,
    "edge_depoling": edge_depoling,
    "wedge": wedge,
    "ovality": ovality,
    "wrong_diameter": _wrong("diameter", 0.01, 0.03),
    "wrong_thickness": _wrong("thickness", 0.01, 0.04),
}


def draw_round(name: str, seed: int, *, points: int = 301) -> Draw:
    """A disk or ring in a laboratory: "disk:EFFECT", "ring:EFFECT", EFFECT one of `ROUND_EFFECTS` or "none"."""
    shape, _, effect = name.partition(":")
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([2030, seed, zlib.crc32(name.encode()), attempt])
        found = _drawn(name, shape, effect, seed, rng, points)
        if np.all(found.clean.real > 0) and draws.passive(found.theta):
            return found
    raise RuntimeError(f"{name}:{seed}: no passive specimen in {_ATTEMPTS} draws")


def _drawn(name: str, shape: str, effect: str, seed: int, rng: np.random.Generator, points: int) -> Draw:
    nominal = np.array([0.0 if shape == "disk" else rng.uniform(3.5e-3, 5e-3), 12e-3])
    height, noise = float(rng.uniform(1.0e-3, 1.6e-3)), float(np.exp(rng.uniform(*np.log((5e-4, 3e-3)))))
    held = PZT5H * rng.uniform(0.96, 1.04, 10) * (1 - 1j * rng.uniform(0.012, 0.02, 10))
    tangents = -held.imag / held.real + draws.STD_TANGENT * rng.standard_normal(10)
    theta = held.real * (1 + draws.STD_HELD * rng.standard_normal(10)) * (1 - 1j * tangents)
    assumed = held.copy()
    for free in FREE:
        number = NAMES.index(free)
        theta[number] = PZT5H[number] * rng.uniform(0.96, 1.04) * (1 - 1j * rng.uniform(0.012, 0.02))
        assumed[number] = PZT5H[number] * (1 - 0.015j)
    density = draws.DENSITY * (1 + draws.STD_DENSITY * rng.standard_normal())
    radii = nominal + STD_DIAMETER / 2 * rng.standard_normal(2) * (nominal > 0)
    thickness = height + STD_THICKNESS * rng.standard_normal()
    near = _fundamental(radii, theta, density)
    build = RoundBuild(radii, thickness, density, theta, near)
    key = []
    if effect != "none":
        entry = ROUND_EFFECTS[effect]
        key.append(entry(build, rng, bool(rng.random() < draws.VARIANTS)))
    build.circuits.append(draws.instrument(rng))
    key = [_in_all(hidden, build, nominal, height) for hidden in key]
    frequency = np.linspace(20e3, 240e3, points)
    clean = build.impedance(frequency)
    normal = rng.standard_normal((2, points))
    z = clean * (1 + noise * (normal[0] + 1j * normal[1]) / np.sqrt(2))
    text = _specification(shape, nominal, height, assumed, noise if rng.integers(2) else None)
    return Draw(name, seed, text, frequency, z, clean, tuple(key), "", build, noise)


def _fundamental(radii: np.ndarray, theta: np.ndarray, density: float) -> float:
    """Approximate frequency of the first radial resonance, Hz: of a thin disk, or of a thin ring at its mean radius."""
    s11, s12 = theta[0].real, theta[1].real
    if radii[0] == 0:
        speed = np.sqrt(1 / (density * s11 * (1 - (s12 / s11) ** 2)))
        return float(2.05 * speed / (2 * np.pi * radii[1]))
    return float(np.sqrt(1 / (density * s11)) / (2 * np.pi * radii.mean()))


def _in_all(hidden: Hidden, build: RoundBuild, nominal: np.ndarray, height: float) -> Hidden:
    """The key of a wrong dimension with the tolerance included, since a sweep shows the total difference from the
    file.
    """
    true = {"wrong_diameter": build.radii[1] / nominal[1], "wrong_thickness": build.thickness / height}
    if hidden.effect not in true:
        return hidden
    return Hidden(hidden.effect, {"relative_error": true[hidden.effect] - 1})


def _specification(shape: str, radii: np.ndarray, height: float, assumed: np.ndarray, noise: float | None) -> str:
    lines = ['name = "hidden"', "[geometry]", f'shape = "{shape}"', 'poling = "thickness"']
    lines += [f"density = {draws.DENSITY}", f"diameter = {2 * float(radii[1])!r}", f"thickness = {height!r}"]
    if shape == "ring":
        lines.append(f"inner_diameter = {2 * float(radii[0])!r}")
    lines += [f"std_diameter = {STD_DIAMETER!r}", f"std_thickness = {STD_THICKNESS!r}"]
    lines += [f"std_density = {draws.STD_DENSITY!r}", *draws.material_lines(FREE, assumed, laboratory=True)]
    return "\n".join([*lines, *draws.measurement_lines(noise, laboratory=True)]) + "\n"
