"""The folder of the results of a command that is refused."""

from __future__ import annotations

from tests.commands import invoked
from tests.specimens import plate

SPEC = f"""{plate("plate", (40e-3, 5e-3, 1e-3), 7500.0)}
[material]
base = "pzt-5h"
[measurement]
file = "missing.csv"
"""


def test_a_refused_run_leaves_no_empty_folder(tmp_path):
    """Nor one of those that it made above it; what was there before stays."""
    (tmp_path / "plate.toml").write_text(SPEC, encoding="utf-8")
    (tmp_path / "there").mkdir()
    for out in ("new/of/plate", "there/of/plate", "there"):
        refused = invoked("update", tmp_path / "plate.toml", "--out", tmp_path / out)
        assert refused.exit_code == 2 and "missing.csv" in refused.output
        assert sorted(path.name for path in tmp_path.iterdir()) == ["plate.toml", "there"]
        assert not any((tmp_path / "there").iterdir())
