"""`Diagnosed`: what the simulation gets wrong, the named cause, the gain."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from femu_piezo.diagnosis.verdict import Cause
from femu_piezo.files import write_atomically
from femu_piezo.inference.unknowns import Estimate
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.output.diagnosis import curves_text, diagnosis_figure, diagnosis_record
from femu_piezo.output.diagnosis_tables import diagnosis_table, ranked
from femu_piezo.output.folder import prepare_folder, write_figure, write_json
from femu_piezo.output.results.result import Result, suffixes
from femu_piezo.specimen.file import Measurement, Specimen, write_study
from femu_piezo.study.diagnose import Diagnosis, extended_specimen

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


class Diagnosed(Result, Diagnosis):
    """What `diagnose` returns: `verdict`, `causes`, `parameters` before and after, `gain`, `extended`.

    `str(result.verdict)` is "none", "effect" or "unknown", and so compares equal to it. With several sweeps
    `result.of(1)` shows the second.
    """

    files: ClassVar[tuple[str, ...]] = ("diagnosis.png", "curves.csv", "report.html")

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The named causes: `cause.parameters["resistance"].value`, `.std`, `.unit`; `cause.probability`."""
        return self.verdict.causes

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Free constants of the final model, with the named causes; `.interval` holds 95 %, averaged over causes."""
        return self.after

    @property
    def parameters_before(self) -> dict[str, Estimate]:
        """Free constants of the base model, without any cause."""
        return self.before

    @property
    def extended(self) -> Specimen:
        """The specimen shown with the named effects, as it was fitted; `result.extended.write("extended.toml")`."""
        return extended_specimen(self)

    def table(self) -> RenderableType:
        """Verdict, candidates, constants before and after."""
        return diagnosis_table(self)

    def plot(self, number: int | None = None) -> Figure:
        """Curves and residuals before and after, of the sweep `number`; of the one shown where None."""
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
        """Write diagnosis.json, diagnosis.png and curves.csv of every sweep, extended.toml of every specimen.

        With several specimens, extended.toml is the study file of all of them. A sweep in memory is written to
        measured.csv, so that the extended specimen has its data.

        report : write report.html as well, whose first page answers in plain words
        """
        out = prepare_folder(folder)
        pieces: dict[str, list[int]] = {}
        for index, suffix in enumerate(suffixes(len(self.sweeps))):
            shown = self.of(index)
            pieces.setdefault(shown.piece.name, []).append(index)
            write_figure(out / f"diagnosis{suffix}.png", shown.plot())
            write_atomically(out / f"curves{suffix}.csv", curves_text(shown))
            if report:
                from femu_piezo.output.report_diagnosis import write_diagnosis_report

                write_diagnosis_report(out / f"report{suffix}.html", shown)
        names = suffixes(len(pieces))
        for suffix, indices in zip(names, pieces.values(), strict=True):
            self._with_data(indices, out).write(out / f"extended{suffix}.toml")
        if len(names) > 1:
            write_study([f"extended{suffix}.toml" for suffix in names], out / "extended.toml")
        write_json(out / "diagnosis.json", diagnosis_record(self))
        return out

    def _with_data(self, indices: list[int], out: Path) -> Specimen:
        """The extended specimen of the sweeps of some indices, with their files.

        Where one has no file, all are written to measured.csv as the fit used them, after their corrections.
        """
        extended = self.of(indices[0]).extended
        files = [self.sweeps[index].specimen.measurement.file for index in indices]
        in_memory = None in files
        if in_memory:
            names = suffixes(len(self.sweeps))
            files = [(out / f"measured{names[index]}.csv").absolute() for index in indices]
            for index, file in zip(indices, files, strict=True):
                write_spectrum(self.sweeps[index].spectrum, file)
        table = extended.measurement or Measurement()
        if in_memory:
            table = table.of_corrected
        if extended.sweep is None:
            return extended.model_copy(update={"measurement": table.model_copy(update={"file": files[0]})})
        sweeps = zip(extended.sweep, files, strict=True)
        named = tuple(one.model_copy(update={"file": file}) for one, file in sweeps)
        return extended.model_copy(update={"sweep": named, "measurement": table if in_memory else extended.measurement})
