"""`Result`: what every result can do: print itself, show itself in a notebook, be drawn, tabulated and saved."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from femu_piezo.output.tables import as_html, as_text

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from femu_piezo.resonances import Resonance


class Result(ABC):
    """Base class of the results; most classes here derive from it and from a result of `femu_piezo.study`."""

    _index: ClassVar[str | None] = None  # the column that names the rows
    #: Files that `save` does not write each time; one stands for those with numbers, impedance.png for impedance_2.png.
    files: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def of_study(cls, result: Any) -> Self:
        """A result of `femu_piezo.study` as an object of this class."""
        return cls(**{field.name: getattr(result, field.name) for field in fields(result)})

    @abstractmethod
    def table(self) -> RenderableType:
        """What the command line prints, for rich."""

    @abstractmethod
    def plot(self, number: int | None = None) -> Figure:
        """The picture of the result; `number` is that of the sweep or the mode where there are several."""

    @abstractmethod
    def rows(self) -> list[dict[str, Any]]:
        """The rows of `to_dataframe`, SI units; column → value."""

    @abstractmethod
    def save(self, folder: Path | str) -> Path:
        """Write the files of the command line into a folder, which is made where it does not exist; the folder."""

    def to_dataframe(self) -> pandas.DataFrame:
        """The rows as a table of pandas; ImportError where pandas is not installed."""
        try:
            import pandas
        except ImportError:
            raise ImportError(
                "to_dataframe needs pandas, which is not installed: pip install 'femu-piezo[notebook]'; "
                "rows() gives the same as a list of dictionaries"
            ) from None
        table = pandas.DataFrame(self.rows())
        return table if self._index is None else table.set_index(self._index)

    def __repr__(self) -> str:
        return as_text(self.table())

    def _repr_html_(self) -> str:
        return as_html(self.table())


def resonance_rows(resonances: Iterable[Resonance]) -> list[dict[str, Any]]:
    """One row for each pole or zero, SI units."""
    return [
        {
            "kind": one.kind,
            "frequency_Hz": one.frequency_Hz,
            "std_Hz": one.std_Hz,
            "loss": one.loss,
            "std_loss": one.std_loss,
            "quality_factor": one.quality_factor,
        }
        for one in resonances
    ]


def suffixes(count: int) -> list[str]:
    """Suffixes of the names of files: "_1", "_2", … for several specimens or sweeps, "" for a single one."""
    return [f"_{index + 1}" for index in range(count)] if count > 1 else [""]
