"""Reading and writing of whole text and JSON files: one-sentence errors, nothing half-written left behind."""

from __future__ import annotations

import json
import os
import re
import secrets
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

from femu_piezo.errors import InputError

SCHEMA = 1
"""Version of the JSON files that the commands write: grows when a key goes, or changes its meaning or unit."""


def path_of(path: object) -> Path:
    """A path given in Python; InputError where it is none."""
    if not isinstance(path, (str, os.PathLike)):
        raise InputError(f"a file or a folder is given by its path, not by a {type(path).__name__}")
    return Path(path)


def read_bytes(path: Path, largest: int) -> bytes:
    """The content of a regular file of at most `largest` bytes.

    Raises InputError where the path is no readable regular file, or the file is larger.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path}: this is a directory; give the path of a file")
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: this is not a regular file (a device or a pipe); give the path of a file")
        if status.st_size > largest:
            raise InputError(
                f"{path}: the file has {status.st_size / 1e6:.0f} MB, more than the {largest / 1e6:.0f} MB "
                "that can be read; is this the right file?"
            )
        return path.read_bytes()
    except FileNotFoundError:
        if names := unset_variables(path):
            raise InputError(
                f"{path}: the environment variable {names[0]} is not set; set it or write a path"
            ) from None
        raise InputError(f"{path}: there is no such file; check the path") from None
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read ({error.strerror or error})") from None
    except ValueError:  # a NUL character in the path
        raise InputError(f"{str(path)!r}: this is not a path; give the path of a file") from None


def unset_variables(path: Path) -> list[str]:
    """Names of the variables `${NAME}` in a path that the environment does not have."""
    return [name for name in re.findall(r"\$\{(\w+)\}", str(path)) if not os.environ.get(name)]


def write_atomically(path: Path | str, text: str | bytes) -> None:
    """Write UTF-8 text or bytes to a temporary file in the same folder, then rename it: no crash leaves half a file.

    Raises InputError where the folder does not exist or cannot be written to.
    """
    path = path_of(path)
    if not path.name:
        raise InputError(f"{path}: this is a directory; give the path of a file")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}.tmp")
    try:
        data = text if isinstance(text, bytes) else text.encode("utf-8")
        with open(temporary, "xb") as stream:
            _to_disk(stream, data)
        os.replace(temporary, path)
    except UnicodeEncodeError:
        raise InputError(f"{path}: the text to write has characters outside Unicode; rename what has them") from None
    except OSError as error:
        raise _unwritable(path, error) from None
    finally:
        temporary.unlink(missing_ok=True)


def append_durably(path: Path, text: str) -> None:
    """Add UTF-8 text to a file, on the disk when this returns.

    Raises InputError where the file cannot be written.
    """
    try:
        with open(path, "ab") as stream:
            _to_disk(stream, text.encode("utf-8"))
    except OSError as error:
        raise _unwritable(path, error) from None


def _to_disk(stream: BinaryIO, data: bytes) -> None:
    stream.write(data)
    stream.flush()
    os.fsync(stream.fileno())


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: the file cannot be written ({error.strerror or error})")


def with_schema(record: Mapping[str, Any]) -> dict[str, Any]:
    """A record as the commands write it, with the key `schema` first."""
    return {"schema": SCHEMA} | dict(record)


def as_json(value: Any) -> Any:
    """A value in JSON types: lists for tuples and arrays, Python's numbers for numpy's, None for NaN and infinity."""
    return json.loads(json.dumps(value, default=_plain), parse_constant=lambda _: None)


def _plain(value: Any) -> Any:
    """An array or a number of numpy in Python's types; TypeError for what is neither."""
    if not hasattr(value, "tolist"):
        raise TypeError(f"{type(value).__name__} has no form in JSON")
    return value.tolist()


def json_text(record: Mapping[str, Any], indent: int | None = 2) -> str:
    """The text of a record with its schema, on one line where `indent` is None; null for NaN and infinity."""
    whole = with_schema(record)
    try:
        text = json.dumps(whole, indent=indent, allow_nan=False, ensure_ascii=False, default=_plain)
    except ValueError:
        text = json.dumps(as_json(whole), indent=indent, ensure_ascii=False)
    return text + "\n"


def read_json(path: Path, largest: int, what: str) -> dict[str, Any]:
    """The record in a file that a command wrote; files of release 0.1, which have no `schema`, count as schema 1.

    what : kind of record that is expected, for messages

    Raises InputError where the file holds no record, or one of another schema than this release reads.
    """
    try:
        record = json.loads(read_bytes(path, largest).decode("utf-8"))
    except (ValueError, RecursionError):
        record = None
    if not isinstance(record, dict):
        raise InputError(f"{path}: this is not {what}")
    schema = record.get("schema", SCHEMA)
    if schema != SCHEMA:
        raise InputError(
            f"{path}: this file has schema {schema!r}, and this release of femu-piezo reads schema {SCHEMA}; read it "
            "with the release that wrote it, or write it again"
        )
    return record
