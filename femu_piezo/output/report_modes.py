"""Mode shapes in a report: the fundamental of each piece at the updated constants."""

from __future__ import annotations

from collections.abc import Sequence

from femu_piezo.effects.effect import Effect
from femu_piezo.errors import FemuPiezoError
from femu_piezo.output.modes import mode_figure
from femu_piezo.output.report import Section, paragraph, picture
from femu_piezo.specimen.file import CONSTANTS, Specimen
from femu_piezo.study.modes import modes
from femu_piezo.study.results import Outcome, UpdateResult


def mode_section(result: UpdateResult) -> Section:
    """The fundamental of each piece, once for all its sweeps: a picture, or a sentence where it cannot be drawn."""
    first = [outcome for outcome in result.outcomes if outcome.measured.conditions.number == 0]
    return Section("modes", "Mode shapes", "".join(_fundamental(result, outcome) for outcome in first))


def _fundamental(result: UpdateResult, outcome: Outcome) -> str:
    pair = outcome.measured.pair
    specimen = updated_specimen(outcome.measured.piece, result)
    return fundamental_picture(specimen, pair.pole.frequency_Hz, 1.2 * pair.zero.frequency_Hz)


def fundamental_picture(
    specimen: Specimen, near_Hz: float, highest_Hz: float, effects: Sequence[Effect] | None = None
) -> str:
    """The mode with the pole next to a frequency; a sentence where it cannot be drawn here.

    Parameters
    ----------
    specimen : with the updated constants
    highest_Hz : end of the band that is searched
    effects : further effects, besides those of the library, that its [effects] may name
    """
    try:
        found = modes(specimen, band=(0.0, highest_Hz), effects=effects)
        distance = [abs(mode.pole.frequency_Hz - near_Hz) for mode in found.modes]
        number = distance.index(min(distance))
        mode = found.modes[number]
        words = f"{specimen.name}: {mode.pole_family} at {mode.pole.frequency_Hz / 1e3:.6g} kHz (short circuit)"
        return picture(mode_figure(found, number), f"{words} with the updated constants; displacement exaggerated.")
    except (FemuPiezoError, RuntimeError, OSError) as error:  # a report without this picture is still a report
        return paragraph(f"The mode shape of {specimen.name} could not be drawn here: {error}.", "note")


def updated_specimen(specimen: Specimen, result: UpdateResult) -> Specimen:
    """The specimen with the updated constants in place of those of its file."""
    values = {name: getattr(result.constants, name).real for name in CONSTANTS}
    tangents = {f"tan_{name}": result.constants.tangent(name) for name in CONSTANTS}
    return specimen.model_copy(update={"material": specimen.material.model_copy(update=values | tangents)})
