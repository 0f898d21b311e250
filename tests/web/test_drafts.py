"""Edits of a specimen file: undone, kept over a restart, never in the file before they are saved."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("tomlkit", reason="drafts need tomlkit: pip install 'femu-piezo[web]'")

from femu_piezo.errors import InputError
from femu_piezo.specimen.file import read_specimen
from femu_piezo.web.drafts import Draft, parsed, shown
from femu_piezo.web.workspace import Workspace

TEXT = """# the plate of drawer 3
name = "plate"

[geometry]
shape = "plate"   # sawn
length = "40 mm"
width = "5 mm"
thickness = "1 mm"

[material]
base = "pzt-5h"
"""


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    (tmp_path / "plate.toml").write_text(TEXT)
    return Workspace.of(tmp_path)


def test_keys_are_set_beside_what_is_written_and_undone(workspace: Workspace) -> None:
    draft = Draft(workspace, "plate.toml", "me")
    draft.put("geometry", "length", "39.9 mm")
    draft.put("measurement", "noise", 0.001)
    draft.put("geometry", "width", None)
    assert "# sawn" in draft.text and 'length = "39.9 mm"' in draft.text and "width" not in draft.text
    assert draft.tables()["measurement"] == {"noise": 0.001}
    assert draft.problem() == "plate.toml: geometry.width is missing; a plate needs length, width, thickness"
    assert (workspace.folder / "plate.toml").read_text() == TEXT
    draft.undo()
    assert draft.problem() == "" and draft.can_redo
    again = Draft(workspace, "plate.toml", "me")  # after a restart
    assert again.text == draft.text and again.changed and again.can_undo and again.can_redo
    again.undo(), again.undo(), again.undo()
    assert again.text == TEXT and not again.can_undo and not again.changed
    assert not Draft(workspace, "plate.toml", "somebody else").changed


def test_saving_writes_what_is_right_alone(workspace: Workspace) -> None:
    draft = Draft(workspace, "plate.toml", "me")
    draft.put("geometry", "length", "39.9 furlongs")
    with pytest.raises(InputError, match=r"plate\.toml: geometry\.length"):
        draft.save()
    assert (workspace.folder / "plate.toml").read_text() == TEXT
    draft.put("geometry", "length", "39.9 mm")
    draft.save()
    assert read_specimen(workspace.folder / "plate.toml").geometry.length == pytest.approx(39.9e-3)
    assert not draft.changed and draft.can_undo
    assert sorted(path.name for path in workspace.folder.iterdir()) == [".femu-piezo", "plate.toml"]


def test_a_file_changed_elsewhere_ends_the_draft(workspace: Workspace) -> None:
    Draft(workspace, "plate.toml", "me").put("geometry", "length", "39.9 mm")
    (workspace.folder / "plate.toml").write_text(TEXT.replace("5 mm", "6 mm"))
    assert "6 mm" in Draft(workspace, "plate.toml", "me").text


def test_text_that_is_no_toml_is_told(workspace: Workspace) -> None:
    draft = Draft(workspace, "plate.toml", "me")
    draft.set("geometry = [")
    assert "this is not TOML" in draft.problem() and draft.tables() == {}
    with pytest.raises(InputError, match="no TOML just now"):
        draft.put("geometry", "length", "1 mm")


@pytest.mark.parametrize("value", ["40 mm", 0.04, True, [1, 0, 0], ["90 kHz", "120 kHz"], None, "a b", 7])
def test_fields_read_back_what_they_show(value) -> None:
    assert parsed(shown(value)) == value
