"""Readable pieces of sentences: sizes of effects, lists, bands of frequency, names of effects."""

from __future__ import annotations

from collections.abc import Sequence

from femu_piezo.diagnosis.verdict import Cause
from femu_piezo.effects.effect import Effect
from femu_piezo.output.curves import PRINTED


def plain(title: str) -> str:
    """The title of a cause in plain words."""
    return title.replace("_", " ").replace(":", " ")


def spoken(effect: Effect) -> str:
    """The name of a cause in plain words, with its law where it has one."""
    law = f" ({effect.law} law)" if effect.law else ""
    return plain(effect.title) + law


def sentence_case(words: str) -> str:
    """Words with a capital letter at the beginning; a Greek symbol there stays as it is."""
    return f"{words[0].upper()}{words[1:]}" if words[0].isascii() else words


def with_article(words: str) -> str:
    """a mass, an uneven body."""
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words}"


def listed(words: list[str] | tuple[str, ...], last: str = "and") -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def names_of(causes: Sequence[Cause]) -> str:
    """The names of causes, one or more, in plain words."""
    return listed([spoken(cause.effect) for cause in causes])


def alike_words(titles: Sequence[str]) -> list[str]:
    """What `Cause.indistinguishable_from` says: other causes with the same effect, and constants that imitate it."""
    constants = [title for title in titles if title.removeprefix("tan_") in PRINTED]
    causes = [title for title in titles if title not in constants]
    words = (
        [f"this sweep cannot distinguish it from {listed(causes, 'or')}, which may equally be the true cause"]
        if causes
        else []
    )
    if constants:
        words.append(
            f"a change of the free constants, mainly {listed(constants)}, has nearly the same effect on this sweep"
        )
    return words


def percent(share: float) -> str:
    """A share in per cent with three digits."""
    return f"{100 * share:.3g} %"


def band(low: float, high: float) -> str:
    """A band of frequencies, Hz, in kHz or MHz."""
    factor, unit = (1e-6, "MHz") if high >= 2e6 else (1e-3, "kHz")
    return f"{low * factor:.5g} to {high * factor:.5g} {unit}"


def merged(bands: tuple[tuple[float, float], ...], gap: float) -> list[tuple[float, float]]:
    """Bands in order of frequency, those less than a gap (Hz) apart joined."""
    found: list[tuple[float, float]] = []
    for low, high in sorted(bands):
        if found and low - found[-1][1] < gap:
            found[-1] = (found[-1][0], max(high, found[-1][1]))
        else:
            found.append((low, high))
    return found
