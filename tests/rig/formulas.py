"""Reference queries with exact answers, and random formulas: one small model, asked in many ways."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.query.tree import (
    Always,
    At,
    Both,
    BoundedResponse,
    Compare,
    Comparison,
    Constant,
    Either,
    Eventually,
    Formula,
    Not,
    Number,
    Operation,
    Path,
    Probability,
    Quantity,
    TimeSpan,
    Until,
)
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import Alphabet
from sim.sha.model import Model, Stay
from sim.sha.trace import Event, Trace
from tests.rig.chain import response, ring, until, wide_response
from tests.rig.literal import CourseStay

NAMES = ("q_0", "q_1", "q_2", "q_3")
CHAIN = ring(NAMES, (20.0, 12.0, 8.0, 30.0))
SLOPES = (0.1, -0.05, 0.3, -0.12)
"""degC/s, by location."""

START = 20.0
"""degC at the begin of every run."""


def small_model() -> Model:
    """The chain as a model without noise: exponential stays, the temperature along straight lines."""
    locations = tuple(
        Location(name, Flow("linear", {"noise": 0.0}), Distribution("normal", {"mu": slope, "sigma": 0.0}))
        for name, slope in zip(NAMES, SLOPES, strict=True)
    )
    edges = tuple(Edge(a, f"to_{b}", b) for a in NAMES for b in NAMES if a != b)
    stays = {
        name: Stay(
            Distribution("exponential", {"mean": mean}), {b: float(p) for b, p in zip(NAMES, row, strict=True) if p}
        )
        for name, mean, row in zip(NAMES, CHAIN.means, CHAIN.to, strict=True)
    }
    sha = SHA("small", locations, edges, NAMES[0], low=-1e6, high=1e6)
    return Model(sha, Alphabet(()), "T", 0.0, Distribution("normal", {"mu": START, "sigma": 0.0}), stays)


@dataclass(frozen=True)
class Reference:
    """A query's text and its exact probability."""

    text: str
    exact: float

    def query(self, model: Model) -> Probability:
        """The query, read."""
        read = parse_query(self.text, model)
        assert isinstance(read, Probability)
        return read


def references() -> list[Reference]:
    """Every temporal form over locations and clocks."""
    model, found = small_model(), []
    # What holds until its goal: the texts say all that the reference needs.
    for text in (
        "Pr[<=60](<> q_3)",
        "Pr[<=25](<> q_2 || q_3)",
        "Pr[<=60](<> q_3 && time >= 30)",
        "Pr[<=60](<> q_2 && (time <= 10 || time > 45))",
        "Pr[<=60]([] !q_3)",
        "Pr[<=40]([] q_3 imply time > 20)",
        "Pr[<=40]([] !(q_2 && time >= 10 && time < 30))",
        "Pr[<=60](<>[30,40] q_3)",
        "Pr[<=60](<>[50,60] q_2)",
        "Pr[<=60](<>[40,40] q_0)",
        "Pr(<>[5,10] q_2)",
        "Pr[<=60]([][20,30] !q_0)",
        "Pr[<=60]([][55,60] q_3)",
        "Pr([][10,15] q_0 || q_3)",
        "Pr[<=60](!q_2 U q_3)",
        "Pr[<=60](q_0 || q_1 U q_3)",
        "Pr[<=60](q_0 U !q_0)",
        "Pr[<=60](!q_2 U q_3 && time >= 20)",
        "Pr[<=60](q_0 || time > 15 U q_3)",
        "Pr[<=60](!q_2 U[20,50] q_3)",
        "Pr[<=60](q_0 U[10,30] q_2)",
        "Pr[<=60](!q_3 U[40,60] !q_3)",
        "Pr[<=60](time < 30 U[20,60] q_3)",
        "Pr[<=60](time <= 0 -->[20,40] q_3)",
    ):
        query = Reference(text, 0.0).query(model)
        path, bound = query.path, query.bound
        low, high = path.span.low, min(path.span.high, bound)
        match path:
            case Eventually(inner=inner):
                exact = until(CHAIN, Constant(True), inner, low, high)
            case Always(inner=inner):
                exact = 1.0 - until(CHAIN, Constant(True), Not(inner), low, high)
            case Until(hold=hold, goal=goal):
                exact = until(CHAIN, hold, goal, low, high)
            case BoundedResponse(effect=effect):
                exact = until(CHAIN, Constant(True), effect, low, high)
        found.append(Reference(text, exact))
    q_1, q_2, q_3 = (At(name) for name in NAMES[1:])
    either = Either(q_1, q_2)
    found += [
        Reference("Pr[<=30](q_1 --> q_3 within 10)", response(CHAIN, q_1, q_3, 10.0, 30.0)),
        Reference("Pr[<=30](q_1 --> q_3 within 40)", response(CHAIN, q_1, q_3, 40.0, 30.0)),
        Reference("Pr[<=300](q_1 --> q_3 within 40)", response(CHAIN, q_1, q_3, 40.0, 300.0)),
        Reference("Pr[<=300](q_1 --> q_3 within 40 weak)", response(CHAIN, q_1, q_3, 40.0, 260.0)),
        Reference("Pr[<=120](q_1 || q_2 --> q_3 within 30)", response(CHAIN, either, q_3, 30.0, 120.0)),
        Reference("Pr[<=120](q_1 || q_2 --> q_3 within 30 weak)", response(CHAIN, either, q_3, 30.0, 90.0)),
        Reference("Pr[<=50](q_3 --> q_1 || q_2 within 45)", response(CHAIN, q_3, either, 45.0, 50.0)),
        Reference("Pr[<=50](true --> q_3 within 70)", response(CHAIN, Constant(True), q_3, 70.0, 50.0)),
        Reference("Pr[<=60](true -->[10,70] q_3)", wide_response(CHAIN, q_3, 10.0, 70.0, 60.0)),
        Reference("Pr[<=100](true -->[30,90] q_3 weak)", wide_response(CHAIN, q_3, 30.0, 90.0, 10.0)),
        # A stay of q_3 that is older than 30 s has waited too long for its end; what begins later is too young.
        Reference("Pr[<=60](<> q_3 && age >= 30)", 1.0 - response(CHAIN, q_3, Not(q_3), 30.0, 30.0)),
        Reference("Pr[<=60]([] q_3 imply age <= 45)", response(CHAIN, q_3, Not(q_3), 45.0, 15.0)),
        Reference("Pr[<=90](<> q_1 && age > 25)", 1.0 - response(CHAIN, q_1, Not(q_1), 25.0, 65.0)),
        Reference("Pr[<=200](q_3 --> !q_3 within 80)", response(CHAIN, q_3, Not(q_3), 80.0, 200.0)),
        # The begin of a stay is answered first of all its instants.
        Reference("Pr[<=200](q_1 && age <= 0 --> q_3 within 40)", response(CHAIN, q_1, q_3, 40.0, 200.0)),
    ]
    return found


COMPARISONS: tuple[Comparison, ...] = ("<", "<=", ">=", ">")


def random_path(rng: np.random.Generator, bound: float, *, whole: bool) -> Path:
    """A random path over locations, clocks and the temperature; `whole`: times are
    multiples of 5 s, so that they meet."""

    def number(low: float, high: float) -> float:
        drawn = float(rng.uniform(low, high))
        return 5.0 * round(drawn / 5.0) if whole else drawn

    def temperature() -> Formula:
        # An odd number: a run that meets the line at an event's very instant is a matter of rounding.
        level = Number(float(rng.uniform(18.5, 23.5)))
        if rng.random() < 0.2:
            moving = Operation("+", level, Operation("*", Number(0.0125), Quantity("time")))
            return Compare(sign(), Quantity("temperature"), moving)
        return Compare(sign(), Quantity("temperature"), level)

    def sign() -> Comparison:
        return COMPARISONS[int(rng.integers(len(COMPARISONS)))]

    def formula(depth: int, warm: bool) -> Formula:
        kind = rng.random()
        if depth and kind < 0.6:
            left = formula(depth - 1, warm)
            if kind < 0.15:
                return Not(left)
            right = formula(depth - 1, False)
            return Both(left, right) if kind < 0.4 else Either(left, right)
        if warm:
            return temperature()
        leaf = rng.random()
        if leaf < 0.45:
            return At(NAMES[int(rng.integers(4))])
        if leaf < 0.7:
            return Compare(sign(), Quantity("time"), Number(number(0.0, bound)))
        if leaf < 0.92:
            return Compare(sign(), Quantity("age"), Number(number(0.0, 25.0)))
        sum_ = Operation("+", Quantity("time"), Quantity("age"))
        return Compare(sign(), sum_, Number(number(0.0, bound)))

    form = int(rng.integers(4))
    low, high = sorted((number(0.0, 0.7 * bound), number(0.1 * bound, bound)))
    span = TimeSpan(low, high) if rng.random() < 0.6 else TimeSpan()
    warm = rng.random() < 0.4
    if form == 0:
        return Eventually(formula(3, warm), span)
    if form == 1:
        return Always(formula(3, warm), span)
    first, second = formula(2, warm and form == 3), formula(2, warm and form == 2)
    if rng.random() < 0.3 and not warm:
        second = Not(first)  # the one begins where the other ends: what an instant belongs to is seen there
    if form == 2:
        return Until(first, second, span)
    return BoundedResponse(
        first, second, TimeSpan(0.0 if rng.random() < 0.5 else low / 2, high), bool(rng.random() < 0.4)
    )


def traced_course(rng: np.random.Generator, bound: float, horizon: float) -> tuple[Trace, list[CourseStay]]:
    """A trace with events at multiples of 5 s, several at one instant among them, and the small model's course."""
    times = sorted(Fraction(5 * int(number)) for number in rng.integers(0, int(bound / 5) + 1, int(rng.integers(12))))
    place, begin, x, course, events = 0, Fraction(0), Fraction(START), list[CourseStay](), []
    for time in [*times, Fraction(horizon)]:
        slope = Fraction(SLOPES[place])
        if begin <= horizon:
            course.append(CourseStay(NAMES[place], begin, min(time, Fraction(horizon)), x, slope))
        x, begin, place = x + slope * (time - begin), time, (place + 1 + int(rng.integers(3))) % len(NAMES)
        events.append(Event(float(time), f"to_{NAMES[place]}"))
    # The last "event" is the course's end.
    ends = max(horizon, bound) + 1.0
    return Trace("drawn", np.array([0.0, ends]), {"T": np.full(2, START)}, tuple(events[:-1])), course
