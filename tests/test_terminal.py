"""The help of the commands: words are not broken, and every command is named."""

from __future__ import annotations

import re

import click
import pytest
from click.testing import CliRunner

from femu_piezo.cli import main

WIDTHS = (60, 80, 118)


@pytest.mark.parametrize("name", ["", *main.commands])
@pytest.mark.parametrize("width", WIDTHS)
def test_no_line_of_a_help_ends_within_a_word(name, width):
    """Not even at a hyphen, as in pip install 'femu-piezo[store]'."""
    shown = CliRunner().invoke(main, [*name.split(), "--help"], terminal_width=width)
    assert shown.exit_code == 0
    assert not re.findall(r"\S*\w-\n.*", shown.output) and "\ue000" not in shown.output
    assert max(map(len, shown.output.splitlines())) <= 118


def test_the_manual_names_every_command():
    shown = main.get_help(click.Context(main))
    assert set(re.findall(r"^ +femu-piezo (\w+) ", shown, flags=re.M)) == set(main.commands)
