"""`Picture`: a matplotlib figure that a notebook shows by itself, also where pyplot was never imported."""

from __future__ import annotations

import io

from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

#: Decades of a logarithmic axis from which it has no minor ticks: laying them out takes longer than all else.
_DECADES = 2.0


class Picture(Figure):
    """A `matplotlib.figure.Figure` that belongs to no window."""

    def savefig(self, fname, **kwargs) -> None:
        """As `matplotlib.figure.Figure.savefig`, without minor ticks on long logarithmic axes."""
        for axes in self.axes:
            for axis in (axes.xaxis, axes.yaxis):
                low, high = axis.get_view_interval()
                if axis.get_scale() == "log" and high > 10**_DECADES * low:
                    axis.set_minor_locator(NullLocator())
        super().savefig(fname, **kwargs)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()
