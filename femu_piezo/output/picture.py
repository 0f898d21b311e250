"""`Picture`: a matplotlib figure that a notebook shows by itself, also where pyplot was never imported."""

from __future__ import annotations

import io
import itertools
import re
import textwrap
from collections.abc import Iterator

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogFormatterSciNotation, NullLocator

#: Decades of a logarithmic axis from which it has no minor ticks: laying them out takes longer than all else.
_DECADES = 2.0
#: Width of a title as a share of the columns of plots that it stands over.
_ROOM = 0.85
_RAISED = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def as_it_stands(text: str) -> str:
    """Words that hold a name of the user, of whose dollar signs matplotlib makes no formula."""
    return text.replace("$", r"\$")


def margins(size: tuple[float, float], left: float, right: float, below: float, above: float) -> dict[str, float]:
    """Edges of a grid of charts, as `gridspec_kw` takes them, that leave so much room beside it.

    For many charts below each other: matplotlib takes twice as long to find a layout as to draw them, and aligned
    labels then stand where they were before it.

    size : width and height of the whole picture, inches, as the room is
    """
    width, height = size
    return {"left": left / width, "right": 1 - right / width, "bottom": below / height, "top": 1 - above / height}


class PowersOfTen(LogFormatterSciNotation):
    """Ticks 10³ and 2×10³ as plain text, which is laid out in a tenth of the time that formulas take."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The label of a tick at x."""
        formula = super().__call__(x, pos).replace(r"\times", "×").replace(r"\mathdefault", "")
        return re.sub(r"\^\{([^}]*)\}", lambda power: power[1].translate(_RAISED), formula).strip("${}")


class Picture(Figure):
    """A `matplotlib.figure.Figure` that belongs to no window."""

    def savefig(self, fname, **kwargs) -> None:
        """As `matplotlib.figure.Figure.savefig`, without minor ticks on long logarithmic axes; PNG is drawn once.

        Titles wider than their room are broken into lines.
        """
        self._fit_titles()
        for axes in self.axes:
            for axis in (axes.xaxis, axes.yaxis):
                if axis.get_scale() != "log":
                    continue
                low, high = axis.get_view_interval()
                if high > 10**_DECADES * low:
                    axis.set_minor_locator(NullLocator())
                for now, change in (
                    (axis.get_major_formatter(), axis.set_major_formatter),
                    (axis.get_minor_formatter(), axis.set_minor_formatter),
                ):
                    if type(now) is LogFormatterSciNotation:
                        change(PowersOfTen(labelOnlyBase=now.labelOnlyBase, minor_thresholds=now.minor_thresholds))
        if kwargs.keys() <= {"format", "dpi"} and kwargs.get("format") == "png":
            self._write_png(fname, kwargs.get("dpi"))
        else:
            super().savefig(fname, **kwargs)

    def _fit_titles(self) -> None:
        """Break titles wider than their room at spaces; one with a word wider than that gets smaller letters."""
        renderer = FigureCanvasAgg(self).get_renderer()

        def width(text: Text) -> float:
            return text.get_window_extent(renderer).width / self.bbox.width

        for text, room in self._titles():
            if width(text) > room:
                lines = text.get_text().split("\n")
                most = int(max(map(len, lines)) * room / width(text))
                broken = (textwrap.wrap(line, most, break_long_words=False, break_on_hyphens=False) for line in lines)
                text.set_text("\n".join(itertools.chain.from_iterable(broken)))
                text.set_fontsize(text.get_fontsize() * min(1.0, room / width(text)))

    def _titles(self) -> Iterator[tuple[Text, float]]:
        """Every title, and the room that it has as a share of the width of the picture."""
        yield from ((text, _ROOM) for text in self.texts if text.get_text() == self.get_suptitle())
        for axes in self.axes:
            place, words = axes.get_subplotspec(), {axes.get_title(side) for side in ("left", "center", "right")}
            if place is not None:
                share = len(place.colspan) / place.get_gridspec().ncols
                titles = (
                    one for one in axes.get_children() if isinstance(one, Text) and one.get_text() in words - {""}
                )
                yield from ((text, _ROOM * share) for text in titles)

    def _write_png(self, fname, dpi: float | None) -> None:
        """Find the layout and draw in one pass; `Figure.savefig` draws once more to find the layout."""
        before = self.dpi
        try:
            self.set_dpi(dpi or before)
            FigureCanvasAgg(self).print_png(fname)
        finally:
            self.set_dpi(before)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()
