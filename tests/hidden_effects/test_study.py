"""The slow study: draws of every effect and nulls, and the confusion matrix.

pytest -m slow tests/hidden_effects -s
HIDDEN_DRAWS=3 HIDDEN_NULLS=10 pytest -m slow tests/hidden_effects -s      (a quarter of an hour)
"""

from __future__ import annotations

import os

import pytest

from hidden_effects.draws import SIZES, draw
from hidden_effects.judge import Confusion, judge_draw

#: Draws of each effect, draws without effect, and where the seeds begin.
DRAWS, NULLS, SEED = (
    int(os.environ.get(name, default))
    for name, default in (("HIDDEN_DRAWS", "12"), ("HIDDEN_NULLS", "40"), ("HIDDEN_SEED", "1000"))
)


@pytest.mark.slow
def test_confusion_matrix(tmp_path, capsys):
    """Detectable effects first or in their class in 95 %, first in 80 %, size within 3 σ in 97 %; nulls none."""
    confusion = Confusion()
    jobs = [(effect, SEED + number) for number in range(DRAWS) for effect in SIZES]
    jobs += [("none", SEED + number) for number in range(NULLS)]
    for effect, seed in jobs:
        outcome = judge_draw(draw(effect, seed), tmp_path / f"{effect}_{seed}")
        confusion.outcomes.append(outcome)
        with capsys.disabled():
            print(f"{effect}:{seed} {outcome}", flush=True)
    with capsys.disabled():
        print("\n" + confusion.text())
    seen = confusion.detectable()
    sizes = [abs(o.deviation) for o in seen if o.deviation is not None]
    nulls = [o for o in confusion.outcomes if o.truth == "none"]
    assert sum(o.in_class for o in seen) >= 0.95 * len(seen)
    assert sum(o.said == o.truth for o in seen) >= 0.8 * len(seen)
    assert sum(d < 3 for d in sizes) >= 0.97 * len(sizes)
    assert sum(o.word == "none" for o in nulls) >= 0.975 * len(nulls)
