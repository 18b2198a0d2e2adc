"""The gate's verdict on learned models, on the public learner's automata and on broken models, as one table.

Learned from: the SYNTHETIC cd1 to cd17 (together and one by one) and production days, and from the real traces in
`--data` as far as they are there. What is proven of a model is put to the test by random timed words, replayed without
clamps: `left` counts those that left the proven interval of a location. A counterexample counts only when its text,
read again and replayed, leaves the model's range.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isinf
from pathlib import Path

import numpy as np
from rich.table import Table

from sim.effects.correction import in_sensor_scale
from sim.lab.formats.find import find_model
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.learning.lsha.learn import learn_lsha
from sim.lab.learning.structure import LearningError
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.plant.scenarios import SCENARIOS, history_and_day, scenario
from sim.proof.bounds import Bounds
from sim.proof.envelope import Envelope, envelopes
from sim.proof.structure import moves
from sim.proof.verification import DEFAULT, Verification, verify
from sim.proof.word import TimedWord, WordStep, parse_word, word_text
from sim.proof.word_replay import replay
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Input
from sim.sha.events import DECANTER, Alphabet, alphabet_symbols
from sim.sha.model import Correction, Model
from sim.sha.trace import UNKNOWN, Trace

ROOT = Path(__file__).parents[1]
TEMPERATURE = "TCuscinettiRiduttore"
REAL = {
    "SKAB": ("skab", "skab/anomaly-free.csv"),
    "CNC": ("made_cnc", "lsha_upstream/made_cnc"),
    "FEMTO 2_4": ("femto", "femto_bearing/Bearing2_4_temp.csv"),
    "FEMTO 2_5": ("femto", "femto_bearing/Bearing2_5_temp.csv"),
    "carobd": ("carobd", "carobd"),
    "can_obd2 A": ("can_obd2", "can_obd2/tripA164_decoded_long.csv"),
}
"""Name -> (column map, place in the data)."""
STAYS, LONGEST_STAY, TOLERANCE = 25, 20_000.0, 1e-6
"""Stays of a random word, the seconds of its longest stay, and degC that rounding may cost."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """One row: `refuted` are the checks that decide against the model, `word` (stays, s, replay leaves) of the first.

    `flows` counts the locations by their flow, `words` random words were replayed of which some have `left`.
    """

    name: str
    kind: str
    locations: int
    flows: str
    deployable: bool
    refuted: str
    word: tuple[int, float, bool] | None = None
    words: int = 0
    left: int = 0


@dataclass(frozen=True, slots=True)
class Source:
    """Traces to learn from, encoded, by their alphabet."""

    name: str
    traces: Sequence[Trace]
    alphabet: Alphabet
    temperature: str


def together() -> Iterator[Source]:
    """cd1 to cd17 together, and the demonstration's three production days."""
    yield Source("cd1-cd17", [scenario(name) for name in SCENARIOS], DECANTER, TEMPERATURE)
    yield Source("production, 3 days", history_and_day(0)[0], DECANTER, TEMPERATURE)


def singles() -> Iterator[Source]:
    """Each scenario alone."""
    for name in SCENARIOS:
        yield Source(name, [scenario(name)], DECANTER, TEMPERATURE)


def real(data: Path) -> Iterator[Source]:
    """The real traces that are there."""
    for name, (map_name, place) in REAL.items():
        if (data / place).exists():
            column_map = load_map(ROOT / "config" / "traces" / f"{map_name}.toml")
            traces, _ = load_traces(data / place, column_map)
            yield Source(name, traces, column_map.alphabet, column_map.temperature)


METHODS: Mapping[str, Callable[[Source], Model]] = {
    "bins": lambda one: learn_bins(one.traces, one.alphabet, one.temperature, seed=0).model,
    "lsha": lambda one: learn_lsha(one.traces, one.alphabet, one.temperature, seed=0).model,
}


def learned(sources: Iterator[Source], words: int) -> Iterator[Verdict]:
    """The verdicts on what both methods learn from each source; a source that teaches nothing is told."""
    for source in sources:
        for method, learn in METHODS.items():
            try:
                yield judged(source.name, method, learn(source), words)
            except LearningError as error:
                yield Verdict(source.name, method, 0, "", deployable=False, refuted=f"nothing learned: {error}")


def public(data: Path) -> Iterator[Verdict]:
    """The verdicts on the public learner's automata, which know no alphabet of a plant."""
    for file in sorted((data / "lsha_upstream" / "artefacts").rglob("*_source.txt")):
        found = find_model(file)
        done = verify(found.model or found.structure, refusal=found.refusal)
        yield _row(found.name, "artefacts", found.structure, done)


def mutants() -> Iterator[Verdict]:
    """The verdicts on a good model, learned from cd1 to cd17, that was broken in one place."""
    model = METHODS["bins"](next(together()))
    for name, broken in MUTANTS.items():
        yield judged(name, "mutant", broken(model), 0)


PARTS: Mapping[str, Callable[[Path, int], Iterator[Verdict]]] = {
    "mutants": lambda data, words: mutants(),
    "together": lambda data, words: learned(together(), words),
    "singles": lambda data, words: learned(singles(), words),
    "real": lambda data, words: learned(real(data), words),
    "public": lambda data, words: public(data),
}
"""The parts of the table, from the folder of the real data and the number of random words a model."""


def judged(name: str, kind: str, model: Model, words: int) -> Verdict:
    """The verdict on a model, and the fate of random words."""
    done = verify(model)
    row = _row(name, kind, model.sha, done)
    word = next((each for check in done.checks if check.blocking for each in check.words), None)
    if word is not None:
        again = replay(model, parse_word(word_text(word)))
        scaled = in_sensor_scale(model).sha
        leaves = again.leaves(scaled.low, scaled.high) is not None
        row = replace(row, word=(len(word.steps), word.end, leaves))
    if words and done.bounds is not None:
        row = replace(row, words=words, left=left_out(model, done.bounds, words, np.random.default_rng(1)))
    return row


def _row(name: str, kind: str, sha: SHA, done: Verification) -> Verdict:
    kinds = [location.flow.kind for location in sha.locations]
    flows = ", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds)))
    against = [f"{one.name} {one.verdict}" for one in done.checks if one.blocking and one.verdict != "proven"]
    return Verdict(name, kind, len(kinds), flows, done.deployable, ", ".join(against))


# ---------------------------------------------------------------- random words


def left_out(model: Model, found: Bounds, words: int, rng: np.random.Generator) -> int:
    """How many of so many random words leave the proven interval of a location in which they are."""
    scaled = in_sensor_scale(model)
    onward = moves(scaled.sha, alphabet_symbols(model.alphabet), DEFAULT.policy)
    rooms = {room.location: room for room in envelopes(scaled, DEFAULT, onward)}
    leads = {(source, symbol): target for source, symbol, target in onward}
    symbols = [*alphabet_symbols(model.alphabet), UNKNOWN]
    return sum(
        _leaves(scaled, found, random_word(scaled.sha.initial, found, rooms, leads, symbols, rng)) for _ in range(words)
    )


def random_word(
    here: str,
    found: Bounds,
    rooms: Mapping[str, Envelope],
    leads: Mapping[tuple[str, str], str],
    symbols: Sequence[str],
    rng: np.random.Generator,
) -> TimedWord:
    """A word within the assumptions: half of its numbers at an end of their range, stays from an instant to hours."""
    steps, time = [_stay(rooms[here], 0.0, "", _within(found.start, rng), rng)], 0.0
    for _ in range(STAYS):
        time += (0.0, rng.exponential(60.0), rng.uniform(0.0, LONGEST_STAY))[rng.integers(3)]
        symbol = symbols[int(rng.integers(len(symbols)))]
        here = leads[here, symbol]
        fresh = rooms[here].fresh
        drawn = None if fresh is None else _within(fresh, rng)
        steps.append(_stay(rooms[here], time, symbol, drawn, rng))
    return TimedWord(tuple(steps), time + LONGEST_STAY)


def _stay(room: Envelope, time: float, symbol: str, drawn: float | None, rng: np.random.Generator) -> WordStep:
    inputs = {name: _within(limits, rng) for name, limits in room.inputs.items()}
    return WordStep(time, symbol, _within(room.m, rng), drawn, inputs)


def _within(limits: tuple[float, float], rng: np.random.Generator) -> float:
    low, high = limits
    corner, share = rng.random(2).tolist()
    return (low, high)[int(4.0 * corner)] if corner < 0.5 else low + share * (high - low)


def _leaves(model: Model, found: Bounds, word: TimedWord) -> bool:
    return any(
        min(visit.entered, visit.left) < found.intervals[visit.location][0] - TOLERANCE
        or max(visit.entered, visit.left) > found.intervals[visit.location][1] + TOLERANCE
        for visit in replay(model, word).visits
    )


# ---------------------------------------------------------------- broken models


def _changed(model: Model, flow: Flow | None = None, law: Distribution | None = None) -> Model:
    """The model with another flow or law in the last location that relaxes."""
    place = max(n for n, one in enumerate(model.sha.locations) if one.flow.kind in ("exponential", "driven"))
    old = model.sha.locations[place]
    new = replace(old, flow=flow or old.flow, distribution=law or old.distribution)
    locations = (*model.sha.locations[:place], new, *model.sha.locations[place + 1 :])
    return replace(model, sha=replace(model.sha, locations=locations))


def _normal(mu: float, sigma: float) -> Distribution:
    return Distribution("normal", {"mu": mu, "sigma": sigma})


def _edges(model: Model, *edges: Edge) -> Model:
    return replace(model, sha=replace(model.sha, edges=(*edges, *model.sha.edges[len(edges) :])))


_LINEAR, _SLOW = Flow("linear", {"noise": 0.0}), Flow("logarithmic", {"t0": 60.0, "noise": 0.0})
_DRIVEN = Flow("driven", {"k": 0.001, "noise": 0.0}, (Input("Assorbimento", 50.0, 350.0),))

MUTANTS: Mapping[str, Callable[[Model], Model]] = {
    "warms by 0.05 degC/s for as long as it runs": lambda m: _changed(m, _LINEAR, _normal(0.05, 0.0)),
    "cools by 0.05 degC/s for as long as it runs": lambda m: _changed(m, _LINEAR, _normal(-0.05, 0.0)),
    "warms on average by nothing, give or take": lambda m: _changed(m, _LINEAR, _normal(0.0, 0.01)),
    "warms by 5 degC ln(1 + t / 60 s)": lambda m: _changed(m, _SLOW, _normal(5.0, 0.0)),
    "a target of 700 degC": lambda m: _changed(m, law=_normal(700.0, 1.0)),
    "a target of 700 degC, give or take 300": lambda m: _changed(m, law=_normal(700.0, 300.0)),
    "a target of -80 degC": lambda m: _changed(m, law=_normal(-80.0, 5.0)),
    "a target with a heavy tail, mean 3.6 million": lambda m: _changed(
        m, law=Distribution("weibull", {"shape": 0.1, "scale": 1.0})
    ),
    "a target that moves by 50 degC per ampere": lambda m: _changed(m, _DRIVEN),
    "noise of 100 degC/sqrt(s)": lambda m: _changed(m, Flow("exponential", {"k": 0.001, "noise": 100.0})),
    "a rate of 0": lambda m: _changed(m, Flow("exponential", {"k": 0.0, "noise": 0.0})),
    "a target that is no number": lambda m: _changed(m, law=_normal(float("nan"), 1.0)),
    "a correction by a factor of 20": lambda m: replace(m, correction=Correction(20.0)),
    "a sensor good to 1,000 degC": lambda m: replace(m, sensor_sigma=1000.0),
    "two targets on one symbol": lambda m: _edges(m, replace(m.sha.edges[1], target=m.sha.locations[-1].name)),
    "a guard": lambda m: _edges(m, replace(m.sha.edges[0], guard="x > 3")),
    "an empty alphabet": lambda m: replace(m, alphabet=Alphabet(())),
    "starts at 400 degC": lambda m: replace(m, initial=_normal(400.0, 1.0)),
}


# ---------------------------------------------------------------- the table


def as_table(rows: Sequence[Verdict]) -> Table:
    """What is printed."""
    table = Table(title="verdicts of the gate", title_justify="left", pad_edge=False)
    for name in ("model", "by", "locations", "flows", "verdict", "because of", "word", "random words", "left"):
        table.add_column(name, justify="right" if name in ("locations", "random words", "left") else "left")
    for one in rows:
        verdict = "deployable" if one.deployable else "refused"
        tried = (f"{one.words:,}", str(one.left)) if one.words else ("", "")
        table.add_row(one.name, one.kind, str(one.locations), one.flows, verdict, one.refuted, _word(one.word), *tried)
    return table


def _word(word: tuple[int, float, bool] | None) -> str:
    if word is None:
        return ""
    stays, seconds, leaves = word
    return f"{stays} stays, {seconds:,.0f} s, {'leaves' if leaves and not isinf(seconds) else 'STAYS INSIDE'}"
