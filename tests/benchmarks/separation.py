"""How many equally spaced points separate two causes as well as a few chosen ones do (`measure --separate`).

    python tests/benchmarks/separation.py --draws 3

Plates of the independent discretisation, 64 equally spaced points with noise. The two causes are those that explain
them best. Each is then fitted to noiseless data of the other, at these points and at further ones: 16 chosen
ones, or equally spaced ones. The table has χ² that the further points add, and the number of equally spaced points
that add as much.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parent))

from adaptive_sweeps import BODIES, bench_of, plain_specimen_of

from femu_piezo.diagnosis.rivals import rivals
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.effects.library import circuits, electrode_resistance, losses, mounting, relaxation
from femu_piezo.inference.fit import Fit
from femu_piezo.study.comparing import compare_causes
from femu_piezo.study.linearised import Linearised
from femu_piezo.study.measured import measure_each
from femu_piezo.study.model_cache import SharedBases
from femu_piezo.study.posterior import Posterior
from femu_piezo.study.progress import Clock
from femu_piezo.study.subjects import subjects
from tests.study.bench import BAND, misfit_of_wrong

#: Hidden effect → modules of the candidates, the effect and others that imitate it.
PAIRS = {
    "dielectric_dispersion": (losses, relaxation),
    "series_resistance": (circuits, electrode_resistance),
    "mounting": (mounting, circuits),
}
START, CHOSEN, EQUAL = 64, 16, (16, 32, 64, 128, 256)


def added(posterior: Posterior, two: tuple[Fit, Fit], extra: np.ndarray) -> float:
    """χ² that further points add, the mean over either cause being the right one."""
    return float(
        np.mean(
            [
                misfit_of_wrong(posterior, *pair, extra) - misfit_of_wrong(posterior, *pair, np.zeros(0))
                for pair in (two, two[::-1])
            ]
        )
    )


def row(effect: str, number: int, bases: SharedBases, folder: Path) -> list[str]:
    """A row of the table for a draw."""
    drawn = BODIES["plate"](number, effect)
    spectrum = bench_of(drawn)(np.linspace(*BAND, START))
    several = subjects(
        measure_each([plain_specimen_of(drawn, folder)], [spectrum]), [module.candidates for module in PAIRS[effect]]
    )
    posterior, comparison = compare_causes(several, Clock(lambda step: None), bases, Rules())
    rival_causes = rivals(comparison)
    if rival_causes is None:
        return [effect, str(number), "nothing shows", *[""] * (len(EQUAL) + 3)]
    about = Linearised(posterior, comparison.final, 0.0)
    best = added(posterior, rival_causes.fits, about.most_separating(BAND, rival_causes.fits, CHOSEN)[0])
    equal = [added(posterior, rival_causes.fits, np.linspace(*BAND, count + 2)[1:-1]) for count in EQUAL]
    above = next((place for place, value in enumerate(equal) if value >= best), None)
    if above is None:
        worth = f"> {EQUAL[-1]}"
    elif above == 0:
        worth = f"< {EQUAL[0]}"
    else:
        worth = f"{np.exp(np.interp(best, equal[above - 1 : above + 1], np.log(EQUAL[above - 1 : above + 1]))):.0f}"
    shown = [f"{value:.3g}" for value in (best, *equal)]
    return [
        effect,
        str(number),
        f"{rival_causes.first}, {rival_causes.second}",
        f"{rival_causes.log_odds:.1f}",
        *shown,
        worth,
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--effects", nargs="+", choices=list(PAIRS), default=list(PAIRS))
    given = parser.parse_args()
    shown = Table(title=f"χ² that further points add to {START} equally spaced ones")
    for heading in ("hidden", "draw", "the two", "log odds", f"{CHOSEN} chosen", *map(str, EQUAL), "worth"):
        shown.add_column(heading)
    bases = SharedBases()
    with tempfile.TemporaryDirectory() as folder:
        for effect in given.effects:
            for number in range(given.draws):
                shown.add_row(*row(effect, number, bases, Path(folder)))
    Console(width=160).print(shown)
