"""Variants of a test of which some are slow."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import pytest


def variants(every: Iterable[str], slow: Collection[str]) -> list:
    """Each as a parameter of a test or fixture; those of `slow` are left to `pytest -m slow`."""
    return [pytest.param(one, marks=[pytest.mark.slow] * (one in slow)) for one in every]
