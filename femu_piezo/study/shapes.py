"""From the [geometry] table of a specimen file to a shape, and where its first driven mode is to be expected."""

from __future__ import annotations

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.forward.thin_limits import NARROW_RING, thin_bar_frequency, thin_disk_frequency, thin_ring_frequency
from femu_piezo.geometry import catalogue
from femu_piezo.geometry.mesh_file import MeshFile
from femu_piezo.geometry.regions import Circle
from femu_piezo.geometry.shape import Shape, poling_along_field
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Electrodes, Slab
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.specimen.file import Specimen
from femu_piezo.specimen.geometry import Geometry

#: Cosine of the angle between poling and field below which the first mode is a shear of the thickness.
_SHEARED = 0.5
_FINER = '; elements = "tetrahedron" in [geometry] reduces it to a third'


def shape_of(specimen: Specimen) -> Shape:
    """The body of a specimen; InputError with file and key where its dimensions do not go together."""
    try:
        return _shape(specimen.geometry)
    except InputError as error:
        raise InputError(f"{specimen.path or specimen.name}: geometry: {error}") from None


def _shape(geometry: Geometry) -> Shape:
    direction = None if isinstance(geometry.poling, str) else geometry.poling
    if geometry.shape == "mesh":
        body = MeshFile(geometry.file, geometry.unit or 1.0, direction or (0.0, 0.0, 1.0))
        _ = body.mesh  # its checks come before any other work
        return body
    if geometry.shape == "plate" and geometry.plain:
        poling = "length" if geometry.poling == "length" else "thickness"
        return Plate(geometry.length, geometry.width, geometry.thickness, poling, direction)
    if geometry.shape == "square" and geometry.plain:
        return Plate(geometry.length, geometry.length, geometry.thickness, "thickness", direction)
    options = {
        "holes": _holes(geometry),
        "electrodes": _electrodes(geometry),
        "chamfer": geometry.chamfer or 0.0,
        "direction": direction,
        "elements": geometry.elements,
    }
    if geometry.shape == "disk":
        return catalogue.disk(geometry.diameter, geometry.thickness, **options)
    if geometry.shape == "ring":
        return catalogue.ring(geometry.diameter, geometry.inner_diameter, geometry.thickness, **options)
    if geometry.shape == "trapezoid":
        return catalogue.trapezoid(geometry.length, geometry.width, geometry.width_end, geometry.thickness, **options)
    width = geometry.length if geometry.shape == "square" else geometry.width
    return catalogue.plate(geometry.length, width, geometry.thickness, geometry.corner_radius or 0.0, **options)


def _holes(geometry: Geometry) -> tuple[Circle, ...]:
    if geometry.hole_diameter is None:
        return ()
    return (Circle(geometry.hole_diameter, geometry.hole_position or (0.0, 0.0)),)


def _electrodes(geometry: Geometry) -> Electrodes:
    span = wrap = None
    if geometry.electrode_length is not None:
        span = (geometry.electrode_start or 0.0, geometry.electrode_length)
    if geometry.wrap_length is not None:
        wrap = (geometry.wrap_length, geometry.wrap_gap)
    return Electrodes(geometry.electrode_margin or 0.0, span, wrap)


def electrode_notes(specimen: Specimen) -> tuple[str, ...]:
    """What to know of the accuracy of a body whose electrodes end inside its faces, as sentences.

    Nothing where its cells are a grid or polar: these are graded towards rims, and results state the error left.
    """
    geometry = specimen.geometry
    partial = (geometry.electrode_margin, geometry.electrode_length, geometry.wrap_length)
    body = shape_of(specimen) if any(partial) else None
    if not isinstance(body, Slab) or body.is_curved:
        return ()
    size, words = ("a few 1e-4", "") if body.element_shape == "tetrahedron" else ("up to 1e-3", _FINER)
    return (
        f"{specimen.name}: the field is singular where an electrode ends inside a face, which may leave a relative "
        f"error of {size} in λ (half of it in frequency) at any requested accuracy{words}",
    )


def _extents(shape: Shape) -> np.ndarray:
    """(3,) extents of a body along the axes, m."""
    if isinstance(shape, MeshFile):
        return shape.extents
    if isinstance(shape, Plate):
        return shape.dimensions
    low_x, high_x, low_y, high_y = shape.outline.extents
    return np.array([high_x - low_x, high_y - low_y, shape.thickness])


def first_mode_Hz(shape: Shape, constants: PiezoConstants, density: float) -> float:
    """First driven mode in the limit of a thin body, Hz: bar, disk or ring, along the thickness for tall ones."""
    if poling_along_field(shape) < _SHEARED:
        return thin_bar_frequency(constants.s44, density, shape.electrode_gap)
    size = _extents(shape)
    along = int(np.argmax(np.abs(shape.field_direction)))
    if size[along] > np.delete(size, along).max():
        return thin_bar_frequency(constants.s33, density, size[along])
    if not isinstance(shape, Slab) or not isinstance(shape.outline, Circle):
        return thin_bar_frequency(constants.s11, density, float(size.max()))
    inner = max((hole.diameter for hole in shape.holes if hole.center == (0.0, 0.0)), default=0.0)
    if inner > NARROW_RING * shape.outline.diameter:
        return thin_ring_frequency(constants, density, (inner + shape.outline.diameter) / 4)
    return thin_disk_frequency(constants, density, shape.outline.diameter / 2)
