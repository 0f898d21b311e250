"""Entries of a store with known numbers, in the form that a batch makes, and a program that writes them."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from datetime import datetime, timedelta

import numpy as np

from femu_piezo.store.entry import Described, Entry, Measured

START = datetime(2026, 1, 5, 8)
BUDGET = {"noise": 3e-14, "geometry": 4e-14}
PLATE = Described("a" * 64, "plate", {"name": "plate", "geometry": {"shape": "plate"}})


def entry(number: int, time: datetime = START, program: str = "0.1.0+test", **values: float) -> Entry:
    """An update of a piece; values : numbers of its row, such as s11=16.5e-12"""
    columns = {"s11": 16.5e-12, "s11_std": 5e-14, "s11_tan": 0.015, "s11_tan_std": 1e-4, "k_eff": 0.35} | values
    one = {
        "value": columns["s11"],
        "std": 5e-14,
        "tan": 0.015,
        "tan_std": 1e-4,
        "budget": BUDGET,
        "tan_budget": {"noise": 1e-4},
    }
    sweep = Measured(hashlib.sha256(f"sweep {number}".encode()).hexdigest(), f"p{number}.csv", time)
    record = {"parameters": {"s11": one}, "causes": []}
    return Entry("update", f"p{number}.csv", "ok", "", ((PLATE, sweep),), columns, record, program)


def lots(months: int, pieces: int, drift: float, seed: int) -> dict[str, list[Entry]]:
    """Lots a month apart: s11 scatters by 1 % within lots and 0.3 % between them, and drifts by `drift` (relative) a
    month.
    """
    rng, found = np.random.default_rng(seed), {}
    for month in range(months):
        mean = 16.5e-12 * (1 + drift * month + 0.003 * rng.standard_normal())
        time = START + timedelta(days=365.25 / 12 * month)
        found[f"{time:%Y-%m}"] = [
            entry(
                1000 * month + number,
                time + timedelta(minutes=number),
                s11=mean * (1 + 0.01 * rng.standard_normal()),
                s11_tan=0.015 * (1 + 0.01 * rng.standard_normal()),
                k_eff=0.35 * (1 + 0.01 * rng.standard_normal()),
            )
            for number in range(pieces)
        ]
    return found


def write_in_turn(address: str, numbers: Iterable[int], lot: str, at_once: int = 5) -> None:
    """Write pieces, `at_once` of them in each transaction."""
    from pathlib import Path

    from femu_piezo.store.database import Database
    from femu_piezo.store.write import write

    database, numbers = Database(address, Path()), list(numbers)
    for start in range(0, len(numbers), at_once):
        write(database, [entry(number) for number in numbers[start : start + at_once]], lot)
    database.close()


def stop_in_the_middle(address: str) -> None:
    """Begin to write two pieces, print "half" and hang while the first is in the tables and not committed."""
    import time

    from sqlalchemy import Engine, event

    @event.listens_for(Engine, "after_cursor_execute")
    def hang(connection, cursor, statement, *rest) -> None:
        if "INSERT INTO estimates" in statement:
            print("half", flush=True)
            time.sleep(600)

    write_in_turn(address, [1, 2], "killed")


if __name__ == "__main__":
    task, address, *rest = sys.argv[1:]
    if task == "write":
        first, last, lot = rest
        write_in_turn(address, range(int(first), int(last)), lot)
    else:
        stop_in_the_middle(address)
