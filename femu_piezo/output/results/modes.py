"""`Modes`: the driven modes of a specimen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from femu_piezo.output.folder import prepare_folder, write_binary, write_figure, write_json
from femu_piezo.output.results.result import Result
from femu_piezo.output.tables import modes_table
from femu_piezo.study.modes import ModesResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Modes(Result, ModesResult):
    """What `modes` returns: the driven `modes`, each with pole, zero, k_eff and what the body does."""

    files: ClassVar[tuple[str, ...]] = ("mode.png", "mode.gif", "mode.vtu", "modes.html", "mesh.msh", "mesh.inp")

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

    def save(
        self, folder: Path | str, *, animate: bool = False, scene: bool = False, vtu: bool = False, mesh: bool = False
    ) -> Path:
        """Write modes.json, mode_01.png, mode_02.png … and the sheet modes.png; the folder.

        Parameters
        ----------
        animate : write mode_01.gif … as well
        scene : modes.html as well, an interactive scene
        vtu : mode_01.vtu … as well: displacement and potential at pole and zero in the whole body
        mesh : mesh.msh and mesh.inp as well, with the electrodes
        """
        from femu_piezo.output.modes import animation

        out = prepare_folder(folder)
        for number in range(len(self.modes)):
            write_figure(out / f"mode_{number + 1:02d}.png", self.plot(number), 200)
            if animate:
                write_binary(out / f"mode_{number + 1:02d}.gif", animation(self, number))
        write_figure(out / "modes.png", self.plot(), 200)
        if scene:
            from femu_piezo.output.scene import scene_html

            write_binary(out / "modes.html", scene_html(self).encode("utf-8"))
        if vtu or mesh:
            self._save_volume(out, vtu, mesh)
        write_json(out / "modes.json", self.to_json())
        return out

    def _save_volume(self, out: Path, vtu: bool, mesh: bool) -> None:
        from femu_piezo.output.volume import mesh_inp, mesh_msh, volume_of, vtu_of_mode

        states = [
            (number, name, vector)
            for number, mode in enumerate(self.modes)
            for name, vector in (("pole", mode.pole_vector), ("zero", mode.zero_vector))
            if vtu and vector is not None
        ]
        vectors = [vector for _, _, vector in states]
        volume = volume_of(self.model, np.array(vectors).T if vectors else np.zeros((self.model.size, 0)))
        for number in range(len(self.modes) if vtu else 0):
            fields = {name: volume.fields[i] for i, (of_mode, name, _) in enumerate(states) if of_mode == number}
            write_binary(out / f"mode_{number + 1:02d}.vtu", vtu_of_mode(volume, fields))
        if mesh:
            write_binary(out / "mesh.msh", mesh_msh(volume))
            write_binary(out / "mesh.inp", mesh_inp(volume))
