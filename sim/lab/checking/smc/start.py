"""Where the runs of a query start: at the beginning of a trace or of the model, or from a belief."""

from dataclasses import dataclass
from difflib import get_close_matches

from sim.engine import Belief, Tracker, advance, compile_tracker, filter_trace, readings
from sim.lab.checking.smc.paths import World
from sim.sha import Distribution, Model, Trace, draw_temperature


@dataclass(frozen=True, slots=True)
class Start:
    """A world and, in words, where it starts and what drives it."""

    world: World
    words: str


def initial(model: Model | Tracker, trace: Trace | None = None, location: str | None = None) -> Start:
    """The initial location. With a trace, its events drive the runs from its first reading of the temperature on, which
    they start at; without, X starts by the model's initial law (or by the location's own, under `resample`), and the
    runs may enter another `location` instead.

    Raises ValueError where there is no such law, reading or location.
    """
    tracker = compile_tracker(model)
    sha = tracker.model.sha
    names = [place.name for place in sha.locations]
    if location is not None and location not in names:
        folded = {name.casefold(): name for name in names}
        near = [folded[name] for name in get_close_matches(location.casefold(), folded, 3, 0.4)] or names[:8]
        raise ValueError(f"model {sha.name!r} has no location {location!r}; did you mean {' or '.join(near)}?")
    place = names.index(location or sha.initial)
    if trace is not None:
        times, values = readings(trace, tracker.model.temperature)
        first = Distribution("normal", {"mu": float(values[0]), "sigma": 0.0})
        world = World(tracker, float(times[0]), place, first, trace=trace)
        return Start(
            world, f"the first reading of {trace.name}, {values[0]:.4g} {tracker.model.unit}; events of the trace"
        )
    law = tracker.model.initial or draw_temperature(sha.locations[place])
    if law is None:
        raise ValueError(
            f"model {sha.name!r} has no law of its first temperature: start from a trace (its first reading) or belief"
        )
    return Start(World(tracker, 0.0, place, law), f"{names[place]}, first temperature by the model; semi-Markov events")


def believed_start(
    model: Model | Tracker, trace: Trace, until: float | None = None, *, recorded: bool = False
) -> Start:
    """What is believed after the rows of an encoded trace up to `until` (absolute s; its end unless given).

    With `recorded` the trace's later events and inputs drive the runs, else the semi-Markov law. Raises ValueError when
    no temperature was read by then, and when nothing is recorded after it.
    """
    tracker = compile_tracker(model)
    end = float(trace.times[-1]) if until is None and trace.times.size else until
    if end is None or not trace.times.size or end < trace.times[0]:
        raise ValueError(f"trace {trace.name!r} has no row up to the time from which the runs should start")
    past = trace.between(float("-inf"), end + 1e-6)  # a hair after `end`, so that what happens at it is in
    belief = filter_trace(tracker, past).belief
    if not belief.seen:
        raise ValueError(f"trace {trace.name!r}: no temperature {tracker.model.temperature!r} was read up to then")
    if belief.time < end:
        belief = advance(tracker, belief, end)
    if recorded and end >= trace.times[-1]:
        raise ValueError(f"trace {trace.name!r} ends where the runs start: nothing recorded drives them")
    now = belief.time - float(trace.times[0])
    driven = "events of the trace" if recorded else "semi-Markov events"
    words = (
        f"{trace.name} at {now:.6g} s: {belief.location} for {belief.age:.4g} s, "
        f"{belief.x:.4g} ± {belief.sigma:.2g} {tracker.model.unit}; {driven}"
    )
    return Start(from_belief(tracker, belief, trace if recorded else None), words)


def from_belief(tracker: Tracker, belief: Belief, trace: Trace | None = None) -> World:
    """The world that goes on from a belief: its location, the age of its stay, its law of temperature and mode."""
    names = [location.name for location in tracker.model.sha.locations]
    first = Distribution("normal", {"mu": belief.x, "sigma": belief.sigma})
    return World(tracker, belief.time, names.index(belief.location), first, belief=belief, trace=trace)
