"""`Modes`: the driven modes of a specimen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from femu_piezo.output.folder import prepare_folder, write_binary, write_figure, write_json
from femu_piezo.output.results.result import Result
from femu_piezo.output.tables import modes_table
from femu_piezo.study.modes import ModesResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Modes(Result, ModesResult):
    """What `modes` returns: the driven `modes`, each with pole, zero, k_eff and what the body does."""

    def table(self) -> RenderableType:
        """Pole, zero and k_eff of every mode."""
        return modes_table(self)

    def plot(self, number: int | None = None) -> Figure:
        """One mode at its pole and zero; all of them on one sheet where None."""
        from femu_piezo.output.modes import mode_figure, overview_figure

        return overview_figure(self) if number is None else mode_figure(self, number)

    def rows(self) -> list[dict[str, Any]]:
        """One row for each mode."""
        return [
            {
                "pole_Hz": mode.pole.frequency_Hz,
                "pole_loss": mode.pole.loss,
                "zero_Hz": None if mode.zero is None else mode.zero.frequency_Hz,
                "zero_loss": None if mode.zero is None else mode.zero.loss,
                "k_eff": mode.k_eff,
                "participation": mode.participation,
                "family": mode.pole_family,
            }
            for mode in self.modes
        ]

    def save(self, folder: Path | str, *, animate: bool = False, scene: bool = False) -> Path:
        """Write modes.json, mode_01.png, mode_02.png … and the sheet modes.png; the folder.

        Parameters
        ----------
        animate : mode_01.gif … as well
        scene : modes.html as well, an interactive scene
        """
        from femu_piezo.output.modes import animation

        out = prepare_folder(Path(folder))
        for number in range(len(self.modes)):
            write_figure(out / f"mode_{number + 1:02d}.png", self.plot(number), 200)
            if animate:
                write_binary(out / f"mode_{number + 1:02d}.gif", animation(self, number))
        write_figure(out / "modes.png", self.plot(), 200)
        if scene:
            from femu_piezo.output.scene import scene_html

            write_binary(out / "modes.html", scene_html(self).encode("utf-8"))
        write_json(out / "modes.json", self.to_json())
        return out
