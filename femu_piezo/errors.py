"""The errors a user can meet, and the exit codes they carry.

An error message is one sentence: what was found, where (file, line or key, value) and what would be right.
"""

from __future__ import annotations


class FemuPiezoError(Exception):
    """Base of every error raised on purpose; `exit_code` is what the command line returns."""

    exit_code = 1


class InputError(FemuPiezoError):
    """The input cannot be used: a file, a key, a value or an option is wrong."""

    exit_code = 2


class TooLargeError(InputError):
    """A model would need more memory than there is."""


class ConvergenceError(FemuPiezoError):
    """A computation did not reach its goal; the message says what to try."""

    exit_code = 3


class InstrumentError(FemuPiezoError):
    """An instrument failed or does not answer; the message says what happened and how to go on."""

    exit_code = 4
