"""Docstrings are plain text with `names`, formulas and numpy's sections: what would be markup in reST is escaped."""

from __future__ import annotations

import re

from sphinx.application import Sphinx

#: What stays as it is: `names`, ``code`` and :role:`targets`; and what is escaped.
_PARTS = re.compile(r"(:\w+:`[^`]*`|``[^`]+``|`[^`]+`)|([*|_\\])")


def _plain(line: str) -> str:
    escaped = _PARTS.sub(lambda part: part[1] or "\\" + part[2], line)
    return re.sub(r"(`[^`]+`)(?=\w)", r"\1\\ ", escaped)  # the s of several `Cell`s


def escape(app: Sphinx, what: str, name: str, item: object, options: object, lines: list[str]) -> None:
    """Escape markup, and let an indented block below a paragraph, such as a formula, be a block of its own."""
    found: list[str] = []
    for line in lines:
        before = found[-1] if found else ""
        indented = len(line) - len(line.lstrip()) > len(before) - len(before.lstrip())
        if line.strip() and before.strip() and indented and not before.lstrip().startswith((":", ".. ")):
            found.append("")
        found.append(line if line.lstrip().startswith((">>>", ".. ")) else _plain(line))
    lines[:] = found


def escape_help(app: Sphinx, context: object, lines: list[str]) -> None:
    """The same for the help of a command."""
    lines[:] = [f"| {_plain(line[2:])}" if line.startswith("| ") else _plain(line) for line in lines]


def of_this_package(app: Sphinx, what: str, name: str, item: object, skip: bool, options: object) -> bool | None:
    """Skip what a module has from elsewhere."""
    return True if not str(getattr(item, "__module__", "femu_piezo")).startswith("femu_piezo") else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Runs before napoleon reads the sections."""
    app.connect("autodoc-process-docstring", escape, priority=400)
    app.connect("autodoc-skip-member", of_this_package)
    app.connect("sphinx-click-process-description", escape_help)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
