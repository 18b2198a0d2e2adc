"""`model judge rank` and `model learn settings` from end to end, and their sentences for what cannot be used."""

import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from gateway.entry.interrupt import Interrupted, control_c, interruptible
from sim.lab.formats.find import find_model
from tests.cli.support import ROOT, decanter, misused, only_object, refused
from tests.rig.no_bands import without_bands

QUICK = ("--runs", 100, "--jobs", 1)
"""Without processes that load all libraries anew: what those do is asked in tests/validation/test_campaign.py."""


@pytest.fixture(scope="module")
def rival(tmp_path_factory: pytest.TempPathFactory, traces: Path) -> Path:
    """A model of the same name as `model`, learned from cd1, by the method that is quicker."""
    folder = tmp_path_factory.mktemp("learned") / "rival"
    command = ("model", "learn", "--method", "lsha", "--traces", traces / "cd1.csv", "--out", folder)
    with pytest.MonkeyPatch.context() as patch:
        # The bands, for which a model is fitted three times more: a ranking does not look at them.
        without_bands(patch)
        assert decanter(*command).exit_code == 0
    return folder


@pytest.fixture(scope="module")
def halves(tmp_path_factory: pytest.TempPathFactory, traces: Path) -> Path:
    """A folder with the two halves of cd1: enough for two folds, and quickly learned."""
    folder = tmp_path_factory.mktemp("halves")
    lines = (traces / "cd1.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    rows = 1 + next(number for number, line in enumerate(lines) if line.startswith("time"))
    middle = (rows + len(lines)) // 2
    for name, part in (("first", lines[rows:middle]), ("second", lines[middle:])):
        (folder / f"{name}.csv").write_text("".join([*lines[:rows], *part]), encoding="utf-8")
    return folder


def test_rank_runs_models_marks_what_they_were_trained_on_and_writes_page_and_picture(
    model: Path, rival: Path, traces: Path, tmp_path: Path
) -> None:
    page, picture = tmp_path / "r.html", tmp_path / "r.png"
    options = ("--traces", traces, *QUICK, "--semantics", "both", "--page", page, "--picture", picture)
    found = only_object(decanter("model", "judge", "rank", model, rival, *options, "--json").stdout)
    rows = {row["entrant"]: row for row in found["models"]}
    kinds = ("carried", "resampled")
    assert set(rows) == {f"decanter ({name}) ({kind})" for name in ("model", "rival") for kind in kinds}
    assert {row["in_sample"] for row in rows.values()} == {"in-sample (1 of 2 traces)"}
    assert all(list(row["seen"].values()) == ["content"] for row in rows.values())
    assert {row["fitness"] for row in rows.values()} == {"unfit"}  # learned from synthetic traces
    assert all("nothing can be told from 2 traces" in pair["sentence"] for pair in found["pairs"])
    assert "in-sample (1 of 2 traces)" in page.read_text(encoding="utf-8")
    assert picture.stat().st_size > 10_000


def test_rank_reads_an_earlier_campaign_with_what_it_knew_of_its_models(
    model: Path, traces: Path, tmp_path: Path
) -> None:
    out = tmp_path / "campaign"
    done = decanter("model", "judge", "validation", model, "--traces", traces, "--out", out, *QUICK, "--no-pictures")
    assert done.exit_code == 0
    (row,) = only_object(decanter("model", "judge", "rank", "--results", out, "--json").stdout)["models"]
    kept = {one["criterion"]: one["kept"] for one in row["findings"]}
    assert (kept["verified"], kept["from a plant"], kept["unseen"]) == (None, False, True)
    assert row["seen"] == {"cd17": "content"}
    fresh = only_object(decanter("model", "judge", "rank", model, "--traces", traces, *QUICK, "--json").stdout)
    assert fresh["scores"]["decanter"] == pytest.approx(row_scores(out))
    (checked,) = only_object(decanter("model", "judge", "rank", model, "--results", out, "--json").stdout)["models"]
    assert next(one["kept"] for one in checked["findings"] if one["criterion"] == "verified") is not None
    text = decanter("model", "judge", "rank", "--results", out, "--allow-synthetic", "--limit", "unseen", "2").stdout
    assert "unseen not kept: 1 trace that it was not trained on (at least 2)" in text
    assert "from a plant not kept" not in text


def row_scores(out: Path) -> dict[str, float]:
    found = only_object(decanter("model", "judge", "rank", "--results", out, "--json").stdout)
    scores = found["scores"]["decanter"]
    assert isinstance(scores, dict)
    return scores


def test_rank_says_what_it_cannot_use(model: Path, traces: Path, wrong: Path) -> None:
    misused(decanter("model", "judge", "rank", model), "--traces, or --results")
    misused(decanter("model", "judge", "rank", "--traces", traces), "--traces, or --results")
    refused(decanter("model", "judge", "rank", "--results", wrong / "folder"), 2, "results.json", "finished campaign")
    refused(decanter("model", "judge", "rank", "--results", wrong / "garbage"), 2, "no results of a campaign")
    refused(decanter("model", "judge", "rank", wrong / "none", "--traces", traces), 2, "none")
    some = ("model", "judge", "rank", model, "--traces", traces)
    refused(decanter(*some, "--limit", "speed", "3"), 2, "no limit 'speed'", "coverage_low")
    refused(decanter(*some, "--weights", 0, 0, 0), 2, "weights of the score")
    refused(decanter(*some, "--picture", "r.txt"), 2, "r.txt: cannot be a picture")


def test_tune_searches_writes_the_model_and_refuses_other_traces(
    traces: Path, halves: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The bands, for which each model is fitted three times more: no objective looks at them.
    without_bands(monkeypatch)
    file, out = tmp_path / "s.db", tmp_path / "best"
    options = ("--map", "decanter", "--study", file, "--folds", 2, "--method", "lsha")
    command = ("model", "learn", "settings", "--traces", halves, *options)
    found = only_object(decanter(*command, "--trials", 1, "--out", out, "--name", "best", "--json").stdout)
    assert found["best"]["settings"] == {} and found["default"]["number"] == 0
    assert found["sentence"] == "no settings were found that are better than the defaults"
    learned = find_model(out).runnable()
    assert learned.sha.name == "best"
    assert learned.provenance.scores["tuning_crps"] == pytest.approx(found["best"]["value"])
    again = decanter(*command, "--trials", 1)
    assert again.exit_code == 0 and "lsha: 1 trials; the best by held-out CRPS" in again.stdout
    other = ("model", "learn", "settings", "--traces", traces / "cd1.csv", "--cycles", *options, "--trials", 2)
    said = refused(decanter(*other), 2)
    assert "usable traces" in said or "another data" in said


def test_tune_says_what_it_cannot_use(traces: Path, wrong: Path) -> None:
    single = ("model", "learn", "settings", "--traces", traces / "cd1.csv")
    refused(decanter(*single, "--study", wrong / "s.db"), 2, "1 usable traces", "cut into cycles")
    both = ("model", "learn", "settings", "--traces", traces)
    refused(decanter(*both, "--study", wrong / "garbage"), 2, "is no study")
    misused(decanter(*both), "--study")
    misused(decanter(*both, "--study", wrong / "s.db", "--method", "magic"), "magic")


class Dropping:
    """Gets Control-C in its destructor, where Python drops the exception."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def test_a_control_c_that_a_callback_swallowed_still_stops_the_search() -> None:
    before, said = signal.getsignal(signal.SIGINT), []
    with interruptible(lambda what, _share: said.append(what)) as report:
        report("trial 1", 0.0)
        dropping = Dropping()
        del dropping
        with pytest.raises(KeyboardInterrupt):
            report("trial 2", 0.1)
    assert said == ["trial 1"]
    assert signal.getsignal(signal.SIGINT) == before


def test_what_a_library_makes_of_a_control_c_is_still_a_control_c() -> None:
    with pytest.raises(Interrupted), control_c():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None
    with pytest.raises(ImportError), control_c():
        raise ImportError("no such module")


def test_a_control_c_that_passed_through_code_from_text_does_not_kill_the_process_at_its_end() -> None:
    body = """
from gateway.entry.interrupt import control_c
try:
    with control_c():
        exec("import signal; signal.raise_signal(signal.SIGINT)")
except KeyboardInterrupt:
    raise SystemExit(130)
"""
    assert subprocess.run([sys.executable, "-c", body], cwd=ROOT, check=False).returncode == 130


def begun(study: Path) -> bool:
    """Whether the study's first trial is over: before it ends it loads libraries, which a signal may break off."""
    if not study.exists():
        return False
    with closing(sqlite3.connect(study)) as database:
        try:
            return bool(database.execute("SELECT COUNT(*) FROM trials").fetchone()[0] > 1)
        except sqlite3.OperationalError:  # its tables are still being made
            return False


def test_control_c_stops_a_search_with_a_sentence_and_its_own_code(halves: Path, tmp_path: Path) -> None:
    file = tmp_path / "s.db"
    words = [
        "model",
        "learn",
        "settings",
        "--traces",
        str(halves),
        "--study",
        str(file),
        "--folds",
        "2",
        "--method",
        "lsha",
    ]
    command = [sys.executable, "-m", "gateway.cli.main", *words]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while not begun(file):
            assert process.poll() is None
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        try:
            out, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "the same command goes on with" in said and "Traceback" not in said
    assert f"study: {file}" in out
