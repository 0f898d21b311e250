"""`Picture`: a matplotlib figure that a notebook shows by itself, also where pyplot was never imported."""

from __future__ import annotations

import io

from matplotlib.figure import Figure


class Picture(Figure):
    """A `matplotlib.figure.Figure` that belongs to no window."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()
