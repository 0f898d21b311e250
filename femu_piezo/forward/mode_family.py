"""Names of modes in words, from the displacement field of a mode and not from its place in the spectrum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.forward.model import ElectroelasticModel

_ORDINAL = {1: "first", 2: "second", 3: "third", 4: "fourth", 5: "fifth", 6: "sixth", 7: "seventh"}
_HALF_WAVES = 12  #: largest number of half waves that is tried


@dataclass(frozen=True)
class Motion:
    """Integrals of one mode over the computed part, with the mode turned to the phase of its largest real part.

    Attributes
    ----------
    share : (3,) share of kinetic energy along x, y, z
    strain : (6,) share of squared strain components, Voigt order
    half_waves : (3,) number of half waves of u_x along x, u_y along y, u_z along z: that of the strongest cosine
    squeeze : (∫S33² dV) (t/2)² / ∫u_z² dV: above 0.5 the thickness pulsates, far below 0.5 the body bends
    radial : share of the in-plane kinetic energy that is motion along the radius
    axisymmetry : share of the energy of radial motion that its mean at each radius holds
    circles : nodal circles of the radial motion
    """

    share: np.ndarray
    strain: np.ndarray
    half_waves: np.ndarray
    squeeze: float
    radial: float
    axisymmetry: float
    circles: int


def real_phase(vector: np.ndarray) -> np.ndarray:
    """A complex mode (m,) times the phase factor that makes its real part largest."""
    square = np.sum(vector**2)
    return vector * np.exp(-0.5j * np.angle(square)) if abs(square) > 0 else vector


def extents(model: ElectroelasticModel) -> np.ndarray:
    """(3, 2) lower and upper corner of the whole specimen, m."""
    mesh = model.domain.mesh
    box = np.array([mesh.p.min(axis=1), mesh.p.max(axis=1)]).T
    for axis in model.domain.symmetry.values():
        box[axis, 0] = 2 * box[axis, 0] - box[axis, 1]
    return box


def motion_of(model: ElectroelasticModel, vector: np.ndarray) -> Motion:
    """The integrals of one mode vector (m,)."""
    basis = model.basis
    fields = [
        basis.interpolate(np.ascontiguousarray(part.real))
        for part in model.displacement(real_phase(np.asarray(vector, dtype=complex)))
    ]
    u = np.array([np.asarray(field) for field in fields]).reshape(3, -1)
    gradient = np.array([field.grad for field in fields]).reshape(3, 3, -1)
    weight = basis.dx.ravel()
    box = extents(model)
    position = (np.asarray(basis.global_coordinates()).reshape(3, -1) - box[:, :1]) / np.ptp(box, axis=1)[:, None]
    shear = [gradient[i, j] + gradient[j, i] for i, j in ((1, 2), (0, 2), (0, 1))]
    strain = np.array([gradient[i, i] for i in range(3)] + [part / np.sqrt(2) for part in shear])
    energy = (u**2) @ weight
    return Motion(
        share=energy / energy.sum(),
        strain=(strain**2) @ weight / np.sum((strain**2) @ weight),
        half_waves=np.array(
            [_half_waves(position[axis], u[axis] * weight, axis in model.domain.symmetry.values()) for axis in range(3)]
        ),
        squeeze=float((strain[2] ** 2) @ weight * np.ptp(box[2]) ** 2 / 4 / max(energy[2], 1e-300)),
        **_radial_motion(position, np.ptp(box, axis=1), u, weight),
    )


def _half_waves(position: np.ndarray, load: np.ndarray, mirrored: bool) -> int:
    """The n of the strongest cos(nπ x) in a displacement; position : x from 0 to 1 along the body.

    mirrored : whether a mirror plane at x = ½ makes the displacement odd about it, so that n is odd
    """
    orders = np.arange(1, _HALF_WAVES + 1, 2 if mirrored else 1)
    return int(orders[np.argmax([abs(np.cos(n * np.pi * position) @ load) for n in orders])])


def _radial_motion(position: np.ndarray, size: np.ndarray, u: np.ndarray, weight: np.ndarray) -> dict:
    x, y = (position[:2] - 0.5) * size[:2, None]
    radius = np.maximum(np.hypot(x, y), 1e-9 * size[0])
    outward = (u[0] * x + u[1] * y) / radius
    in_plane = (u[0] ** 2 + u[1] ** 2) @ weight
    bins = np.minimum((radius / radius.max() * 24).astype(int), 23)
    mass = np.bincount(bins, weight, 24)
    filled = mass > 0
    mean = np.bincount(bins, outward * weight, 24)[filled] / mass[filled]
    radial = outward**2 @ weight
    loud = mean[np.abs(mean) > 0.08 * np.abs(mean).max()]
    return {
        "radial": float(radial / max(in_plane, 1e-300)),
        "axisymmetry": float(mean**2 @ mass[filled] / max(radial, 1e-300)),
        "circles": int(np.sum(np.sign(loud[1:]) != np.sign(loud[:-1]))),
    }


def family(model: ElectroelasticModel, vector: np.ndarray) -> str:
    """A mode (m,) in words, such as "first length extension", "second radial", "flexure", "thickness shear"."""
    motion = motion_of(model, vector)
    size = np.ptp(extents(model), axis=1)
    round_outline = np.isclose(size[0], size[1], rtol=1e-6) and _is_round(model)
    # between mirror planes across x and y the face shear is odd, and nothing shears as a whole
    if motion.strain[5] > 0.5 and not {0, 1} <= set(model.domain.symmetry.values()):
        return "face shear"
    if motion.strain[3] + motion.strain[4] > 0.5 and motion.share[2] < 0.5:
        return "thickness shear"
    if motion.share[2] > 0.5 and size[2] <= size[:2].min():
        return _along("thickness extension", motion.half_waves[2]) if motion.squeeze > 0.5 else _bending(motion)
    compact = max(size[:2]) < 1.25 * min(size[:2])
    axisymmetric = motion.axisymmetry > 0.8
    if compact and motion.share[:2].sum() > 0.5 and motion.radial > 0.85 and axisymmetric:
        order = motion.circles + 1
        word = "radial" if round_outline else "planar extension"
        return f"{_ordinal(order)} {word}" if round_outline or order > 1 else f"first {word} (all edges in phase)"
    if round_outline and size[2] <= size[0]:
        if axisymmetric or model.domain.radii is not None:  # a body of revolution has no other driven modes
            return "radial and axial motion"
        return "contour mode of a disk (not axisymmetric)"
    axis = int(np.argmax(motion.share))
    word = _axis_words(size)[axis]
    text = _along(f"{word} extension", motion.half_waves[axis])
    return text if motion.share[axis] > 0.65 else f"{text}, coupled"


def _is_round(model: ElectroelasticModel) -> bool:
    """Whether all vertices lie inside the ellipse inscribed in the box around the body, within 1 %."""
    box, mesh = extents(model), model.domain.mesh
    center, half = box[:2].mean(axis=1), np.ptp(box[:2], axis=1) / 2
    reach = np.hypot(*((mesh.p[:2] - center[:, None]) / half[:, None]))
    return bool(reach.max() < 1.01)


def _axis_words(size: np.ndarray) -> tuple[str, str, str]:
    if size[2] > size[:2].max():
        return ("transverse", "transverse", "length")
    return ("length", "width", "thickness")


def _bending(motion: Motion) -> str:
    if motion.strain[3] + motion.strain[4] > 0.5:
        return "flexure with thickness shear"
    return "flexure along the length" if motion.strain[0] > motion.strain[1] else "flexure across the width"


def _along(what: str, half_waves: int) -> str:
    return f"first {what}" if half_waves == 1 else f"{what}, {_ordinal(half_waves)} harmonic"


def _ordinal(number: int) -> str:
    return _ORDINAL.get(number, f"{number}th")
