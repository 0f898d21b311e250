"""Reading and writing of whole text files, with one-sentence errors and nothing half-written left behind."""

from __future__ import annotations

import os
import re
import secrets
import stat
from pathlib import Path

from femu_piezo.errors import InputError


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
    """Write UTF-8 text, or bytes, beside `path`, then rename: after a crash there is the old or the new file, whole.

    Raises InputError where the folder does not exist or cannot be written to.
    """
    path = Path(path)
    if not path.name:
        raise InputError(f"{path}: this is a directory; give the path of a file")
    beside = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}.tmp")
    try:
        data = text if isinstance(text, bytes) else text.encode("utf-8")
        with open(beside, "xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(beside, path)
    except UnicodeEncodeError:
        raise InputError(f"{path}: the text to write has characters outside Unicode; rename what has them") from None
    except OSError as error:
        raise InputError(f"{path}: the file cannot be written ({error.strerror or error})") from None
    finally:
        beside.unlink(missing_ok=True)
