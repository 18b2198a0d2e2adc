"""`decanter model check`: the documented examples run, answers are as stated, wrong input gets its sentence."""

import csv
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading.scan import Scan
from gateway.machine.records import Keeper
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from tests.cli.support import ROOT, decanter, misused, only_object, refused
from tests.gateway.support import one_machine

EXAMPLES = [
    line[2:]
    for line in (ROOT / "docs" / "checking.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("$ decanter model check")
]
THERE = ("--from", "location:ON/100-200")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, traces: Path, model: Path) -> Path:
    """A folder with model, cd17.csv and plant.sqlite, as the documentation's examples have it."""
    folder = tmp_path_factory.mktemp("checking")
    (folder / "model").symlink_to(model)
    (folder / "cd17.csv").symlink_to(traces / "cd17.csv")
    _historian(folder / "plant.sqlite", traces / "cd17.csv")
    return folder


def _historian(path: Path, file: Path, rows: int = 400) -> None:
    """What a gateway would have kept of the first rows of a trace."""
    (trace,), _ = load_traces(str(file), load_map(ROOT / "config" / "traces" / "decanter.toml"))
    tags = {name: Tag(name, f"holding:{number}") for number, name in enumerate(trace.signals)}
    store, historian = one_machine(path, tags.values())
    keeper = Keeper(tags, 60.0)
    last: dict[str, float] = {}
    for row, time in enumerate(trace.times[:rows].tolist()):
        last |= {name: float(column[row]) for name, column in trace.signals.items() if np.isfinite(column[row])}
        samples = {name: Sample(name, value, Quality.GOOD, time, time) for name, value in last.items()}
        scan = Scan(row, time, samples, 0, 0.01)
        historian.put("scans", [(scan.time, scan.duration, scan.missed)])
        historian.put("samples", keeper.rows(scan))
    assert store.close()


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda line: line.removeprefix("decanter model check model ")[:60])
def test_every_example_of_the_documentation_is_answered(
    example: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    result = decanter(*shlex.split(example)[1:])
    assert result.exit_code in (0, 1), result.stderr
    assert result.exit_code == 0 or "does not hold" in result.stdout
    assert len(result.stdout.splitlines()) <= 24
    for option, word in zip(shlex.split(example), shlex.split(example)[1:], strict=False):
        if option in ("--csv", "--picture"):
            assert (place / word).stat().st_size > 1000


def test_no_success_stops_at_29_runs_with_the_known_interval(place: Path) -> None:
    data = only_object(decanter("model", "check", place / "model", "Pr[<=60](<> Temp >= 149)", *THERE, "--json").stdout)
    assert data["runs"] == 29
    assert data["numbers"]["low"] == 0.0 and data["numbers"]["high"] == pytest.approx(0.0981446, abs=5e-8)
    assert any("less often than its level says" in note for note in data["notes"])


def test_equal_seeds_give_equal_answers_and_other_seeds_other_ones(place: Path) -> None:
    words = ("model", "check", place / "model", "Pr[<=600; 500](<> Temp >= 22)", *THERE, "--json")
    first, again, other = (only_object(decanter(*words, "--seed", seed).stdout) for seed in (1, 1, 3))
    assert first == again
    assert first["numbers"] != other["numbers"]


def test_more_runs_begin_with_the_same_runs(place: Path) -> None:
    """The first 1000 of 3000 runs are the 1000 runs: their courses' goals come at the same moments."""
    from sim.lab.checking.language.parse import parse_query
    from sim.lab.checking.smc.answers import QuerySettings, answer
    from sim.lab.checking.smc.start import initial
    from sim.lab.formats.find import find_model

    found = find_model(place / "model").runnable()
    start = initial(found, location="ON/100-200")
    query = parse_query("Pr[<=600](<> Temp >= 22)", found)
    few, many = (answer(query, start, QuerySettings(rule="fixed", runs=runs)).passages for runs in (1000, 3000))
    assert few is not None and many is not None
    assert np.array_equal(few, many[:1000])


@pytest.mark.parametrize(
    ("query", "code", "word"),
    [
        ("Pr[<=600](<> Temp >= 10) >= 0.5", 0, "holds"),
        ("Pr[<=600](<> Temp >= 149) >= 0.5", 1, "does not hold"),
        ("Pr[<=600](<> Temp >= 10) >= Pr[<=600](<> Temp >= 149)", 0, "greater"),
        ("Pr[<=600](<> Temp >= 149) >= Pr[<=600](<> Temp >= 10)", 1, "smaller"),
        ("E<> ON_300_plus", 0, "witness"),
        ("A[] ON_300_plus", 1, "counterexample"),
        ("Pr[<=600](<> Temp >= 149)", 0, "Pr = 0"),
    ],
)
def test_the_exit_code_says_whether_it_holds(place: Path, query: str, code: int, word: str) -> None:
    result = decanter("model", "check", place / "model", query, *THERE)
    assert result.exit_code == code
    assert word in result.stdout


def test_courses_are_written_as_they_are_summed_up(place: Path, tmp_path: Path) -> None:
    words = ("model", "check", place / "model", "simulate [<=100; 3] {Temp, time}", *THERE)
    data = only_object(decanter(*words, "--csv", tmp_path / "runs.csv", "--json").stdout)
    with (tmp_path / "runs.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["run"] for row in rows} == {"0", "1", "2"}
    assert all(row["time"] == "0.0" or float(row["time"]) == pytest.approx(float(row["time"])) for row in rows)
    hottest = max(float(row["Temp"]) for row in rows)
    assert data["numbers"]["Temp: greatest"] == pytest.approx(hottest)
    assert data["numbers"]["time: greatest"] == pytest.approx(100.0)


def test_wrong_input_gets_its_sentence(place: Path) -> None:
    def said(query: str, *options: object) -> Result:
        return decanter("model", "check", place / "model", query, *options)

    good, cd17 = "Pr[<=60](<> Temp >= 30)", place / "cd17.csv"
    for result, words in (
        (said("Pr[<=60](<> Temp >= )"), ("column",)),
        (said("Pr[<=60](<> Temp * Temp >= 900)"), ("linear in the temperature",)),
        (said(good, "--from", "tomorrow"), ("trace:SECONDS",)),
        (said(good, "--from", "trace:60"), ("--events",)),
        (said(good, "--from", "trace:minus", "--events", cd17), ("seconds since",)),
        (said(good, "--from", "trace:99999999", "--events", cd17), ("nothing recorded",)),
        (said(good, "--from", "location:NOWHERE"), ("no location 'NOWHERE'", "did you mean")),
        (said(good, "--from", "location:on/100-20"), ("did you mean ON/100-200",)),
        (said(good, "--from", "historian:none.sqlite"), ("there is no historian",)),
        (said(good, "--csv", "x.csv", *THERE), ("simulate",)),
        (said("A[] not deadlock", "--picture", "x.png"), ("no picture",)),
        (said("E[<=60; 10](max: Temp)", "--rare", *THERE), ("importance splitting answers",)),
    ):
        refused(result, 2, *words)
    refused(decanter("model", "check", place / "none", good), 2, "no model directory")
    misused(said(good, "--picture", "x.xyz"), "is no picture")
    misused(said(good, "--picture", place / "nowhere" / "x.png"), "is no folder")
    misused(said("simulate [<=9] {Temp}", "--csv", place / "nowhere" / "x.csv"), "is no folder")


def test_the_screen_says_answer_method_runs_seed_and_start(place: Path) -> None:
    shown = decanter("model", "check", place / "model", "Pr[<=60; 500](<> Temp >= 20)", *THERE, "--seed", 4).stdout
    query, answer, method, runs, start = shown.splitlines()
    assert query == "Pr[<=60; 500](<> Temp >= 20)" and answer.startswith("  Pr = 0.")
    assert "95 % interval [0." in answer and "Clopper-Pearson" in method
    assert runs == "  runs     500, seed 4" and start.startswith("  start    ON/100-200")


def test_splitting_shows_its_levels_with_the_chance_to_reach_each(place: Path) -> None:
    words = ("model", "check", place / "model", "Pr[<=100](<> Temp >= 29)", "--events", place / "cd17.csv", "--rare")
    options = ("--from", "trace:600")
    data = only_object(decanter(*words, *options, "--json").stdout)
    chances = [level["chance"] for level in data["levels"]]
    assert chances == sorted(chances, reverse=True) and chances[-1] >= data["numbers"]["probability"] > 0
    shown = decanter(*words, *options).stdout
    assert "chance to reach it" in shown and "the event" in shown
    assert shown.count("°C") == len(chances) >= 1


def test_conditions_in_courses_are_written_as_0_and_1(place: Path, tmp_path: Path) -> None:
    query = "simulate [<=100; 4] {ON_100_200, 2 * (Temp > 20)}"
    files = ("--csv", tmp_path / "runs.csv", "--picture", tmp_path / "runs.png")
    result = decanter("model", "check", place / "model", query, *THERE, *files)
    assert result.exit_code == 0 and "ON_100_200" in result.stdout
    with (tmp_path / "runs.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["ON_100_200"] for row in rows} <= {"0.0", "1.0"}
    assert {row["2 * (Temp > 20)"] for row in rows} <= {"0.0", "2.0"}
    assert all(row["ON_100_200"] == "1.0" for row in rows if row["time"] == "0.0")


def test_a_belief_starts_where_the_trace_is_warm(place: Path) -> None:
    data = only_object(
        decanter(
            "model",
            "check",
            place / "model",
            "E[<=1; 200](max: Temp)",
            "--json",
            "--events",
            place / "cd17.csv",
            "--from",
            "trace:600",
        ).stdout
    )
    from_historian = only_object(
        decanter(
            "model",
            "check",
            place / "model",
            "E[<=1; 200](max: Temp)",
            "--json",
            "--from",
            f"historian:{place / 'plant.sqlite'}",
        ).stdout
    )
    assert "cd17 at 600 s" in data["start"] and 24.0 < data["numbers"]["mean"] < 29.0
    assert "plant.sqlite at" in from_historian["start"]
    assert "semi-Markov" in from_historian["start"]
