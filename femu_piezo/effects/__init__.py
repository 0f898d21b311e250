"""Effects: what a real specimen has and the base model leaves out, as data; `library` is the list of those known."""

from femu_piezo.effects import library
from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, ExtraTerm, LocalTerm

__all__ = ["Effect", "EffectContext", "EffectParameter", "ExtraTerm", "LocalTerm", "library"]
