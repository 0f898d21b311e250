"""`Identified`: which constants sweeps can determine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from femu_piezo.output.folder import prepare_folder, write_figure, write_json
from femu_piezo.output.plan_files import write_plan
from femu_piezo.output.results.result import Result, suffixes
from femu_piezo.output.tables import identifiability_table
from femu_piezo.study.identify import IdentifyResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Identified(Result, IdentifyResult):
    """What `identify` returns: how well sweeps determine each of the ten constants, and `recommendations`.

    `expected.parameters` are the free constants as an update would state them, `expected.improvements` the tolerances,
    of which the first is the one to improve.
    """

    files: ClassVar[tuple[str, ...]] = (
        "sensitivity.png",
        "study.png",
        "plan.csv",
        "plan_segments.csv",
        "plan_e4990a.scpi",
    )

    _index = "constant"

    def table(self) -> RenderableType:
        """Predicted standard deviations, and what to measure next."""
        return identifiability_table(self)

    def plot(self, number: int | None = None) -> Figure:
        """Sensitivity of one sweep to every constant."""
        from femu_piezo.output.sensitivity import sensitivity_figure

        return sensitivity_figure(self.sensitivities[number or 0])

    def rows(self) -> list[dict[str, Any]]:
        """One row for each constant; its deviations are infinite where the sweeps tell nothing of it."""
        known = self.known
        return [
            {
                "constant": name,
                "determined": known.verdict(name),
                "relative_std": float(known.std[index]),
                "relative_std_if_all_else_known": float(known.std_alone[index]),
                "tan_std": float(known.std[known.names.index(f"tan_{name}")]),
            }
            for index, name in enumerate(known.names)
            if f"tan_{name}" in known.names
        ]

    def save(self, folder: Path | str) -> Path:
        """Write identifiability.json, budget.png, and sensitivity.png of every sweep; the folder.

        A study adds study.png, a plan adds plan.csv, plan_segments.csv and plan_e4990a.scpi.
        """
        from femu_piezo.output.budget_chart import budget_figure

        out = prepare_folder(folder)
        title = f"{' + '.join(self.names)}: where the deviations will come from"
        write_figure(out / "budget.png", budget_figure(title, self.expected.parameters))
        for number, suffix in enumerate(suffixes(len(self.sensitivities))):
            write_figure(out / f"sensitivity{suffix}.png", self.plot(number))
        if self.study:
            from femu_piezo.output.noise_study import noise_study_figure

            write_figure(out / "study.png", noise_study_figure(" + ".join(self.names), self.study))
        if self.plan is not None:
            write_plan(out, self.plan.frequency)
        write_json(out / "identifiability.json", self.to_json())
        return out
