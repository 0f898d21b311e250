"""`Diagnosed`: what the simulation gets wrong, the named cause, the gain."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from femu_piezo.diagnosis.verdict import Cause
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.output.diagnosis import diagnosis_figure, diagnosis_record
from femu_piezo.output.diagnosis_tables import diagnosis_table, ranked
from femu_piezo.output.folder import prepare_folder, write_figure, write_json
from femu_piezo.output.results.result import Result, suffixes
from femu_piezo.specimen.file import Specimen, write_study
from femu_piezo.study.diagnose import Diagnosis, extended_specimen

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Diagnosed(Result, Diagnosis):
    """What `diagnose` returns: `verdict`, `causes`, `parameters` before and after, `gain`, `extended`.

    `str(result.verdict)` is "none", "effect" or "unknown", and so compares equal to it. Of several specimens
    `result.of(1)` shows the second.
    """

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The named causes: `cause.parameters["resistance"].value`, `.std`, `.unit`; `cause.probability`."""
        return self.verdict.causes

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Free constants with what is named in the model."""
        return self.constants(self.comparison.final)

    @property
    def parameters_before(self) -> dict[str, Estimate]:
        """Free constants by the base model."""
        return self.constants(self.comparison.base)

    @property
    def extended(self) -> Specimen:
        """The specimen shown with the named effects, as it was fitted; `result.extended.write("extended.toml")`."""
        return extended_specimen(self)

    def table(self) -> RenderableType:
        """Verdict, candidates, constants before and after."""
        return diagnosis_table(self)

    def plot(self, number: int | None = None) -> Figure:
        """Curves and residuals before and after, of the specimen `number`; of the one shown where None."""
        return diagnosis_figure(self if number is None else self.of(number))

    def rows(self) -> list[dict[str, Any]]:
        """One row for each parameter of each candidate, tried alone; the most probable first."""
        named = {cause.effect.key: cause.probability for cause in self.causes}
        return [
            {
                "effect": trial.effect.key,
                "parameter": parameter.name,
                "value": float(value),
                "std": float(std),
                "unit": parameter.unit,
                "log_odds": trial.log_odds,
                "probability": named.get(trial.effect.key),
            }
            for trial in ranked(self)
            for parameter, value, std in zip(trial.effect.parameters, trial.values, trial.std, strict=True)
        ]

    def save(self, folder: Path | str, *, report: bool = False) -> Path:
        """Write diagnosis.json and of every specimen diagnosis.png and extended.toml; the folder.

        Of several specimens extended.toml is the study file of all. A sweep in memory is written to measured.csv, so
        that the extended specimen has its data.

        report : report.html as well, whose first page answers in plain words
        """
        out = prepare_folder(Path(folder))
        names = suffixes(len(self.sweeps))
        for index, suffix in enumerate(names):
            shown = self.of(index)
            write_figure(out / f"diagnosis{suffix}.png", shown.plot())
            _with_data(shown, out / f"measured{suffix}.csv").write(out / f"extended{suffix}.toml")
            if report:
                from femu_piezo.output.report_diagnosis import write_diagnosis_report

                write_diagnosis_report(out / f"report{suffix}.html", shown)
        if len(names) > 1:
            write_study([f"extended{suffix}.toml" for suffix in names], out / "extended.toml")
        write_json(out / "diagnosis.json", diagnosis_record(self))
        return out


def _with_data(shown: Diagnosed, path: Path) -> Specimen:
    """The extended specimen; a sweep that has no file is written to `path`, as it was after its corrections."""
    extended = shown.extended
    if extended.measurement.file is not None:
        return extended
    write_spectrum(shown.spectrum, path)
    table = {"file": path.absolute(), "correct_phase": False, "mask_faults": False}
    return extended.model_copy(update={"measurement": extended.measurement.model_copy(update=table)})
