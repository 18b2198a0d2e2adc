"""Threads that share the chunks of a query's runs: the same answers, none of them left, errors that arrive."""

import os
import threading
from time import monotonic, sleep

import numpy as np
import pytest

from gateway.lab.checking import check
from sim.lab.checking.query.tree import Expectation, Hypothesis, Number, Operation, PairedComparison, Query
from sim.lab.checking.smc import chunks
from sim.lab.checking.smc.answers import Answer, QuerySettings, Start, answer
from sim.lab.checking.smc.chunks import chunk_size, in_order
from sim.lab.checking.smc.monitors.monitor import EventuallyMonitor
from sim.lab.checking.smc.start import initial
from sim.lab.formats import FoundModel
from sim.lab.workers import Threads, threads
from tests.checking.test_effects_queries import made, recorded
from tests.checking.worlds import TEMP, TIME, along, compare, eventually, flow, model, normal
from tests.sha.effect_reference import EFFECTS

PATIENCE_S = 60.0
RELAXING = model([flow("exponential", k=0.01)], [normal(42.0, 1.0)], first=normal(40.0, 0.5), stay=normal(100.0, 5.0))
REACHED = eventually(compare(">=", 43.0), 200.0)


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of 256 runs count as large ones, and none is larger: many of them in few runs."""
    monkeypatch.setattr(chunks, "SIDE_BY_SIDE", 256)
    monkeypatch.setattr(chunks, "LARGEST", 256)


def _same(left: Answer, right: Answer) -> bool:
    assert left.passages is None or right.passages is None or np.array_equal(left.passages, right.passages)
    return (left.sentence, left.numbers, left.runs, left.notes) == (
        right.sentence,
        right.numbers,
        right.runs,
        right.notes,
    )


KNOWN, UNKNOWN = along(RELAXING, 40.0, 200.0, (100.0,)), initial(RELAXING)
WARMED = initial(made(*EFFECTS["current-heating"]), recorded(100.0))


@pytest.mark.parametrize(
    ("start", "query", "settings"),
    [
        (KNOWN, REACHED, QuerySettings(rule="fixed", runs=1500)),
        (KNOWN, REACHED, QuerySettings(epsilon=0.025)),
        (KNOWN, Hypothesis(REACHED, ">=", 0.25), QuerySettings(delta=0.005)),
        (KNOWN, PairedComparison(REACHED, eventually(compare(">=", 43.02), 200.0)), QuerySettings(delta=0.01)),
        (KNOWN, Expectation(200.0, 1200, "max", TEMP), QuerySettings()),
        (UNKNOWN, eventually(compare(">=", 42.0), 150.0, 150.0), QuerySettings(runs=800)),
        (WARMED, Expectation(50.0, 800, "max", TEMP), QuerySettings()),
    ],
    ids=["fixed", "sequential", "hypothesis", "comparison", "expectation", "unknown events", "effects"],
)
def test_answers_are_the_same_with_any_number_of_threads(start: Start, query: Query, settings: QuerySettings) -> None:
    alone = answer(query, start, settings)
    assert alone.runs > 64 + 128 + 2 * 256, "several large chunks are seen"
    for count in (1, 2):
        with threads(count) as helpers:
            assert _same(alone, answer(query, start, settings, threads=helpers))


def test_large_chunks_are_made_by_the_threads_and_none_beyond_the_runs_that_are_asked_for() -> None:
    by: dict[int, str] = {}

    def make(number: int) -> int:
        by[number] = threading.current_thread().name
        return number

    with threads(2) as helpers:
        source = in_order(make, helpers, runs=64 + 128 + 2 * 256)
        assert [next(source) for _ in range(4)] == [0, 1, 2, 3]
    here = threading.current_thread().name
    assert sorted(by) == [0, 1, 2, 3]
    assert by[0] == by[1] == here
    assert here not in (by[2], by[3])


def test_a_rule_that_stops_early_leaves_no_thread_and_what_was_begun_ahead_ends() -> None:
    """The runs ahead are endless unless they are told that nobody wants them."""
    begun, told = threading.Event(), threading.Event()
    before = set(threading.enumerate())

    def make(number: int) -> int:
        if number < 3:
            return number
        begun.set()
        assert helpers is not None
        deadline = monotonic() + PATIENCE_S
        while helpers.wanted() and monotonic() < deadline:
            sleep(0.01)
        if not helpers.wanted():
            told.set()
        return number

    with threads(2) as helpers:
        assert next(source := in_order(make, helpers)) == 0
        assert [next(source), next(source)] == [1, 2]
        assert begun.wait(PATIENCE_S)
    assert told.is_set()
    assert set(threading.enumerate()) <= before


def test_runs_that_nobody_wants_end_on_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []
    see = EventuallyMonitor.see
    monkeypatch.setattr(EventuallyMonitor, "see", lambda self, piece, who: (seen.append(1.0), see(self, piece, who))[1])
    start, query = along(RELAXING, 40.0, 200.0), eventually(compare(">=", 90.0), 200.0)
    answer(query, start, QuerySettings(runs=64))
    whole = len(seen)
    seen.clear()
    with threads(2) as helpers:
        assert helpers is not None
        helpers.end()
        answer(query, start, QuerySettings(runs=64), threads=helpers)
    assert 0 < len(seen) < whole


@pytest.mark.parametrize("at", [0, 4])
def test_an_error_arrives_where_its_chunk_is_due_and_leaves_no_thread(at: int) -> None:
    def make(number: int) -> int:
        if number == at:
            raise ValueError(f"chunk {number} cannot be made")
        return number

    before = set(threading.enumerate())
    seen = []
    with pytest.raises(ValueError, match=f"chunk {at} cannot be made"), threads(2) as helpers:
        for number in in_order(make, helpers):
            seen.append(number)
    assert seen == list(range(at))
    assert set(threading.enumerate()) <= before


def test_an_expression_that_is_no_number_is_refused_as_without_threads() -> None:
    nowhere = Expectation(200.0, 1000, "max", Operation("+", TEMP, Operation("/", Number(1.0), TIME)))
    start = along(RELAXING, 40.0, 200.0)
    before = set(threading.enumerate())
    with pytest.raises(ValueError, match="it divides by 0 there"), threads(2) as helpers:
        answer(nowhere, start, QuerySettings(), threads=helpers)
    assert set(threading.enumerate()) <= before


def test_chunks_keep_their_sizes() -> None:
    """Run i is the same run in every version: the sizes are part of a seed's meaning."""
    assert [chunk_size(number) for number in range(4)] == [64, 128, 256, 256]


@pytest.mark.parametrize(("cores", "count"), [({0}, None), ({0, 3}, 2)])
def test_a_query_has_a_thread_for_each_core(
    cores: set[int], count: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[int | None] = []

    def seen(query: Query, start: Start, settings: QuerySettings, report: object, helpers: Threads | None) -> Answer:
        given.append(None if helpers is None else helpers.count)
        return answer(query, start, settings, threads=helpers)

    monkeypatch.setattr(check, "answer", seen)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: cores)
    found = FoundModel("relaxing", RELAXING.sha, RELAXING)
    check.answer_query("Pr[<=200](<> Temp >= 43)", found, None, settings=QuerySettings(runs=1000))
    assert given == [count]
