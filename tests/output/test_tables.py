"""Tables for the terminal, as text and as HTML."""

from __future__ import annotations

import html

import pytest
from rich.table import Table

from femu_piezo.output.tables import as_html, as_text, console


@pytest.mark.parametrize("name", ["probe [a]", "probe [/b]", "plate:100:new", "[bold]x"])
def test_names_stand_as_they_are(capsys, name):
    """Brackets are no styles, and words between colons no pictures."""
    table = Table(title=name)
    table.add_column(name)
    table.add_row(name)
    console().print(table)
    for text in (as_text(table), html.unescape(as_html(table)), capsys.readouterr().out):
        assert text.count(name) == 3
