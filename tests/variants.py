"""Parameters of a test or fixture of which some are marked slow."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import pytest


def variants(every: Iterable[str], slow: Collection[str]) -> list:
    """Each of `every` as a parameter; those in `slow` are marked slow."""
    return [pytest.param(one, marks=[pytest.mark.slow] * (one in slow)) for one in every]
