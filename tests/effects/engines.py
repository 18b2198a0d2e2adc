"""One effect on one record through every engine that executes it: the fit of a diagnosis and four of the automaton."""

from dataclasses import replace
from functools import cache

import numpy as np

from sim.engine.belief import advance, on_event, start, with_inputs
from sim.engine.open_loop_run import open_loop
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.engine.tracker import compile_model
from sim.lab.discrepancy.fitting.baseline import build_frame
from sim.lab.discrepancy.fitting.candidates import catalogue_entry
from sim.lab.discrepancy.fitting.course import run_frame
from sim.lab.discrepancy.fitting.named import Named, automaton_effects
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.learning.structure import contexts, product_sha
from sim.lab.uppaal.model_export import export
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import Alphabet, Bins, Switch
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Array, Event, Trace
from tests.sha.effect_reference import EFFECTS as EXAMPLES
from tests.uppaal.support import courses, middle

FIT: dict[str, float] = {"thermostatic-cooling": 3.3, "sensor-lag": 0.09}
"""degC by which the fit's course differs at most, where it is more than 0.03: it holds a law over a step of the record.
Thermostats that cycle lose step with one another, and then differ by their hysteresis; a lag is late by half a step."""
LEARNERS = ("bins", "lsha", "own names")

ALPHABET = Alphabet((Switch("on", "W_ON", "W_OFF"), Bins("I", (120.0,), ("A_0", "A_1"))), gap=600.0)
LENGTH, STEP = 2400.0, 0.5
"""Seconds of the record, and between its rows: so short that a law held over a step is nearly exact."""
OUTPUTS: Array = np.arange(60.0, LENGTH + 1.0, 60.0)
REST = 22.0
STILL = Flow("constant", {"noise": 0.0})
TARGETS = {"rest": (REST, 0.003), "low": (45.0, 0.004), "high": (60.0, 0.004)}
"""(degC, 1/s)."""
NAMES = {
    "lsha": {"rest": "OFF/0-120", "low": "ON/0-120 rising", "high": "ON/120+ #2"},
    "own names": {"rest": "q0", "low": "q1", "high": "q2"},
}
EVENTS = (
    Event(0.0, "W_OFF"),
    Event(0.0, "A_0"),
    Event(200.0, "W_ON"),
    Event(400.0, "A_1"),
    Event(900.0, "A_0"),
    Event(1200.0, "W_OFF"),
    Event(1500.0, "W_ON"),
    Event(1500.0, "A_1"),
    Event(2100.0, "W_OFF"),
)


def location(name: str, which: str) -> Location:
    """A location that relaxes to the target of one of TARGETS, without any noise."""
    target, k = TARGETS[which]
    law = Distribution("normal", {"mu": target, "sigma": 0.0})
    return Location(name, Flow("exponential", {"k": k, "noise": 0.0}), law)


@cache
def model_of(learner: str) -> Model:
    """The same plant as the learners write it: a product of contexts, classes of words, or names of somebody's own.

    In all of them UNKNOWN leads to the initial location.
    """
    if learner == "bins":
        known = {name: Location(name, STILL) for name in contexts(ALPHABET)}
        for name, context in contexts(ALPHABET).items():
            if None not in context:
                known[name] = location(name, "rest" if context[0] == 0 else "low" if context[1] == 0 else "high")
        return Model(product_sha(ALPHABET, known, "small"), ALPHABET, "T", 0.1)
    names = NAMES[learner]
    rest, low, high = names["rest"], names["low"], names["high"]
    edges = [Edge(place, symbol, rest) for place in names.values() for symbol in ("W_OFF", UNKNOWN)]
    edges += [Edge(rest, "W_ON", low), Edge(rest, "A_0", rest), Edge(rest, "A_1", rest)]
    edges += [
        Edge(place, symbol, low if symbol == "A_0" else high) for place in (low, high) for symbol in ("A_0", "A_1")
    ]
    edges += [Edge(place, "W_ON", place) for place in (low, high)]
    places = tuple(location(names[which], which) for which in TARGETS)
    return Model(SHA("small", places, tuple(edges), rest), ALPHABET, "T", 0.1)


@cache
def trace_of(first: float = 0.0) -> Trace:
    """The record: at rest, running low and high, at rest again; signals that change every 100 s, read from `first`."""
    rng = np.random.default_rng(3)
    times: Array = np.arange(0.0, LENGTH + STEP / 2, STEP)
    rows = np.flatnonzero((times % 100.0 == 0) & (times >= first))
    values = {
        "I": rng.uniform(50.0, 200.0, rows.size),
        "M": rng.uniform(0.0, 40.0, rows.size),
        "Ta": rng.uniform(10.0, 30.0, rows.size),
        "P": rng.integers(-1, 2, rows.size).astype(float),
    }
    signals = {"T": np.full(times.size, REST)}
    for name, column in values.items():
        signals[name] = np.full(times.size, np.nan)
        signals[name][rows] = column
    return Trace("record", times, signals, EVENTS)


def named(kind: str, signals: dict[str, str], params: dict[str, float]) -> Named:
    """The effect as a diagnosis has it."""
    return Named(catalogue_entry(kind), signals, params)


def with_effects(model: Model, one: Named) -> Model:
    """The model to which a diagnosis would have added the effect."""
    return replace(model, sha=replace(model.sha, effects=automaton_effects(one, model), low=-500.0, high=500.0))


def fitted(model: Model, one: Named, trace: Trace) -> Array:
    """(n,) what the free run of the fit reads at the OUTPUTS."""
    record = build_record(model, [trace], tuple(name for name in trace.signals if name != "T"))
    frame = build_frame(record)
    state = run_frame(frame, np.append(frame.centre, one.strength), np.array([REST]), [one])
    return np.interp(OUTPUTS, record.runs.time, state.mean)


def automaton(model: Model, trace: Trace) -> Array:
    """(n,) the mean course of the automaton."""
    run = open_loop(model, trace, "resync")
    return np.interp(OUTPUTS, run.times, run.mean)


def filtered(model: Model, trace: Trace) -> Array:
    """(n,) what the filter predicts when nothing is measured after the start."""
    tracker = compile_model(model)
    belief = start(tracker, 0.0, REST)
    rows = np.flatnonzero(np.isfinite(trace.signals["I"]))
    coming = [(event.time, 0, event) for event in trace.events]
    coming += [(float(trace.times[row]), 1, int(row)) for row in rows]
    coming += [(time, 2, None) for time in OUTPUTS.tolist()]
    found = []
    for time, _, what in sorted(coming, key=lambda each: each[:2]):
        if isinstance(what, Event):
            belief = on_event(tracker, belief, what)
        elif what is not None:
            belief = with_inputs(
                tracker, belief, time, {n: float(c[what]) for n, c in trace.signals.items() if n != "T"}
            )
        else:
            belief = advance(tracker, belief, time)
            found.append(belief.x)
    return np.array(found)


def sampled(model: Model, trace: Trace) -> Array:
    """(n,) a run of the sampler, which without noise is the mean."""
    steps = schedule(model, trace.events, np.append(0.0, OUTPUTS), inputs=trace, policy="resync")
    return np.asarray(simulate(steps, REST, 2, np.random.default_rng(0)).temperatures[0, 1:])


def exported(model: Model, trace: Trace) -> tuple[Array, Array]:
    """(times, what the interpreted text of the export reads at them), wherever something happens in it."""
    thermostat = any(effect.kind == "thermostatic-cooling" for effect in model.sha.effects)
    made = export(model, trace, tick=1 if thermostat else 0)
    _, seen = courses(made.main.xml, made.replay.duration, middle, most=1.0)
    times = sorted({*made.replay.times, made.replay.duration} & set(seen))
    return np.array(times), np.array([float(np.mean(seen[time])) for time in times])


@cache
def plain_course(learner: str, first: float) -> Array:
    """(n,) the mean course without any effect."""
    return automaton(model_of(learner), trace_of(first))


def check_one_course(name: str, learner: str, first: float) -> None:
    """Asserts that the example `name` has one course in all engines; its signals are read from `first` (s) on."""
    (example,) = EXAMPLES[name]
    check_course(named(example.kind, dict(example.signals), dict(example.params)), learner, first)


def check_course(one: Named, learner: str, first: float) -> None:
    """The same of any effect."""
    kind = one.entry.name
    plain, trace = model_of(learner), trace_of(first)
    model = with_effects(plain, one)
    assert len(model.sha.effects) == 1
    expected = automaton(model, trace)
    assert np.abs(expected - plain_course(learner, first)).max() > 0.2, "the effect must be seen"
    np.testing.assert_allclose(fitted(plain, one, trace), expected, atol=FIT.get(kind, 0.03))
    exact = 5e-4 if kind == "radiation-loss" else 1e-4  # a tangent that is taken once a segment
    np.testing.assert_allclose(filtered(model, trace), expected, atol=exact)
    np.testing.assert_allclose(sampled(model, trace), expected, atol=exact)
    times, read = exported(model, trace)
    native = open_loop(model, trace, "resync")
    rows = np.searchsorted(native.times, times + 1e-5) - 1
    near = np.abs(native.times[rows] - times) < 1e-4  # a dead time's events lie between the rows
    assert near.any()
    bound = 0.05 if kind == "thermostatic-cooling" else 2e-3
    np.testing.assert_allclose(read[near], native.mean[rows][near], atol=bound)
