"""The [geometry] table of a specimen file: shape, dimensions, electrodes, poling (SI once read)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, ConfigDict

from femu_piezo.specimen.schema import PAIR, PATH, Table, described, quantity
from femu_piezo.units import shown

Length = Annotated[float, quantity("m", 1e-6, 0.5, 'is the unit right (mm taken for m)? write "40 mm"')]
Distance = Annotated[float, quantity("m", 0.0, 10.0, 'is the unit right (mm taken for m)? write "0.5 mm"')]
Position = Annotated[float, quantity("m", -10.0, 10.0, 'is the unit right (mm taken for m)? write "5 mm"')]
Density = Annotated[float, quantity("kg/m^3", 100, 30000, 'is the unit right? write "7900 kg/m^3" or "7.9 g/cm^3"')]
Tolerance = Annotated[float, quantity("m", 0.0, 0.1, 'the deviation of a calliper is a length such as "0.02 mm"')]
RelativeStd = Annotated[float, quantity("1", 0.0, 1.0, 'a relative standard deviation, such as 0.003 or "0.3 %"')]
Mass = Annotated[float, quantity("kg", 1e-9, 100.0, 'is the unit right? write "1.580 g"')]
MassStd = Annotated[float, quantity("kg", 0.0, 10.0, 'the deviation of a balance is a mass such as "1 mg"')]
Unit = Annotated[float, quantity("m", 1e-7, 1.0, 'give the length of one unit of the mesh, such as "1 mm"')]

#: Ratio of the largest to the smallest dimension above which one of them has a wrong unit.
_SLENDEREST = 1000.0
#: Share of a dimension or mass above which its deviation has a wrong unit; no fit moves it farther.
_LOOSEST = 0.1
#: Dimensions that each shape must have.
DIMENSIONS = {
    "plate": ("length", "width", "thickness"),
    "square": ("length", "thickness"),
    "trapezoid": ("length", "width", "width_end", "thickness"),
    "disk": ("diameter", "thickness"),
    "ring": ("diameter", "inner_diameter", "thickness"),
    "mesh": ("file",),
}
#: Dimensions by name, each with a standard deviation `std_NAME`.
LENGTHS = ("length", "width", "width_end", "thickness", "diameter", "inner_diameter")
#: What a slab may have beyond its dimensions.
FEATURES = (
    "hole_diameter",
    "hole_position",
    "chamfer",
    "electrode_margin",
    "electrode_start",
    "electrode_length",
    "wrap_length",
    "wrap_gap",
    "elements",
)
#: What each shape may have.
OPTIONAL = {
    "plate": ("corner_radius", *FEATURES),
    "square": ("corner_radius", *FEATURES),
    "trapezoid": FEATURES,
    "disk": FEATURES,
    "ring": FEATURES,
    "mesh": ("unit",),
}
_ALL = tuple(dict.fromkeys(name for table in (DIMENSIONS, OPTIONAL) for names in table.values() for name in names))


def _to_poling(value: object) -> object:
    """ "thickness", "length", or a direction (x, y, z), which becomes "thickness" where it is along z > 0."""
    right = 'write "thickness", "length" or a direction such as [1, 0, 0]'
    if isinstance(value, (list, tuple)):
        numbers = [isinstance(part, (int, float)) and not isinstance(part, bool) for part in value]
        if len(value) != 3 or not all(numbers) or not any(value):
            raise ValueError(f"{shown(list(value))} is no direction; {right}")
        try:
            x, y, z = (float(part) for part in value)
        except OverflowError:
            raise ValueError(f"{shown(list(value))} has a number that is too large; {right}") from None
        return "thickness" if x == y == 0 and z > 0 else (x, y, z)
    if value not in ("thickness", "length"):
        raise ValueError(f"{shown(value)} is not known; {right}")
    return value


def belongs_to(shape: str, key: str) -> bool:
    """Whether a key of the [geometry] table is one that a shape has or may have."""
    if key in _ALL:
        return key in DIMENSIONS[shape] + OPTIONAL[shape]
    dimension = key.removeprefix("std_")
    return dimension == key or dimension not in _ALL or dimension in DIMENSIONS[shape]


class Geometry(Table):
    """Shape, dimensions, electrodes and poling; which dimensions a shape has is in `DIMENSIONS`."""

    model_config = ConfigDict(title="geometry")

    missing: ClassVar[dict[str, str]] = {"shape": f"give one of {', '.join(DIMENSIONS)}"}

    shape: Literal["plate", "square", "trapezoid", "disk", "ring", "mesh"] = described("shape of the body", ...)
    length: Length | None = described("dimension along x")
    width: Length | None = described("dimension along y; of a trapezoid the width at the end x_min")
    width_end: Length | None = described("width of a trapezoid at the end x_max")
    thickness: Length | None = described("dimension along z")
    diameter: Length | None = described("outer diameter")
    inner_diameter: Length | None = described("inner diameter of a ring")
    corner_radius: Distance | None = described("radius of round corners")
    hole_diameter: Length | None = described("diameter of a hole through both faces")
    hole_position: Annotated[tuple[Position, Position] | None, PAIR] = described(
        "centre (x, y) of the hole, from the middle of the body; default: the middle"
    )
    chamfer: Distance | None = described("45° bevel along the outer edges of both faces")
    electrode_margin: Distance | None = described("width of the bare rim of both faces")
    electrode_start: Distance | None = described(
        "distance of the hot electrode from the end x_min (the wide end of a trapezoid); default: zero"
    )
    electrode_length: Length | None = described("length of the hot electrode along x; default: the whole face")
    wrap_length: Length | None = described(
        "length along x of the ground electrode on the hot face, where it wraps around the end x_min"
    )
    wrap_gap: Length | None = described("width of the bare gap between the wrapped ground and the hot electrode")
    elements: Literal["hexahedron", "tetrahedron"] | None = described(
        "kind of elements of a drawn body (rounded, pierced, chamfered, partly covered); default: chosen by the program"
    )
    file: Annotated[Path | None, PATH] = described(
        "mesh file with surfaces named hot and ground, such as gmsh writes; relative to the specimen file"
    )
    unit: Unit | None = described("length of one unit of the coordinates in the mesh file; default: a metre")
    density: Density | None = described("density; default: that of the base material")
    mass: Mass | None = described("mass of the specimen, instead of the density")
    std_length: Tolerance | None = described("standard deviation of the length", usual=20e-6)
    std_width: Tolerance | None = described("standard deviation of the width", usual=20e-6)
    std_thickness: Tolerance | None = described("standard deviation of the thickness", usual=5e-6)
    std_diameter: Tolerance | None = described("standard deviation of the diameter", usual=20e-6)
    std_inner_diameter: Tolerance | None = described("standard deviation of the inner diameter of a ring", usual=20e-6)
    std_width_end: Tolerance | None = described(
        "standard deviation of the width of a trapezoid at the end x_max", usual=20e-6
    )
    std_density: RelativeStd | None = described("relative standard deviation of the density", usual=0.005)
    std_mass: MassStd | None = described("standard deviation of the mass; default: 0.1 % of the mass")
    poling: Annotated[str | tuple[float, float, float], BeforeValidator(_to_poling)] = described(
        '"thickness" or "length", the direction of poling and of the field; or a direction (x, y, z), with the '
        "electrodes on the two faces (x along the length, z through the thickness)",
        "thickness",
    )

    @property
    def plain(self) -> bool:
        """Whether the body has only dimensions: no holes, chamfers, margins and so on."""
        return all(getattr(self, name) is None for name in _ALL if name not in DIMENSIONS[self.shape])

    def problem(self) -> str | None:
        return self._wrong_dimensions() or self._wrong_feature() or self._wrong_poling() or self._wrong_tolerance()

    def _wrong_tolerance(self) -> str | None:
        for name in LENGTHS:
            if getattr(self, f"std_{name}") is not None and getattr(self, name) is None:
                words = name.replace("_", " ")
                return f"geometry.std_{name} is given, but a {self.shape} has no {words}; take it out"
        for name in (*LENGTHS, "mass"):
            size, std = getattr(self, name), getattr(self, f"std_{name}")
            if size is not None and std is not None and std > _LOOSEST * size:
                unit = "kg" if name == "mass" else "m"
                return (
                    f"geometry.std_{name} = {std:g} {unit} is {100 * std / size:.3g} % of {name} = {size:g} {unit}; is "
                    f"the unit right (of a deviation, at most {100 * _LOOSEST:g} %)?"
                )
        if self.mass is not None and self.density is not None:
            return "geometry.mass and geometry.density are both given; the mass stands in place of the density"
        if self.mass is not None and self.std_density is not None:
            return "geometry.std_density is given beside geometry.mass; give std_mass"
        if self.std_mass is not None and self.mass is None:
            return "geometry.std_mass is given without geometry.mass; give both"
        return None

    def _wrong_dimensions(self) -> str | None:
        wanted, optional = DIMENSIONS[self.shape], OPTIONAL[self.shape]
        for name in _ALL:
            if name in wanted and getattr(self, name) is None:
                return f"geometry.{name} is missing; a {self.shape} needs {', '.join(wanted)}"
            if name not in wanted + optional and getattr(self, name) is not None:
                return (
                    f"geometry.{name} does not belong to a {self.shape}, which has {', '.join(wanted)} and may have "
                    f"{', '.join(optional)}"
                )
        sizes = {name: getattr(self, name) for name in wanted if name != "file"}
        if sizes and max(sizes.values()) > _SLENDEREST * min(sizes.values()):
            small, large = min(sizes, key=sizes.get), max(sizes, key=sizes.get)
            return (
                f"geometry.{small} = {sizes[small]:g} m is less than 1/{_SLENDEREST:g} of {large} = {sizes[large]:g} "
                "m; is the unit of one of them wrong?"
            )
        if self.shape == "ring" and self.inner_diameter >= self.diameter:
            return (
                f"geometry.inner_diameter = {self.inner_diameter:g} m is not smaller than diameter = "
                f"{self.diameter:g} m; are the two exchanged?"
            )
        return None

    def _wrong_feature(self) -> str | None:
        for first, second in (
            ("hole_position", "hole_diameter"),
            ("electrode_start", "electrode_length"),
            ("wrap_length", "wrap_gap"),
            ("wrap_gap", "wrap_length"),
        ):
            if getattr(self, first) is not None and getattr(self, second) is None:
                return f"geometry.{first} is given without geometry.{second}; give both"
        return None

    def _wrong_poling(self) -> str | None:
        if self.poling == "length" and self.shape != "plate":
            return f'geometry.poling = "length" is for a plate; a {self.shape} is poled along "thickness"'
        if self.poling == "length" and not self.plain:
            return (
                'geometry.poling = "length" is for a plain rectangular plate with its electrodes on the two ends; '
                "take out holes, corners, chamfers and partial electrodes, or give a mesh file"
            )
        return None
