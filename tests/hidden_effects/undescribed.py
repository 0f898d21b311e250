"""Effects that no candidate of the library describes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hidden_effects.body import Surface
from hidden_effects.build import Build
from hidden_effects.catalogue import log_uniform


def air_gap(build: Build, rng: np.random.Generator) -> None:
    """A capacitance in series: an electrode that stands off."""
    value = log_uniform(rng, 1e-8, 2e-7)
    build.circuits.append(lambda w, z: z + 1 / (1j * w * value))


def tuned_mass(build: Build, rng: np.random.Generator) -> None:
    """A small oscillator on one face: its mass acts as m/(1 − (f/f0)² (1 − jη)) does, resonance within the band."""
    mass = log_uniform(rng, 1e-4, 1e-3) * float(np.prod(build.size)) * build.density
    own, loss, side = 2 * np.pi * float(rng.uniform(80e3, 220e3)), float(rng.uniform(0.01, 0.05)), 1.6e-3
    x, y = (float(rng.uniform(0.1, 0.9)) * (length - side) / 2 for length in build.size[:2])

    def coefficient(w):
        spring = own**2 * (1 + 1j * loss)
        return -(w**2) * mass / side**2 * spring / (spring - w**2)

    build.surfaces.append(Surface((x - side / 2, x + side / 2), (y - side / 2, y + side / 2), (1,), coefficient))


def liquid(build: Build, rng: np.random.Generator) -> None:
    """One face in a viscous liquid: shear waves load it with (1 + j) √(ωρη/2), the pressure wave with a part of ρc."""
    shear = log_uniform(rng, 0.03, 1.0) * 1e3  # ρη, kg²/(m⁴ s); water has 1, oils up to 1000
    pressure = log_uniform(rng, 1e4, 2e5)  # kg/(m² s); water has 1.5e6 for plane waves
    face = build.whole_face
    build.surfaces.append(Surface(*face, (1,), lambda w: 1j * w * (1 + 1j) * np.sqrt(w * shear / 2), (0, 1)))
    build.surfaces.append(Surface(*face, (1,), lambda w: 1j * w * pressure, (2,)))


def fixture_resonance(build: Build, rng: np.random.Generator) -> None:
    """A series LC branch parallel to the specimen with its resonance in the band."""
    own, quality = 2 * np.pi * float(rng.uniform(60e3, 230e3)), float(rng.uniform(20, 80))
    capacitance = log_uniform(rng, 1e-12, 2e-11)
    inductance = 1 / (own**2 * capacitance)
    build.circuits.append(
        lambda w, z: 1 / (1 / z + 1 / (1j * w * inductance + own * inductance / quality + 1 / (1j * w * capacitance)))
    )


def glue_layer(build: Build, rng: np.random.Generator) -> None:
    """A stiff, lossy, light layer on one face: the membrane of a glued foil."""
    thickness, modulus = log_uniform(rng, 20e-6, 150e-6), log_uniform(rng, 3e9, 2e10)
    nu, loss = 0.35, float(rng.uniform(0.02, 0.1))
    stiff, heavy = modulus * thickness / (1 - nu**2) * (1 + 1j * loss), 1200.0 * thickness
    face = build.whole_face
    build.surfaces.append(Surface(*face, (-1,), lambda w: stiff * np.ones_like(w), membrane=nu))
    build.surfaces.append(Surface(*face, (-1,), lambda w: -(w**2) * heavy))


def range_switch(build: Build, rng: np.random.Generator) -> None:
    """The instrument changes its range in the sweep, and the gains of the two ranges differ."""
    switch, step = 2 * np.pi * float(rng.uniform(60e3, 200e3)), log_uniform(rng, 2e-3, 2e-2)
    build.circuits.append(lambda w, z: np.where(w > switch, 1 + step, 1.0) * z)


def drive_level(build: Build, rng: np.random.Generator) -> None:
    """Near the fundamental the strain softens the material: the curve bends there alone."""
    shift, width = -log_uniform(rng, 2e-4, 2e-3), float(rng.uniform(0.01, 0.03)) * build.fundamental
    centre = build.fundamental * float(rng.uniform(0.98, 1.02))
    build.warp = lambda f: f * (1 - shift / (1 + ((f - centre) / width) ** 2))


def warming(build: Build, rng: np.random.Generator) -> None:
    """The specimen warms up during the sweep: all resonances fall, later ones further, towards a new balance."""
    fall, early = log_uniform(rng, 5e-4, 5e-3), float(rng.uniform(40e3, 90e3))
    build.warp = lambda f: f * (1 + fall * (1 - np.exp(-(f - 20e3) / early)))


UNDESCRIBED: Mapping[str, Callable[[Build, np.random.Generator], None]] = {
    "air_gap": air_gap,
    "tuned_mass": tuned_mass,
    "liquid": liquid,
    "fixture_resonance": fixture_resonance,
    "glue_layer": glue_layer,
    "range_switch": range_switch,
    "drive_level": drive_level,
    "warming": warming,
}
