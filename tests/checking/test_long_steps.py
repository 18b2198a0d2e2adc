"""One exact step over several pieces: its law, where it is filled in, and that answers are those of single pieces."""

import tracemalloc
from dataclasses import replace
from math import inf, sqrt

import numpy as np
import pytest

from sim.lab.checking.query.tree import Always, Both, Either, Formula, Path, Probability, TimeSpan, Until
from sim.lab.checking.smc.answers import QuerySettings, Start, answer
from sim.lab.checking.smc.paths import Cuts, State, long_steps
from sim.lab.checking.smc.paths.known_events import known_engine
from sim.lab.checking.smc.paths.long_steps import NestedStep, join_steps
from sim.lab.checking.smc.start import initial
from tests.checking.worlds import along, compare, eventually, flow, model, normal

RELAXING = model([flow("exponential", k=0.01)], [normal(42.0, 0.5)], first=normal(40.0))
TOGETHER = (initial(RELAXING), along(RELAXING, 40.0, 400.0))


def test_the_pieces_of_a_filled_step_have_the_law_of_pieces_one_after_another() -> None:
    """Each piece's noise, worked back from its ends, is standard normal and owes nothing to where the piece began."""
    runs, rng = 40_000, np.random.default_rng(5)
    parts = [
        NestedStep(
            begin=10.0 * k,
            dt=10.0,
            age=10.0 * k,
            location=0,
            decay=decay,
            pull=1.0 - decay,
            shift=0.3 * k,
            variance=0.5 + k,
            bridge=0.6 + k,
        )
        for k, decay in enumerate((0.9, 0.7, 0.95))
    ]
    mode, start = rng.normal(10.0, 1.0, runs), rng.normal(10.0, 1.0, runs)
    state = State(start, mode, *np.zeros((2, runs), dtype=np.intp))
    lines = np.arange(-10.0, 40.0, 0.5).tolist()  # so many that every run comes near to one
    pieces = join_steps(parts).advance(state, mode, sha=RELAXING.sha, lines=lines, rng=rng)
    assert pieces is not None
    found = list(pieces)
    assert [piece.begin for piece in found] == [0.0, 10.0, 20.0]
    before = start
    for part, piece in zip(parts, found, strict=True):
        assert piece.start.tobytes() == before.tobytes()
        noise = (piece.end - part.mean(piece.start, mode)) / sqrt(part.variance)
        assert abs(noise.mean()) < 4.0 / sqrt(runs)
        assert abs(noise.std() - 1.0) < 4.0 / sqrt(2.0 * runs)
        for other in (piece.start, mode):
            assert abs(np.corrcoef(noise, other)[0, 1]) < 4.0 / sqrt(runs)
        before = piece.end
    assert before.tobytes() == state.x.tobytes()


@pytest.mark.parametrize(("line", "pieces"), [(60.0, 20), (40.0, None)])
def test_only_runs_near_a_line_take_single_pieces(line: float, pieces: int | None) -> None:
    """400 s in pieces of 5 s are 20 steps of four pieces."""
    made = known_engine(TOGETHER[1].world, Cuts(400.0, looked=((0.0, 400.0),), lines=(line,)))
    rng = np.random.default_rng(1)
    state = made.begin(500, rng)
    found = [piece for row in range(made.clock.size - 1) for piece in made.advance(row, state, rng)]
    lasts = np.concatenate([np.full(piece.start.size, piece.dt) for piece in found])
    assert lasts.sum() == pytest.approx(500 * 400.0), "every run all the time"
    if pieces is not None:
        assert len(found) == pieces
    assert (lasts.min() < 5.01) == (pieces is None)
    for piece in found:  # a piece without a bridge keeps away from the line
        if not piece.bridge:
            assert ((line - piece.start) * (line - piece.end)).min() > 0.0


def test_a_query_of_too_many_steps_is_refused_before_they_are_laid_out() -> None:
    """Six million steps are half a gigabyte."""
    tracemalloc.start()
    with pytest.raises(ValueError, match="needs 6000000 steps a run, above 200000"):
        known_engine(TOGETHER[1].world, Cuts(3e7, looked=((0.0, 3e7),)))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50e6


BAND = Both(compare(">=", 39.8), compare("<", 42.5))
PATHS: dict[str, Path] = {
    "reached": eventually(compare(">=", 42.5), 400.0).path,
    "left": Always(BAND, TimeSpan(0.0, 400.0)),
    "either": eventually(Either(compare(">=", 43.0), compare("<=", 39.5)), 400.0).path,
    "until": Until(compare(">", 39.7), compare(">=", 42.0), TimeSpan(50.0, 400.0)),
}


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("start", TOGETHER, ids=["unknown events", "known events"])
def test_answers_and_moments_are_those_of_single_pieces(
    name: str, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, settings = Probability(400.0, PATHS[name]), QuerySettings(rule="fixed", runs=20_000)
    several = answer(asked, start, settings)
    monkeypatch.setattr(long_steps, "MAX_PIECES", 1)
    single = answer(asked, start, replace(settings, seed=1))
    p = single.numbers["probability"]
    assert 0.05 < p < 0.95
    assert abs(several.numbers["probability"] - p) < 4.0 * sqrt(2.0 * p * (1.0 - p) / 20_000)
    assert several.passages is not None and single.passages is not None
    ours, theirs = (each[np.isfinite(each)] for each in (several.passages, single.passages))
    apart = ours.mean() - theirs.mean()
    assert abs(apart) < 4.0 * sqrt(ours.var() / ours.size + theirs.var() / theirs.size)


@pytest.mark.parametrize("known_events", [False, True])
@pytest.mark.parametrize(("high", "max_rate"), [(42.0, inf), (1e6, 0.01)])
def test_where_a_step_is_not_affine_pieces_are_taken_one_by_one(
    known_events: bool, high: float, max_rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = model([flow("exponential", k=0.01)], [normal(42.0, 0.5)], first=normal(41.5), high=high, max_rate=max_rate)
    start = along(made, 41.5, 400.0) if known_events else initial(made)
    asked: Formula = compare("<=", 39.2)  # in so few runs that decided ones are left out by neither
    settings = QuerySettings(rule="fixed", runs=2000)
    several = answer(eventually(asked, 400.0), start, settings)
    monkeypatch.setattr(long_steps, "MAX_PIECES", 1)
    single = answer(eventually(asked, 400.0), start, settings)
    assert several.numbers == single.numbers
    assert several.notes == single.notes
    assert several.notes, "clamps, or limited steps, are counted"
