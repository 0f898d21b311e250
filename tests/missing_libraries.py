"""Skips tests that fail because the machine lacks shared libraries of gmsh or VTK, and says what to install."""

from __future__ import annotations

import re
from functools import cache

import pytest


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


@cache
def drawing_lacks() -> str:
    """What VTK lacks to draw without a display, and how to get it; "" where it can draw."""
    from femu_piezo.errors import InputError
    from femu_piezo.output.off_screen import RENDER_PACKAGES, pyvista_off_screen

    try:
        pyvista_off_screen()
        return ""
    except InputError:
        return f"VTK lacks libEGL and libOSMesa: apt-get install {RENDER_PACKAGES}"


#: Part of an error message of femu_piezo → function that says what is missing.
_SENTENCES = {
    "gmsh cannot be loaded on this machine": gmsh_lacks,
    "mode pictures need a library to draw with": drawing_lacks,
}


def skip_without_libraries(report: pytest.TestReport) -> None:
    """Turn a failed report into a skipped one if its error says that a library is missing, and it is."""
    if not report.failed:
        return
    told = "\n".join([report.longreprtext, *(text for _, text in report.sections)])
    for sentence, lacks in _SENTENCES.items():
        if sentence in told and (missing := lacks()):
            report.outcome = "skipped"
            report.longrepr = (__file__, 1, f"Skipped: {missing}")
