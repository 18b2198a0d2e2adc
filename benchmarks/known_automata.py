"""Random deterministic automata with known locations, traces of them, and how well L*_SHA finds them again.

Three families over a switch and a level of three bins. `context`: the law depends on what both channels are;
`direction`: also on whether the level rose or fell last; `free`: any deterministic automaton of so many locations, in
which the location may depend on the whole word.

`python -m benchmarks.known_automata` learns automata of the family `free` from ever more traces of 30 stays: what comes
back must not get worse with more of them. Truth is the smallest automaton with the same targets in which no location
stands for both positions of the switch; the error is that of free runs of the whole model over eight new traces.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import exp
from time import process_time
from typing import Literal

import click
import numpy as np

from benchmarks.figures import Figure, give
from sim.engine.open_loop_run import open_loop, readings
from sim.lab.learning.lsha.evidence import PooledEvidence, same_distribution
from sim.lab.learning.lsha.flow_hypotheses import Flowing, choose_flow
from sim.lab.learning.lsha.hypothesis import build_hypothesis
from sim.lab.learning.lsha.learn import learn_lsha
from sim.lab.learning.lsha.settings import LshaSettings
from sim.lab.learning.lsha.structures import choose_structure
from sim.lab.learning.lsha.teacher import Teacher, make_teacher
from sim.lab.learning.lsha.words import build_classes
from sim.sha.automaton import transitions
from sim.sha.events import Alphabet, Bins, Switch, encode
from sim.sha.trace import Trace

PLANT = Alphabet((Switch("On", "ON", "OFF"), Bins("Load", (1.0, 2.0), ("L_0", "L_1", "L_2"))), gap=60.0)
SYMBOLS = ("ON", "OFF", "L_0", "L_1", "L_2")
POSITIONS = {"ON": 1, "OFF": 0}
LEVELS = (0.5, 1.5, 2.5)
PERIOD, TAU, SCATTER, SENSOR = 4.0, 200.0, 1.0, 0.1
"""Seconds between rows, time constant (s), degC from stay to stay, degC of the sensor."""
TRACES, STAYS = 14, 30
APART = 12.0
"""degC between the targets of two locations."""

Family = Literal["context", "direction", "free"]


@dataclass(frozen=True, slots=True)
class Automaton:
    """`after` (state, symbol) -> state, `target` state -> degC, `on` state -> position of the switch, None if unknown.

    The word since the beginning starts in state 0.
    """

    after: Mapping[tuple[int, str], int]
    target: tuple[float, ...]
    on: tuple[int | None, ...]

    def minimal(self) -> tuple[int, ...]:
        """The location of each state of the smallest automaton with the same targets and positions of the switch after
        every word (Moore 1956)."""
        block = _numbers(list(zip(self.target, self.on, strict=True)))
        while True:
            finer = _numbers(
                [
                    (block[state], *(block[self.after[state, symbol]] for symbol in SYMBOLS))
                    for state in range(len(block))
                ]
            )
            if max(finer) == max(block):
                return tuple(finer)
            block = finer


def _numbers(keys: Sequence[tuple[object, ...]]) -> list[int]:
    order: dict[tuple[object, ...], int] = {}
    return [order.setdefault(key, len(order)) for key in keys]


def random_automaton(family: Family, laws: int, rng: np.random.Generator) -> Automaton:
    """An automaton with `laws` different targets (`free`: locations), drawn anew until all of them can be reached."""
    while True:
        found = _free(laws, rng) if family == "free" else _remembering(family, laws, rng)
        reached = {0}
        front = [0]
        for state in front:
            new = {found.after[state, symbol] for symbol in SYMBOLS} - reached
            reached |= new
            front += sorted(new)
        if len({found.target[state] for state in reached}) >= laws:
            return found


def _targets(laws: int, rng: np.random.Generator) -> list[float]:
    return (20.0 + APART * rng.permutation(laws)).tolist()


def _free(laws: int, rng: np.random.Generator) -> Automaton:
    free = {(law, symbol): int(rng.integers(laws)) for law in range(laws) for symbol in SYMBOLS}
    targets = _targets(laws, rng)
    # Each location once for each position of the switch, before it is known as well.
    states = list(product((None, 0, 1), range(laws)))
    place = {state: number for number, state in enumerate(states)}
    after = {
        (place[on, law], symbol): place[POSITIONS.get(symbol, on), free[law, symbol]]
        for on, law in states
        for symbol in SYMBOLS
    }
    return Automaton(after, tuple(targets[law] for _, law in states), tuple(on for on, _ in states))


def _remembering(family: Family, laws: int, rng: np.random.Generator) -> Automaton:
    """States are (on, level, direction); a law for each context, and in the family `direction` for each of both."""
    states = list(product((0, 1), range(3), (0, 1) if family == "direction" else (0,)))
    place = {state: number for number, state in enumerate(states)}
    after = {}
    for on, level, direction in states:
        for symbol in SYMBOLS:
            new = int(symbol[-1]) if symbol.startswith("L") else level
            turn = int(new > level) if new != level and family == "direction" else direction
            after[place[on, level, direction], symbol] = place[POSITIONS.get(symbol, on), new, turn]
    targets = _targets(laws, rng)
    law = [*range(laws), *rng.integers(laws, size=max(len(states) - laws, 0)).tolist()]
    own = tuple(targets[number] for number in rng.permutation(law)[: len(states)])
    return Automaton(after, own, tuple(on for on, _, _ in states))


def traces_of(
    automaton: Automaton,
    rng: np.random.Generator,
    scatter: float = SCATTER,
    *,
    count: int = TRACES,
    stays: int = STAYS,
) -> list[Trace]:
    """`count` encoded traces of random words; every trace begins by announcing both channels."""
    return [_trace(automaton, rng, f"t{number:02d}", number * 1e6, scatter, stays) for number in range(count)]


def _trace(
    automaton: Automaton, rng: np.random.Generator, name: str, begin: float, scatter: float, stays: int
) -> Trace:
    on, level, x, rows = int(rng.integers(2)), int(rng.integers(3)), float(rng.uniform(20, 60)), []
    state = automaton.after[automaton.after[0, "ON" if on else "OFF"], f"L_{level}"]
    for _ in range(stays):
        m = automaton.target[state] + scatter * rng.normal()
        for _ in range(int(rng.integers(6, 30))):
            rows.append((on, LEVELS[level], x + SENSOR * rng.normal()))
            x = m + (x - m) * exp(-PERIOD / TAU)
        if rng.random() < 0.3:
            on = 1 - on
            symbol = "ON" if on else "OFF"
        else:
            level = int(rng.choice([other for other in range(3) if other != level]))
            symbol = f"L_{level}"
        state = automaton.after[state, symbol]
    columns = dict(zip(("On", "Load", "T"), np.array(rows).T, strict=True))
    trace = Trace(name, begin + PERIOD * np.arange(len(rows)), columns, origin="known automaton", synthetic=True)
    return replace(trace, events=encode(trace, PLANT))


@dataclass(frozen=True, slots=True)
class Found:
    """What came back of the smallest automaton, judged where both channels are known.

    `count`: the locations are as many. `isomorphic`: they are the same ones after every word of the traces. Where a
    plant never says some symbols in some locations several smallest automata are equally right, and only one of them is
    the reference. `right`: the share of events of new words after which the law is the right one, default edges
    included.
    """

    count: bool
    isomorphic: bool
    right: float


def found_again(automaton: Automaton, traces: Sequence[Trace], others: Sequence[Trace]) -> Found:
    """The learner's structure for `traces` against the automaton that they are of; `others` are new words of it."""
    chosen = LshaSettings()
    teacher, flowing = _flowing(traces, chosen)
    structure, _ = choose_structure(teacher, flowing.sample, chosen)
    hypothesis = build_hypothesis(teacher, structure, complete=True)
    after = {key: target for key, (target, _) in hypothesis.observed.items()} | dict(hypothesis.default)
    pairs = _met(automaton, after, traces)
    minimal = automaton.minimal()
    true, learned = {minimal[state] for state, _ in pairs}, {there for _, there in pairs}
    same = len({(minimal[state], there) for state, there in pairs}) == len(true) == len(learned)
    law: dict[int, Counter[float]] = {there: Counter() for there in range(len(hypothesis.names))}
    for (state, there), times in pairs.items():
        law[there][automaton.target[state]] += times
    taken = {there: max(times, key=lambda one: (times[one], one)) for there, times in law.items() if times}
    new = _met(automaton, after, others)
    right = sum(times for (state, there), times in new.items() if taken.get(there) == automaton.target[state])
    return Found(len(true) == len(learned), same, right / sum(new.values()))


def _met(
    automaton: Automaton, after: Mapping[tuple[int, str], int], traces: Sequence[Trace]
) -> Counter[tuple[int, int]]:
    """(state, learned location) after every event but the first one of each trace, and how often they met."""
    pairs: Counter[tuple[int, int]] = Counter()
    for trace in traces:
        here, state = 0, 0
        for number, event in enumerate(trace.events):
            here, state = after[here, event.symbol], automaton.after[state, event.symbol]
            if number:
                pairs[state, here] += 1
    return pairs


def _flowing(traces: Sequence[Trace], settings: LshaSettings) -> tuple[Teacher, Flowing]:
    teacher = make_teacher(traces, PLANT, "T", settings.n_min, settings.split)
    return teacher, choose_flow(teacher, settings.default_flow, settings.alpha, settings.n_min)[0]


@dataclass(frozen=True, slots=True)
class LearnedAgain:
    """A model of one automaton against the truth: `locations` and `edges` (both channels known, as met in the traces),
    how far off targets are on average, the free-run error (both degC), and processor seconds."""

    locations: tuple[int, int]
    edges: tuple[int, int]
    target_error: float
    held_out: float
    seconds: float


def learned_from(automaton: Automaton, traces: Sequence[Trace], others: Sequence[Trace]) -> LearnedAgain:
    """The whole model learned from `traces`, judged on `others`."""
    begin = process_time()
    model = learn_lsha(traces, PLANT, "T", seed=0).model
    seconds = process_time() - begin
    moves, minimal = transitions(model.sha), automaton.minimal()
    locations: set[tuple[int, str]] = set()
    edges: set[tuple[int, str, str]] = set()
    off: list[float] = []
    for trace in traces:
        state, here = 0, model.sha.initial
        for number, event in enumerate(trace.events):
            if number > 1:
                edges.add((minimal[state], here, event.symbol))
            state, here = automaton.after[state, event.symbol], moves[here, event.symbol]
            if number:
                locations.add((minimal[state], here))
                law = model.sha.by_name[here].distribution
                off.append(abs((law.params["mu"] if law else np.nan) - automaton.target[state]))
    errors = []
    for trace in others:
        times, values = readings(trace, "T")
        run = open_loop(replace(model, calibration={}), trace, "resync")
        errors.append(run.mean[np.searchsorted(run.times, times, side="right") - 1] - values)
    return LearnedAgain(
        locations=(len({there for _, there in locations}), len({state for state, _ in locations})),
        edges=(len({edge[1:] for edge in edges}), len({(state, symbol) for state, _, symbol in edges})),
        target_error=float(np.nanmean(off)),
        held_out=float(np.mean(np.abs(np.concatenate(errors)))),
        seconds=seconds,
    )


def query_p(difference: float, rng: np.random.Generator, kind: str = "exponential") -> float:
    """p of one hypothesis-test query (no tolerance) between two locations whose targets differ by `difference` degC.

    On with a low load is at 50, with a middle one at 50 + `difference`, with a high one at 80; off is at 20. The
    segments come out of traces, with a rate that was estimated from the same traces.
    """
    targets = (20.0, 20.0, 20.0, 50.0, 50.0 + difference, 80.0)
    after = {
        (3 * on + level, symbol): 3 * POSITIONS.get(symbol, on) + (int(symbol[-1]) if symbol.startswith("L") else level)
        for on in (0, 1)
        for level in range(3)
        for symbol in SYMBOLS
    }
    settings = LshaSettings(default_flow=kind)
    teacher, flowing = _flowing(traces_of(Automaton(after, targets, (0, 0, 0, 1, 1, 1)), rng), settings)
    classes = build_classes(teacher.words, "context")
    pooled = flowing.sample.pool_classes(classes.of_state, len(classes), settings.n_min)
    low, middle = (_evidence(pooled, classes.keys, level) for level in (0, 1))
    return same_distribution(low, middle, 0.0).p


def _evidence(pooled: Sequence[PooledEvidence], keys: Sequence[object], level: int) -> PooledEvidence:
    """Of the words that are on with that level; those that are states of their own belong to it as well."""
    mine = [one for one, key in zip(pooled, keys, strict=True) if getattr(key, "context", None) == (1, level)]
    whole = mine[0]
    for one in mine[1:]:
        whole = whole.merge(one)
    return whole


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="One automaton of six locations, 20 and 80 traces.")
@click.option("--locations", default="4,6,8,10", show_default=True, help="Locations of the automata.")
@click.option("--traces", default="5,20,60,200", show_default=True, help="Traces of each automaton.")
@click.option("--stays", default=STAYS, show_default=True, type=click.IntRange(2), help="Stays of a trace.")
@click.option("--seed", default=1, show_default=True, help="Seed of the automata.")
def main(as_json: bool, quick: bool, locations: str, traces: str, stays: int, seed: int) -> None:
    figures = []
    for laws in [6] if quick else [int(text) for text in locations.split(",")]:
        automaton = random_automaton("free", laws, np.random.default_rng(seed))
        others = traces_of(automaton, np.random.default_rng([seed, laws]), count=8, stays=stays)
        first: float | None = None
        for count in [20, 80] if quick else [int(text) for text in traces.split(",")]:
            given = traces_of(automaton, np.random.default_rng([seed, laws, count]), count=count, stays=stays)
            found = learned_from(automaton, given, others)
            first = found.held_out if first is None else first
            what = f"{laws} locations, {count} traces, {sum(len(trace.events) for trace in given):,} events"
            figures += [
                Figure(f"{what}: locations", found.locations[0], "", "true ones", found.locations[1]),
                Figure(f"{what}: edges", found.edges[0], "", "true ones", found.edges[1]),
                Figure(f"{what}: targets off by", found.target_error, "degC", "scatter from stay to stay", SCATTER),
                Figure(f"{what}: held-out MAE", found.held_out, "degC", "that of the fewest traces", first),
                Figure(f"{what}: processor time", found.seconds, "s", "bound for 20,000 events", 30.0),
            ]
    give("Known automata", figures, as_json=as_json)


if __name__ == "__main__":
    main()
