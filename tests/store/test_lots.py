"""A lot kept in a store by the commands; lots compared, charted and exported; and a store that fails in between."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from datetime import UTC, datetime
from pathlib import Path

import pyarrow.parquet
import pytest
from made import entry, write_in_turn
from made import lots as made_lots
from sqlalchemy import select

from femu_piezo.batch.jobs import find_jobs, program_checksum
from femu_piezo.batch.run import run_lot
from femu_piezo.errors import InputError
from femu_piezo.store import schema
from femu_piezo.store.address import check_address
from femu_piezo.store.database import Database
from femu_piezo.store.read import read_pieces
from femu_piezo.store.write import keeper, lot_keeper, write

sys.path.append(str(Path(__file__).parents[1] / "batch"))
from lots import InlinePool, write_lot

from tests.commands import invoked


def run(*arguments: str, code: int = 0) -> str:
    answer = invoked(*arguments)
    assert answer.exit_code == code, answer.output
    return answer.output


def table(address: str, name: str) -> list[dict]:
    database = Database(address, Path(), make=False)
    rows = database.read(lambda connection: connection.execute(select(schema.metadata.tables[name])).mappings().all())
    database.close()
    return [dict(row) for row in rows]


@pytest.fixture(scope="module")
def line(tmp_path_factory) -> Path:
    """A folder with sweeps, a specimen file, and a computed lot of three, the last of them unreadable, not yet in
    any store.
    """
    folder = tmp_path_factory.mktemp("line")
    sweeps, specimen = write_lot(folder, 3)
    (sweeps / "p3.csv").write_bytes(b"\x00\x01\x02")
    run_lot(find_jobs(sweeps, specimen), folder / "out", InlinePool)
    return folder


def batch(line: Path, *arguments: str, code: int = 0) -> str:
    folder, specimen = line / "sweeps", line / "bar.toml"
    return run("batch", folder, "--specimen", specimen, "--out", line / "out", *arguments, code=code)


def test_a_lot_is_kept_with_all_that_belongs_to_it(line, address):
    batch(line, "--store", address)
    batch(line, "--store", address)  # a second run adds nothing
    assert [one["name"] for one in table(address, "lots")] == ["sweeps"]
    results = {one["name"]: one for one in table(address, "results")}
    assert {name: one["status"] for name, one in results.items()} == {
        "p1.csv": "ok",
        "p2.csv": "ok",
        "p3.csv": "failed",
    }
    assert "p3.csv" in results["p3.csv"]["reason"]
    for name, one in results.items():
        record = json.loads((line / "out" / "records" / f"{name}.json").read_text(encoding="utf-8"))
        assert (one["columns"], one["record"]) == (record["columns"], record["results"].get("update"))
        assert one["program"] == program_checksum()
    sweeps = {one["file"]: one for one in table(address, "sweeps")}
    for name, one in sweeps.items():
        file = line / "sweeps" / name
        assert one["hash"] == hashlib.sha256(file.read_bytes()).hexdigest()
        assert one["measured"].replace(tzinfo=UTC).timestamp() == pytest.approx(file.stat().st_mtime, abs=1e-3)
    described = table(address, "specimens")
    assert len(described) == 1 and described[0]["description"]["geometry"]["length"] == 0.04
    assert str(line) not in json.dumps(described[0]["description"])  # the same on every station
    estimates = {(one["result_id"], one["quantity"]): one["std"] for one in table(address, "estimates")}
    parts: dict = {}
    for one in table(address, "budgets"):
        key = (one["result_id"], one["quantity"])
        parts[key] = parts.get(key, 0.0) + one["std"] ** 2
    assert len(parts) == 12  # three constants and their tangents of two pieces
    assert {key: total**0.5 for key, total in parts.items()} == pytest.approx(
        {key: estimates[key] for key in parts}, rel=1e-6, abs=0
    )


def test_update_finds_its_piece_in_the_lot_and_diagnose_adds_to_it(line, tmp_path, monkeypatch):
    batch(line, "--store", "--lot", "may")
    store = line / "out"  # the address of a store may be the folder that contains it
    run("update", line / "bar.toml", "--out", tmp_path / "update", "--store", store)
    assert (tmp_path / "update" / "update.json").exists()
    assert len(table(str(store), "results")) == 3  # the same sweep and description: nothing new
    database = Database(str(store), Path())
    assert {row["lot"] for row in read_pieces(database)} == {"may"}
    cause = {"effect": "leakage", "specimen": None, "probability": 0.9, "parameters": {"tan": {"value": 1.0}}}
    known = next(row for row in read_pieces(database) if row["file"] == "p1.csv")
    monkeypatch.setattr("femu_piezo.store.write.entry_of_result", lambda specimens, result: diagnosed)
    sweep = entry(1).inputs[0][1]
    diagnosed = type(entry(1))(
        step="diagnose",
        name="p1.csv",
        status="ok",
        reason="",
        inputs=((entry(1).inputs[0][0], type(sweep)(known["sweep"], "p1.csv", sweep.time)),),
        columns={"verdict": "effect", "cause": "leakage", "probability": 0.9},
        record={"causes": [cause], "parameters": {"before": {}, "after": {}}},
        program="0.1.0+test",
    )
    keeper(str(store), tmp_path)([], None)
    found = next(row for row in read_pieces(database) if row["file"] == "p1.csv")
    assert (found["verdict"], found["cause"], found["s11"]) == ("effect", "leakage", known["s11"])
    database.close()
    assert [(one["effect"], one["probability"]) for one in table(str(store), "causes")] == [("leakage", 0.9)]


def test_a_store_that_fails_in_the_middle_loses_nothing_on_disk(line, tmp_path):
    jobs, out = find_jobs(line / "sweeps", line / "bar.toml"), tmp_path / "out"

    out.mkdir()

    def broken(step, done, all_, record) -> None:
        keep(jobs[done - 1], record)
        if done == 1:
            for file in out.glob("store.sqlite*"):
                file.write_bytes(b"struck by lightning" * 1000)

    with pytest.raises(InputError) as caught, lot_keeper("sqlite", out, "may") as keep:
        keep.__self__._written = 0.0  # write at once
        run_lot(jobs, out, InlinePool, finished=broken)
    said = str(caught.value)
    assert "not a database" in said and f"all results are in {out}, 2 of them not in the store" in said
    assert len(list((out / "records").glob("*.json"))) == 3
    for file in out.glob("store.sqlite*"):
        file.unlink()
    run("batch", line / "sweeps", "--specimen", line / "bar.toml", "--out", out, "--store")
    assert len(table(str(out), "results")) == 3


def test_an_address_that_does_not_answer_is_refused_before_the_work(line, tmp_path):
    address = "postgresql://me:secret@127.0.0.1:1/line"
    for order in (
        ["batch", line / "sweeps", "--specimen", line / "bar.toml"],
        ["update", line / "bar.toml"],
        ["diagnose", line / "bar.toml"],
    ):
        said = run(*order, "--out", tmp_path / "out", "--store", address, code=2)
        assert "Connection refused" in said and "secret" not in said and said.count("\n") == 1
        assert not (tmp_path / "out").exists()
    assert "Connection refused" in run("lots", "--store", address, code=2)


@pytest.mark.parametrize("command", ["batch", "update", "diagnose", "measure", "serve"])
@pytest.mark.parametrize("word", ["bar.toml", "sweeps", "line7"])
def test_a_word_after_store_that_is_no_address_is_refused(line, tmp_path, command, word):
    """Such as the argument of the command: no database of that name is made, and no argument is said to be missing."""
    before = {path: path.read_bytes() for path in line.rglob("*") if path.is_file()}
    out = () if command == "serve" else ("--out", tmp_path / "out")
    said = run(command, "--store", line / word, *out, code=2)
    assert "this is no address of a store" in said and "--store=sqlite" in said and said.count("\n") == 1
    assert {path: path.read_bytes() for path in line.rglob("*") if path.is_file()} == before


def test_a_folder_with_a_store_is_an_address(tmp_path):
    assert check_address("sqlite") == "sqlite" and check_address(str(tmp_path / "new.DB"))
    write_in_turn(str(tmp_path / "store.sqlite"), [0], "may")
    shutil.copy(tmp_path / "store.sqlite", tmp_path / "line7")
    assert check_address(str(tmp_path)) == str(tmp_path) and check_address(str(tmp_path / "line7"))


def test_a_refused_run_leaves_no_store(line, tmp_path):
    (tmp_path / "empty").mkdir()
    run("batch", tmp_path / "empty", "--out", tmp_path / "out", "--store", code=2)
    assert not (tmp_path / "out").exists()


@pytest.fixture
def months(address) -> str:
    """Nine lots of 25 pieces, a month apart, whose s11 falls by 0.4 % a month and scatters by 0.3 % between lots."""
    database = Database(address, Path())
    for name, entries in made_lots(9, 25, -0.004, seed=3).items():
        write(database, entries, name)
    database.close()
    return address


def test_lots_are_listed_compared_and_their_drift_is_found(months, tmp_path):
    said = run("lots", "--store", months, "--out", tmp_path)
    assert "2026-01" in said and "2026-09" in said
    found = json.loads((tmp_path / "lots.json").read_text(encoding="utf-8"))
    assert {name: one["pieces"] for name, one in found["lots"].items()} == dict.fromkeys(made_lots(9, 1, 0, 1), 25)
    s11, tan = found["quantities"]["s11"], found["quantities"]["s11_tan"]
    mean = s11["individuals"]["centre"]
    assert s11["drift"]["significant"] and s11["drift"]["through"] == "lots"
    assert s11["drift"]["per_month"] / 16.5e-12 == pytest.approx(-0.004, abs=3 * s11["drift"]["std"] / mean)
    assert 0.2e-3 < s11["drift"]["std"] / mean < 0.8e-3  # 0.36 % of a lot over √60 months²: 0.46e-3
    assert s11["within_std"] / mean == pytest.approx(0.01, rel=0.2)
    assert next(one["lot"] for one in s11["lots"] if one["beyond"]) == "2026-01" and not tan["drift"]["significant"]
    assert not any(one["beyond"] for one in tan["lots"])
    rows = pyarrow.parquet.read_table(tmp_path / "lots.parquet").to_pylist()
    assert len(rows) == 225 and rows[0]["lot"] == "2026-01" and rows[0]["number"] == 1
    assert rows[0]["measured"] == datetime(2026, 1, 5, 8, tzinfo=UTC) and rows[0]["file"] == "p0.csv"
    assert (tmp_path / "lots.png").stat().st_size > 20_000


def test_some_lots_and_quantities_only(months, tmp_path):
    run("lots", "--store", months, "--lot", "2026-03", "--lot", "2026-02", "--quantity", "k_eff", "--out", tmp_path)
    assert pyarrow.parquet.read_metadata(tmp_path / "lots.parquet").num_rows == 50
    found = json.loads((tmp_path / "lots.json").read_text(encoding="utf-8"))
    assert list(found["lots"]) == ["2026-02", "2026-03"] and list(found["quantities"]) == ["k_eff"]
    assert (
        found["quantities"]["k_eff"]["drift"]["through"] == "pieces"
    )  # two lots are too few for a trend of lots, so single pieces are used
    assert "no such lot" in run("lots", "--store", months, "--lot", "2031", code=2)
    assert "no piece has a quantity of this name" in run("lots", "--store", months, "--quantity", "s13", code=2)


@pytest.mark.parametrize("steps", [(0.0, 0.0, 0.0), (-1.0, 0.0, 1.0)])
def test_a_quantity_with_the_mean_zero_has_no_per_cent(tmp_path, steps):
    """Where all values are zero, and where they cancel."""
    database = Database("sqlite", tmp_path)
    for month, step in enumerate(steps):
        time = datetime(2026, 1 + month, 5)
        write(database, [entry(10 * month + number, time, s11_tan=step) for number in range(3)], f"lot {month}")
    database.close()
    found = invoked("lots", "--store", tmp_path, "--quantity", "s11_tan", "--out", tmp_path / "out")
    assert found.exit_code == 0, found.output
    row = next(line for line in found.output.splitlines() if line.startswith("│ s11_tan"))
    assert [cell.strip() for cell in row.split("│")[6:9]] == ["-", "-", "-"]
    assert (tmp_path / "out" / "lots.png").exists() and "nan" not in found.output


def test_a_negative_constant_of_growing_magnitude_rises_in_per_cent(tmp_path):
    """d31 of three lots, 1 % larger in magnitude each month."""
    database = Database("sqlite", tmp_path)
    for month in range(3):
        of_pieces = [-270e-12 * (1 + 0.01 * month + 1e-4 * number) for number in range(4)]
        time = datetime(2026, 1 + month, 5)
        pieces = [entry(10 * month + number, time, d31=d31) for number, d31 in enumerate(of_pieces)]
        write(database, pieces, f"lot {month}")
    database.close()
    said = run("lots", "--store", tmp_path, "--quantity", "d31", "--out", tmp_path / "out")
    of_lots = [line.split("│")[2] for line in said.splitlines() if line.startswith("│ lot") and "±" in line]
    assert float(of_lots[0].split("±")[0]) == pytest.approx(-1.0, abs=0.05)
    assert float(of_lots[2].split("±")[0]) == pytest.approx(1.0, abs=0.05)
    drift = next(line for line in said.splitlines() if line.startswith("│ d31")).split("│")[-2]
    assert drift.strip().startswith("+")


def test_an_empty_store_is_reported(tmp_path):
    database = Database(str(tmp_path / "line.sqlite"), Path())
    write(database, [])
    database.close()
    said = run("lots", "--store", tmp_path / "line.sqlite", "--out", tmp_path / "out", code=2)
    assert "holds no piece" in said and not (tmp_path / "out").exists()
