"""Delimited text of any dialect to columns of numbers and their names."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.measurement.columns import UNDERSTOOD, bare_unit, is_no_unit, is_unit, parse_column, with_unit

_POINT = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan|inf(?:inity)?)", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?(?:(?:\d+,?\d*|,\d+)(?:[eE][+-]?\d+)?|nan|inf(?:inity)?)", re.IGNORECASE)
_QUOTED_COMMA = re.compile(r'(?<=")\s*[+-]?\d*,\d+(?:[eE][+-]?\d+)?\s*(?=")')
_COMMENT = ("#", "%", "!", "//")
_HEADER_LINES = 100
_LONGEST_ROW = 100_000


@dataclass(frozen=True)
class Table:
    """Numbers (rows, columns), the names of the columns, and the line (from 1) on which each row stands."""

    names: list[str]
    values: np.ndarray
    lines: np.ndarray


def decode(raw: bytes, source: str) -> str:
    """Text of a file in UTF-8, UTF-16 or, failing these, Latin-1, with "\\n" as line end.

    Raises InputError where it is not text.
    """
    encodings = ["utf-8", "latin-1"]
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ["utf-16"]
    elif raw.startswith(codecs.BOM_UTF8):
        encodings = ["utf-8-sig"]
    elif b"\0" in raw[:2000]:
        encodings = ["utf-16-be" if raw[:1] == b"\0" else "utf-16-le"]
    for encoding in encodings:
        try:
            text = raw.decode(encoding)
            break
        except UnicodeDecodeError:
            continue
    else:
        raise InputError(f"{source}: this is not text, or it ends within a character; give a text file of a sweep")
    text = text.rstrip("\x1a").replace("\r\n", "\n").replace("\r", "\n")
    if not text.strip():
        raise InputError(f"{source}: the file is empty; give a text file of a sweep")
    if re.search(r"[\x00-\x08\x0b\x0e-\x1f\x7f]", text):
        raise InputError(f"{source}: this is a binary file; give a text file of a sweep, such as an export to CSV")
    return text


def read_table(lines: list[str], source: str, first_line: int = 1, names: Sequence[str] | None = None) -> Table:
    """The one table in `lines`: a header that names the columns, then rows of numbers to the end.

    Comment lines (#, %, !, //) and blank lines are skipped; the header may be the last comment.
    `first_line` is the number of the first line in the file, for messages; `names` are those of the columns, in place
    of a header, "" for a column that is not used.

    Raises InputError where there is no header, no table, or a line that does not fit it.
    """
    lines = _with_points(lines, source)
    start = next((i for i, line in enumerate(lines) if _delimiter(line)), None)
    if start is None:
        raise InputError(f"{source}: there are no rows of numbers in this file; {UNDERSTOOD}")
    delimiter, decimal_comma = _delimiter(lines[start])
    rows = (line.rstrip(" ;\t" if delimiter == ";" else None).rstrip(",") for line in lines[start:])
    numbered = [
        (number, row)  # a line of delimiters alone, as spreadsheets write it, is no row
        for number, row in enumerate(rows, start + first_line)
        if row.strip() and not row.lstrip().startswith(_COMMENT)
    ]
    body = [row for _, row in numbered]
    decimal_comma = decimal_comma or (delimiter != "," and any("," in line for line in body[:200]))
    if decimal_comma:
        _refuse_thousands(body[:200], source)
        body = [line.replace(",", ".") for line in body]
    numbers = np.array([number for number, _ in numbered])
    values = _parse_rows(body, delimiter, numbers, source)
    _refuse_cut_last_line(lines, body, delimiter, int(numbers[-1]), source)
    if names is None:
        names = _find_names(lines[max(0, start - _HEADER_LINES) : start], delimiter, values.shape[1], source)
    else:
        _check_count(names, values.shape[1], " numbers", source)
    return Table(list(names), values, numbers)


def read_table_with_words(
    lines: list[str], source: str, names: Sequence[str] | None = None
) -> tuple[Table, tuple[str, ...]]:
    """`read_table` of a file in which columns may hold words in every row, such as the verdict of a limit test.

    Such a column is left out if its name is that of no quantity; a note says so.
    """
    if any(_delimiter(line) for line in lines):
        return read_table(lines, source, names=names), ()
    lines = _with_points(lines, source)
    found = _rows_with_words(lines)
    if found is None:
        return read_table(lines, source, names=names), ()
    delimiter, rows = found
    start, width = min(rows), len(next(iter(rows.values())))
    if names is None:
        names = _find_names(lines[max(0, start - _HEADER_LINES) : start], delimiter, width, source)
    else:
        _check_count(names, width, "", source)
    words = [column for column in range(width) if not any(_is_number(row[column], delimiter) for row in rows.values())]
    for column in words:
        if parse_column(names[column]):
            raise InputError(
                f"{source}, line {start + 1}: the column {names[column][:40]!r} holds words in every row, the first is "
                f"{rows[start][column][:40]!r}; export its numbers"
            )
    kept = [column for column in range(width) if column not in words]
    wrong = next((rows[start][column] for column in kept if not _is_number(rows[start][column], delimiter)), None)
    if wrong is not None:
        raise InputError(f"{source}, line {start + 1}: {wrong[:40]!r} is not a number; correct or remove this line")
    lines = list(lines)
    for number, row in rows.items():
        lines[number] = (delimiter or " ").join(row[column] for column in kept)
    table = read_table(lines, source, names=[names[column] for column in kept])
    named = [names[column][:40] for column in words if names[column]]
    return table, tuple(f"the column {name!r} holds words and is not used" for name in named)


def _rows_with_words(lines: list[str]) -> tuple[str | None, dict[int, list[str]]] | None:
    """Delimiter and rows (index of the line → cells) of a table that ends the lines; None where there is none.

    Every row has at least one number, and two columns or more have numbers.
    """
    every = [(i, line) for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(_COMMENT)]
    for delimiter in (";", "\t", ",", None):
        rows: dict[int, list[str]] = {}
        for number, line in reversed(every):
            cells = _all_cells(line, delimiter)
            if rows and len(cells) != len(next(iter(rows.values()))):
                break
            if not any(_is_number(cell, delimiter) for cell in cells):
                break
            rows[number] = cells
        columns = list(zip(*rows.values(), strict=True))
        while columns and not any(columns[-1]):
            columns.pop()
        if sum(any(_is_number(cell, delimiter) for cell in column) for column in columns) >= 2:
            return delimiter, {number: cells[: len(columns)] for number, cells in rows.items()}
    return None


def _all_cells(line: str, delimiter: str | None) -> list[str]:
    """Cells of a row without quotes, empty ones included."""
    if delimiter is not None and '"' in line and len(line) < _LONGEST_ROW:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
    return [cell.strip().strip('"').strip() for cell in line.strip(None if delimiter != "\t" else " ").split(delimiter)]


def _is_number(cell: str, delimiter: str | None) -> bool:
    return bool(_POINT.fullmatch(cell) or (delimiter != "," and _COMMA.fullmatch(cell)))


def _check_count(names: Sequence[str], width: int, what: str, source: str) -> None:
    """InputError where the names of columns that a file is read with are not as many as its columns."""
    if len(names) != width:
        named = "1 column" if len(names) == 1 else f"{len(names)} columns"
        raise InputError(
            f"{source}: the key columns names {named} ({', '.join(names)[:80]}), and the rows have "
            f'{width}{what}; name each, with "" for a column that is not used'
        )


def _with_points(lines: list[str], source: str) -> list[str]:
    """The lines with decimal points in place of the commas of quoted numbers that commas separate: "1,5","2,5".

    Raises InputError where every such number may have separators of thousands as well.
    """
    some = [line for line in lines if '"' in line]
    quoted = [match for line in some if re.search('",|,"', line) for match in _QUOTED_COMMA.findall(line)]
    if not quoted:
        return lines
    if all(re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", number) for number in quoted):
        raise InputError(
            f"{source}: the comma of {quoted[0]!r} may be a decimal comma or separate thousands; export plain numbers"
        )
    return [_QUOTED_COMMA.sub(lambda match: match[0].replace(",", "."), line) for line in lines]


def _split(line: str, delimiter: str | None) -> list[str]:
    """Cells of a row of numbers, without quotes and without empty cells at its end."""
    cells = [cell.strip().strip('"').strip() for cell in line.strip().split(delimiter)]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _delimiter(line: str) -> tuple[str | None, bool] | None:
    """(delimiter, whether the decimal sign is a comma) of a row of at least two numbers; None for other lines."""
    for delimiter in (";", "\t", ",", None):
        if delimiter is not None and delimiter not in line:
            continue
        cells = _split(line, delimiter)
        if len(cells) < 2:
            continue
        if all(_POINT.fullmatch(cell) for cell in cells):
            return delimiter, False
        if delimiter != "," and all(_COMMA.fullmatch(cell) for cell in cells):
            return delimiter, True
    return None


def _refuse_thousands(body: list[str], source: str) -> None:
    """Refuse numbers such as 1.000,5 or 1,000,000, in which a comma may not be the decimal sign."""
    for line in body:
        if re.search(r"\d\.\d+,\d|\d,\d+\.\d|\d,\d+,\d", line):
            raise InputError(
                f"{source}: {line.strip()[:60]!r} has numbers with separators of thousands, or with both points and "
                "commas; export plain numbers with one decimal sign"
            )


def _parse_rows(body: list[str], delimiter: str | None, numbers: np.ndarray, source: str) -> np.ndarray:
    """(rows, columns) of numbers; a row that does not fit is named with its line."""
    try:
        return np.loadtxt(body, delimiter=delimiter, comments=None, quotechar='"', ndmin=2)
    except (ValueError, OverflowError):
        pass
    width = len(_split(body[0], delimiter))
    for number, line in zip(numbers, body, strict=True):
        cells = _split(line, delimiter)
        wrong = next((cell for cell in cells if not _POINT.fullmatch(cell)), None)
        if wrong is not None:
            raise InputError(f"{source}, line {number}: {wrong[:40]!r} is not a number; correct or remove this line")
        if len(cells) != width:
            raise InputError(
                f"{source}, line {number}: {len(cells)} numbers where the first row has {width}; "
                "correct the line, or export the file again if it is cut off"
            )
    raise InputError(f"{source}: the rows cannot be read as numbers; export the sweep as plain CSV")


def _refuse_cut_last_line(lines: list[str], body: list[str], delimiter: str | None, number: int, source: str) -> None:
    """Refuse a last number that has no line end and looks shorter than those above it."""
    if not lines[-1].strip() or len(body) < 3:
        return
    above = [_split(line, delimiter)[-1].lower() for line in body[-201:-1]]
    last = _split(body[-1], delimiter)[-1].lower()
    digits, exponents = _digits_after_point(above), [cell.partition("e")[2].lstrip("+-") for cell in above]
    exponent = last.partition("e")[2].lstrip("+-")
    cut = _digits_after_point([last])[0] < min(digits)
    cut |= len(exponent) < min(len(e) for e in exponents)
    cut |= bool(exponent) and len(exponent) < min((len(e) for e in exponents if e), default=0)
    if not exponent and any(exponents):
        ratio = abs(float(last)) / max(abs(float(above[-1])), 1e-300)
        cut |= not 1e-3 < ratio < 1e3
    if cut:
        raise InputError(
            f"{source}, line {number}: the file ends in this line, whose last number {last!r} is shorter than those "
            "above; export the file again, or end the line with a line break if it is whole"
        )


def _digits_after_point(cells: list[str]) -> list[int]:
    return [len(cell.partition("e")[0].partition(".")[2]) for cell in cells]


def _find_names(above: list[str], delimiter: str | None, width: int, source: str) -> list[str]:
    """The names of the columns from the nearest line above the numbers that names any.

    A row of units alone, below or above it, is joined with it. A column may have none there ("-"), and one whose name
    is not understood any text. Units that contradict the names are refused, and so is any other line between names and
    numbers, for it may be a damaged row.
    """
    kept = " " if delimiter == "\t" else None  # a tab at either end of a line is an empty cell
    lines = [line.strip(kept).lstrip("#%!/").strip(kept) for line in above]
    told = [(text, line.lstrip().startswith(_COMMENT)) for text, line in zip(lines, above, strict=True) if text.strip()]
    units: list[str] | None = None
    between: list[str] = []
    for number in reversed(range(len(told))):
        text, is_comment = told[number]
        ways = _header_splits(text, delimiter, width)
        if (found := _units_alone(ways)) is not None:
            units = units or found
            continue
        names = next((cells for cells in ways if any(parse_column(cell) for cell in cells)), None)
        if names is not None:
            if units is None and len(between) == 1:
                units = _units_alone(_header_splits(between[0], delimiter, width), names)
                between = between if units is None else []
            if between:
                raise InputError(
                    f"{source}: {between[-1][:60]!r} below the names of the columns is neither a row of numbers nor of "
                    "units that are understood; correct it"
                )
            if units is None and number:
                units = _units_alone(_header_splits(told[number - 1][0], delimiter, width))
            return [with_unit(c, u, source) for c, u in zip(names, units or [""] * width, strict=True)]
        if not is_comment:
            between.append(text)
    seen = f"the line above the numbers, {told[-1][0].strip()[:80]!r}, does not name {width} columns" if told else ""
    raise InputError(
        f"{source}: a header must say what the {width} columns are, and {seen or 'no line does'}; {UNDERSTOOD}"
    )


def _units_alone(ways: list[list[str]], names: list[str] | None = None) -> list[str] | None:
    """The units of a row of units, "" for a column without; None for any other row.

    Parameters
    ----------
    ways : to split the row into cells
    names : of the columns, where they are known; the cell of one that is not understood may hold any text
    """
    for cells in ways:
        asked = [cell for column, cell in enumerate(cells) if names is None or parse_column(names[column])]
        if any(map(is_unit, cells)) and all(is_unit(cell) or is_no_unit(cell) for cell in asked):
            return [bare_unit(cell) if is_unit(cell) else "" for cell in cells]
    return None


def _header_splits(text: str, delimiter: str | None, width: int) -> list[list[str]]:
    """The ways to split a header line into `width` cells, by the delimiter of the numbers first."""
    ways = []
    for split in dict.fromkeys((delimiter, "\t", ";", ",", None)):
        if split is None:
            ways.append(re.split(r"\s{2,}|\t", text))
            ways.append(_words_with_units(text))
        elif split in text:
            ways.append(next(csv.reader([text], delimiter=split, skipinitialspace=True)))
    trimmed = []
    for cells in ways:
        cells = [cell.strip().strip('"').strip() for cell in cells]
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if len(cells) == width and cells not in trimmed:
            trimmed.append(cells)
    return trimmed


def _words_with_units(text: str) -> list[str]:
    """Words, each with the unit in brackets that follows it: 'f (Hz) "R s" [Ohm]' → two cells, '[Hz] [Ohm]' as well."""
    cells: list[str] = []
    for word in re.findall(r'"[^"]*"|\S+', text):
        if cells and word[0] in "([" and cells[-1][0] not in "([":
            cells[-1] += f" {word}"
        else:
            cells.append(word)
    return cells
