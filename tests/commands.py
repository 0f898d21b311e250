"""Commands of femu-piezo, run in this process."""

from __future__ import annotations

from click.testing import CliRunner, Result

from femu_piezo.cli import main


def invoked(*words) -> Result:
    """How a command ends, with the words that stand behind `femu-piezo` in a terminal."""
    return CliRunner().invoke(main, [str(word) for word in words])


def succeeded(*words) -> Result:
    """The same of a command that has to end without an error."""
    found = invoked(*words)
    assert found.exit_code == 0, found.output
    return found
