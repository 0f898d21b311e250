"""One self-contained HTML page of results: sections in, page out; nothing is loaded from anywhere else.

    write_report(path, title, subtitle, [*update_sections(result), provenance_section(...)], record)

A command brings its sections (`femu_piezo.output.report_update` those of an update) and the record that it also
writes as JSON; the record is embedded in the page, so that the file alone holds every number at full precision.
"""

from __future__ import annotations

import base64
import hashlib
import html
import io
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata, resources
from pathlib import Path

from matplotlib.figure import Figure

from femu_piezo.files import with_schema, write_atomically
from femu_piezo.output.chart import embedded
from femu_piezo.specimen.file import Specimen

#: Packages on whose versions the numbers depend.
_DISTRIBUTIONS = ("femu-piezo", "numpy", "scipy", "scikit-fem", "gmsh", "pyvista", "matplotlib")


@dataclass(frozen=True)
class Section:
    """A titled part of a report; `body` is HTML."""

    name: str
    title: str
    body: str


def write_report(path: Path, title: str, subtitle: str, sections: Sequence[Section], record: dict) -> None:
    """Write the page, whole or not at all.

    Parameters
    ----------
    record : what the command writes as JSON, embedded under the id "record"
    """
    write_atomically(path, report_html(title, subtitle, sections, with_schema(record)))


def report_html(title: str, subtitle: str, sections: Sequence[Section], record: dict) -> str:
    """The page as text; see `write_report`."""
    folder = resources.files("femu_piezo.output")
    parts = {
        "__TITLE__": html.escape(title),
        "__SUBTITLE__": html.escape(subtitle),
        "__VERSION__": metadata.version("femu-piezo"),
        "__CONTENTS__": " ".join(f'<a href="#{one.name}">{html.escape(one.title)}</a>' for one in sections),
        "__SECTIONS__": "\n".join(
            f'<section id="{one.name}"><h2>{html.escape(one.title)}</h2>\n{one.body}\n</section>' for one in sections
        ),
        "__RECORD__": embedded(record),
        "__SCRIPT__": folder.joinpath("report.js").read_text(encoding="utf-8"),
    }
    page = folder.joinpath("report.html").read_text(encoding="utf-8")
    pieces = page.split("__")  # split once, so that no part is searched for the names of others
    return "".join(parts.get(f"__{piece}__", piece) for piece in pieces)


def paragraph(text: str, kind: str = "") -> str:
    """<p> of plain text."""
    return f"<p{f' class={chr(34)}{kind}{chr(34)}' if kind else ''}>{html.escape(text)}</p>"


def notes(sentences: Iterable[str]) -> str:
    """Sentences that a reader must not miss, one box each."""
    return "".join(paragraph(sentence, "note") for sentence in sentences)


@dataclass(frozen=True)
class Cell:
    """A number of a table as it is shown, with its exact value and where that stands in the record."""

    text: str
    key: str
    value: float | None

    def html(self) -> str:
        """The <td> with key and exact value as data attributes."""
        exact = "" if self.value is None else f' data-value="{self.value!r}"'
        return f'<td data-key="{html.escape(self.key)}"{exact}>{html.escape(self.text)}</td>'


def table(headings: Sequence[str], rows: Iterable[Sequence[str | Cell]], caption: str = "", kind: str = "") -> str:
    """<table> of plain text and `Cell`s."""
    head = "".join(f"<th>{html.escape(heading)}</th>" for heading in headings)
    body = "".join(
        "<tr>"
        + "".join(cell.html() if isinstance(cell, Cell) else f"<td>{html.escape(cell)}</td>" for cell in row)
        + "</tr>\n"
        for row in rows
    )
    title = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return (
        f'<div class="wide"><table class="{kind}">{title}<thead><tr>{head}</tr></thead>\n'
        f"<tbody>{body}</tbody></table></div>"
    )


def picture(figure: Figure, words: str, dots_per_inch: int = 110) -> str:
    """A matplotlib figure as an embedded PNG with its description."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dots_per_inch)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return (
        f'<figure><img alt="{html.escape(words)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{html.escape(words)}</figcaption></figure>"
    )


def inputs_of(specimen: Specimen) -> tuple[Path, ...]:
    """The files that the result of one sweep of a specimen depends on; the sweep is that of its [measurement]."""
    return specimen.model_copy(update={"sweep": None}).files


def provenance_section(inputs: Sequence[Path], facts: Sequence[tuple[str, str]]) -> Section:
    """Where the numbers come from: inputs with checksums, versions, date, and further facts.

    Parameters
    ----------
    inputs : files that were read
    facts : (what, value) in words, such as mesh and times
    """
    files = [(path.name, f"{path.stat().st_size} bytes", sha256(path)) for path in dict.fromkeys(inputs)]
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in _DISTRIBUTIONS)
    rows = [
        ("date", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")),
        ("software", versions),
        ("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        *facts,
    ]
    body = table(("input file", "size", "SHA-256"), files, kind="words files") + table(("", ""), rows, kind="words")
    return Section("provenance", "Provenance", body)


def sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
