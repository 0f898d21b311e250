"""Extensions of click for the command line: errors as sentences, help that can be copied, values with units."""

from __future__ import annotations

import atexit
import gc
import io
import signal
import sys
from pathlib import Path
from typing import Any

import click

from femu_piezo import steps
from femu_piezo.errors import FemuPiezoError, InputError

#: Stands for a hyphen while lines are wrapped, which would break at it; no text has this character (private use).
_HYPHEN = "\ue000"
#: New objects that start the garbage collector; at Python's default of 700 the imports alone start it 200 times.
_OBJECTS = 100_000


class _Formatter(click.HelpFormatter):
    """Breaks no line at a hyphen, so that pip install 'femu-piezo[store]' is copied whole."""

    def write_text(self, text: str) -> None:
        super().write_text(text.replace("-", _HYPHEN))

    def write_dl(self, rows: Any, *args: Any, **kwargs: Any) -> None:
        super().write_dl([(name, words.replace("-", _HYPHEN)) for name, words in rows], *args, **kwargs)

    def write(self, string: str) -> None:
        super().write(string.replace(_HYPHEN, "-"))


class _Context(click.Context):
    formatter_class = _Formatter


class _Command(click.Command):
    context_class = _Context


class Commands(click.Group):
    """Turns every intended error into one sentence on stderr and its exit code.

    The manual of the group names its commands; click's own list, which cuts their first sentences off, is left out.
    """

    context_class = _Context
    command_class = _Command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Nothing: see the class."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was asked for."""
        gc.set_threshold(_OBJECTS)
        atexit.register(gc.freeze)  # otherwise Python collects garbage once more before it ends
        if steps.wanted():  # such a program cancels by SIGINT, which this process may inherit as ignored
            signal.signal(signal.SIGINT, signal.default_int_handler)
        for stream in (sys.stdout, sys.stderr):  # a terminal without ε shows ? for it
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")
        try:
            return super().invoke(ctx)
        except FemuPiezoError as error:
            click.echo(f"femu-piezo: {error}", err=True)
            _tidy()
            ctx.exit(error.exit_code)
        except KeyboardInterrupt:
            click.echo("femu-piezo: interrupted", err=True)
            _tidy()
            ctx.exit(130)


def _tidy() -> None:
    """Leave no empty result folder behind."""
    from femu_piezo.output.folder import remove_empty_folders

    remove_empty_folders()


class Quantity(click.ParamType):
    """A number or a quantity with its unit, such as "0.5 V"."""

    def __init__(self, unit: str, name: str) -> None:
        self._unit, self.name = unit, name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number in the unit."""
        from femu_piezo.units import parse_quantity

        return parse_quantity(value, self._unit, f"--{self.name}")


class Folder(click.ParamType):
    """A folder; no words are none, and not the present one."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; raises InputError where it is empty."""
        if not str(value).strip():
            raise InputError("--out names no folder; give one, such as --out results")
        return Path(value)


class StoreAddress(click.ParamType):
    """The address of a database; --store without an address takes the next word, which may be another argument."""

    name = "address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The address; raises InputError where it is none."""
        from femu_piezo.store.address import check_address

        return check_address(value)
