"""Addresses of a store: a URL, an SQLite file, a folder that holds one, or the word for the folder of the results."""

from __future__ import annotations

from pathlib import Path

from femu_piezo.errors import InputError

#: The file in a folder of results, and the address that asks for it.
FILE, HERE = "store.sqlite", "sqlite"
#: Endings by which the name of an SQLite file is known before the file exists.
_ENDINGS = (".sqlite", ".sqlite3", ".db")
#: What an SQLite file begins with (sqlite.org/fileformat2.html, 1.3.1).
_MAGIC = b"SQLite format 3\0"


def check_address(word: str) -> str:
    """The word that followed --store, if it is an address and not meant as another argument of the command.

    Raises
    ------
    InputError : a specimen file, a sweep, a folder of these, or a name that tells nothing
    """
    if "://" in word or word == HERE or word.lower().endswith(_ENDINGS) or _holds_a_store(Path(word)):
        return word
    raise InputError(
        f"--store {word}: this is no address of a store; give postgresql://user@host/name or a file that ends in "
        f"{_ENDINGS[0]}, and to use --store without an address write --store={HERE} or put it last"
    )


def _holds_a_store(path: Path) -> bool:
    try:
        with open(path / FILE if path.is_dir() else path, "rb") as stream:
            return stream.read(len(_MAGIC)) == _MAGIC
    except OSError:
        return False
