"""The written equations of flows and effects, integrated numerically with a tight tolerance: no code of the engines."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import exp, inf, isfinite, nan

import numpy as np
from scipy.integrate import solve_ivp

from sim.sha.automaton import SHA, Distribution, Edge, Effect, Flow, Input, Location
from sim.sha.trace import Array, Event, Trace
from tests.sha.models import normal

Heat = Callable[[Effect, float, float, float, dict[str, float]], float]


def _with(role: str, law: Callable[[dict[str, float], float], float]) -> Heat:
    return lambda e, x, u, t, s: law(dict(e.params), s[e.signals[role]])


def _power(p: dict[str, float], s: float) -> float:
    return p["gain"] * (max(s, 0.0) ** p["power"] - p["reference"] ** p["power"])


def _radiation(e: Effect, x: float, u: float, t: float, s: dict[str, float]) -> float:
    around = s[e.signals["ambient"]] if "ambient" in e.signals else e.params["surroundings"]
    level, linear = e.params.get("surroundings", 0.0), e.params.get("linear", 0.0)
    held = linear * 4.0 * (level + 273.15) ** 3 * max(x - level, 0.0)
    return -e.params["gain"] * ((x + 273.15) ** 4 - (around + 273.15) ** 4 - held)


HEATS: dict[str, Heat] = {
    "current-heating": _with("current", lambda p, i: p["gain"] * (i - p["reference"])),
    "quadratic-current-heating": _with("current", lambda p, i: p["gain"] * (i * i - p["reference"] ** 2)),
    "late-current-heating": _with("current", lambda p, i: p["gain"] * (i - p["reference"])),
    "current-saturation": _with("current", lambda p, i: -p["gain"] * max(i - p["knee"], 0.0)),
    "torque-friction": _with("torque", _power),
    "speed-friction": _with("speed", _power),
    "vibration-friction": _with("vibration", _power),
    "ambient-coupling": _with("ambient", lambda p, a: p["gain"] * (a - p["reference"])),
    "feed-temperature-coupling": lambda e, x, u, t, s: (
        -e.params["loss"] * (s[e.signals["pump"]] if "pump" in e.signals else 1.0) * (x - s[e.signals["feed"]])
    ),
    "pump-cooling": lambda e, x, u, t, s: (
        -e.params["loss"]
        * s[e.signals["pump"]]
        * (x - (s[e.signals["sink"]] if "sink" in e.signals else e.params["sink"]))
    ),
    "startup-churning": lambda e, x, u, t, s: (
        e.params["gain"] * exp(-((u / e.params["tau"]) ** e.params["shape"])) if u < inf else 0.0
    ),
    "wear-drift": lambda e, x, u, t, s: e.params["gain"] * max(t - e.params["since"], 0.0),
    "radiation-loss": _radiation,
}
# What of a heat comes through its lag.
SOURCES: dict[str, Heat] = {
    "quadratic-current-heating": _with("current", lambda p, i: p["gain"] * i * i),
    "late-current-heating": _with("current", lambda p, i: p["gain"] * i),
}


def drift(flow: Flow, x: float, m: float, age: float, signals: dict[str, float]) -> float:
    if flow.kind in ("exponential", "driven"):
        known = [one for one in flow.inputs if isfinite(signals[one.signal])]
        moved = sum(one.gain * (signals[one.signal] - one.reference) for one in known)
        return flow.params["k"] * (m + moved - x)
    if flow.kind == "linear":
        return m
    if flow.kind == "transient":
        return m / flow.params["tau"] * exp(-age / flow.params["tau"])
    return m / (flow.params["t0"] + age) if flow.kind == "logarithmic" else 0.0


def reference(sha: SHA, events: Sequence[Event], outputs: Array, inputs: Trace, x0: float) -> Array:
    """What the sensor reads at the outputs: every stay's m at its law's mean, inputs held, first reading `x0`."""
    by = {effect.kind: effect for effect in sha.effects}
    delay = by["dead-time"].params["delay"] if "dead-time" in by else 0.0
    step = by.get("sensor-offset-step")
    lag = by.get("sensor-lag")
    order = int(lag.params["order"]) if lag else 0

    def offset(t: float) -> float:
        return step.params["size"] if step is not None and t >= step.params["at"] else 0.0

    delayed = [(event.time + delay, event.symbol) for event in events]
    late = next((e for e in sha.effects if "lag" in e.params), None)
    on_the_way = late.params.get("delay", 0.0) if late is not None else 0.0
    marks = {outputs[0], outputs[-1], *outputs, *(t for t, _ in delayed), *(inputs.times + delay)}
    marks |= {*(inputs.times + delay + on_the_way)}
    if "wear-drift" in by:
        marks.add(by["wear-drift"].params["since"])
    clock = sorted(t for t in marks if outputs[0] <= t <= outputs[-1])
    moves = {(edge.source, edge.symbol): edge.target for edge in sha.edges}
    known = sha.by_name
    state = np.full(3 + order, x0 - offset(outputs[0]))
    first = nan
    before = dict.fromkeys(inputs.signals, nan)
    here, entered, started, opened, read = sha.initial, clock[0], -inf, False, []
    pending = list(delayed)
    for begin, end in zip(clock, [*clock[1:], clock[-1]], strict=True):
        while pending and pending[0][0] <= begin:
            time, symbol = pending.pop(0)
            here, entered = moves[here, symbol], time
            started = time if any(e.event == symbol for e in sha.effects) else started
        row = int(np.searchsorted(inputs.times + delay, begin, side="right")) - 1
        signals = {name: float(column[row]) if row >= 0 else nan for name, column in inputs.signals.items()}
        read += [state[-1 if lag else 0] + offset(begin)] * int(np.sum(outputs == begin))
        if late is not None and not isfinite(before[late.signals["current"]]):
            # At its first reading the heat is what it is late behind; before, a state that nothing reads.
            first = SOURCES[late.kind](late, 0.0, 0.0, 0.0, signals)
            state[1] = np.nan_to_num(first)
        before, coming = signals, first
        earlier = int(np.searchsorted(inputs.times + delay + on_the_way, begin, side="right")) - 1
        if late is not None and earlier >= 0:
            ago = {name: float(column[earlier]) for name, column in inputs.signals.items()}
            coming = SOURCES[late.kind](late, 0.0, 0.0, 0.0, ago)
            coming = coming if isfinite(coming) else first
        if end > begin:
            place = (sha, known[here], signals, entered, started, coming)
            state, opened = _piece(place, state, begin, end, opened)
    return np.array(read)


def _piece(place: tuple, state: Array, begin: float, end: float, opened: bool) -> tuple[Array, bool]:
    """One piece without event or changed input, cut where the thermostat switches."""
    sha, location, signals, entered, started, coming = place
    by = {e.kind: e for e in sha.effects}
    thermostat, lag, housing = by.get("thermostatic-cooling"), by.get("sensor-lag"), by.get("housing-thermal-mass")
    there = [e for e in sha.effects if not e.locations or location.name in e.locations]
    acting = [e for e in there if all(isfinite(signals[name]) for name in e.signals.values())]
    late = next((e for e in sha.effects if "lag" in e.params), None)
    source = SOURCES[late.kind](late, 0.0, 0.0, 0.0, signals) if late is not None else nan
    # The solver asks for the slope some thousand times: what stays in the piece is looked up once.
    m = location.distribution.params["mu"] if location.distribution else 0.0
    heats = [(HEATS[e.kind], e) for e in acting if e.kind in HEATS]
    cooled, housed = thermostat is not None and thermostat in acting, housing is not None and housing in acting

    def slope(t: float, s: Array) -> Array:
        x, warm, h, *lags = s.tolist()
        dx = drift(location.flow, x, m, t - entered, signals)
        dx += sum(heat(e, x, t - started, t, signals) for heat, e in heats)
        if cooled and opened:
            dx -= thermostat.params["loss"] * (x - thermostat.params["sink"])
        dh = warmed = 0.0
        if isfinite(source):
            warmed = (coming - warm) / late.params["lag"]
            dx += warm - source
        if housing is not None:
            dh = (x - h) / housing.params["tau"]
            dx += housing.params["coupling"] * (h - x) if housed else 0.0
        rates = zip([x, *lags], lags, strict=False)
        lagged = [(a - b) * lag.params["order"] / lag.params["tau"] for a, b in rates] if lag is not None else []
        return np.array([dx, warmed, dh, *lagged])

    while begin < end:
        stops = []
        if thermostat is not None:
            if not opened and state[0] >= thermostat.params["opens"] - 1e-9:
                opened = True
            elif opened and state[0] <= thermostat.params["closes"] + 1e-9:
                opened = False
            wanted = thermostat.params["closes" if opened else "opens"]

            def crossing(t: float, s: Array, wanted: float = wanted) -> float:
                return float(s[0] - wanted)

            crossing.terminal = True  # type: ignore[attr-defined]
            crossing.direction = -1 if opened else 1  # type: ignore[attr-defined]
            stops = [crossing]
        done = solve_ivp(slope, (begin, end), state, rtol=1e-10, atol=1e-11, method="LSODA", events=stops)
        state, begin = done.y[:, -1], float(done.t[-1])
    return state, opened


FLOWS = {
    "constant": (Flow("constant", {"noise": 0.02}), None),
    "linear": (Flow("linear", {"noise": 0.02}), normal(0.01, 0.004)),
    "exponential": (Flow("exponential", {"k": 0.004, "noise": 0.03}), normal(55.0, 2.0)),
    "driven": (Flow("driven", {"k": 0.006, "noise": 0.03}, (Input("I", 0.05, 100.0),)), normal(50.0, 2.0)),
    "logarithmic": (Flow("logarithmic", {"t0": 20.0, "noise": 0.02}), normal(6.0, 1.0)),
    "transient": (Flow("transient", {"tau": 40.0, "noise": 0.02}), normal(-6.0, 1.0)),
}

EFFECTS: dict[str, tuple[Effect, ...]] = {
    "current-heating": (Effect("current-heating", {"gain": 3e-4, "reference": 90.0}, {"current": "I"}),),
    "quadratic-current-heating": (
        Effect("quadratic-current-heating", {"gain": 2e-6, "reference": 80.0}, {"current": "I"}),
    ),
    "late-current-heating": (
        Effect("late-current-heating", {"gain": 4e-4, "reference": 80.0, "lag": 60.0}, {"current": "I"}, ("on",)),
    ),
    "late heat on the way": (
        Effect(
            "late-current-heating",
            {"gain": 4e-4, "reference": 80.0, "lag": 40.0, "delay": 130.0},
            {"current": "I"},
            ("on",),
        ),
    ),
    "current-saturation": (Effect("current-saturation", {"gain": 4e-4, "knee": 100.0}, {"current": "I"}),),
    "torque-friction": (
        Effect("torque-friction", {"gain": 1e-3, "reference": 20.0, "power": 1.4}, {"torque": "M"}, ("on",)),
    ),
    "speed-friction": (Effect("speed-friction", {"gain": 2e-4, "reference": 10.0, "power": 2.0}, {"speed": "M"}),),
    "vibration-friction": (
        Effect("vibration-friction", {"gain": 2e-3, "reference": 12.0, "power": 1.0}, {"vibration": "M"}),
    ),
    "ambient-coupling": (Effect("ambient-coupling", {"gain": 2e-3, "reference": 20.0}, {"ambient": "Ta"}),),
    "feed-temperature-coupling": (
        Effect("feed-temperature-coupling", {"loss": 3e-3}, {"feed": "Ta", "pump": "P"}, ("on",)),
    ),
    "feed without pump": (Effect("feed-temperature-coupling", {"loss": 3e-3}, {"feed": "Ta"}),),
    "pump-cooling": (Effect("pump-cooling", {"loss": 5e-3, "sink": 25.0}, {"pump": "P"}),),
    "pump with sink": (Effect("pump-cooling", {"loss": 5e-3}, {"pump": "P", "sink": "Ta"}),),
    "startup-churning": (Effect("startup-churning", {"gain": 0.1, "tau": 80.0, "shape": 1.0}, {}, (), "W_ON"),),
    "startup stretched": (Effect("startup-churning", {"gain": 0.1, "tau": 60.0, "shape": 0.5}, {}, (), "W_ON"),),
    "startup compressed": (Effect("startup-churning", {"gain": 0.1, "tau": 90.0, "shape": 2.5}, {}, (), "W_ON"),),
    "wear-drift": (Effect("wear-drift", {"gain": 2e-5, "since": 777.7}),),
    "dead-time": (Effect("dead-time", {"delay": 17.3}),),
    "sensor-lag 1": (Effect("sensor-lag", {"tau": 25.0, "order": 1.0}),),
    "sensor-lag 3": (Effect("sensor-lag", {"tau": 60.0, "order": 3.0}),),
    "sensor-offset-step": (Effect("sensor-offset-step", {"size": -1.5, "at": 900.0}),),
    "housing-thermal-mass": (Effect("housing-thermal-mass", {"coupling": 0.01, "tau": 900.0}),),
    "thermostatic-cooling": (
        Effect("thermostatic-cooling", {"loss": 0.02, "sink": 20.0, "opens": 38.0, "closes": 35.0}),
    ),
    "gradual thermostat": (
        Effect("thermostatic-cooling", {"loss": 0.05, "sink": 38.0, "opens": 38.0, "closes": 38.0}),
    ),
    "radiation-loss": (Effect("radiation-loss", {"gain": 2e-11, "surroundings": 20.0}),),
    "radiation beyond its linear part": (
        Effect("radiation-loss", {"gain": 1e-11, "surroundings": 12.0, "linear": 0.9}, {"ambient": "Ta"}, ("on",)),
    ),
    "radiation to ambient": (Effect("radiation-loss", {"gain": 2e-11}, {"ambient": "Ta"}, ("on",)),),
}

# Heat that goes on after a stop.
LATE: dict[str, tuple[Effect, ...]] = {
    "late heat": (
        Effect("quadratic-current-heating", {"gain": 4e-6, "reference": 80.0, "lag": 70.0}, {"current": "I"}, ("on",)),
    ),
}
LATE["late heat on the way, dead time"] = (*EFFECTS["late heat on the way"], *EFFECTS["dead-time"])
LATE["late heat, housing, lag, dead time"] = (
    *LATE["late heat"],
    *EFFECTS["housing-thermal-mass"],
    *EFFECTS["sensor-lag 3"],
    *EFFECTS["dead-time"],
)

LATE["late heat, thermostat, radiation"] = (
    *LATE["late heat"],
    *EFFECTS["thermostatic-cooling"],
    *EFFECTS["radiation-loss"],
    *EFFECTS["pump-cooling"],
)

# Effects whose mean is 0: tests/effects/test_random.py holds their laws against numerical integration.
RANDOM: dict[str, Effect] = {
    "heat-disturbance": Effect("heat-disturbance", {"sigma": 0.004, "memory": 240.0}),
    "machine-offset": Effect("machine-offset", {"sigma": 4.0}),
}

TOGETHER: dict[str, tuple[Effect, ...]] = {
    "pump, housing, lag, dead time": (
        *EFFECTS["pump-cooling"],
        *EFFECTS["housing-thermal-mass"],
        *EFFECTS["sensor-lag 3"],
        *EFFECTS["dead-time"],
    ),
    "startup, wear, feed": (*EFFECTS["startup-churning"], *EFFECTS["wear-drift"], *EFFECTS["feed without pump"]),
    "thermostat, radiation": (*EFFECTS["thermostatic-cooling"], *EFFECTS["radiation-loss"]),
    "thermostat, housing, lag": (
        *EFFECTS["thermostatic-cooling"],
        *EFFECTS["housing-thermal-mass"],
        *EFFECTS["sensor-lag 1"],
    ),
}


def plant(kind: str, effects: tuple[Effect, ...]) -> SHA:
    """An automaton that starts in `off` (exponential) and runs the flow of that kind in `on`."""
    flow, law = FLOWS[kind]
    off = Location("off", Flow("exponential", {"k": 0.003, "noise": 0.02}), normal(22.0, 1.0))
    edges = (Edge("off", "W_ON", "on"), Edge("on", "W_OFF", "off"))
    return SHA("augmented", (off, Location("on", flow, law)), edges, "off", low=-500.0, high=500.0, effects=effects)


def course(seed: int, length: float = 3000.0) -> tuple[list[Event], Trace]:
    """Random starts and stops, and signals that change at times of their own."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(150.0, 700.0, 12))
    events = [Event(float(t), "W_OFF" if i % 2 else "W_ON") for i, t in enumerate(times) if t < length]
    clock = np.concatenate([[0.0], np.sort(rng.uniform(0.0, length, 40))])
    signals = {
        "I": rng.uniform(50.0, 200.0, clock.size),
        "M": rng.uniform(0.0, 40.0, clock.size),
        "Ta": rng.uniform(10.0, 30.0, clock.size),
        "P": rng.integers(0, 2, clock.size).astype(float),
    }
    return events, Trace("inputs", clock, signals)


def without_noise(sha: SHA) -> SHA:
    """The automaton whose runs are its mean."""
    still = []
    for location in sha.locations:
        law = location.distribution
        narrow = Distribution("normal", {"mu": law.params["mu"], "sigma": 0.0}) if law else None
        params = {**location.flow.params, "noise": 0.0}
        still.append(replace(location, flow=replace(location.flow, params=params), distribution=narrow))
    return replace(sha, locations=tuple(still))
