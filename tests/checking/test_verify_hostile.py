"""Models that nobody should be handed: each gets the right verdict, in a sentence, and none of them a traceback."""

from collections.abc import Callable
from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from benchmarks.verdicts import MUTANTS, judged, left_out
from sim.proof.envelope import Assumptions
from sim.proof.verification import verify
from sim.sha.automaton import SHA, Distribution, Edge, Entry, Flow, Input
from sim.sha.events import Alphabet
from sim.sha.model import Correction, Model, Stay
from tests.checking.verify_models import LEVELS, linear, normal, of, relaxing
from tests.gateway.support import two_modes

BASE = two_modes()
ASSUMED = (
    Assumptions(),
    Assumptions(z=0.0, sojourn="law"),
    Assumptions(sojourn=(0.0, 600.0), policy="ignore", unknown=False),
)


def on(flow: Flow | None = None, law: Distribution | None = None, entry: Entry | None = None) -> Model:
    """The small known model with another running location."""
    *others, old = BASE.sha.locations
    new = replace(old, flow=flow or old.flow, distribution=law or old.distribution, entry=entry or old.entry)
    return replace(BASE, sha=replace(BASE.sha, locations=(*others, new)))


def bare(flow: Flow, entry: Entry = "parameter") -> Model:
    """The running location without any law."""
    *others, old = BASE.sha.locations
    return replace(
        BASE, sha=replace(BASE.sha, locations=(*others, replace(old, flow=flow, distribution=None, entry=entry)))
    )


def exponential(k: float, noise: float = 0.0) -> Flow:
    return Flow("exponential", {"k": k, "noise": noise})


def logarithmic(t0: float) -> Flow:
    return Flow("logarithmic", {"t0": t0, "noise": 0.0})


def driven(gain: float, reference: float = 0.0, signal: str = "Assorbimento") -> Model:
    return on(Flow("driven", {"k": 0.1, "noise": 0.0}, (Input(signal, gain, reference),)))


def staying(law: Distribution | None = None, **parts: object) -> Model:
    old = BASE.semi_markov["on"]
    return replace(BASE, semi_markov={**BASE.semi_markov, "on": replace(old, law=law or old.law, **parts)})


def shaped(**parts: object) -> Model:
    return replace(BASE, sha=replace(BASE.sha, **parts))


LINEAR = Flow("linear", {"noise": 0.0})
EDGES = BASE.sha.edges

FINE: dict[str, Callable[[], Model]] = {
    "a rate so small that nothing moves": lambda: on(exponential(1e-300)),
    "a rate so great that it jumps": lambda: on(exponential(1e300)),
    "a linear flow that does not move": lambda: on(LINEAR, normal(0.0, 0.0)),
    "a linear flow without a law": lambda: bare(LINEAR),
    "an exponential law of a target": lambda: on(law=Distribution("exponential", {"mean": 30.0})),
    "a rate limit of next to nothing": lambda: shaped(max_rate=1e-300),
    "no law of the start": lambda: replace(BASE, initial=None),
    "a start that may be anywhere": lambda: replace(BASE, initial=normal(25.0, 1e6)),
    "no edges": lambda: shaped(edges=()),
    "a location that is never left": lambda: shaped(edges=tuple(e for e in EDGES if e.source != "on")),
    "an edge on unknown": lambda: shaped(edges=(*EDGES, Edge("on", "unknown", "off"))),
    "one location alone": lambda: replace(BASE, sha=SHA("one", BASE.sha.locations[:1], (), "start"), semi_markov={}),
    "no sojourn laws": lambda: replace(BASE, semi_markov={}),
    "a stay that leads nowhere": lambda: staying(to={}),
    "a stay seen once": lambda: staying(normal(5.0, 0.0)),
    "a correction": lambda: replace(BASE, correction=Correction(1.2, -3.0)),
}

NOT_DEPLOYABLE: dict[str, tuple[str, Callable[[], Model]]] = {
    "upwards": ("growth refuted", lambda: on(LINEAR, normal(0.05, 0.0))),
    "a fixed slope": ("growth refuted", lambda: bare(Flow("linear", {"noise": 0.0, "m": 0.05}))),
    "upwards under a rate limit": (
        "growth refuted",
        lambda: replace(on(LINEAR, normal(5.0, 0.0)), sha=replace(on(LINEAR, normal(5.0, 0.0)).sha, max_rate=1e-3)),
    ),
    "a slope of next to nothing": ("growth not decided", lambda: on(LINEAR, normal(1e-12, 0.0))),
    "slow growth": ("growth refuted", lambda: on(logarithmic(5.0), normal(1.0, 0.0))),
    "a logarithm from nothing": ("growth refuted", lambda: on(logarithmic(1e-300), normal(1.0, 0.0))),
    "a range that hides growth": (
        "growth not decided",
        lambda: replace(
            on(LINEAR, normal(0.05, 0.0)), sha=replace(on(LINEAR, normal(0.05, 0.0)).sha, low=-1e300, high=1e300)
        ),
    ),
    "700 degC": ("mean course refuted", lambda: on(law=normal(700.0, 1.0))),
    "700 degC, unsure": ("mean course refuted", lambda: on(law=normal(700.0, 300.0))),
    "1e300 degC": ("mean course refuted", lambda: on(law=normal(1e300, 1.0))),
    "entered at 400 degC": ("mean course refuted", lambda: on(law=normal(400.0, 1.0), entry="resample")),
    "starts at 400 degC": ("mean course refuted", lambda: replace(BASE, initial=normal(400.0, 1.0))),
    "a range of nothing": ("mean course refuted", lambda: shaped(low=0.0, high=1e-9)),
    "a great gain": ("mean course refuted", lambda: driven(50.0, 150.0)),
    "an enormous gain": ("mean course refuted", lambda: driven(1e300, 150.0)),
    "a gain beyond numbers": ("growth not decided", lambda: driven(1e308, -1e308)),
    "a signal that nobody knows": ("growth not decided", lambda: driven(1.0, signal="X")),
    "loud noise": ("noise refuted", lambda: on(exponential(0.1, 1e3))),
    "a blind sensor": ("noise refuted", lambda: replace(BASE, sensor_sigma=1e4)),
    "an empty alphabet": ("alphabet refuted", lambda: replace(BASE, alphabet=Alphabet(()))),
    "another alphabet": ("alphabet refuted", lambda: replace(BASE, alphabet=LEVELS)),
    "a correction that is none": ("correction refuted", lambda: replace(BASE, correction=Correction(20.0))),
}

NOT_RUNNABLE: dict[str, tuple[str, Callable[[], Model]]] = {
    "a rate that is no number": ("k must be positive and finite, got nan", lambda: on(exponential(nan))),
    "a rate of 0": ("k must be positive and finite, got 0", lambda: on(exponential(0.0))),
    "a negative rate": ("k must be positive", lambda: on(exponential(-0.1))),
    "noise that is no number": ("noise must be", lambda: on(exponential(0.1, nan))),
    "noise beyond numbers": ("beyond all numbers", lambda: on(exponential(0.1, 1e200))),
    "a mean that is no number": ("mu=nan is out of range", lambda: on(law=normal(nan, 1.0))),
    "an infinite mean": ("mu=inf is out of range", lambda: on(law=normal(inf, 1.0))),
    "a sigma beyond numbers": ("beyond all numbers", lambda: on(law=normal(50.0, 1e300))),
    "a negative sigma": ("sigma=-1.0 is out of range", lambda: on(law=normal(50.0, -1.0))),
    "a lognormal beyond numbers": (
        "beyond all numbers",
        lambda: on(law=Distribution("lognormal", {"mu": 800.0, "sigma": 1.0})),
    ),
    "a Weibull beyond numbers": (
        "beyond all numbers",
        lambda: on(law=Distribution("weibull", {"shape": 1e-3, "scale": 1.0})),
    ),
    "an unknown law": ("unknown distribution 'cauchy'", lambda: on(law=Distribution("cauchy", {}))),
    "T of 0 in a logarithm": ("t0 must be positive", lambda: on(logarithmic(0.0))),
    "a negative T in a logarithm": ("t0 must be positive", lambda: on(logarithmic(-5.0))),
    "driven by nothing": ("needs inputs", lambda: on(Flow("driven", {"k": 0.1, "noise": 0.0}))),
    "a gain that is no number": ("must be finite", lambda: driven(nan)),
    "an unknown flow": ("unknown flow 'magic'", lambda: on(Flow("magic", {"noise": 0.0}))),
    "drawn on entry from no law": ("needs a distribution", lambda: bare(exponential(0.1), "resample")),
    "a range without an end": ("has no end", lambda: shaped(low=-inf, high=inf)),
    "a sensor that is no number": ("sensor_sigma is nan", lambda: replace(BASE, sensor_sigma=nan)),
    "a negative sensor": ("sensor_sigma is -1", lambda: replace(BASE, sensor_sigma=-1.0)),
    "a start that is no number": ("mu=nan", lambda: replace(BASE, initial=normal(nan, 1.0))),
    "two targets on one symbol": ("2 targets on 'W_OFF'", lambda: shaped(edges=(*EDGES, Edge("on", "W_OFF", "start")))),
    "a guard": ("has the guard 'x>1'", lambda: shaped(edges=(replace(EDGES[0], guard="x>1"), *EDGES[1:]))),
    "a stay that is no number": ("mean=nan", lambda: staying(Distribution("exponential", {"mean": nan}))),
    "half a probability": ("sum to 0.5", lambda: staying(to={"off": 0.5})),
    "a probability that is no number": ("is nan; it must be at least 0", lambda: staying(to={"off": nan})),
    "a stay that leads to nowhere known": ("not a location", lambda: staying(to={"zz": 1.0})),
    "a stay of nowhere known": (
        "belongs to no location",
        lambda: replace(BASE, semi_markov={"zz": Stay(normal(1.0, 0.0), {})}),
    ),
    "an input that is no number": ("is nan with sigma", lambda: staying(inputs={"Assorbimento": (nan, 1.0)})),
    "a calibration by 0": ("the calibration at 60 s is 0", lambda: replace(BASE, calibration={60.0: 0.0})),
    "a correction beyond numbers": ("mu=inf", lambda: replace(BASE, correction=Correction(1e308))),
    "a law that cannot be shifted": (
        "cannot shift",
        lambda: replace(on(law=Distribution("exponential", {"mean": 30.0})), correction=Correction(1.0, 5.0)),
    ),
}


@pytest.mark.parametrize("name", FINE)
def test_what_is_odd_but_harmless_is_deployable(name: str) -> None:
    for assumed in ASSUMED:
        assert verify(FINE[name](), assumptions=assumed).reasons == ()


@pytest.mark.parametrize("name", NOT_DEPLOYABLE)
def test_what_can_be_run_but_leads_astray_is_not_deployable(name: str) -> None:
    begun, make = NOT_DEPLOYABLE[name]
    found = verify(make())
    assert found.executable and found.reasons[0].startswith(begun)
    for assumed in ASSUMED[1:] if "not decided" not in begun else ():
        assert verify(make(), assumptions=assumed).executable


@pytest.mark.parametrize("name", NOT_RUNNABLE)
def test_what_cannot_be_run_is_told_by_its_reason(name: str) -> None:
    said, make = NOT_RUNNABLE[name]
    for assumed in ASSUMED:
        found = verify(make(), assumptions=assumed)
        assert not found.executable and found.bounds is None
        assert said in found.reasons[0]


@pytest.mark.parametrize("name", MUTANTS)
def test_every_mutant_of_the_benchmark_is_refused_and_its_word_leaves_the_range(name: str) -> None:
    good = of(relaxing("p", 30.0, sigma=1.0), relaxing("q", 60.0, 0.002, 2.0))
    found = judged(name, "mutant", MUTANTS[name](replace(good, sensor_sigma=0.1)), 0)
    assert not found.deployable and found.refuted
    assert found.word is None or found.word[2]


def test_thousands_of_random_words_stay_in_the_proven_intervals_and_would_leave_narrower_ones() -> None:
    rng = np.random.default_rng(5)
    slow = replace(linear("r", 0.0), flow=Flow("constant", {"noise": 0.0}), distribution=None, entry="none")
    fresh = replace(relaxing("s", 40.0, sigma=5.0), entry="resample")
    ring = of(relaxing("p", 30.0, sigma=3.0), relaxing("q", 90.0, 0.002, 9.0), slow, fresh, max_rate=0.5)
    for model in (BASE, ring, replace(ring, correction=Correction(1.1, 4.0))):
        found = verify(model)
        assert found.bounds is not None and found.deployable
        assert left_out(model, found.bounds, 400, rng) == 0
        tight = {name: (low + 0.1, high - 0.1) for name, (low, high) in found.bounds.intervals.items()}
        assert left_out(model, replace(found.bounds, intervals=tight), 100, rng) > 20
