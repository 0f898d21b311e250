"""`Picture`: a matplotlib figure that a notebook shows by itself, also where pyplot was never imported."""

from __future__ import annotations

import io
import re

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, NullLocator

#: Decades of a logarithmic axis from which it has no minor ticks: laying them out takes longer than all else.
_DECADES = 2.0
_RAISED = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def as_it_stands(text: str) -> str:
    """Words that hold a name of the user, of whose dollar signs matplotlib makes no formula."""
    return text.replace("$", r"\$")


class PowersOfTen(LogFormatterSciNotation):
    """Ticks 10³ and 2×10³ as plain text, which is laid out in a tenth of the time that formulas take."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The label of a tick at x."""
        formula = super().__call__(x, pos).replace(r"\times", "×").replace(r"\mathdefault", "")
        return re.sub(r"\^\{([^}]*)\}", lambda power: power[1].translate(_RAISED), formula).strip("${}")


class Picture(Figure):
    """A `matplotlib.figure.Figure` that belongs to no window."""

    def savefig(self, fname, **kwargs) -> None:
        """As `matplotlib.figure.Figure.savefig`, without minor ticks on long logarithmic axes; PNG is drawn once."""
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
