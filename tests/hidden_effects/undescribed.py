"""Effects that no candidate of the library describes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hidden_effects.body import Surface
from hidden_effects.build import Build
from hidden_effects.catalogue import log_uniform


def tuned_mass(build: Build, rng: np.random.Generator) -> None:
    """A small oscillator on one face: it acts as a mass m/(1 − (f/f0)² (1 − jη)) with its resonance in the band."""
    mass = log_uniform(rng, 1e-4, 1e-3) * float(np.prod(build.size)) * build.density
    resonance, loss, side = 2 * np.pi * float(rng.uniform(80e3, 220e3)), float(rng.uniform(0.01, 0.05)), 1.6e-3
    x, y = (float(rng.uniform(0.1, 0.9)) * (length - side) / 2 for length in build.size[:2])

    def coefficient(w):
        spring = resonance**2 * (1 + 1j * loss)
        return -(w**2) * mass / side**2 * spring / (spring - w**2)

    build.surfaces.append(Surface((x - side / 2, x + side / 2), (y - side / 2, y + side / 2), (1,), coefficient))


def fixture_resonance(build: Build, rng: np.random.Generator) -> None:
    """A series LC branch parallel to the specimen with its resonance in the band."""
    resonance, quality = 2 * np.pi * float(rng.uniform(60e3, 230e3)), float(rng.uniform(20, 80))
    capacitance = log_uniform(rng, 1e-12, 2e-11)
    inductance = 1 / (resonance**2 * capacitance)
    build.circuits.append(
        lambda w, z: (
            1 / (1 / z + 1 / (1j * w * inductance + resonance * inductance / quality + 1 / (1j * w * capacitance)))
        )
    )


def range_switch(build: Build, rng: np.random.Generator) -> None:
    """The instrument changes its range in the sweep, and the gains of the two ranges differ."""
    switch, step = 2 * np.pi * float(rng.uniform(60e3, 200e3)), log_uniform(rng, 2e-3, 2e-2)
    build.circuits.append(lambda w, z: np.where(w > switch, 1 + step, 1.0) * z)


def delamination(build: Build, rng: np.random.Generator) -> None:
    """A stretch of the plate is softer and hardly poled, as where its layers have separated."""
    place, width = float(rng.uniform(0.1, 0.6)) * build.size[0] / 2, float(rng.uniform(0.06, 0.2)) * build.size[0]
    soft, poled = float(rng.uniform(0.03, 0.25)), float(rng.uniform(0.2, 0.8))

    def profile(depth: float):
        return lambda x: 1 - depth * (np.abs(x - place) < width / 2)

    build.stiffness.append(profile(soft))
    build.piezoelectric.append(profile(poled))
    build.elements += [end for end in (place - width / 2, place + width / 2) if abs(end) < build.size[0] / 2]


def second_piece(build: Build, rng: np.random.Generator) -> None:
    """A chip of another plate in the same fixture: a weak resonance with its own capacitance, in parallel."""
    resonance, quality = 2 * np.pi * float(rng.uniform(60e3, 230e3)), float(rng.uniform(30, 90))
    static, coupling = log_uniform(rng, 5e-12, 5e-11), float(rng.uniform(0.05, 0.3))
    elastance = 1 / (coupling * static)

    def circuit(w, z):
        branch = 1j * w / (elastance * (1 - (w / resonance) ** 2 + 1j * w / resonance / quality))
        return 1 / (1 / z + 1j * w * static + branch)

    build.circuits.append(circuit)


def loose_contact(build: Build, rng: np.random.Generator) -> None:
    """The resistance of a contact varies during the sweep."""
    size, waves = log_uniform(rng, 1.0, 10.0), float(rng.uniform(1.5, 4.0))
    phase = float(rng.uniform(0, 2 * np.pi))
    build.circuits.append(lambda w, z: z + size * (1 + np.sin(waves * w / (2 * np.pi * 35e3) + phase)))


def clamped_end(build: Build, rng: np.random.Generator) -> None:
    """A clip holds one end of the plate on both faces."""
    stiffness, damping = log_uniform(rng, 3e5, 5e6), log_uniform(rng, 0.5, 6.0)
    half, width = build.size[0] / 2, float(rng.uniform(0.4e-3, 1.0e-3))
    area = 2 * width * build.size[1]
    strip = ((half - width, half), build.whole_face[1])
    build.surfaces.append(Surface(*strip, (1, -1), lambda w: (stiffness + 1j * w * damping) / area))


def half_film(build: Build, rng: np.random.Generator) -> None:
    """Paste covers a part of one face, from one end."""
    mass, end = log_uniform(rng, 0.03, 0.3), float(rng.uniform(-0.5, 0.5)) * build.size[0] / 2
    build.surfaces.append(Surface((end, build.size[0] / 2), build.whole_face[1], (1,), lambda w: -(w**2) * mass))


UNDESCRIBED: Mapping[str, Callable[[Build, np.random.Generator], None]] = {
    "tuned_mass": tuned_mass,
    "fixture_resonance": fixture_resonance,
    "range_switch": range_switch,
    "delamination": delamination,
    "second_piece": second_piece,
    "loose_contact": loose_contact,
    "clamped_end": clamped_end,
    "half_film": half_film,
}
