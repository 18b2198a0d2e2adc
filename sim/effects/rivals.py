"""What a plant has and no name stands for: held by a diagnosis beside the names, so that none of them is taken for it.

Each is a heat or a loss along a record (`kind.RecordedLaw`) and a sentence in plant words; no engine executes one.
Where one explains more than every name does, the gap is described and stays without a name.
"""

from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from itertools import combinations, product

import numpy as np

from sim.effects.kind import (
    ABSOLUTE_SECONDS,
    Acts,
    EffectCandidate,
    EffectKind,
    EffectRefusal,
    MachineLog,
    Parameter,
    Params,
    RecordedLaw,
    RecordView,
    Roles,
)
from sim.effects.roles import CURRENT
from sim.moments import WORLD_CLOCK_S, has_date
from sim.sha import Array, Effect

HOUR, DAY = 3600.0, 86400.0
MAX_MOMENTS = 24
"""Moments of a record at which something is tried to begin, at most."""
MAX_PAIR_MOMENTS = 16
"""The same of what comes twice, where every two of them are tried."""
BREAK_S = 600.0
"""Seconds without a step from which a record is broken off there."""
NO_NAME = EffectRefusal("it has no name")
SEARCH_COST_NATS = 3.0
"""Nats that looking at a dozen moments or hours costs."""


def moment_words(time: float) -> str:
    """A moment (absolute s) to its minute, in UTC; of a clock that is not the world's its hours.

    What is later than any date is said in seconds, so that a model with such a moment can be read and shown.
    """
    if not has_date(time):
        return f"{time / HOUR:.1f} h on the traces' clock" if time < WORLD_CLOCK_S else f"{time:.6g} s"
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _hour_words(seconds: float) -> str:
    minutes = round(seconds % DAY / 60.0) % 1440
    return f"{minutes // 60:02d}:{minutes % 60:02d} UTC"


def _moments(log: MachineLog, count: int = MAX_MOMENTS) -> list[float]:
    """Moments inside the record, evenly over what it ran (at rest hardly anything begins to show), none at its ends.

    Where the record breaks off near one, that is the moment: what is changed at a machine is changed while nobody logs.
    """
    ran = np.cumsum(log.dt * (log.running if log.running.any() else 1.0))
    shares = (np.arange(count) + 1.0) / (count + 1)
    times = np.interp(shares * ran[-1], ran, log.time)
    silent = (log.time - log.dt)[1:] - log.time[:-1]
    nearest = np.rint(ran[:-1] / max(ran[-1], 1e-9) * (count + 1)).astype(int) - 1
    broken = np.flatnonzero((silent > BREAK_S) & (nearest >= 0) & (nearest < count))
    # The longest comes last, and stays.
    for row in broken[np.argsort(silent[broken], kind="stable")]:
        times[nearest[row]] = np.nextafter(log.time[row], np.inf)
    return [float(time) for time in times]


def _heat_law(heat: Callable[[Params, RecordView], Array]) -> RecordedLaw:
    def law(effect: Effect, view: RecordView) -> tuple[Array, Array]:
        gained = heat(effect.params, view)
        return gained, np.zeros_like(gained)

    return RecordedLaw(law)


def _after_steps(p: Params, view: RecordView) -> Array:
    """gain (I - late(I)), or its size where `both` directions heat."""
    moved = view.signals["current"] - view.late("current", p["lag"])
    return np.asarray(p["gain"] * (np.abs(moved) if p["both"] else moved))


def _step_words(p: Params) -> str:
    return f"heat that follows each step of the load and fades over {p['lag'] / 60.0:.0f} min"


def _no_heat(p: Params, view: RecordView) -> Array:
    """Nothing that the record foresees: what comes and goes by itself is noise, and a fit has it there."""
    return np.zeros_like(view.time)


def _unmeasured_words(p: Params) -> str:
    return f"heat from something that is not measured, that comes and goes over about {p['memory'] / HOUR:.1f} hours"


def _daily(p: Params, view: RecordView) -> Array:
    """gain cos(2 pi (t - at) / period)."""
    return np.asarray(p["gain"] * np.cos(2.0 * np.pi * (view.time - p["at"]) / p["period"]))


def _daily_words(p: Params) -> str:
    most = p["at"] + (0.0 if p["gain"] > 0 else p["period"] / 2.0)
    twice = p["period"] < DAY
    hours = _hour_words(most) + (f" and {_hour_words(most + p['period'])}" if twice else "")
    return f"heat that comes with the clock, most at {hours}"


def _in_shift(p: Params, view: RecordView) -> Array:
    """gain within `length` s from `at` on of each day, everywhere or while the machine runs."""
    inside = (view.time - p["at"]) % DAY < p["length"]
    return np.asarray(p["gain"] * inside * (view.running if p["turning"] else 1.0))


def _shift_words(p: Params) -> str:
    begin, end = p["at"], p["at"] + p["length"]
    if p["gain"] < 0:
        begin, end = end, begin
    while_ = " while the machine runs" if p["turning"] else ""
    return f"heat that comes with the clock, between {_hour_words(begin)} and {_hour_words(end)}{while_}"


def _on_weekends(p: Params, view: RecordView) -> Array:
    """gain on Saturdays and Sundays (UTC); 1970-01-01 was a Thursday."""
    return np.asarray(p["gain"] * ((np.floor(view.time / DAY) + 3.0) % 7.0 >= 5.0) * view.running)


def _weekend_words(p: Params) -> str:
    return f"heat that comes with the weekday, more {'at weekends' if p['gain'] > 0 else 'on working days'}"


SECOND_MOMENT = "again"
"""The parameter that is the moment at which what fades comes a second time."""


def _fading_heat(p: Params, view: RecordView) -> Array:
    """gain exp(-u / tau) while the machine runs, u its running seconds since `at`; that of `again` too, if there is."""
    heat = np.zeros_like(view.time)
    for at in (p[name] for name in ("at", SECOND_MOMENT) if name in p):
        run = np.maximum(view.run_since(at), 0.0)
        heat += np.where(view.time >= at, np.exp(-run / p["tau"]), 0.0)
    return np.asarray(p["gain"] * heat * view.running)


def _fading_words(p: Params) -> str:
    first, *further = sorted(p[name] for name in ("at", SECOND_MOMENT) if name in p)
    events = f"an event at {moment_words(first)}" + "".join(f" and again at {moment_words(each)}" for each in further)
    return f"heat after {events}, fading over {p['tau'] / HOUR:.1f} running hours"


def _lasting_heat(p: Params, view: RecordView) -> Array:
    """gain from `at` on, all the time or while the machine runs."""
    return np.asarray(p["gain"] * (view.time >= p["at"]) * (view.running if p["turning"] else 1.0))


def _since_words(p: Params) -> str:
    while_ = " while the machine runs," if p["turning"] else ""
    return f"{'heat' if p['gain'] > 0 else 'less heat'}{while_} since {moment_words(p['at'])}"


def _surroundings(p: Params, view: RecordView) -> Array:
    """rise k from `at` on, k the model's own rate: what it tends to is by `rise` (degC) warmer, running or at rest."""
    return np.asarray(p["rise"] * view.rate * (view.time >= p["at"]))


def _surroundings_words(p: Params) -> str:
    return f"{'warmer' if p['rise'] > 0 else 'cooler'} surroundings since {moment_words(p['at'])}"


def _grown(since: Array, over: float) -> Array:
    """How far what grows by 1 each `over` s has grown; over 0 s it is there at once."""
    return np.asarray(np.maximum(since, 0.0) / over if over > 0 else since >= 0, dtype=float)


def _drifting(p: Params, view: RecordView) -> Array:
    """rise k (t - at) / over from `at` on, k the model's own rate: so much warmer after `over` s, running or at rest.

    A sensor that drifts reads as much, but for what it drifts by within one time constant.
    """
    return np.asarray(p["rise"] * view.rate * _grown(view.time - p["at"], p["over"]))


def _drifting_words(p: Params) -> str:
    more, up = ("warmer", "up") if p["rise"] > 0 else ("cooler", "down")
    return f"surroundings that grow {more}, or a sensor that drifts {up}, since {moment_words(p['at'])}"


def _less_cooling(effect: Effect, view: RecordView) -> tuple[Array, Array]:
    """Heat loss s (X - sink): s goes from 0 to 1 at `at`, and by 1 more at `again` if there is one, or grows from `at`
    by 1 each `over` s (not 0); all the time, or while the machine runs, as what it drives itself cools."""
    p = effect.params
    lost = np.zeros_like(view.time)
    for since in (view.time - p[name] for name in ("at", SECOND_MOMENT) if name in p):
        lost += _grown(since, p["over"])
    loss = np.asarray(-p["loss"] * lost * (view.running if p["turning"] else 1.0))
    return loss * p["sink"], loss


SINK_SHARES = (0.25, 1.0)
"""Of what the temperature of a machine that hardly rests spans, by how much colder what cools it may be."""


def _sinks(log: MachineLog) -> Sequence[float]:
    """degC that a cooling may draw to: what is read at rest. A machine that hardly rests was never as cold as that, and
    the nearer to it a cooling would draw, the less of it is seen there, and so of its moment."""
    if log.rests:
        return (log.cold,)
    return tuple(log.cold - share * float(np.ptp(log.smooth)) for share in SINK_SHARES)


def _growth_starts(log: MachineLog) -> list[float]:
    """Moments at which something is tried to begin to grow: the record's beginning, and such as lie inside it."""
    return [float(log.time[0]), *_moments(log)[::2]]


def _cooling_words(p: Params) -> str:
    way = "less" if p["loss"] >= 0 else "more"
    while_ = "while the machine runs, " if p["turning"] else ""
    first, *further = sorted(p[name] for name in ("at", SECOND_MOMENT) if name in p)
    again = "".join(f" and {way} again since {moment_words(each)}" for each in further)
    return f"{way} cooling {while_}{'more and more ' if p['over'] > 0 else ''}since {moment_words(first)}{again}"


MAX_CLOCK_DAYS = 2.0
"""Days beyond which a record shows what comes with the time of day: an hour that came once is a moment."""
CHANGES_AT_A_MOMENT = (
    "less-cooling",
    "less-cooling-twice",
    "other-surroundings",
    "heat-since-a-moment",
    "sensor-offset-step",
)
"""What makes a machine warmer from a moment on: under one load that never stops they look alike."""
DRIFTING_SURROUNDINGS = "drifting-surroundings"
"""The rival that is surroundings, or a sensor, that grow warmer or cooler."""
UNMEASURED_NEIGHBOUR = "unmeasured-neighbour"
"""The rival that has no course along a record: a heat that wanders, which a fit has in its noise."""


def _has_days(log: MachineLog) -> bool:
    return float(log.time[-1] - log.time[0]) > MAX_CLOCK_DAYS * DAY


SECONDS = Parameter(unit="s", positive=True, rescaled="stays")
CHOICE = Parameter(unit="1", low=0.0, high=1.0, whole=True, rescaled="stays")
PARAMETERS: Mapping[str, Parameter] = {
    "gain": Parameter(unit="degC/s, for each unit of the signal where one is read", rescaled="scaled"),
    "rise": Parameter(unit="degC", rescaled="scaled"),
    "sigma": Parameter(unit="degC/s", positive=True, rescaled="scaled"),
    "loss": Parameter(unit="1/s", low=0.0, rescaled="stays"),
    "sink": Parameter(unit="degC", rescaled="mapped"),
    **dict.fromkeys(("at", SECOND_MOMENT), Parameter(unit=ABSOLUTE_SECONDS, rescaled="stays")),
    "over": Parameter(unit="s", low=0.0, rescaled="stays"),
    **dict.fromkeys(("lag", "period", "length", "tau", "memory"), SECONDS),
    **dict.fromkeys(("both", "turning"), CHOICE),
}
"""What a rival's parameters are, by their names."""
IN_RECORD = (-np.inf, np.inf)
"""Bounds of a moment that is looked for: the record's own ends."""


def _rival(
    name: str,
    meaning: str,
    law: RecordedLaw,
    words: Callable[[Params], str],
    *,
    parameters: tuple[str, ...],
    shapes: Callable[[MachineLog], Sequence[Params]],
    experiment: str,
    look: str,
    sign: float = 1.0,
    acts: Acts = "running",
    roles: Roles | None = None,
    refine: Mapping[str, tuple[float, float]] | None = None,
    widths: Mapping[str, float] | None = None,
    burden: float = SEARCH_COST_NATS,
    special: tuple[str, ...] = (),
) -> EffectKind:
    """A row of the table; the first of its parameters is the strength."""
    return EffectKind(
        name=name,
        meaning=meaning,
        parameters={each: PARAMETERS[each] for each in parameters},
        roles=roles or Roles(),
        acts=acts,
        law=law,
        bound=NO_NAME,
        uppaal=NO_NAME,
        candidate=EffectCandidate(
            strength=parameters[0],
            sign=sign,
            experiment=experiment,
            look=look,
            shapes=shapes,
            refine=refine or {},
            widths=widths or {},
            burden=burden,
            special=special,
            words=words,
        ),
    )


def _cooling(
    name: str,
    meaning: str,
    shapes: Callable[[MachineLog], Sequence[Params]],
    moments: tuple[str, ...] = ("at",),
    special: tuple[str, ...] = (),
) -> EffectKind:
    """A loss that becomes smaller at one or two moments, or from one on."""
    return _rival(
        name,
        meaning,
        RecordedLaw(_less_cooling),
        _cooling_words,
        parameters=("loss", "sink", *moments, "over", "turning"),
        shapes=lambda log: [
            {**shape, "sink": sink, "turning": turning}
            for shape, sink, turning in product(shapes(log), _sinks(log), (0.0, 1.0))
        ],
        acts="anywhere",
        refine=dict.fromkeys(moments, IN_RECORD),
        widths=dict.fromkeys(moments, 4 * HOUR),
        burden=len(moments) * SEARCH_COST_NATS,
        special=special,
        experiment="clean the cooler or open the air's way, and compare the same load before and after",
        look="what carries heat away: cooler, fan, filter, flow of oil and water, dirt on the housing",
    )


def _event(
    name: str,
    meaning: str,
    moments: tuple[str, ...],
    shapes: Callable[[MachineLog], Sequence[Params]],
    special: tuple[str, ...] = (),
) -> EffectKind:
    """A heat that fades with the hours run since one or two moments, each of which was looked for."""
    return _rival(
        name,
        meaning,
        _heat_law(_fading_heat),
        _fading_words,
        parameters=("gain", "tau", *moments),
        shapes=shapes,
        refine={"tau": (0.5 * HOUR, 60 * HOUR), **dict.fromkeys(moments, IN_RECORD)},
        widths=dict.fromkeys(moments, 4 * HOUR),
        burden=len(moments) * SEARCH_COST_NATS,
        special=special,
        experiment="do again what was done then, and watch the same load for as many hours",
        look="what was done to the machine then: greasing, a new part, a cleaning",
    )


RIVAL_KINDS = (
    _rival(
        "heat-after-load-steps",
        "heat that follows each step of the load and fades",
        _heat_law(_after_steps),
        _step_words,
        parameters=("gain", "lag", "both"),
        roles=Roles(needed=(CURRENT,)),
        shapes=lambda _: [
            {"lag": lag, "both": both} for lag, both in product((60.0, 180.0, 480.0, 1200.0), (0.0, 1.0))
        ],
        refine={"lag": (20.0, 7200.0)},
        burden=0.0,
        experiment="step the load up and down twice within an hour, without a stop",
        look="what each change of the load does: belt, coupling, scroll, the grease as the load settles",
    ),
    _rival(
        "heat-by-the-clock",
        "heat that comes with the time of day",
        _heat_law(_daily),
        _daily_words,
        parameters=("gain", "at", "period"),
        sign=0.0,
        acts="anywhere",
        shapes=lambda log: [
            {"period": period, "at": period / 2.0 * number / 4.0}
            for period, number in product((DAY, DAY / 2.0), range(4))
            if _has_days(log)
        ],
        refine={"at": (0.0, DAY)},
        widths={"at": 6 * HOUR},
        experiment="log the room for three days, with a night at rest",
        look="what goes by the hour beside the machine: sun, ventilation, heating, another machine",
    ),
    _rival(
        "heat-in-a-shift",
        "heat that comes with a shift",
        _heat_law(_in_shift),
        _shift_words,
        parameters=("gain", "at", "length", "turning"),
        sign=0.0,
        acts="anywhere",
        shapes=lambda log: [
            {"at": hour * HOUR, "length": length * HOUR, "turning": turning}
            for (length, hours), turning in product(((8.0, range(0, 24, 2)), (12.0, range(0, 12, 2))), (0.0, 1.0))
            for hour in hours
            if _has_days(log)
        ],
        refine={"at": (0.0, DAY), "length": (2 * HOUR, 22 * HOUR)},
        widths={"at": 3 * HOUR, "length": 3 * HOUR},
        experiment="run the same load in each shift, on three days",
        look="what a shift does differently: feed, doors, settings, another machine",
    ),
    _rival(
        "heat-at-weekends",
        "heat that comes with the weekday",
        _heat_law(_on_weekends),
        _weekend_words,
        parameters=("gain",),
        sign=0.0,
        shapes=lambda log: [{}] if log.time[-1] - log.time[0] > 7 * DAY else [],
        experiment="run the same load on a working day and at a weekend",
        look="what is different at weekends: feed, staff, ventilation, other machines",
    ),
    _event(
        "heat-after-an-event",
        "heat after an event, fading over running hours",
        ("at",),
        lambda log: [{"at": at, "tau": hours * HOUR} for at, hours in product(_moments(log), (2.0, 6.0))],
    ),
    _event(
        "heat-after-two-events",
        "heat after an event that came twice, fading over running hours",
        ("at", SECOND_MOMENT),
        lambda log: [
            {"at": first, SECOND_MOMENT: second, "tau": 4.0 * HOUR}
            for first, second in combinations(_moments(log, MAX_PAIR_MOMENTS), 2)
        ],
        special=("heat-after-an-event",),
    ),
    _rival(
        "heat-since-a-moment",
        "heat that begins or ends at some moment",
        _heat_law(_lasting_heat),
        _since_words,
        parameters=("gain", "at", "turning"),
        sign=0.0,
        acts="anywhere",
        shapes=lambda log: [{"at": at, "turning": turning} for at in _moments(log) for turning in (0.0, 1.0)],
        refine={"at": IN_RECORD},
        widths={"at": 4 * HOUR},
        experiment="look up what was changed then, and undo it for a day",
        look="what was changed at the machine then: a bearing, a belt, a setting, the load's kind",
    ),
    _rival(
        "other-surroundings",
        "surroundings that are warmer or cooler from some moment on",
        _heat_law(_surroundings),
        _surroundings_words,
        parameters=("rise", "at"),
        sign=0.0,
        acts="anywhere",
        shapes=lambda log: [{"at": at} for at in _moments(log)],
        refine={"at": IN_RECORD},
        widths={"at": 4 * HOUR},
        experiment="log the room's temperature for three days, with a night at rest",
        look="what changed around the machine then: weather, heating, a door, another machine, its enclosure, and its "
        "cooler where it never rests",
    ),
    _rival(
        DRIFTING_SURROUNDINGS,
        "surroundings, or a sensor, that grow warmer or cooler from some moment on",
        _heat_law(_drifting),
        _drifting_words,
        parameters=("rise", "at", "over"),
        sign=0.0,
        acts="anywhere",
        # Only where it rests is it told from a heat that grows.
        shapes=lambda log: [{"at": at, "over": float(log.time[-1]) - at} for at in _growth_starts(log) if log.rests],
        refine={"at": IN_RECORD},
        widths={"at": 4 * HOUR},
        experiment="read a second thermometer beside the sensor at long rest, now and after some days",
        look="the sensor (its seat, its age, when it was calibrated), and what grows warmer or cooler around it",
    ),
    _cooling(
        "less-cooling",
        "less cooling from some moment on",
        lambda log: [{"at": at, "over": 0.0} for at in _moments(log)],
    ),
    _cooling(
        "less-cooling-twice",
        "less cooling from some moment on, and less again from a later one on",
        lambda log: [
            {"at": first, SECOND_MOMENT: second, "over": 0.0}
            for first, second in combinations(_moments(log, MAX_PAIR_MOMENTS // 2), 2)
        ],
        ("at", SECOND_MOMENT),
        special=("less-cooling",),
    ),
    _cooling(
        "less-and-less-cooling",
        "a cooling that grows less from some moment on",
        lambda log: [{"at": at, "over": float(log.time[-1]) - at} for at in _growth_starts(log)],
    ),
    _rival(
        UNMEASURED_NEIGHBOUR,
        "heat from something that is not measured",
        _heat_law(_no_heat),
        _unmeasured_words,
        parameters=("sigma", "memory"),
        acts="anywhere",
        shapes=lambda _: [],
        burden=1.0,
        experiment="log the room and the machines beside this one for some days",
        look="what is beside the machine and not recorded: another machine, a pipe, a heating, a door",
    ),
)
"""Kinds that a diagnosis holds beside the names, and that no engine executes."""
