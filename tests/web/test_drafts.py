"""Edits of a specimen file: they can be undone, survive a restart, and reach the file only when saved."""

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


def test_only_valid_drafts_are_saved(workspace: Workspace) -> None:
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


def test_a_file_changed_elsewhere_is_shown_and_edits_are_a_step_away(workspace: Workspace) -> None:
    draft = Draft(workspace, "plate.toml", "me")
    draft.put("geometry", "length", "39.9 mm")
    (workspace.folder / "plate.toml").write_text(TEXT.replace("5 mm", "6 mm"))
    with pytest.raises(InputError, match="changed elsewhere"):
        draft.save()
    assert "6 mm" in (workspace.folder / "plate.toml").read_text()
    again = Draft(workspace, "plate.toml", "me")
    assert again.text == draft.text and "6 mm" in again.text and not again.changed
    again.undo()
    assert "39.9 mm" in again.text and again.changed


def test_two_windows_share_their_edits(workspace: Workspace) -> None:
    one, other = (Draft(workspace, "plate.toml", "me") for _ in range(2))
    one.put("geometry", "length", "39.9 mm")
    other.put("geometry", "length", "39.8 mm")
    other.undo()
    assert "39.9 mm" in other.text


def test_continuous_typing_is_one_step_to_undo(workspace: Workspace) -> None:
    draft = Draft(workspace, "plate.toml", "me")
    for end in range(1, 6):
        draft.set(TEXT + "# typed"[:end], typed=True)
    draft.put("geometry", "length", "39.9 mm")
    draft.undo()
    assert draft.text == TEXT + "# typ"
    draft.undo()
    assert draft.text == TEXT


@pytest.mark.parametrize("value", [[["61 kHz"]], [["61 kHz", "62 kHz", "63 kHz"]], [7], "61 kHz", [[]], {"a": 1}])
def test_any_value_of_a_key_is_answered_by_a_sentence(workspace: Workspace, value) -> None:
    draft = Draft(workspace, "plate.toml", "me")
    draft.put("measurement", "mask", value)
    assert "measurement.mask" in draft.problem()


@pytest.mark.parametrize("text", ["geometry = 3", "[[geometry]]"])
def test_a_key_of_something_that_is_no_table_is_refused(workspace: Workspace, text: str) -> None:
    draft = Draft(workspace, "plate.toml", "me")
    draft.set(text)
    with pytest.raises(InputError, match="geometry is not a table"):
        draft.put("geometry", "length", "1 mm")


def test_text_that_is_no_toml_is_reported(workspace: Workspace) -> None:
    draft = Draft(workspace, "plate.toml", "me")
    draft.set("geometry = [")
    assert "this is not TOML" in draft.problem() and draft.tables() == {}
    with pytest.raises(InputError, match="not valid TOML at present"):
        draft.put("geometry", "length", "1 mm")


@pytest.mark.parametrize("value", ["40 mm", 0.04, True, [1, 0, 0], ["90 kHz", "120 kHz"], None, "a b", 7])
def test_fields_read_back_what_they_show(value) -> None:
    assert parsed(shown(value)) == value
