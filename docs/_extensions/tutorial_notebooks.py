"""The tutorials as notebooks for myst-nb: scripts in cells, whose pictures show below the cell that wrote them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import jupytext
import nbformat

PACKAGE = Path(__file__).resolve().parents[2] / "femu_piezo"
#: Runs first in every tutorial and is not shown. Its last line makes the cache of results that of these sources.
_FIRST_CELL = """\
import sys
sys.path.insert(0, {folder!r})
from tutorial_notebooks import show_new_pictures
get_ipython().events.register("post_run_cell", show_new_pictures())
# sources of femu_piezo: {digest}
"""


def read(text: str) -> nbformat.NotebookNode:
    """The notebook of a tutorial, from its text."""
    notebook = jupytext.reads(text, fmt="py:percent")
    first = nbformat.v4.new_code_cell(_FIRST_CELL.format(folder=str(Path(__file__).parent), digest=_digest()))
    first.metadata["tags"] = ["remove-cell"]
    notebook.cells.insert(0, first)
    notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return notebook


def _digest() -> str:
    """A hash of everything in the package that a result may depend on."""
    sources = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        sources.update(path.read_bytes())
    return sources.hexdigest()


def show_new_pictures():
    """A hook for IPython: after a cell, show the pictures that it wrote into the folder of results."""
    import os

    from IPython.display import Image, display

    folder = Path(os.environ["FEMU_PIEZO_OUT"])
    shown = {path: path.stat().st_mtime_ns for path in folder.rglob("*.png")}

    def show(result) -> None:
        for path in sorted(folder.rglob("*.png")):
            written = path.stat().st_mtime_ns
            if shown.get(path) != written:
                shown[path] = written
                display(Image(filename=str(path), alt=path.stem.replace("_", " ")))

    return show
