"""Runs many draws, in one process or several, and keeps their outcomes so that a study can be resumed.

Within each process the draws of a set-up share model and basis.
"""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from femu_piezo.study.model_cache import SharedBases
from hidden_effects.draws import LABORATORY, draw, pair_of, place_of
from hidden_effects.judge import Outcome, judge_draw
from hidden_effects.round_draws import ROUND, draw_round
from hidden_effects.undescribed import UNDESCRIBED

Job = tuple[str, int]

#: Number of set-ups whose bases are kept: each may need one for the noise of the file and one for that of the sweep.
_KEPT = 4


@cache
def _bases() -> SharedBases:
    """The bases of this process."""
    return SharedBases(models=2 * _KEPT, bases=4 * _KEPT, extended=_KEPT)


def jobs(
    effects: Sequence[str], draws: int, nulls: int, pairs: int, undescribed: int, seed: int, laboratory: bool = False
) -> list[Job]:
    """(name, seed) of every draw, sorted by lot and set-up, so that neighbouring draws share a basis.

    laboratory : specimen and instrument are off by their tolerances
    """
    found = [(effect, seed + number) for number in range(draws) for effect in effects]
    found += [("none", seed + number) for number in range(nulls)]
    found += [(pair_of(seed + number), seed + number) for number in range(pairs)]
    kinds = list(UNDESCRIBED)
    found += [(f"undescribed:{kinds[number % len(kinds)]}", seed + number) for number in range(undescribed)]
    found = [((LABORATORY if laboratory else "") + name, number) for name, number in found]
    return sorted(found, key=lambda job: place_of(*job))


def jobs_of_shapes(prefixes: Sequence[str], effects: Sequence[str], draws: int, nulls: int, seed: int) -> list[Job]:
    """(name, seed) of so many draws of each effect and so many nulls, for several shapes in turn."""
    found = [(effect, seed + number) for number in range(draws) for effect in effects]
    found += [("none", seed + number) for number in range(nulls)]
    return [(prefix + name, number) for name, number in found for prefix in prefixes]


def judged(job: Job) -> Outcome:
    """Draw and judge one job."""
    make = draw_round if job[0].partition(":")[0] in ROUND else draw
    with TemporaryDirectory(prefix="hidden_") as folder:
        return judge_draw(make(*job), Path(folder), _bases())


def run(wanted: Sequence[Job], processes: int = 1, results: Path | None = None) -> Iterator[Outcome]:
    """Outcomes as they are computed, those in the file `results` first; new ones are appended to it."""
    known = {(o.name, o.seed): o for o in read(results)} if results and results.exists() else {}
    yield from (known[job] for job in wanted if job in known)
    missing = [job for job in wanted if job not in known]
    for outcome in _computed(missing, processes):
        if results:
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")
        yield outcome


def _computed(missing: Sequence[Job], processes: int) -> Iterator[Outcome]:
    """Outcomes as they are computed; an error is raised once all other jobs have ended."""
    if processes == 1:
        yield from map(judged, missing)
        return
    errors = []
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        for future in as_completed([pool.submit(judged, job) for job in missing]):
            if error := future.exception():
                errors.append(error)
            else:
                yield future.result()
    if errors:
        raise errors[0]


def read(results: Path) -> list[Outcome]:
    """Outcomes of a file of JSON lines."""
    rows = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    return [Outcome(**{key: tuple(v) if isinstance(v, list) else v for key, v in row.items()}) for row in rows]
