"""Pages, as the server sends them, of specimen files that are being written."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlencode
from urllib.request import urlopen

import pytest

pytest.importorskip("nicegui", reason="the page needs nicegui: pip install 'femu-piezo[web]'")

from femu_piezo.web.drafts import Draft
from femu_piezo.web.pages.specimen import _Form
from femu_piezo.web.pages.update import _Update
from femu_piezo.web.workspace import Workspace

TEXT = """name = "plate"
[geometry]
shape = "plate"
length = "40 mm"
width = "5 mm"
thickness = "1 mm"
[material]
base = "pzt-5h"
free = ["s11"]
"""
#: What stands in the file, and what is written in its place.
WRITTEN = (
    ('free = ["s11"]', "free = 5"),
    ('shape = "plate"', 'shape = ["plate"]'),
    ("[geometry]", "[[geometry]]"),
    ("[material]", "[[material]]"),
    (TEXT, "geometry = 5\nmaterial = 6"),
)


def test_a_specimen_with_values_of_another_kind_is_shown(serve, tmp_path: Path) -> None:
    """So that it can be corrected: the page of each answers."""
    for number, (before, after) in enumerate(WRITTEN):
        (tmp_path / f"{number}.toml").write_text(TEXT.replace(before, after))
    server = serve()
    for number in range(len(WRITTEN)):
        with urlopen(f"{server.base}/specimen?{urlencode({'spec': f'{number}.toml'})}", timeout=60) as answer:
            assert answer.status == 200


@pytest.mark.parametrize(("before", "after"), WRITTEN)
def test_text_with_values_of_another_kind_is_told(tmp_path: Path, before: str, after: str) -> None:
    """The form follows the text as it is typed, and says what is wrong with it."""
    (tmp_path / "plate.toml").write_text(TEXT)
    workspace, told = Workspace.of(tmp_path), []
    draft = Draft(workspace, "plate.toml", "me")
    form = _Form(SimpleNamespace(), "plate.toml", draft)
    form._tell = form._rebuild = lambda: told.append(draft.problem())
    form._typed(SimpleNamespace(value=TEXT.replace(before, after)))
    assert len(told) == 1 and told[0].startswith("plate.toml: ")


def test_an_update_shows_the_free_constants_of_a_text_with_values_of_another_kind(tmp_path: Path) -> None:
    (tmp_path / "plate.toml").write_text(TEXT)
    workspace = Workspace.of(tmp_path)
    site = SimpleNamespace(workspace=workspace, draft=lambda name: Draft(workspace, name, "me"))
    site.draft("plate.toml").put("material", "free", 5)
    page = _Update(site, "plate.toml")
    assert page._draft_free(workspace.specimen("plate.toml")[0]) == ["s11"]
    site.draft("plate.toml").put("material", "free", ["d31"])
    assert page._draft_free(workspace.specimen("plate.toml")[0]) == ["d31"]
