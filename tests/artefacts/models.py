"""Models for the tests of the artefacts: one with every flow kind, and hypothesis strategies over all of them."""

from math import inf

from hypothesis import strategies as st

from sim.anomaly import AnomalyRecord
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Input, Location
from sim.sha.events import DECANTER, Alphabet, Bins, Switch
from sim.sha.model import Model, Provenance, Stay

TEMPERATURE = "TCuscinettiRiduttore"


def normal(mu: float, sigma: float) -> Distribution:
    return Distribution("normal", {"mu": mu, "sigma": sigma})


def decanter_model(name: str = "cd") -> Model:
    """Every flow kind, every entry mode, a fixed parameter, a guard-free cycle over the decanter's alphabet."""
    current = (Input("Assorbimento", 0.05, 150.0), Input("Coppia", -0.1, 40.0))
    locations = (
        Location("off", Flow("exponential", {"k": 0.001, "noise": 0.01}), normal(20.0, 1.0)),
        Location("on", Flow("driven", {"k": 0.003, "noise": 0.02}, current), normal(40.0, 2.0)),
        Location("warm", Flow("linear", {"m": 0.05, "noise": 0.0}), normal(23.5, 1.2), "resample"),
        Location("late", Flow("logarithmic", {"t0": 12.0, "noise": 0.0}), normal(3.0, 0.2)),
        Location("held", Flow("constant", {"noise": 0.1}), None, "none"),
    )
    edges = (
        Edge("off", "W_ON", "on"),
        Edge("on", "W_OFF", "off"),
        Edge("on", "A_1", "warm"),
        Edge("warm", "A_2", "late"),
        Edge("late", "A_3", "held"),
    )
    return Model(
        sha=SHA(name, locations, edges, "off", max_rate=0.5),
        alphabet=DECANTER,
        temperature=TEMPERATURE,
        sensor_sigma=0.1,
        initial=normal(20.0, 3.0),
        semi_markov={
            "off": Stay(
                Distribution("weibull", {"shape": 1.5, "scale": 90.0}), {"on": 1.0}, {"Assorbimento": (1.0, 0.5)}
            )
        },
        calibration={60.0: 1.1, 300.0: 1.25},
        provenance=Provenance("bins", "ab" * 32, ("cd1", "cd2"), True, {"seed": 7, "share": 0.6, "x": "y", "b": True}),
    )


numbers = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6).map(lambda x: x + 0.0)
sizes = st.floats(min_value=1e-6, max_value=1e6)
noises = st.floats(min_value=0.0, max_value=10.0)
names = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)
texts = st.text(max_size=12)
laws = st.one_of(
    st.builds(normal, numbers, noises),
    st.builds(lambda mean: Distribution("exponential", {"mean": mean}), sizes),
    st.builds(lambda a, b: Distribution("weibull", {"shape": a, "scale": b}), st.floats(0.5, 5.0), sizes),
    st.builds(
        lambda a, b: Distribution("lognormal", {"mu": a, "sigma": b}), st.floats(-5.0, 5.0), st.floats(0.01, 2.0)
    ),
)
inputs = st.lists(
    st.builds(Input, st.sampled_from(["Assorbimento", "Volume Flow (l/min)", "log", "Tank.Level"]), numbers, numbers),
    min_size=1,
    max_size=3,
    unique_by=lambda given: given.signal,
).map(tuple)


def with_fixed(constants: dict[str, float], fixed: float | None) -> dict[str, float]:
    return constants if fixed is None else {**constants, "m": fixed}


def flows(fixed: st.SearchStrategy[float | None]) -> st.SearchStrategy[Flow]:
    """Flows of every kind; `fixed` gives their constant m or None."""
    return st.one_of(
        st.builds(lambda n: Flow("constant", {"noise": n}), noises),
        st.builds(lambda n, m: Flow("linear", with_fixed({"noise": n}, m)), noises, fixed),
        st.builds(lambda k, n, m: Flow("exponential", with_fixed({"k": k, "noise": n}, m)), sizes, noises, fixed),
        st.builds(
            lambda k, n, m, i: Flow("driven", with_fixed({"k": k, "noise": n}, m), i), sizes, noises, fixed, inputs
        ),
        st.builds(lambda t, n, m: Flow("logarithmic", with_fixed({"t0": t, "noise": n}, m)), sizes, noises, fixed),
        st.builds(lambda t, n, m: Flow("transient", with_fixed({"tau": t, "noise": n}, m)), sizes, noises, fixed),
    )


@st.composite
def locations(draw: st.DrawFn, name: str) -> Location:
    """A location that can be run: a drawn parameter and a fixed one exclude each other."""
    law = draw(st.none() | laws)
    entry = draw(st.sampled_from(["parameter", "none"] if law is None else ["parameter", "resample", "none"]))
    drawn = law is not None and entry == "parameter"
    return Location(name, draw(flows(st.none() if drawn else st.none() | numbers)), law, entry)


@st.composite
def automata(draw: st.DrawFn) -> SHA:
    places = draw(st.lists(names.filter(lambda name: name != "__init__"), min_size=1, max_size=4, unique=True))
    edges = draw(
        st.lists(
            st.builds(Edge, st.sampled_from(places), names, st.sampled_from(places), st.none() | names),
            max_size=5,
        )
    )
    rate = draw(st.just(inf) | sizes)
    return SHA(
        "model_1", tuple(draw(locations(place)) for place in places), tuple(edges), places[0], rate, -10.0, 200.0
    )


@st.composite
def alphabets(draw: st.DrawFn) -> Alphabet:
    symbols = iter(draw(st.lists(names.filter(lambda name: name != "unknown"), min_size=6, max_size=6, unique=True)))
    switch = Switch(draw(names), next(symbols), next(symbols), draw(st.booleans()))
    thresholds = tuple(sorted(draw(st.lists(numbers, min_size=2, max_size=2, unique=True))))
    bins = Bins(
        draw(names), thresholds, (next(symbols), next(symbols), next(symbols)), draw(noises), draw(st.booleans())
    )
    return Alphabet((switch, bins), draw(sizes), draw(noises), ((switch.rising, draw(texts)),))


settings_values = st.one_of(texts, numbers, st.integers(-(10**12), 10**12), st.booleans())
provenances = st.builds(
    Provenance,
    texts,
    texts,
    st.lists(texts, max_size=3).map(tuple),
    st.booleans(),
    st.dictionaries(texts, settings_values, max_size=3),
    st.dictionaries(texts, st.floats(allow_nan=False), max_size=3),
    texts,
)


records = st.builds(
    AnomalyRecord,
    seconds=noises,
    units=st.integers(1, 500),
    peaks=st.lists(noises, max_size=3).map(tuple),
    level=noises,
)


@st.composite
def models(draw: st.DrawFn) -> Model:
    """Any model: everything that the JSON form has to hold."""
    sha = draw(automata())
    places = st.sampled_from([location.name for location in sha.locations])
    moments = st.tuples(numbers, noises)
    stays = st.builds(
        Stay, laws, st.dictionaries(places, noises, max_size=2), st.dictionaries(names, moments, max_size=2)
    )
    return Model(
        sha,
        draw(alphabets()),
        draw(names.filter(lambda name: name.lower() not in ("m", "u", "nan", "inf", "infinity"))),
        draw(noises),
        draw(st.none() | laws),
        draw(st.dictionaries(places, stays, max_size=2)),
        draw(st.dictionaries(sizes, sizes, max_size=3)),
        draw(provenances),
        anomalies=draw(st.none() | records),
    )
