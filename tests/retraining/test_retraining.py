"""From a historian to a proposed version: what is cut, chosen, judged, kept; and what a kill at any step leaves."""

import json
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.tag import Quality, Sample, Tag
from gateway.lab.judging import figures as judging
from gateway.lab.judging.figures import score_trace
from gateway.lab.learning.familiar import free_run_error
from gateway.lab.retraining import cutting, lineage, shadow, study
from gateway.lab.retraining.cutting import CycleSource, cut_new, extend_cycle, read_cycle
from gateway.lab.retraining.cycle_library import CycleLibrary, CycleRow, open_library
from gateway.lab.retraining.report import coverage_figure
from gateway.lab.retraining.study import RetrainingRequest, cut_and_rate, join_traces, make_source, new_cycles, sparse
from gateway.lab.retraining.training_record import read_record
from gateway.machine.reading import Scan
from gateway.machine.records import Keeper
from gateway.store import open_historian
from sim.artefacts import (
    VERDICT_FILE,
    JudgedCriterion,
    ModelVerdict,
    current,
    load,
    objections,
    promote,
    read_familiarity,
    version_directory,
    versions,
)
from sim.engine import open_loop
from sim.lab.formats import save
from sim.lab.judge.comparison import NEW, PRESENT, compare_horizons, propose_verdict
from sim.lab.learning.semi_markov import sojourns
from sim.lab.tuning import METHODS, Taught
from sim.sha import Distribution, Location, Model, Trace, content_hash, encode, encode_trace
from tests.cli.support import decanter, only_object, refused
from tests.gateway.support import TEMPERATURE, one_machine, two_modes

BEGIN = 1_770_000_000.0
CYCLES, RUN, REST, STEP = 16, 900.0, 300.0, 10.0
SHORT_DAY = 2 * (RUN + REST)
"""s: days so short that the plant's cycles last longer than a trial."""
HOT = 60.0
_UPSIDE_DOWN = JudgedCriterion(criterion="switch", kept=False, sentence="MarciaDecanter is upside down")


def heated(target: float) -> Model:
    """Two modes whose running location warms to `target`."""
    model = two_modes()
    places = tuple(
        replace(place, distribution=Distribution("normal", {"mu": target, "sigma": 1.0}))
        if place.name == "on"
        else place
        for place in model.sha.locations
    )
    assert any(isinstance(place, Location) and place.name == "on" for place in places)
    return replace(model, sha=replace(model.sha, locations=places))


def plant(cycles: int = CYCLES, begin: float = BEGIN) -> Trace:
    """Runs of a quarter of an hour towards HOT, rests of five minutes towards 20 degC, by the two modes' own rates."""
    rng = np.random.default_rng(3)
    times = begin + STEP * np.arange(int(cycles * (RUN + REST) / STEP))
    running = (np.arange(times.size) * STEP % (RUN + REST) < RUN).astype(float)
    temperature, now = np.empty(times.size), 25.0
    for row, on in enumerate(running):
        temperature[row] = now
        target, rate = (HOT, 0.01) if on else (20.0, 0.002)
        now = target + (now - target) * np.exp(-rate * STEP)
    load = np.where(running > 0, 150.0 + 2.0 * rng.normal(size=times.size), 0.0)
    noise = 0.05 * rng.normal(size=times.size)
    return Trace("plant", times, {"MarciaDecanter": running, "Assorbimento": load, TEMPERATURE: temperature + noise})


def test_a_wide_band_at_rest_hides_no_error_while_the_machine_runs() -> None:
    trace = plant(cycles=1)
    cycle = replace(trace, events=encode(trace, two_modes().alphabet))
    found = {}
    for target in (HOT, HOT - 12.0):
        model = heated(target)
        places = tuple(
            replace(place, distribution=Distribution("normal", {"mu": 20.0, "sigma": 80.0}))
            if place.name == "off"
            else place
            for place in model.sha.locations
        )
        found[target] = free_run_error(replace(model, sha=replace(model.sha, locations=places)), cycle)
    right, wrong = found[HOT], found[HOT - 12.0]
    assert right is not None and wrong is not None
    assert right.error < right.allowed and wrong.error > wrong.allowed
    assert wrong.allowed < 8.0, "what is allowed where the errors are, and not at rest"


def written(path: Path, *traces: Trace) -> Path:
    """A gateway's historian that has scanned the traces one after the other."""
    store, historian = one_machine(path, [Tag(name, f"holding:{n}") for n, name in enumerate(traces[0].signals)])
    keeper = Keeper({name: Tag(name, "holding:0") for name in traces[0].signals}, 5.0)
    historian.put("runs", [(float(traces[0].times[0]), TEMPERATURE, "", STEP, 5.0)])
    for trace in traces:
        for row, time in enumerate(trace.times.tolist()):
            read = {
                name: Sample(name, float(column[row]), Quality.GOOD, time, time)
                for name, column in trace.signals.items()
            }
            historian.put("scans", [(time, 0.0, 0)])
            historian.put("samples", keeper.rows(Scan(row, time, read, 0, 0.0)))
    assert store.close()
    return path


@pytest.fixture(scope="module")
def historian(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A day's cycles, a hole of three days, and some more."""
    first = plant()
    return written(tmp_path_factory.mktemp("h") / "historian.sqlite", first, plant(4, first.times[-1] + 3 * 86_400.0))


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A store whose current version expects 50 degC where the plant warms to HOT."""
    folder = tmp_path / "store"
    promote(folder, save(folder, heated(50.0), created=BEGIN - 1.0))
    return folder


@pytest.fixture
def request_of(store: Path, historian: Path) -> RetrainingRequest:
    return RetrainingRequest(
        store=store,
        historian=historian,
        machine="decanter",
        since=None,
        standard=(),
        former=(),
        method="bins",
        seed=0,
        rows=100_000,
        trials=0,
        diagnosis=False,
        yellow=0.4,
        red=0.5,
    )


@pytest.fixture
def library(tmp_path: Path) -> Iterator[CycleLibrary]:
    with open_library(tmp_path / "library", machine="decanter", temperature=TEMPERATURE) as held:
        yield held


def silent(_what: str, _share: float) -> None:
    """A report to nobody."""


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Learning and judging without their cost: the learned model is right, its CRPS by half smaller; both counted."""
    calls = SimpleNamespace(learned=0, judged=0)

    def learn(task: Any, _settings: Any) -> Taught:
        calls.learned += 1
        return Taught(heated(HOT), {})

    def judge(trace: Trace, *_: Any, **__: Any) -> list[dict[str, Any]]:
        calls.judged += 1
        rng = np.random.default_rng(int(trace.times[0]))
        crps = {PRESENT: 1.0 + 0.1 * rng.random(), NEW: 0.5}
        return [
            {"trace": trace.name, "horizon": 60.0, "method": name, "crps": value, "coverage": 0.9}
            for name, value in crps.items()
        ]

    monkeypatch.setitem(METHODS, "bins", replace(METHODS["bins"], learn=learn))  # type: ignore[arg-type]
    monkeypatch.setattr(study, "score_trace", judge)
    return calls


def run(request: RetrainingRequest, library: CycleLibrary) -> Any:
    """The whole way, as the command goes it."""
    source = make_source(request, BEGIN)
    cut_and_rate(request, library, source, silent)
    return study.retrain(request, library, source, report=silent, clock=lambda: BEGIN)


def test_the_historian_is_cut_at_starts_and_at_gaps_once(
    request_of: RetrainingRequest, library: CycleLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = make_source(request_of, BEGIN)
    assert cut_and_rate(request_of, library, source, silent) == CYCLES + 3
    rows = library.cycles()
    assert [row.begin - BEGIN for row in rows[:CYCLES]] == [number * (RUN + REST) for number in range(CYCLES)]
    assert rows[CYCLES].begin - rows[CYCLES - 1].begin > 2 * 86_400.0, "the hole ends a cycle and is none"
    assert all(row.rating == "badly predicted" and row.kept for row in rows), "ten degrees off"
    assert (rows[0].region, rows[5].region) == ("A_1, begun at 20-30", "A_1, begun at 40-50")
    assert cut_and_rate(request_of, library, source, silent) == 0, "the cycle that goes on waits for its end"
    # In pieces of an hour it comes to the same cycles, and their readings are found again by their hash.
    monkeypatch.setattr(cutting, "READ_SPAN_S", 3600.0)
    with open_library(library.folder / "other", machine="decanter", temperature=TEMPERATURE) as other:
        cut_new(other, source, None, silent)
        assert [row.content for row in other.cycles()] == [row.content for row in rows]
        plain = replace(rows[3], kept=False)
        again = read_cycle(source, plain, other)
        assert again is not None and content_hash(again) == rows[3].content
        assert read_cycle(source, replace(plain, content="0" * 64), other) is None


def test_a_rest_is_seen_to_end_though_the_next_cycle_is_not_learned_from(
    request_of: RetrainingRequest, library: CycleLibrary
) -> None:
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    rows = library.cycles()
    assert [row.until for row in rows[: CYCLES - 1]] == [row.begin for row in rows[1:CYCLES]]
    assert rows[CYCLES - 1].until < rows[CYCLES].begin, "a gap ended it, and nobody knows when its rest did"
    alone = [library.readings(row.content) for row in rows[: CYCLES - 1 : 2]]
    pairs = [(alone[0], library.readings(rows[1].content))]
    assert [len(join_traces(traces, 30.0)) for traces in (alone, *pairs)] == [len(alone), 1]
    rests = [
        stay
        for trace in join_traces(alone, 30.0)
        for stay in sojourns(source.model, encode_trace(trace, source.model.alphabet))
        if stay.location == "off"
    ]
    assert len(rests) == len(alone)
    assert all(stay.to == "on" and stay.end - stay.start == pytest.approx(REST, abs=STEP) for stay in rests)


def test_a_machine_that_is_never_stopped_has_cycles_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, store: Path, library: CycleLibrary
) -> None:
    on = plant(4)
    on = replace(on, signals={**on.signals, "MarciaDecanter": np.ones(on.times.size)})
    monkeypatch.setattr(cutting, "READ_SPAN_S", 3000.0)
    monkeypatch.setattr(cutting, "MAX_CYCLE_S", 1500.0)
    path = written(tmp_path / "on.sqlite", on)
    source = CycleSource(historian=path, machine="decanter", model=load(store), version="x", since=-np.inf)
    # Each is as long as a cycle may be, wherever the pieces lie in which the historian is read; the last goes on.
    assert cut_new(library, source, None, silent) == 3
    cut = [(row.begin - BEGIN, row.until - BEGIN) for row in library.cycles()]
    assert cut == [(0.0, 1500.0), (1500.0, 3000.0), (3000.0, 4500.0)]
    # So does a later call, and a machine that has been started once is no other.
    assert cut_new(library, source, None, silent) == 0 and len(library.cycles()) == 3
    again = replace(on, times=on.times + on.times.size * STEP)
    longer = written(tmp_path / "longer.sqlite", on, again)
    assert cut_new(library, replace(source, historian=longer), None, silent) == 3
    begun = [row.begin - BEGIN for row in library.cycles()]
    assert begun == [1500.0 * place for place in range(6)]


@pytest.mark.parametrize("kept", [["long ago", "before"], ["before"], []])
def test_where_room_is_short_the_oldest_training_is_left_out_first(
    kept: list[str], request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace, store: Path
) -> None:
    new = run(request_of, library).rows
    earlier = tuple(
        replace(plant(4, BEGIN - 86_400.0 * days), name=name) for name, days in (("long ago", 9), ("before", 2))
    )
    rows = new + len(kept) * earlier[0].times.size
    found = run(replace(request_of, former=earlier, rows=rows), library)
    record = read_record(version_directory(store, found.version))
    assert record is not None and found.rows == rows
    assert [name for name, _ in record.training if name in ("long ago", "before")] == kept


def test_a_better_model_is_proposed_with_its_report_and_nothing_is_promoted(
    request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace, store: Path
) -> None:
    before = current(store)
    found = run(request_of, library)
    assert found.proposed and current(store) == before and versions(store)[-1] == found.version != before
    home = version_directory(store, found.version)
    text = (home / "retraining_report.txt").read_text(encoding="utf-8")
    assert "better than the present model at 60 s on the new cycles" in text
    page = (home / "retraining_report.html").read_text(encoding="utf-8")
    assert "<svg" in page and "src=" not in page
    assert load(store, found.version).provenance.contents == tuple(
        sorted(content for _, content in read_record(home).training)  # type: ignore[union-attr]
    )
    # What was held out is in no training, and all of it is kept beyond the historian.
    chosen = library.step(1, "sets")
    held, trained = ({content for _, content in chosen[name]} for name in ("held_out", "training"))
    assert held and trained and not held & trained
    assert all(content_hash(library.readings(content)) == content for content in held | trained)
    familiar = read_familiarity(home)
    assert familiar is not None and familiar.curve is not None and familiar.held_out
    # The first cycles have no hour before them, which could be looked back over.
    pointed = {row.content for row in library.cycles() if len(row.points)}
    assert familiar.curve.cycles == len(held & pointed) >= len(held) - 3


@pytest.mark.parametrize("killed", ["learned_model", "score_trace", "save", "replace_durably"])
def test_a_kill_at_any_step_leaves_the_present_model_and_a_study_that_goes_on(
    killed: str,
    request_of: RetrainingRequest,
    library: CycleLibrary,
    quick: SimpleNamespace,
    store: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The step is broken off at its beginning, and `save` after the version is there."""
    monkeypatch.setattr(study, "report_files", lambda *_: {"retraining_report.txt": "drawn in another test"})
    real, before = getattr(study, killed), current(store)

    def broken(*arguments: Any, **named: Any) -> Any:
        if killed == "save":
            real(*arguments, **named)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(study, killed, broken)
        with pytest.raises(KeyboardInterrupt):
            run(request_of, library)
    assert current(store) == before and load(store) == heated(50.0)
    found = run(request_of, library)
    assert found.study == 1 and versions(store) == (before, found.version), "one version, whoever made it"
    assert quick.learned == 1, "what was done is not done again"
    assert library.step(2, "sets") is None


def test_an_excluded_cycle_is_neither_learned_from_nor_judged_by(
    request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace
) -> None:
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    name = library.cycles()[5].name
    library.exclude(name, "Ada", "sensor was being changed")
    study.retrain(request_of, library, source, report=silent, clock=lambda: BEGIN)
    chosen = library.step(1, "sets")
    assert name not in {each for pairs in (chosen["held_out"], chosen["training"]) for each, _ in pairs}
    with pytest.raises(ValueError, match="has no cycle 'nobody'"):
        library.exclude("nobody", "Ada", "why")
    library.exclude(name, "", "")
    assert name in {row.name for row in new_cycles(library, source.model)}


def test_where_room_is_short_regions_take_turns_and_the_error_of_the_present_model_chooses_nothing(
    request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace
) -> None:
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    rows = library.cycles()
    # Were it the rating that chooses, the older half would be learned from.
    for row in rows[CYCLES // 2 :]:
        library.rate(row.name, "ordinary", "", 0.5)
    found = study.retrain(replace(request_of, rows=6 * 120 + 60), library, source, report=silent, clock=lambda: BEGIN)
    assert 0 < found.rows <= 6 * 120 + 60
    chosen = library.step(1, "sets")
    held, trained = ({name for name, _ in chosen[part]} for part in ("held_out", "training"))
    left = [row for row in rows if row.name not in held]
    regions = {row.region for row in left}
    assert len(regions) > 1 and len(trained) < len(left)
    for region in regions:
        own = [row.name for row in left if row.region == region]
        taken = [name for name in own if name in trained]
        assert taken and taken == own[-len(taken) :]


def _row(number: int, region: str) -> CycleRow:
    """A day's only cycle, 100 scans in a `region`, with the error that lets it be run."""
    begin = BEGIN + 86_400.0 * number
    return CycleRow(
        name=f"c{number:03d}",
        begin=begin,
        until=begin + 3600.0,
        rows=100,
        content=f"{number:064x}",
        region=region,
        rating="ordinary",
        words="",
        strangeness=None,
        error=0.1,
        allowed=1.0,
        moved=1.0,
        model="0001",
        points=np.empty((0, 0)),
    )


def test_a_plant_that_was_changed_is_judged_and_learned_by_its_newest_cycles(
    request_of: RetrainingRequest, library: CycleLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A year of cycles: a region of the winter alone, and two that the plant is always in.
    rows = [_row(n, "winter" if n < 100 else ("load", "idling")[n % 2]) for n in range(365)]
    library.add(rows, rows[-1].until)
    readings = Trace("cycle", BEGIN + np.arange(100.0), {TEMPERATURE: np.full(100, 30.0)})
    monkeypatch.setattr(study, "read_cycle", lambda *_: readings)
    monkeypatch.setattr(library, "keep", lambda *_: None)
    monkeypatch.setattr(study, "new_cycles", lambda *_: library.cycles())
    source = make_source(request_of, BEGIN)
    held, trained = (
        [int(name[1:]) for name, _ in study.choose_cycles(replace(request_of, rows=2000), library, source)[part]]
        for part in ("held_out", "training")
    )
    # Evenly over the newest 48, of which 12 are held out.
    assert held == list(range(319, 365, 4))
    # Twenty have room: the newest of the winter, all others from the newest forty that are left.
    assert len(trained) == 20 and trained[0] == 99
    assert trained[1] >= 365 - 12 - 40 and not set(trained) & set(held)
    # Where there is room for all nothing is left out.
    every = study.choose_cycles(replace(request_of, rows=100_000), library, source)["training"]
    assert len(every) == 365 - 12


def test_a_cycle_before_the_last_one_of_the_training_is_no_news(
    request_of: RetrainingRequest, library: CycleLibrary, store: Path
) -> None:
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    rows = library.cycles()
    learned = replace(source.model.provenance, contents=(rows[4].content,))
    assert [row.name for row in new_cycles(library, replace(source.model, provenance=learned))] == [
        row.name for row in rows[5:]
    ]


def _scores(new: float, horizon: float = 60.0, cycles: int = 10) -> list[dict[str, Any]]:
    rng = np.random.default_rng(1)
    rows = []
    for number in range(cycles):
        present = 1.0 + 0.1 * rng.random()
        for method, crps in ((PRESENT, present), (NEW, present * new * (1.0 + 0.01 * rng.random()))):
            rows.append({"trace": f"c{number}", "horizon": horizon, "method": method, "crps": crps, "coverage": 0.9})
    return rows


def test_better_is_told_from_the_longest_horizon_on_and_is_not_paid_for_by_the_shorter_ones() -> None:
    def rows(horizon: float, gains: list[float]) -> list[dict[str, Any]]:
        crps = [(name, {PRESENT: 1.0, NEW: 1.0 - gain}) for name, gain in zip("abcdefgh", gains, strict=True)]
        row = {"horizon": horizon, "coverage": 0.9}
        return [
            row | {"trace": name, "method": method, "crps": values[method]}
            for name, values in crps
            for method in values
        ]

    nothing = [0.01, -0.012, 0.014, -0.016, 0.011, -0.013, 0.015, -0.017]
    large = [0.5, 0.4, 0.45, -0.02, 0.3, 0.35, -0.01, 0.55]
    scores = [*rows(60.0, nothing), *rows(300.0, nothing), *rows(900.0, large)]
    minute, _, quarter = compare_horizons("new cycles", scores, seed=0)
    assert quarter.p > 0.05 > quarter.sequence, "by the correction for three it could not be told"
    assert (quarter.outcome, minute.outcome) == ("better", "")
    assert propose_verdict(compare_horizons("new cycles", scores, seed=0), (), "new cycles")[0]
    # A gain at the minute alone is none, whatever its test says: the quarter of an hour comes first.
    other = compare_horizons("new cycles", [*rows(60.0, [0.3] * 8), *rows(900.0, nothing)], seed=0)
    assert [each.outcome for each in other] == ["", ""]
    # What is worse is told at any horizon.
    worse = compare_horizons("new cycles", [*rows(60.0, [-0.3] * 8), *rows(900.0, large)], seed=0)
    assert [each.outcome for each in worse] == ["worse", "better"]


def test_a_model_is_proposed_only_where_it_is_better_and_worse_nowhere() -> None:
    better, worse = (
        compare_horizons("new cycles", _scores(0.7), seed=0),
        compare_horizons("standard set", _scores(1.2, 300.0), seed=0),
    )
    assert better[0].outcome == "better" and worse[0].refuses
    assert propose_verdict(better, (), "new cycles")[0]
    assert propose_verdict([*better, *worse], (), "new cycles") == (
        False,
        "not proposed: it is worse than the present model at 300 s on the standard set",
    )
    assert not propose_verdict(better, ("it grows without bound",), "new cycles")[0]
    unfit = ModelVerdict(word="unfit", criteria=(_UPSIDE_DOWN,))
    assert propose_verdict(better, objections((), unfit), "new cycles") == (
        False,
        f"not proposed: it is {unfit.sentence}",
    )
    few = compare_horizons("new cycles", _scores(0.7, cycles=4), seed=0)
    proposed, sentence = propose_verdict(few, (), "new cycles")
    assert not proposed and sentence.endswith("4 cycles could not show more")
    # Two horizons at which nothing differs are called better in one of twenty sets at most.
    rng = np.random.default_rng(5)
    called = 0
    for _ in range(60):
        rows = [
            {"trace": f"c{n}", "horizon": h, "method": m, "crps": 1 + 0.1 * rng.random(), "coverage": 0.9}
            for n in range(10)
            for h in (60.0, 300.0)
            for m in (PRESENT, NEW)
        ]
        called += any(each.outcome for each in compare_horizons("x", rows, seed=0))
    assert called <= 8


def test_traces_that_follow_one_another_are_learned_from_as_one() -> None:
    whole = plant(3)
    parts = [whole.between(a, b) for a, b in ((0, BEGIN + 1200), (BEGIN + 1200, BEGIN + 2400), (BEGIN + 2500, np.inf))]
    made = join_traces(list(reversed(parts)), 30.0)
    assert [trace.times.size for trace in made] == [240, 110]
    shared = [whole.between(BEGIN, BEGIN + 1201), *parts[1:]]
    assert [trace.times.size for trace in join_traces(shared, 30.0)] == [240, 110], "the row that two have comes once"
    assert made[0].signals[TEMPERATURE].tolist() == whole.signals[TEMPERATURE][:240].tolist()


def test_a_diagnosis_gets_fewer_rows_and_all_events() -> None:
    whole = encode_trace(plant(1), heated(HOT).alphabet)
    thin = sparse(whole, 60.0)
    assert np.diff(thin.times).tolist() == [60.0] * 19 and thin.events == whole.events
    assert thin.signals[TEMPERATURE].tolist() == whole.signals[TEMPERATURE][::6].tolist()


@pytest.mark.parametrize(("at_longest", "stays"), [(0.5, True), (1.0, False)])
def test_a_version_that_is_better_at_the_longest_horizon_is_not_rolled_back_for_a_shorter_one(
    at_longest: float, stays: bool, store: Path, historian: Path, library: CycleLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    def judge(trace: Trace, *_: Any, **__: Any) -> list[dict[str, Any]]:
        worth = {60.0: 1.2 + 0.001 * float(trace.times[0] % 7), 900.0: at_longest}
        row = {"trace": f"{trace.times[0]:.0f}", "coverage": 0.9}
        crps = [(h, m, w if m == NEW else 1.0) for h, w in worth.items() for m in (PRESENT, NEW)]
        return [row | {"horizon": horizon, "method": method, "crps": value} for horizon, method, value in crps]

    monkeypatch.setattr(shadow, "score_trace", judge)
    first = current(store)
    second = save(store, heated(HOT), created=BEGIN - 0.5)
    promote(store, second)
    found = shadow.side_by_side(
        store, historian, library, machine="decanter", version=first, roll_back=True, seed=0, report=silent
    )
    assert "worse" in found.sentence and found.cycles >= shadow.MIN_TEST_CYCLES
    assert current(store) == (second if stays else first) and ("and better at 900 s" in found.sentence) is stays


@pytest.mark.parametrize(("first", "later", "promoted"), [(0.7, 1.5, True), (1.0, 0.7, False)])
def test_a_candidate_is_judged_by_its_first_days_and_no_others(
    first: float,
    later: float,
    promoted: bool,
    store: Path,
    historian: Path,
    library: CycleLibrary,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    judged: list[float] = []

    def judge(trace: Trace, *_: Any, **__: Any) -> list[dict[str, Any]]:
        begin = float(trace.times[0])
        judged.append(begin)
        worth = first if begin < BEGIN + 6 * SHORT_DAY else later
        row = {"trace": f"{begin:.0f}", "horizon": 60.0, "coverage": 0.9}
        return [row | {"method": name, "crps": crps} for name, crps in ((PRESENT, 1.0), (NEW, worth))]

    monkeypatch.setattr(shadow, "score_trace", judge)
    candidate = save(store, heated(HOT), created=BEGIN - 0.5)

    def ask() -> shadow.SideBySide:
        return shadow.side_by_side(
            store, historian, library, machine="decanter", version=candidate, promotes=True, seed=0, report=silent
        )

    said = ask().sentence
    assert "cycles on 1 of 7 days since both were made are too few to tell" in said
    monkeypatch.setattr(shadow, "DAY_S", SHORT_DAY)
    monkeypatch.setattr(shadow, "TRIAL_DAYS", 10)
    assert "cycles on 9 of 10 days" in ask().sentence and not judged
    monkeypatch.setattr(shadow, "TRIAL_DAYS", 6)
    found = ask()
    assert len(judged) == found.cycles == 12 and max(judged) < BEGIN + 6 * SHORT_DAY and found.days == 6
    assert {each.difference.n for each in found.comparisons} == {6}
    assert bool(found.promoted) is promoted


def test_a_day_that_is_much_better_in_all_its_cycles_promotes_nothing(
    store: Path, historian: Path, library: CycleLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sixteen cycles of one day, all better: what they share is one operator and one product."""

    def judge(trace: Trace, *_: Any, **__: Any) -> list[dict[str, Any]]:
        row = {"trace": trace.name, "horizon": 60.0, "coverage": 0.9}
        return [row | {"method": name, "crps": crps} for name, crps in ((PRESENT, 1.0), (NEW, 0.5))]

    monkeypatch.setattr(shadow, "score_trace", judge)
    monkeypatch.setattr(shadow, "TRIAL_DAYS", 1)
    monkeypatch.setattr(shadow, "CYCLES_A_DAY", CYCLES)
    candidate = save(store, heated(HOT), created=BEGIN - 0.5)
    found = shadow.side_by_side(
        store, historian, library, machine="decanter", version=candidate, promotes=True, seed=0, report=silent
    )
    assert found.cycles == CYCLES and found.days == 1 and not found.promoted
    assert "not told apart" in found.sentence


def test_what_was_judged_unfit_is_better_on_every_day_and_still_not_promoted_by_a_timer(
    store: Path, historian: Path, library: CycleLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    def judge(trace: Trace, *_: Any, **__: Any) -> list[dict[str, Any]]:
        row = {"trace": f"{trace.times[0]:.0f}", "horizon": 60.0, "coverage": 0.9}
        return [row | {"method": name, "crps": crps} for name, crps in ((PRESENT, 1.0), (NEW, 0.7))]

    monkeypatch.setattr(shadow, "score_trace", judge)
    monkeypatch.setattr(shadow, "DAY_S", SHORT_DAY)
    monkeypatch.setattr(shadow, "TRIAL_DAYS", 6)
    unfit = ModelVerdict(word="unfit", criteria=(_UPSIDE_DOWN,))
    candidate = save(store, heated(HOT), created=BEGIN - 0.5, more={VERDICT_FILE: unfit.text()})
    running = current(store)
    found = shadow.side_by_side(
        store, historian, library, machine="decanter", version=candidate, promotes=True, seed=0, report=silent
    )
    assert not found.promoted and current(store) == running
    assert f"is better than {running}" in found.sentence
    assert f"{candidate} is not promoted, as it is {unfit.sentence}" in found.sentence


def test_a_trial_has_cycles_from_all_over_a_day_and_none_of_the_one_at_hand(
    request_of: RetrainingRequest, library: CycleLibrary
) -> None:
    cut_and_rate(request_of, library, make_source(request_of, BEGIN), silent)
    rows = library.cycles()
    many = [
        replace(rows[0], begin=BEGIN + day * shadow.DAY_S + 3600.0 * hour) for day in range(9) for hour in range(10)
    ]
    chosen = shadow.trial_cycles(many)
    hours = [round((row.begin - BEGIN) / 3600.0) % 24 for row in chosen]
    assert hours == [0, 2, 4, 6, 8] * shadow.TRIAL_DAYS
    assert shadow.trial_cycles(many[:15]) == [row for row in chosen if row.begin < BEGIN + shadow.DAY_S]
    assert shadow.trial_cycles([]) == []


def test_the_forecasts_of_the_right_model_are_better_on_live_cycles_and_the_worse_one_is_rolled_back(
    tmp_path: Path, historian: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is stubbed here: the gateway's own forecasts along the records."""
    store = tmp_path / "store"
    good = save(store, heated(HOT), created=BEGIN - 2.0)
    bad = save(store, heated(50.0), created=BEGIN - 1.0)
    new = save(store, heated(HOT + 1.0), created=BEGIN - 1.0)
    promote(store, good)
    promote(store, bad)
    monkeypatch.setattr(shadow, "MAX_TEST_CYCLES", 8)
    monkeypatch.setattr(judging, "MIN_FORECAST_PERIOD_S", 400.0)
    given = ("model", "version", "shadow", store, good, "--historian", historian, "--library", tmp_path / "l", "--json")
    result = decanter(*given)
    data = only_object(result.stdout)
    assert result.exit_code == 0 and not data["rolled_back"] and current(store) == bad
    assert any(each["told_apart"] == "worse" for each in data["comparisons"]), data["sentence"]
    monkeypatch.setattr(shadow, "score_trace", lambda *_, **__: _scores(1.5))
    data = only_object(decanter(*given, "--roll-back").stdout)
    assert data["rolled_back"] and current(store) == good
    # What was rolled back is no candidate any more, or a timer would promote it every night.
    refused(decanter(*given[:4], bad, *given[5:-1], "--promote"), 2, "has run, and was replaced since")
    # A candidate that is worse stays one, a better one runs by the stated policy.
    waits = (*given[:4], new, *given[5:])
    refused(decanter(*waits[:-1], "--roll-back"), 2, "has never run, and there is no way back to it")
    monkeypatch.setattr(shadow, "DAY_S", SHORT_DAY)
    kept = only_object(decanter(*waits, "--promote").stdout)
    assert kept["days"] == shadow.TRIAL_DAYS and kept["enough"] and not kept["promoted"] and current(store) == good
    monkeypatch.setattr(shadow, "score_trace", lambda *_, **__: _scores(0.7))
    data = only_object(decanter(*waits, "--promote").stdout)
    assert data["promoted"] == current(store) == new
    refused(decanter(*given[:-1], "--promote", "--roll-back"), 2, "--promote needs the VERSION that waits for it")
    refused(
        decanter("model", "version", "shadow", store, new, "--historian", historian),
        2,
        "is no other version of this store",
    )
    # The one that ran before it is the one to go back to, whichever of them it was learned beside.
    monkeypatch.setattr(shadow, "score_trace", lambda *_, **__: _scores(1.5))
    data = only_object(decanter("model", "version", "shadow", store, *given[5:], "--roll-back").stdout)
    assert data["rolled_back"] and data["promoted"] == good


def test_the_commands_show_cycles_and_family_and_make_a_version_again(
    tmp_path: Path, store: Path, historian: Path, quick: SimpleNamespace
) -> None:
    library = tmp_path / "l"
    given = ("model", "version", "retrain", store, "--historian", historian, "--library", library, "--full-speed")
    data = only_object(decanter(*given, "--no-diagnosis", "--json").stdout)
    assert data["proposed"] and data["cut"] == CYCLES + 3
    listed = only_object(
        decanter("model", "version", "cycles", library, "--picture", tmp_path / "map.png", "--json").stdout
    )
    assert listed["counts"]["badly predicted"] == CYCLES + 3 and (tmp_path / "map.png").stat().st_size > 1000
    name = listed["cycles"][0]["name"]
    shown = decanter("model", "version", "cycles", library, "--exclude", name, "--reason", "cleaning", "--by", "Ada")
    assert "cleaning (Ada)" in shown.stdout
    family = decanter("model", "version", "lineage", store).stdout.splitlines()
    assert family[0].endswith("RUNS  (by hand: it has no record)") and family[1].startswith(f"└─ {data['version']}")
    again = only_object(
        decanter(
            "model", "version", "lineage", store, "--remake", data["version"], "--library", library, "--json"
        ).stdout
    )
    assert again["remade"]["same"]
    # The map rings what was learned from, and nothing else.
    with open_library(library) as held:
        trained = frozenset(held.newest_training())
        rows = [row for row in held.cycles() if not row.is_excluded and len(row.points)]
    dots = coverage_figure(rows, trained).axes[0].collections
    drawn = [(np.size(each.get_facecolor()), len(np.asarray(each.get_offsets()))) for each in dots]
    assert sum(count for filled, count in drawn if filled) == len(rows)
    assert sum(count for filled, count in drawn if not filled) == sum(row.name in trained for row in rows) > 0
    waiting = only_object(decanter(*given, "--if-due", "--after", 30, "--json").stdout)
    unseen = f"{historian} has no model of {TEMPERATURE}"
    assert waiting == {"ok": True, "due": False, "cycles": 0, "drift_not_looked_at": unseen}
    refused(
        decanter("model", "version", "cycles", tmp_path / "none"),
        2,
        "is no library of cycles; `decanter model version retrain` makes one",
    )


def test_a_timer_retrains_on_its_own_bearings_drift_alarm_and_waits_without_a_reason(
    tmp_path: Path, store: Path, quick: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plant's alarm comes from two cycles on; those of the bearing that is followed first are no reason."""
    path, begin = tmp_path / "historian.sqlite", BEGIN
    written(path, plant())

    given: tuple[object, ...] = ("model", "version", "retrain", store, "--historian", path, "--library", tmp_path / "l")
    given += ("--full-speed", "--no-diagnosis", "--if-due", "--after", 99)

    def due(*more: object) -> dict[str, Any]:
        return only_object(decanter(*given, "--json", *more).stdout)

    unseen = {"drift_not_looked_at": f"{path} has no model of {TEMPERATURE}"}
    assert due() == {"ok": True, "due": False, "cycles": CYCLES - 1} | unseen, "never retrained is no reason"
    monkeypatch.setattr("time.time", lambda: begin + 3 * 86_400.0)
    assert due("--every", 4)["due"] is False, "the version was made three days ago"
    said = decanter(*given, "--every", 2).stdout
    assert "not yet: the last retraining is 3 days ago, but 15 new cycles are too few; it takes 16" in said
    more = plant(4, begin + CYCLES * (RUN + REST))
    gateway = open_historian(path)
    tags = [Tag(name, f"holding:{n}") for n, name in enumerate(more.signals)]
    first, own = (gateway.view("decanter", tags, temperature=name) for name in ("Assorbimento", TEMPERATURE))
    last = float(more.times[-1])
    guards = {"cycles": 2, "alarm_cycles": 2, "error": 2.0, "limit": 1.0}
    first.put("guards", [(last, json.dumps({"drift": guards}))])
    own.put("guards", [(last, json.dumps({"drift": guards | {"cycles": 1}}))])
    assert gateway.close()
    written(path, more)
    assert due() == {"ok": True, "due": False, "cycles": 4}
    gateway = open_historian(path)
    gateway.view("decanter", tags, temperature=TEMPERATURE).put("guards", [(last, json.dumps({"drift": guards}))])
    assert gateway.close()
    assert due()["due"] == "the drift alarm's condition holds"


def _quickly_searched(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The trials of each search of settings, which costs nothing and finds none that are better."""
    searched: list[int] = []

    def search(*_: Any, trials: int) -> SimpleNamespace:
        searched.append(trials)
        return SimpleNamespace(better=False, best=None, sentence="the defaults are as good")

    monkeypatch.setattr(study, "tune", search)
    return searched


@pytest.mark.parametrize(
    ("trials", "limit", "searches"), [(5, 2.0, True), (5, 90.0, False), (5, None, True), (0, 2.0, False)]
)
def test_settings_are_searched_where_s_in_per_cent_of_the_readings_is_above_its_limit(
    trials: int,
    limit: float | None,
    searches: bool,
    request_of: RetrainingRequest,
    library: CycleLibrary,
    quick: SimpleNamespace,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(study, "report_files", lambda *_: {"retraining_report.txt": "drawn in another test"})
    searched = _quickly_searched(monkeypatch)
    found = run(replace(request_of, trials=trials, score_limit=limit), library)
    assert searched == ([trials] if searches else [])
    why = "(limit 20%)" if limit is None else f"on 12 new cycles (limit {limit:g} %)"
    begin = "searched, as " if searches else "not searched: "
    assert (found.tuned.startswith(begin) and why in found.tuned) if trials else not found.tuned


def test_a_model_is_learned_with_the_settings_that_a_search_found_better(
    request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []
    learn = study.learned_model

    def noted(record: Any, *more: Any) -> Taught:
        given.append(record.settings)
        return learn(record, *more)

    monkeypatch.setattr(study, "learned_model", noted)
    better = SimpleNamespace(better=True, best=SimpleNamespace(settings={"debounce": 20.0}), sentence="")
    monkeypatch.setattr(study, "tune", lambda *_, **__: better)
    run(replace(request_of, trials=5, score_limit=2.0), library)
    assert given == [{"debounce": 20.0}]


def test_s_is_half_the_mean_error_three_tenths_of_the_largest_and_two_of_the_scatter(
    request_of: RetrainingRequest, library: CycleLibrary
) -> None:
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    rows = new_cycles(library, source.model)
    by_hand = []
    for row in rows[-study.MAX_HELD_OUT :]:
        cycle = encode_trace(library.readings(row.content), source.model.alphabet)
        measured = cycle.signals[TEMPERATURE]
        run = open_loop(source.model, cycle, "resync")
        off = run.mean[np.searchsorted(run.times, cycle.times)] - measured
        score = 0.5 * np.abs(off).mean() + 0.3 * np.abs(off).max() + 0.2 * off.std()
        by_hand.append(100.0 * score / np.abs(measured).mean())
    percent, count = study.score_percent(library, source, rows)
    assert percent == pytest.approx(np.mean(by_hand)) and count == study.MAX_HELD_OUT
    assert np.isnan(study.score_percent(library, source, [])[0])


def test_a_timer_retrains_where_s_of_the_cycles_since_the_last_retraining_is_above_its_limit(
    tmp_path: Path, store: Path, historian: Path, quick: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched = _quickly_searched(monkeypatch)
    given = ("model", "version", "retrain", store, "--historian", historian, "--library", tmp_path / "l")
    given += ("--full-speed", "--no-diagnosis", "--if-due", "--after", 99)
    said = decanter(*given, "--tune", "7:90").stdout
    assert "fewer than 99 that are not ordinary; S of the current version is " in said
    assert said.rstrip().endswith(" % of the readings on 12 new cycles (limit 90 %)")
    assert only_object(decanter(*given, "--json").stdout)["due"] is False, "without a limit S is no reason"
    data = only_object(decanter(*given, "--tune", "7:2", "--json").stdout)
    assert data["due"].startswith("S of the current version is ") and data["due"].endswith(
        " % of the readings on 12 new cycles (limit 2 %)"
    )
    assert searched == [7] and data["tuned"].startswith(f"searched, as {data['due']}")
    # The same cycles are no reason for a second one, whatever became of the first; nothing is said of an S of none.
    again = decanter(*given, "--tune", "7:2").stdout
    assert again.rstrip().endswith("; S not looked at (0 new cycles since the last retraining; it takes 8)")
    for text in ("0", "x", "7:", "7:x", "7:-1", "7:nan", "7:inf", ":8"):
        refused(decanter(*given, "--tune", text), 2, f"'{text}' is not TRIALS or TRIALS:PERCENT")


def test_a_retraining_that_s_made_due_searches_by_the_same_s(
    request_of: RetrainingRequest, library: CycleLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight cycles came since a retraining that was not taken; the four before them forecast well."""
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    rows = new_cycles(library, source.model)
    latest = {row.name for row in rows[-study.MIN_HELD_OUT :]}
    library.set_fact("finished", {"last": rows[-study.MIN_HELD_OUT - 1].name, "at": BEGIN, "study": 0, "version": ""})

    def score(_library: Any, _source: Any, cycles: Any) -> tuple[float, int]:
        return float(np.mean([9.0 if row.name in latest else 0.0 for row in cycles])), len(cycles)

    monkeypatch.setattr(study, "score_percent", score)
    request = replace(request_of, trials=5, score_limit=8.0)
    ripe = study.due(request, library, source, after=99, drifting=False, age=0.0, every=1e9)
    assert ripe.reason == "S of the current version is 9 % of the readings on 8 new cycles (limit 8 %)"
    assert study._has_fallen(request, library, source) == (True, ripe.reason)


def test_a_cycle_of_readings_that_are_all_0_has_no_s_and_takes_it_from_no_other(
    request_of: RetrainingRequest, library: CycleLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    rows = new_cycles(library, source.model)
    whole = study.run_job

    def job(given: Any) -> Any:
        outcome = whole(given)
        return (
            replace(outcome, result=replace(outcome.result, level=0.0))
            if given.trace.name == rows[-1].name
            else outcome
        )

    before = study.score_percent(library, source, rows[-3:-1])
    monkeypatch.setattr(study, "run_job", job)
    assert study.score_percent(library, source, rows[-3:]) == pytest.approx(before) and before[1] == 2
    monkeypatch.setattr(study, "MAX_HELD_OUT", 3)
    _, said = study._has_fallen(replace(request_of, score_limit=1.0), library, source)
    assert "of the readings on 2 new cycles (1 more have none: no readings but 0" in said


def test_a_damaged_library_and_too_few_cycles_are_one_sentence(
    tmp_path: Path, store: Path, request_of: RetrainingRequest
) -> None:
    path = written(tmp_path / "few.sqlite", plant(6))
    given = ("model", "version", "retrain", store, "--historian", path, "--full-speed", "--library", tmp_path / "few")
    refused(decanter(*given), 2, "5 new cycles are too few to learn from and to judge by; it takes 16")
    (tmp_path / "few" / "cycles.sqlite").write_bytes(b"no database" * 100)
    refused(decanter(*given), 2, "cannot be used as a library of cycles")


def test_what_is_foretold_at_the_end_of_a_cycle_is_judged_by_what_came_in_the_next(
    request_of: RetrainingRequest, library: CycleLibrary
) -> None:
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    rows, model = library.cycles(), source.model
    cycle = library.readings(rows[3].content)
    followed, end = extend_cycle(source, cycle, 900.0), float(cycle.times[-1])
    assert followed.times[-1] == end + 900.0 and content_hash(followed.between(BEGIN, end + STEP)) == rows[3].content

    def forecasts(trace: Trace) -> dict[float, int]:
        found = score_trace(encode_trace(trace, model.alphabet), model, None, seed=0, report=silent, until=end)
        return {row["horizon"]: row["forecasts"] for row in found if row["method"] == PRESENT}

    alone, with_next = forecasts(cycle), forecasts(followed)
    assert alone[900.0] < alone[60.0] < with_next[60.0] == with_next[900.0]
    # Nothing follows on a hole, and what the historian has otherwise is not joined to it.
    last = library.readings(rows[CYCLES - 1].content)
    assert content_hash(extend_cycle(source, last, 900.0)) == rows[CYCLES - 1].content
    other = replace(cycle, signals={**cycle.signals, TEMPERATURE: cycle.signals[TEMPERATURE] + 1.0})
    assert extend_cycle(source, other, 900.0) is other


def test_a_cycle_scores_the_same_horizons_for_both_models(historian: Path, store: Path) -> None:
    cycle = encode_trace(plant(1), load(store).alphabet)
    rows = score_trace(replace(cycle, name="one"), load(store), heated(HOT), seed=0, report=silent)
    crps = {row["method"]: row["crps"] for row in rows if row["horizon"] == 60.0}
    assert crps[NEW] < crps[PRESENT]


def test_what_a_clock_that_was_set_back_has_mixed_is_left_out_with_the_reason(
    tmp_path: Path, store: Path, library: CycleLibrary
) -> None:
    # Half a second between the rows of the two passes, as two clocks hardly ever agree.
    first, second = plant(6), plant(6, BEGIN + 3 * (RUN + REST) + 0.5)
    path = written(tmp_path / "back.sqlite", first, second, plant(2, BEGIN + 20 * (RUN + REST)))
    source = CycleSource(historian=path, machine="decanter", model=load(store), version="x", since=-np.inf)
    assert cut_new(library, source, None, silent)
    twice = (BEGIN + 3 * (RUN + REST) + 0.5, BEGIN + 6 * (RUN + REST) - 1.0)
    for row in library.cycles():
        mixed = row.begin <= twice[1] and twice[0] <= row.until
        assert row.is_excluded == mixed and ("set back" in row.reason) == mixed and not (mixed and row.kept), row.name
    assert any(row.is_excluded for row in library.cycles()) and not all(row.is_excluded for row in library.cycles())


def test_a_clock_that_was_ahead_and_was_put_right_hides_nothing(
    tmp_path: Path, store: Path, library: CycleLibrary
) -> None:
    path = tmp_path / "ahead.sqlite"
    source = CycleSource(historian=path, machine="decanter", model=load(store), version="x", since=-np.inf)
    ahead = plant(4, BEGIN + 10 * 86_400.0)
    written(path, plant(6), ahead)
    assert cut_new(library, source, None, silent) == 9
    learned = replace(source.model.provenance, contents=tuple(row.content for row in library.cycles()))
    # Right again, a day after the beginning: what comes now is cut, and it is new, though other cycles are "later".
    written(path, plant(12, BEGIN + 86_400.0))
    assert cut_new(library, source, None, silent) >= 11
    fresh = new_cycles(library, replace(source.model, provenance=learned))
    assert len(fresh) >= 11 and all(row.begin < ahead.times[0] for row in fresh)


def test_days_before_a_tag_came_have_no_cycles_and_a_tag_that_never_came_is_named(
    tmp_path: Path, store: Path, library: CycleLibrary
) -> None:
    early = plant(4)
    early = replace(early, signals={name: early.signals[name] for name in ("MarciaDecanter", TEMPERATURE)})
    path = written(tmp_path / "late.sqlite", early)
    source = CycleSource(historian=path, machine="decanter", model=load(store), version="x", since=-np.inf)
    with pytest.raises(ValueError, match="has no tag 'Assorbimento', which the model is made of"):
        cut_new(library, source, None, silent)
    assert library.fact("cursor") is None
    written(path, plant(4, BEGIN + 5 * 86_400.0))
    assert cut_new(library, source, None, silent) >= 3
    with pytest.raises(ValueError, match=r"nothing is in it since 2099-01-01 00:00 UTC; its newest scan is of"):
        cut_new(library, replace(source, since=4070908800.0), None, silent)


def test_a_kept_file_that_is_gone_is_made_again_and_one_that_nobody_has_is_named_with_the_way_out(
    request_of: RetrainingRequest, library: CycleLibrary, tmp_path: Path
) -> None:
    source = make_source(request_of, BEGIN)
    cut_and_rate(request_of, library, source, silent)
    row = next(row for row in library.cycles() if row.kept)
    file = library.folder / "kept" / f"{row.content}.npz"
    for damage in (file.unlink, lambda: file.write_bytes(b"half")):
        damage()
        trace = read_cycle(source, row, library)
        assert trace is not None and content_hash(trace) == row.content
        assert content_hash(library.readings(row.content)) == row.content
    file.unlink()
    elsewhere = replace(source, historian=written(tmp_path / "other.sqlite", plant(2, BEGIN + 9e6)))
    with pytest.raises(
        ValueError, match=rf"leave the cycle out: decanter model version cycles .* --exclude {row.name}"
    ):
        read_cycle(elsewhere, row, library)


def test_what_is_excluded_between_a_kill_and_the_next_call_is_not_learned_from(
    request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "score_trace", _killed)
    with pytest.raises(KeyboardInterrupt):
        run(request_of, library)
    chosen = library.step(1, "sets")
    out = [chosen["training"][0], chosen["held_out"][0]]
    for name, _ in out:
        library.exclude(name, "me", "cleaning")
    monkeypatch.setattr(study, "score_trace", lambda *_, **__: [])
    found = run(request_of, library)
    again = library.step(found.study, "sets")
    assert not {name for name, _ in out} & {name for part in ("training", "held_out") for name, _ in again[part]}


def _killed(*_: Any, **__: Any) -> list[dict[str, Any]]:
    raise KeyboardInterrupt


def test_traces_of_a_time_that_the_library_has_cycles_of_are_not_learned_from_beside_them(
    request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace
) -> None:
    # An export of the same historian: its cycles would be held out and learned from at once.
    export = replace(plant(8), name="export")
    before = replace(plant(8, BEGIN - 86_400.0), name="before")
    found = run(replace(request_of, former=(export, before)), library)
    record = read_record(version_directory(request_of.store, found.version))
    assert record is not None and {"export", "before"} & {name for name, _ in record.training} == {"before"}
    assert any("export is of a time that the library has cycles of" in note for note in found.notes)
    # What is familiar is what was learned from, cycle by cycle.
    familiar = read_familiarity(version_directory(request_of.store, found.version))
    assert familiar is not None


def test_a_standard_trace_that_judges_nothing_lets_nothing_be_proposed(
    request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "score_trace", lambda trace, *_, **__: [] if trace.name == "short" else _scores(0.7))
    assert run(request_of, library).proposed
    short = replace(plant(1).between(BEGIN, BEGIN + 30.0), name="short")
    found = run(replace(request_of, standard=(short,), seed=1), library)
    assert not found.proposed and "short of the standard set judges nothing" in found.sentence


def test_better_at_a_shorter_horizon_counts_only_where_the_longer_ones_are_better_too() -> None:
    def told(*worth: float) -> list[str]:
        rows = [
            each for horizon, one in zip((60.0, 300.0, 900.0), worth, strict=True) for each in _scores(one, horizon)
        ]
        return [each.outcome for each in compare_horizons("cycles", rows, seed=1)]

    assert told(0.5, 0.5, 0.5) == ["better"] * 3
    assert told(0.5, 0.5, 1.5) == ["", "", "worse"]
    assert told(0.5, 1.5, 0.5) == ["", "worse", "better"]


def test_the_cycles_that_judge_a_candidate_outlive_the_historian(
    tmp_path: Path, historian: Path, store: Path, library: CycleLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    new, forecast = save(store, heated(HOT), created=BEGIN - 0.5), list[str]()

    def scored(trace: Trace, *_: Any, **__: Any) -> list[dict[str, Any]]:
        forecast.append(trace.name)
        return []

    monkeypatch.setattr(shadow, "score_trace", scored)

    def judged() -> shadow.SideBySide:
        return shadow.side_by_side(
            store, historian, library, machine="decanter", version=new, promotes=True, seed=0, report=silent
        )

    monkeypatch.setattr(shadow, "DAY_S", SHORT_DAY)
    assert judged().cycles == 2 * shadow.TRIAL_DAYS == len(forecast)
    assert all(row.kept for row in library.cycles()[: 2 * shadow.TRIAL_DAYS])
    monkeypatch.setattr(
        shadow, "read_cycle", lambda _, row, held: None if row.begin == BEGIN else held.readings(row.content)
    )
    less = judged()
    assert not less.enough and less.cycles == 2 * shadow.TRIAL_DAYS - 1
    assert len(forecast) == 2 * shadow.TRIAL_DAYS, "nobody is judged by fewer"
    assert "and 1 are neither kept nor in the historian any more" in less.sentence


def test_a_historian_of_several_machines_and_one_without_a_scan_are_one_sentence(tmp_path: Path, store: Path) -> None:
    new = save(store, heated(HOT), created=BEGIN - 0.5)
    path = tmp_path / "two.sqlite"
    empty = open_historian(path)
    assert empty.close()
    given = ("model", "version", "shadow", store, new, "--historian", path)
    refused(decanter(*given), 2, "has no scan yet; let the gateway run first")
    both = open_historian(path)
    for machine in ("one", "two"):
        view = both.view(machine, [Tag(TEMPERATURE, "holding:1")])
        view.put("scans", [(BEGIN, 0.0, 0)])
    assert both.close()
    refused(decanter(*given), 2, "has the rows of several machines; name one of one, two")


def test_a_library_of_a_later_program_and_one_that_is_a_directory_are_one_sentence(tmp_path: Path) -> None:
    with open_library(tmp_path / "l", machine="decanter", temperature=TEMPERATURE):
        pass
    with closing(sqlite3.connect(tmp_path / "l" / "cycles.sqlite")) as connection:
        connection.execute("PRAGMA user_version = 7")
    refused(
        decanter("model", "version", "cycles", tmp_path / "l"), 2, "has layout 7, and this program knows 1; update it"
    )
    (tmp_path / "d" / "cycles.sqlite").mkdir(parents=True)
    with (
        pytest.raises(ValueError, match="cannot be opened as a library"),
        open_library(tmp_path / "d", machine="decanter", temperature=TEMPERATURE),
    ):
        pass


def test_a_library_is_listed_while_another_process_works_on_it_and_where_nothing_may_be_written(
    request_of: RetrainingRequest, library: CycleLibrary, quick: SimpleNamespace, tmp_path: Path
) -> None:
    """The fixture's library is held; excluding a cycle there waits its turn, listing does not."""
    run(request_of, library)
    every = library.cycles()
    assert len(every) > 10 and quick.learned == 1
    listed = only_object(decanter("model", "version", "cycles", library.folder, "--json").stdout)
    assert [each["name"] for each in listed["cycles"]] == [row.name for row in every]
    given = ("--reason", "cleaning", "--by", "Ada")
    refused(
        decanter("model", "version", "cycles", library.folder, "--exclude", "c", *given),
        2,
        "another process is working on",
    )
    shutil.copytree(library.folder, tmp_path / "copy")
    (tmp_path / "copy" / ".lock").unlink(missing_ok=True)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "copy").rglob("*")}
    assert decanter("model", "version", "cycles", tmp_path / "copy").exit_code == 0
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "copy").rglob("*")} == before
    # A process that was killed while it wrote has left its journal: that write is taken back, and the rest listed.
    file = tmp_path / "copy" / "cycles.sqlite"
    writing = (
        "import os, sqlite3, sys; held = sqlite3.connect(sys.argv[1]); held.execute('PRAGMA cache_size = 1');"
        "held.execute('BEGIN'); held.execute('UPDATE cycles SET region = printf(\"%.9999c\", 42)');"
        "os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", writing, file], check=False).returncode == -9
    assert file.with_name("cycles.sqlite-journal").stat().st_size > 0
    again = only_object(decanter("model", "version", "cycles", tmp_path / "copy", "--json").stdout)
    assert again["cycles"] == listed["cycles"]
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "cycles.sqlite").touch()
    refused(decanter("model", "version", "cycles", tmp_path / "empty"), 2, "is no library of cycles")


def test_an_edited_record_is_one_sentence_and_a_family_in_a_circle_is_named(
    request_of: RetrainingRequest,
    library: CycleLibrary,
    quick: SimpleNamespace,
    store: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    version = run(request_of, library).version
    file = version_directory(store, version) / "record.json"
    text = file.read_text()
    document = json.loads(text)
    for key, value in (("parent", ["x"]), ("settings", 5), ("seed", "1"), ("training", [["a"]])):
        file.write_text(json.dumps({**document, key: value}))
        refused(decanter("model", "version", "lineage", store), 2, "cannot be used as a record")
    file.write_text(text)
    record = read_record(file.parent)
    assert record is not None
    circle = replace(record, parent=version)
    monkeypatch.setattr(lineage, "read_record", lambda folder: circle if folder == file.parent else None)
    shown = decanter("model", "version", "lineage", store)
    assert shown.exit_code == 0 and f"what came before: {version}" in shown.stdout


def test_a_version_made_at_no_moment_is_one_sentence(store: Path) -> None:
    manifest = version_directory(store) / "manifest.json"
    document = json.loads(manifest.read_text())
    for created in (1e18, 1e30, -1e18, "yesterday", None):
        manifest.write_text(json.dumps({**document, "created": created}))
        refused(decanter("model", "version", "lineage", store), 2, "does not say when the version was made")
