"""Tests that fail because the machine lacks shared libraries of gmsh are skipped, and say what to install."""

from __future__ import annotations

import re
from functools import cache

import pytest

#: How `femu_piezo.geometry.gmsh_session` says that gmsh cannot be loaded, and what Debian has against it.
_SENTENCE = re.compile(r"gmsh cannot be loaded on this machine")


@cache
def gmsh_lacks() -> str:
    """What gmsh lacks on this machine, and how to get it; "" where it can be loaded."""
    from femu_piezo.errors import InputError
    from femu_piezo.geometry.gmsh_session import GMSH_PACKAGES, gmsh_session

    try:
        with gmsh_session():
            return ""
    except InputError as error:
        library = re.search(r"lib\w+\.so[.\d]*", str(error))
        return f"gmsh lacks {library[0] if library else 'shared libraries'}: apt-get install {GMSH_PACKAGES}"


def skip_without_gmsh(report: pytest.TestReport) -> None:
    """Make a failure that says that gmsh cannot be loaded a skip, where that is so."""
    if not report.failed:
        return
    told = "\n".join([report.longreprtext, *(text for _, text in report.sections)])
    if _SENTENCE.search(told) and (missing := gmsh_lacks()):
        report.outcome = "skipped"
        report.longrepr = (__file__, 1, f"Skipped: {missing}")
