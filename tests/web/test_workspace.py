"""The folder of the page: nothing outside of it is read or written, and uploads replace nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from femu_piezo.errors import InputError
from femu_piezo.web.workspace import LARGEST_UPLOAD, OWN, Workspace
from tests.specimens import plate

SPECIMEN = plate("plate", (40e-3, 5e-3, 1e-3), 7500.0) + '[material]\nbase = "pzt-5h"\n[measurement]\nfile = "{file}"\n'


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    (tmp_path / "lab").mkdir()
    (tmp_path / "secret.csv").write_text("frequency_Hz,resistance_ohm,reactance_ohm\n")
    return Workspace.of(tmp_path / "lab")


@pytest.mark.parametrize(
    "name", ["../secret.csv", "/etc/passwd", "a/../../secret.csv", "", "a\0b", f"{OWN}/secret", f"a/../{OWN}/x", "link"]
)
def test_names_that_lead_outside_are_refused(workspace: Workspace, name: str) -> None:
    (workspace.folder / "link").symlink_to(workspace.folder.parent / "secret.csv")
    with pytest.raises(InputError):
        workspace.path(name)


def test_a_specimen_may_name_files_of_the_folder_alone(workspace: Workspace, monkeypatch) -> None:
    (workspace.folder / "in.csv").write_text("")
    monkeypatch.setenv("ELSEWHERE", "/etc")
    for file in ("in.csv", "sub/in.csv"):
        (workspace.folder / "a.toml").write_text(SPECIMEN.format(file=file))
        assert workspace.specimen("a.toml")[0].measurement.file == workspace.folder / file
    for file in ("../secret.csv", "/etc/passwd", "~/x.csv"):
        (workspace.folder / "a.toml").write_text(SPECIMEN.format(file=file))
        with pytest.raises(InputError, match="outside the folder"):
            workspace.specimen("a.toml")
    (workspace.folder.parent / "b.toml").write_text("secret = true")
    (workspace.folder / "study.toml").write_text('specimens = ["../b.toml"]')
    with pytest.raises(InputError, match="outside the folder") as told:
        workspace.specimen("study.toml")
    assert "secret" not in str(told.value)  # the content of the file is not even read
    (workspace.folder / "a.toml").write_text(SPECIMEN.format(file="${ELSEWHERE}/x.csv"))
    (workspace.folder / "study.toml").write_text('specimens = ["a.toml"]')
    for name in ("a.toml", "study.toml"):
        with pytest.raises(InputError, match="no environment variables") as told:
            workspace.specimen(name)
        assert "/etc" not in str(told.value)
    (workspace.folder / "mesh.toml").write_text(
        '[geometry]\nshape = "mesh"\nfile = "/etc/hosts"\nunit = "1 mm"\n[material]\nbase = "pzt-5h"\n'
    )
    with pytest.raises(InputError, match="outside the folder"):
        workspace.specimen("mesh.toml")


def test_uploads_are_named_cleanly_and_replace_nothing(workspace: Workspace) -> None:
    assert workspace.take("../../etc/x y.csv", b"1") == "x y.csv"
    assert workspace.take("x y.csv", b"1") == "x y.csv"  # the same file again
    assert workspace.take("x y.csv", b"2") == "x y-2.csv"
    assert workspace.take("C:\\data\\s.S1P", b"3") == "s.S1P"
    assert workspace.take(".hidden.csv", b"4") == "hidden.csv"
    assert (workspace.folder / "x y.csv").read_bytes() == b"1"
    assert workspace.sweeps() == ["hidden.csv", "s.S1P", "x y-2.csv", "x y.csv"]
    (workspace.folder / "a.csv").mkdir()
    assert workspace.take("a.csv", b"5") == "a-2.csv"
    for name in ("run.py", "page.html", "x", "..", "a.csv.exe"):
        with pytest.raises(InputError, match="not read"):
            workspace.take(name, b"")
    with pytest.raises(InputError, match="is this the right file"):
        workspace.take("big.csv", bytes(LARGEST_UPLOAD + 1))


@pytest.mark.parametrize("name", ["測" * 100, "ü" * 200, "a" * 300, *(f"x{' .b' * 80}{'c' * k}" for k in range(3))])
def test_uploads_with_long_names_are_kept_and_listed(workspace: Workspace, name: str) -> None:
    """The end of the name remains, which file systems take and which is no hidden file."""
    kept = workspace.take(f"{name}.csv", b"1")
    assert workspace.sweeps() == [kept] and f"{name}.csv".endswith(kept)
    assert workspace.take(f"{name}.csv", b"2") == kept.replace(".csv", "-2.csv")


def test_lists_leave_out_results_and_hidden_files(workspace: Workspace) -> None:
    for name in ("a.toml", "lot/b.toml", "lot/b.csv", "results/c.toml", ".d.toml", ".git/e.csv"):
        path = workspace.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("")
    assert workspace.specimens() == ["a.toml", "lot/b.toml"]
    assert workspace.sweeps() == ["lot/b.csv"]
    assert workspace.lots() == ["lot"]
    (workspace.folder / "c.toml").write_text("")
    assert workspace.lots() == [".", "lot"] and workspace.results(".", "batch") == "results/batch"
    assert workspace.results("lot/b.toml", "update") == "results/lot/b.toml/update"
    assert workspace.free_name("a.toml") == "a-2.toml"


def test_a_folder_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        Workspace.of(tmp_path / "none")


def test_studies_that_name_each_other_are_refused(workspace: Workspace) -> None:
    for name, other in (("a", "b"), ("b", "a")):
        (workspace.folder / f"{name}.toml").write_text(f'specimens = ["{other}.toml"]')
    with pytest.raises(InputError, match="specimens"):
        workspace.specimen("a.toml")
