"""Mode shapes as figures: one mode at its pole and zero, the overview sheet of a band, the animation."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from femu_piezo.output.picture import Picture, as_it_stands
from femu_piezo.output.render import (
    COLORS,
    ELECTRODE_COLORS,
    WINDOW,
    Renderer,
    Shape,
    cropped,
    electrode_image,
    shapes_of,
)
from femu_piezo.output.surface import GROUND, HOT

if TYPE_CHECKING:
    from femu_piezo.resonances import Resonance
    from femu_piezo.study.modes import DrivenMode, ModesResult


def mode_figure(result: ModesResult, number: int) -> Figure:
    """One mode: pole and zero side by side, with frequencies, loss, k_eff and what it does in words."""
    mode = result.modes[number]
    shapes = shapes_of(result, mode)
    images = [_image(shape, WINDOW) for shape in shapes]
    height = max(image.shape[0] / image.shape[1] for image in images) * 6.0 + 2.1
    figure = Picture(figsize=(6.2 * len(shapes), height), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(shapes)))
    for axis, shape, image, (resonance, words) in zip(axes, shapes, images, _described(mode), strict=True):
        axis.imshow(image)
        axis.set_axis_off()
        axis.set_title(f"{words}\n{_numbers(resonance)}", fontsize=11)
        _color_bar(figure, axis, shape)
    figure.suptitle(_headline(result, number), fontsize=13, fontweight="bold")
    figure.legend(
        handles=[
            Patch(color=ELECTRODE_COLORS[HOT], label="edge of the hot electrode"),
            Patch(color=ELECTRODE_COLORS[GROUND], label="edge of the ground electrode"),
            Patch(color="#555555", label="body at rest"),
        ],
        loc="outside lower center",
        ncols=3,
        frameon=False,
        fontsize=9,
    )
    return figure


def _described(mode: DrivenMode):
    yield mode.pole, f"pole (short circuit): {mode.pole_family}"
    if mode.zero is not None:
        yield mode.zero, f"zero (open circuit): {mode.zero_family}"


def _headline(result: ModesResult, number: int) -> str:
    mode = result.modes[number]
    coupling = "" if mode.k_eff is None else f", $k_\\mathrm{{eff}}$ = {mode.k_eff:.3f}"
    return f"{as_it_stands(result.specimen.name)}: mode {number + 1}, {mode.pole_family}{coupling}"


def _frequency(value: float) -> str:
    return f"{value / 1e6:.5g} MHz" if value >= 1e6 else f"{value / 1e3:.5g} kHz"


def _color_bar(figure: Figure, axis, shape: Shape) -> None:
    mappable = ScalarMappable(Normalize(*shape.limits), COLORS[shape.quantity])
    label = "|u| / max |u|" if shape.quantity == "displacement" else "φ / max |φ|, from the mean of its extremes"
    bar = figure.colorbar(mappable, ax=axis, orientation="horizontal", shrink=0.6, aspect=32, pad=0.02)
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8)


def overview_figure(result: ModesResult) -> Figure:
    """All driven modes of the band on one sheet, at their poles, and the body at rest with its electrodes."""
    images = [_stacked(electrode_image(result, above=True), electrode_image(result, above=False))]
    titles = ["electrodes, from two opposite sides:\nhot red, ground blue, bare ceramic pale"]
    for number, mode in enumerate(result.modes, start=1):
        images.append(_image(shapes_of(result, mode)[0], (1000, 700)))
        coupling = "" if mode.k_eff is None else f", $k_\\mathrm{{eff}}$ = {mode.k_eff:.3f}"
        titles.append(f"{number}: {mode.pole_family}\n{_numbers(mode.pole)}{coupling}")
    columns = min(3, len(images))
    rows = -(-len(images) // columns)
    tallest = max(image.shape[0] / image.shape[1] for image in images[1:])
    figure = Picture(figsize=(4.6 * columns, (4.4 * max(tallest, 0.5) + 0.75) * rows + 0.9), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axis in axes:
        axis.set_axis_off()
    for axis, image, title in zip(axes, images, titles, strict=False):
        axis.imshow(image)
        axis.set_title(title, fontsize=10)
    low, high = result.band
    band = f"up to {_frequency(high)}" if low == 0 else f"from {_frequency(low)} to {_frequency(high)}"
    title = f"{as_it_stands(result.specimen.name)}: driven modes {band}"
    figure.suptitle(f"{title}\n(poles, coloured by |u| from dark to bright)", fontsize=13)
    return figure


def _image(shape: Shape, window: tuple[int, int]) -> np.ndarray:
    with Renderer(shape, window) as renderer:
        return cropped(renderer.image())


def _stacked(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Two pictures, one above the other."""
    width = max(upper.shape[1], lower.shape[1])
    padded = []
    for image in (upper, lower):
        space = width - image.shape[1]
        padded.append(np.pad(image, ((20, 20), (space // 2, space - space // 2), (0, 0)), constant_values=255))
    return np.concatenate(padded)


def _numbers(resonance: Resonance) -> str:
    loss = f"loss {resonance.loss:.4f}" if resonance.loss > 1e-9 else "no loss"
    return f"{_frequency(resonance.frequency_Hz)}, {loss}"


def animation(result: ModesResult, number: int, frames: int = 24) -> bytes:
    """One mode's pole over a period of its oscillation as an animated GIF that repeats for ever."""
    from PIL import Image

    shape = shapes_of(result, result.modes[number])[0]
    with Renderer(shape, (800, 560)) as renderer:
        pictures = [renderer.image(2 * np.pi * frame / frames) for frame in range(frames)]
    images = [Image.fromarray(picture).convert("P", palette=Image.Palette.ADAPTIVE, colors=128) for picture in pictures]
    buffer = io.BytesIO()
    images[0].save(buffer, "GIF", save_all=True, append_images=images[1:], duration=50, loop=0, optimize=True)
    return buffer.getvalue()
