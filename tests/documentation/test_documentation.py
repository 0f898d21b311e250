"""The documentation refers to things that exist: keys, commands with their options, tests, links; versions agree."""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
import tomllib
from pathlib import Path

import click
import pytest

import femu_piezo
from femu_piezo.cli import main
from femu_piezo.specimen.file import Specimen
from femu_piezo.specimen.schema import Table

ROOT = Path(__file__).resolve().parents[2]
MADE = {"_build", "tutorials", "modules"}
SITE = [path for path in (ROOT / "docs").rglob("*.md") if not MADE & set(path.relative_to(ROOT).parts)]
PAGES = [ROOT / "README.md", *SITE, *(ROOT / "tutorials").glob("*.md")]
TABLES = Table.__subclasses__()


def page_id(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("table", TABLES)
def test_every_key_has_a_description(table):
    """From which the reference of the specimen file and the docstring of the table are generated."""
    for name, field in table.model_fields.items():
        assert field.description or name == "path", f"{table.__name__}.{name}"
        assert name == "path" or f"{name}\n    {field.description}" in table.__doc__


def test_the_reference_shows_every_table():
    page = (ROOT / "docs/reference/specimen_file.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"```\{schema\} (\S+)", page))
    assert shown == {table.model_config["title"] for table in TABLES if table is not Specimen}
    assert len(shown) > 9


def commands(text: str) -> list[list[str]]:
    """Every call of femu-piezo in code spans and blocks, as words."""
    lines = re.findall(r"^(?:\S*/)?(femu-piezo .+)$", text, flags=re.M)
    lines += re.findall(r"`(?:\S*/)?(femu-piezo [^`]+)`", text)
    return [shlex.split(line.replace("\\|", "|").split("#")[0]) for line in lines]


@pytest.mark.parametrize("path", PAGES, ids=page_id)
def test_commands_and_options_exist(path):
    for _, name, *words in commands(path.read_text(encoding="utf-8")):
        if name == "COMMAND" or name.startswith("-"):
            continue
        command = main.get_command(click.Context(main), name)
        assert command is not None, name
        options = {option for parameter in command.params for option in parameter.opts}
        given = {word.split("=")[0] for word in words if word.startswith("--")}
        assert given <= options | {"--help"}, (name, given - options)


def test_every_command_has_its_row_in_the_readme():
    named = {words[1] for words in commands((ROOT / "README.md").read_text(encoding="utf-8"))}
    assert set(main.commands) <= named


def test_tests_that_are_named_exist():
    text = (ROOT / "docs/validation.md").read_text(encoding="utf-8")
    named = re.findall(r"`pytest ([^`]*)`", text)
    assert len(named) > 30
    for call in named:
        target = next(word for word in call.split() if word.startswith("tests/"))
        file, _, name = target.partition("::")
        assert (ROOT / file).exists(), file
        if name:
            tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
            assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, target
    for script in re.findall(r"`python (?:-m )?([\w./]+)", text):
        assert (ROOT / script).is_file() or (ROOT / (script.replace(".", "/") + ".py")).is_file(), script


@pytest.mark.parametrize("path", PAGES, ids=page_id)
def test_links_between_pages_lead_somewhere(path):
    """In the layout of the repository; docs/tutorials is where a build puts a copy of tutorials."""
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        if re.match(r"\w+:", target):
            continue
        file = (path.parent / target).resolve().relative_to(ROOT)
        if file.parts[:2] == ("docs", "tutorials"):
            file = Path(*file.parts[1:])
        assert (ROOT / file).is_file(), f"{page_id(path)}: {target}"


def test_versions_agree():
    version = femu_piezo.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" in project["project"]["dynamic"] and "path" in project["tool"]["hatch"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_check_of_a_site_finds_faults(tmp_path):
    spec = importlib.util.spec_from_file_location("check_site", ROOT / "docs/check_site.py")
    check = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(check)
    assert check.faults(tmp_path) == [f"{tmp_path}: there is no page"]
    (tmp_path / "a.html").write_text('<p id="here"><a href="b.html#there">b</a><a href="#here">a</a>', encoding="utf-8")
    (tmp_path / "b.html").write_text('<p id="there"><a href="https://example.org">out</a>', encoding="utf-8")
    assert check.faults(tmp_path) == []
    (tmp_path / "b.html").write_text(
        '<a href="c.html">c</a><script src="https://example.org/x.js"></script>', encoding="utf-8"
    )
    assert [fault.split(": ", 1)[1].split()[0] for fault in check.faults(tmp_path)] == [
        "b.html#there",
        "loads",
        "c.html",
    ]
