"""One mode shape drawn off-screen: displaced body with colours, its outline at rest, the edges of the electrodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from femu_piezo.forward.mode_family import real_phase
from femu_piezo.output.off_screen import pyvista_off_screen
from femu_piezo.output.surface import BARE, GROUND, HOT, Surface, surface_of

if TYPE_CHECKING:
    from femu_piezo.study.modes import DrivenMode, ModesResult

#: Largest drawn displacement relative to the longest side; of thickness modes relative to the thickness.
_EXAGGERATION, _IN_THICKNESS = 0.07, 0.3
#: Most by which the drawn displacement shortens or stretches the surface along any line, so that no hole turns over.
_MOST_STRAIN = 0.8
COLORS = {"displacement": "viridis", "potential": "RdBu_r"}
ELECTRODE_COLORS = {BARE: "#e8dfc8", HOT: "#c0392b", GROUND: "#1f4e79"}
WINDOW = (1500, 1000)
#: Distance, relative to the body, within which points are the same.
_SAME = 1e-9
#: Length, relative to the body, below which lines are not drawn: the pinhole of a disk is not shown.
_SHORTEST = 3e-5
#: Vertical angle of view, degrees.
_VIEW = 30.0


@dataclass(frozen=True)
class Shape:
    """One mode ready to draw: surface points, motion scaled for drawing, and colours.

    Attributes
    ----------
    motion : (p, 3) complex drawn displacement, m
    colors : (p,) complex relative values; quantity : "displacement" (magnitude) or "potential"
    """

    surface: Surface
    motion: np.ndarray
    colors: np.ndarray
    quantity: str

    def at(self, phase: float) -> tuple[np.ndarray, np.ndarray]:
        """Points (p, 3) and relative colours (p,) at a phase of the oscillation, rad."""
        turn = np.exp(1j * phase)
        points = self.surface.points + (self.motion * turn).real
        if self.quantity == "potential":
            return points, (self.colors * turn).real
        return points, self.colors.real * abs(np.cos(phase))

    @property
    def limits(self) -> tuple[float, float]:
        """Range of the colours."""
        return (-1.0, 1.0) if self.quantity == "potential" else (0.0, 1.0)


def shapes_of(result: ModesResult, mode: DrivenMode, subdivisions: int = 4) -> tuple[Shape, ...]:
    """The pole's shape coloured by displacement and, where there is one, the zero's coloured by potential.

    With short-circuited electrodes the potential vanishes on them, so it is shown at the zero.
    """
    vectors = [(mode.pole_vector, "displacement", mode.pole_family)]
    if mode.zero_vector is not None:
        vectors.append((mode.zero_vector, "potential", mode.zero_family))
    return tuple(_shape(result, *entry, subdivisions) for entry in vectors)


def _shape(result: ModesResult, vector: np.ndarray, quantity: str, words: str, subdivisions: int) -> Shape:
    surface = surface_of(result.model, real_phase(vector)[:, None], subdivisions)
    displacement, potential = surface.displacement[0], surface.potential[0]
    hot, ground = (potential[surface.triangles[surface.electrode == label]].real.mean() for label in (HOT, GROUND))
    if quantity == "potential" and hot < ground:  # shown at the instant of positive voltage
        displacement, potential = -displacement, -potential
    size = np.linalg.norm(displacement.real, axis=1)
    largest = size.max()
    box = np.ptp(surface.points, axis=0)
    reach = _IN_THICKNESS * box.min() if "thickness" in words else _EXAGGERATION * box.max()
    reach = min(reach, _MOST_STRAIN * largest / _strain_along_edges(surface, displacement.real))
    if quantity == "potential":
        middle = (potential.real.max() + potential.real.min()) / 2  # only differences of potential mean anything
        centred = potential - middle
        colors = centred / max(np.abs(centred.real).max(), 1e-300)
    else:
        colors = size / largest + 0j
    return Shape(surface, displacement * (reach / largest), colors, quantity)


def _strain_along_edges(surface: Surface, displacement: np.ndarray) -> float:
    """Largest relative change of length of an edge of the triangles by a small displacement (p, 3)."""
    corners = surface.triangles
    along, moved = (np.diff(field[corners[:, [0, 1, 2, 0]]], axis=1) for field in (surface.points, displacement))
    squares = np.sum(along**2, axis=2)
    long = squares > (_SHORTEST * surface.extent) ** 2
    return float(np.max(np.abs(np.sum(along * moved, axis=2)[long]) / squares[long], initial=1e-300))


class Renderer:
    """One off-screen window that draws a shape again and again; close it after use (a context manager)."""

    def __init__(self, shape: Shape, window: tuple[int, int] = WINDOW) -> None:
        pv = pyvista_off_screen()
        self._shape = shape
        surface = shape.surface
        faces = np.hstack([np.full((len(surface.triangles), 1), 3), surface.triangles]).ravel()
        self._mesh = pv.PolyData(surface.points.copy(), faces)
        self._mesh["value"] = np.zeros(len(surface.points))
        self._plotter = plotter = pv.Plotter(off_screen=True, window_size=list(window))
        plotter.set_background("white")
        plotter.add_mesh(
            self._mesh,
            scalars="value",
            cmap=COLORS[shape.quantity],
            clim=shape.limits,
            show_scalar_bar=False,
            ambient=0.35,
            diffuse=0.7,
            specular=0.1,
            smooth_shading=False,
        )
        rest = pv.PolyData(surface.points, faces)
        self._borders = []
        for label in (HOT, GROUND):
            border = border_of(surface, label)
            if border.size:
                cells = np.hstack([np.full((len(border), 1), 2), np.arange(border.size).reshape(-1, 2)]).ravel()
                lines = pv.PolyData(surface.points[border.ravel()].copy(), lines=cells)
                color = ELECTRODE_COLORS[label]
                plotter.add_mesh(lines, color=color, line_width=5, render_lines_as_tubes=True, lighting=False)
                self._borders.append((lines, border.ravel()))
        outline = _sharp_edges(rest)
        if outline.n_points:
            plotter.add_mesh(outline, color="#555555", line_width=2)
        _aim(plotter, surface.points, largest=float(np.linalg.norm(shape.motion, axis=1).max()))
        plotter.enable_anti_aliasing("ssaa")

    def image(self, phase: float = 0.0) -> np.ndarray:
        """(height, width, 3) picture of the body at a phase of its oscillation."""
        points, colors = self._shape.at(phase)
        self._mesh.points = points
        self._mesh["value"] = colors
        for lines, where in self._borders:
            lines.points = points[where]
        self._plotter.render()
        return self._plotter.screenshot(return_img=True)

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self._plotter.close()


def border_of(surface: Surface, label: int) -> np.ndarray:
    """(m, 2) numbers of the points at the ends of the lines around an electrode, HOT or GROUND."""
    triangles = surface.triangles[surface.electrode == label]
    place = _places(surface.points, _SAME * surface.extent)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, first, count = np.unique(np.sort(place[edges], axis=1), axis=0, return_index=True, return_counts=True)
    border = edges[first[count == 1]]
    lengths = np.linalg.norm(np.diff(surface.points[border], axis=1)[:, 0], axis=1)
    return border[lengths > _SHORTEST * surface.extent]


def _places(points: np.ndarray, near: float) -> np.ndarray:
    """(p,) number of the place of each point (p, 3), the same for points within a distance along every axis."""
    numbers = np.empty(points.shape, dtype=int)
    for axis, values in enumerate(points.T):
        order = np.argsort(values, kind="stable")
        numbers[order, axis] = np.cumsum(np.append(False, np.diff(values[order]) > near))
    return np.unique(numbers, axis=0, return_inverse=True)[1].ravel()


def _sharp_edges(mesh):
    """The edges of the undeformed body, those around the pinhole of a disk left out."""
    extent = float(np.ptp(mesh.points, axis=0).max())
    edges = mesh.clean(tolerance=_SAME * extent, absolute=True).extract_feature_edges(
        feature_angle=40, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
    )
    lengths = edges.compute_cell_sizes(length=True, area=False, volume=False)["Length"]
    return edges.extract_cells(np.flatnonzero(lengths > _SHORTEST * extent))


def _aim(plotter, points: np.ndarray, above: bool = True, largest: float = 0.0) -> None:
    """Oblique view from above, or from the opposite side, that fits a body even where its points (p, 3) move by
    `largest`, m.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    center, half = (low + high) / 2, (high - low) / 2
    toward = np.array([0.55, -1.0, 0.75]) * (1 if above else -1)
    toward /= np.linalg.norm(toward)
    across = np.cross([0.0, 0.0, 1.0], toward)
    across /= np.linalg.norm(across)
    corners = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * (half + largest)
    width, height = plotter.window_size
    slope = np.tan(np.radians(_VIEW / 2))
    sideways, upwards = np.abs(corners @ across) * height / width, np.abs(corners @ np.cross(toward, across))
    needed = corners @ toward + np.maximum(sideways, upwards) / slope
    distance = max(3.5 * float(np.linalg.norm(half)), 1.02 * float(needed.max()))
    plotter.camera_position = [tuple(center + distance * toward), tuple(center), (0.0, 0.0, 1.0)]
    plotter.camera.view_angle = _VIEW


def cropped(image: np.ndarray, margin: int = 12) -> np.ndarray:
    """The picture without its white surroundings."""
    inked = np.any(image < 250, axis=2)
    rows, columns = np.flatnonzero(inked.any(axis=1)), np.flatnonzero(inked.any(axis=0))
    if not rows.size:
        return image
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    return image[top : rows[-1] + margin + 1, left : columns[-1] + margin + 1]


def electrode_image(result: ModesResult, above: bool = True, window: tuple[int, int] = (1000, 700)) -> np.ndarray:
    """(height, width, 3) picture of the body at rest: hot electrode red, ground blue, bare ceramic pale."""
    pv = pyvista_off_screen()
    surface = surface_of(result.model, result.modes[0].pole_vector[:, None])
    plotter = pv.Plotter(off_screen=True, window_size=list(window))
    plotter.set_background("white")
    for label, color in ELECTRODE_COLORS.items():
        triangles = surface.triangles[surface.electrode == label]
        if len(triangles):
            faces = np.hstack([np.full((len(triangles), 1), 3), triangles]).ravel()
            plotter.add_mesh(pv.PolyData(surface.points, faces), color=color, ambient=0.4, diffuse=0.65)
    faces = np.hstack([np.full((len(surface.triangles), 1), 3), surface.triangles]).ravel()
    outline = _sharp_edges(pv.PolyData(surface.points, faces))
    if outline.n_points:
        plotter.add_mesh(outline, color="#333333", line_width=2)
    _aim(plotter, surface.points, above)
    plotter.enable_anti_aliasing("ssaa")
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return cropped(image)
