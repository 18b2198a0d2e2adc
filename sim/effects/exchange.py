"""Heat exchanged with something of a temperature of its own: a feed, a sink, a housing, a cooler, the walls."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from sim.effects.kind import (
    EffectCandidate,
    EffectKind,
    HeldLaw,
    LossBound,
    MachineLog,
    OptionalRole,
    Parameter,
    Params,
    Roles,
    Signals,
    Structural,
    TextLaw,
    TextWriter,
)
from sim.effects.roles import AMBIENT, FEED, PUMP, SINK, TO_SCALE_OF_X
from sim.phrase import Phrase
from sim.sha import Array, Effect

ABSOLUTE_ZERO = -273.15
"""degC."""

MIN_VALVE_BAND_DEGC = 0.2
"""degC between the opening and the closing of a switching thermostat that a diagnosis names, at least."""
MAX_VALVE_LOSS_PER_S = 0.3
"""1/s: the greatest loss of an open valve that a diagnosis names: its element of wax follows within seconds."""

_LOSS = Parameter(unit="1/s per unit of the pump", low=0.0, rescaled="stays")
_DEGREES = Parameter(unit="degC", rescaled="mapped")


def in_scale_of_x(effect: Effect, role: str, signals: Signals) -> Array:
    """The temperature signal of a role in the scale of X."""
    scale, shift = effect.params.get("scale", 1.0), effect.params.get("shift", 0.0)
    return np.asarray(scale * signals[effect.signals[role]] + shift)


def _feed(effect: Effect, signals: Signals) -> tuple[Array, Array]:
    """Heat -loss pump (X - feed), the pump counting as 1 where it has no signal, and as 0 below 0."""
    feed = in_scale_of_x(effect, "feed", signals)
    pump = signals[effect.signals["pump"]] if "pump" in effect.signals else np.ones_like(feed)
    loss = effect.params["loss"] * np.maximum(pump, 0.0)
    return loss * feed, loss


def _feeds(log: MachineLog) -> Sequence[Params]:
    """Towards the feed's own temperature; or by the feed alone, where it warms a part that stands between."""
    # What is fed may set the temperature of a bowl, whose heat then goes by the feed and hardly by the measured part.
    # With the feed spread about a reference by a great scale the same law is that heat: X is little beside the sink.
    usual, running = log.usual("feed", running=True), log.running > 0.5
    warm = float(np.median(log.smooth[running])) if running.any() else usual
    spread = [(scale, reference) for scale in (4.0, 40.0) for reference in (log.cold, usual, warm)]
    # About a reference far off all that is heat whenever the pump turns, whatever is fed: the pump's, and no feed's.
    feed = log.signals["feed"]
    ends = {
        "coldest": float(min(np.min(feed), log.cold)),
        "warmest": float(max(np.max(feed), np.quantile(log.smooth, 0.98))),
    }
    return [{}, *({"scale": scale, "shift": (1.0 - scale) * reference, **ends} for scale, reference in spread)]


def _settled_feed(params: Params) -> Params:
    """A feed that is spread about a reference, with that among the temperatures that there were."""
    scale = params.get("scale", 1.0)
    if scale == 1.0 or "warmest" not in params:
        return params
    reference = min(max(params["shift"] / (1.0 - scale), params["coldest"]), params["warmest"])
    return {**params, "shift": (1.0 - scale) * reference}


def _feed_text(writer: TextWriter, effect: Effect) -> str:
    feed, read = writer.degrees(effect, "feed"), writer.read(effect, "feed")[1]
    loss = writer.constant("LOSS", effect.params["loss"])
    pumped = ""
    if "pump" in effect.signals:
        value, known = writer.read(effect, "pump")
        pumped = f"{known} * fmax({value}, 0.0) * "
    return f" - {read} * {pumped}{loss} * ({writer.x} - {feed})"


def _pump(effect: Effect, signals: Signals) -> tuple[Array, Array]:
    """Heat -loss pump (X - sink), sink the signal of that role or the parameter."""
    loss = effect.params["loss"] * np.maximum(signals[effect.signals["pump"]], 0.0)
    sink = in_scale_of_x(effect, "sink", signals) if "sink" in effect.signals else effect.params["sink"]
    return loss * sink, loss


def _pump_text(writer: TextWriter, effect: Effect) -> str:
    value, read = writer.read(effect, "pump")
    loss = writer.constant("LOSS", effect.params["loss"])
    if "sink" in effect.signals:
        sink, read = writer.degrees(effect, "sink"), f"{read} * {writer.read(effect, 'sink')[1]}"
    else:
        sink = writer.constant("SINK", effect.params["sink"])
    return f" - {read} * {loss} * fmax({value}, 0.0) * ({writer.x} - {sink})"


def _sinks(log: MachineLog) -> Sequence[Params]:
    # The first lies so far off that the pump takes a nearly constant heat: between that and a loss towards a sink at
    # hand lies what data can tell.
    cold, span = log.cold, float(np.ptp(log.smooth))
    return [{"sink": sink} for sink in (cold - 10.0 * span, cold - 0.5 * span, cold, cold + 0.3 * span)]


def _valves(log: MachineLog) -> Sequence[Params]:
    running, cold = log.running > 0.5, log.cold
    span = float(np.quantile(log.smooth[running] if running.any() else log.smooth, 0.98)) - cold
    return [
        {"opens": cold + share * span, "closes": cold + (share - width) * span, "sink": cold}
        for share, width in product((0.4, 0.55, 0.7, 0.8, 0.9), (0.03, 0.1, 0.2))
    ]


def _settled_valve(params: Params) -> Params:
    """A valve that opens gradually (`gradual` 1) cools from where it opens on; another closes below."""
    opens = params["opens"]
    if params.get("gradual"):
        return {**params, "closes": opens, "sink": opens}
    return {**params, "closes": min(params["closes"], opens - MIN_VALVE_BAND_DEGC)}


def is_gradual(effect: Effect) -> bool:
    """Whether a thermostat opens gradually: heat -loss max(X - opens, 0), a function of the temperature alone."""
    return effect.params["opens"] == effect.params["closes"]


def _opening_text(params: Params) -> str:
    opens, closes, sink = params["opens"], params["closes"], params["sink"]
    if closes < opens or closes == opens == sink:
        return ""
    return (
        f"must close below where it opens (or open gradually: closes and sink equal to opens): closes {closes:g}, "
        f"opens {opens:g}, sink {sink:g} degC"
    )


def radiation_tangent(
    effect: Effect, *, gain: Array | float, about: Array, around: Array | float
) -> tuple[Array, Array]:
    """(loss, heat) of the tangent at `about` to what an effect radiates towards `around` with the strength `gain`."""
    # A tangent has the form of every other loss, heat - loss X, so that one exact step serves them all.
    zero = effect.params.get("zero", ABSOLUTE_ZERO)
    loss = 4.0 * gain * (about - zero) ** 3
    radiated = gain * ((about - zero) ** 4 - (around - zero) ** 4)
    slope, level = linear_radiation(effect)
    held = np.where(about > level, gain * slope, 0.0)
    return loss - held, loss * about - radiated - held * level


def linear_radiation(effect: Effect) -> tuple[float, float]:
    """(loss for a gain of 1, degC above which it counts): of what is radiated, the part that the flow has already."""
    share, level = effect.params.get("linear", 0.0), effect.params.get("surroundings", 0.0)
    return 4.0 * share * (level - effect.params.get("zero", ABSOLUTE_ZERO)) ** 3, level


def _radiation_text(writer: TextWriter, effect: Effect) -> str:
    gain = writer.constant("GAIN", effect.params["gain"])
    zero = writer.constant("ZERO", effect.params.get("zero", ABSOLUTE_ZERO))
    if "ambient" in effect.signals:
        around, read = writer.degrees(effect, "ambient"), f"{writer.read(effect, 'ambient')[1]} * "
    else:
        around, read = writer.constant("AROUND", effect.params["surroundings"]), ""
    linear, level = linear_radiation(effect)
    bent = ""
    if linear:
        bent = f" - {writer.constant('LINEAR', linear)} * fmax({writer.x} - {writer.constant('LEVEL', level)}, 0.0)"
    return f" - {read}{gain} * (pow({writer.x} - {zero}, 4.0) - pow({around} - {zero}, 4.0){bent})"


def _walls(log: MachineLog) -> Sequence[Params]:
    """Against walls of one temperature, or against the room's where it is measured."""
    # A rate that was learned where the machine radiates holds the linear part of that. Added to it once more, the whole
    # radiation could be no more than a rate can give up: at rest, where nothing blows, next to nothing.
    choices = (1.0, 0.0) if "ambient" in log.signals else (1.0,)
    return [{"surroundings": log.cold, "walls": walls, "linear": 1.0} for walls in choices]


def _has_level(params: Params) -> str:
    lacking = params.get("linear", 0.0) > 0 and "surroundings" not in params
    return "has a linear part, and no surroundings at which that would be taken" if lacking else ""


FLOWING = (
    EffectKind(
        name="feed-temperature-coupling",
        meaning=Phrase(
            "what is fed draws the measured part towards its own temperature",
            it="il prodotto alimentato tira la temperatura verso la propria",
            de="das Zugeführte zieht die Temperatur zu seiner eigenen",
        ),
        parameters={"loss": _LOSS, **TO_SCALE_OF_X},
        roles=Roles(
            needed=(FEED,),
            # Without a pump's signal something is fed while the machine runs, and nothing while it stands.
            optional=(OptionalRole(role=PUMP, without="the pump counts as 1", acts="running"),),
        ),
        acts="anywhere",
        law=HeldLaw(_feed),
        bound=LossBound(strength="pump", sink="feed"),
        uppaal=TextLaw(_feed_text),
        candidate=EffectCandidate(
            strength="loss",
            sign=1.0,
            experiment=Phrase(
                "feed at two temperatures at one load",
                it="alimentare a due temperature con lo stesso carico",
                de="bei einer Last mit zwei Temperaturen zuführen",
            ),
            look="what is fed: its temperature, and how much flows by the bearing",
            shapes=_feeds,
            refine={"shift": (-6000.0, 1000.0)},
            settled=_settled_feed,
        ),
    ),
    EffectKind(
        name="pump-cooling",
        meaning=Phrase(
            "the pump cools the measured part while it runs",
            it="la pompa raffredda mentre è in marcia",
            de="die Pumpe kühlt, solange sie läuft",
        ),
        parameters={
            "loss": _LOSS,
            "sink": Parameter(unit="degC", rescaled="mapped", role="sink"),
            **TO_SCALE_OF_X,
        },
        roles=Roles(
            needed=(PUMP,), optional=(OptionalRole(role=SINK, without="the sink has the temperature of the parameter"),)
        ),
        acts="anywhere",
        law=HeldLaw(_pump),
        bound=LossBound(strength="pump", sink="sink"),
        uppaal=TextLaw(_pump_text),
        candidate=EffectCandidate(
            strength="loss",
            sign=1.0,
            experiment=Phrase(
                "run for half an hour at one load with the pump on, then off",
                it="mezz'ora allo stesso carico con la pompa in marcia, poi ferma",
                de="bei einer Last eine halbe Stunde mit Pumpe fahren, dann ohne",
            ),
            look="the pump's water: flow, valve, filter, and how cold it comes",
            shapes=_sinks,
            refine={"sink": (-1000.0, 100.0)},
        ),
    ),
)

HOUSING = EffectKind(
    name="housing-thermal-mass",
    # heat coupling (H - X), dH/dt = (X - H) / tau, H starts at X
    meaning=Phrase(
        "a second mass (the housing) stores heat and gives it back",
        it="una seconda massa (la carcassa) accumula calore e lo restituisce",
        de="eine zweite Masse (das Gehäuse) speichert Wärme und gibt sie zurück",
    ),
    parameters={
        "coupling": Parameter(unit="1/s", low=0.0, rescaled="stays"),
        "tau": Parameter(unit="s", positive=True, rescaled="stays"),
    },
    roles=Roles(),
    acts="anywhere",
    law=Structural("housing"),
    bound=Structural("housing"),
    uppaal=Structural("housing"),
    candidate=EffectCandidate(
        strength="coupling",
        sign=1.0,
        experiment=Phrase(
            "log the room for three days, or a second sensor: a housing lags, a room does not",
            it="registrare l'ambiente per tre giorni, o un secondo sensore: la carcassa ritarda, l'ambiente no",
            de="den Raum drei Tage aufzeichnen oder einen zweiten Sensor: ein Gehäuse hinkt nach, ein Raum nicht",
        ),
        look="housing and foundation: what metal is warmed with the bearing, insulation, a missing second sensor",
        shapes=lambda _: [{"tau": tau} for tau in (900.0, 1800.0, 3600.0, 7200.0, 14400.0)],
        refine={"tau": (300.0, 40000.0)},
    ),
)

BENDING = (
    EffectKind(
        name="thermostatic-cooling",
        # heat -loss (X - sink) while open; opens at X >= opens, closes at X <= closes, closed at the start
        meaning=Phrase(
            "a cooling by a thermostat, which switches or opens gradually as it gets warmer",
            it="un raffreddamento con termostato, che scatta o si apre gradualmente quando si scalda",
            de="eine Kühlung mit Thermostat, der bei Erwärmung schaltet oder allmählich öffnet",
        ),
        parameters={
            "loss": Parameter(unit="1/s", low=0.0, rescaled="stays"),
            "sink": _DEGREES,
            "opens": _DEGREES,
            "closes": _DEGREES,
        },
        roles=Roles(),
        acts="anywhere",
        law=Structural("thermostat"),
        bound=Structural("thermostat"),
        uppaal=Structural("thermostat"),
        consistent=_opening_text,
        candidate=EffectCandidate(
            strength="loss",
            sign=1.0,
            experiment=Phrase(
                "a slow ramp of the load up and down: a hysteresis loop",
                it="una rampa lenta del carico, su e giù: un ciclo di isteresi",
                de="eine langsame Rampe der Last auf und ab: eine Hystereseschleife",
            ),
            look="a thermostat, valve or fan that switches by itself: where it opens and closes",
            shapes=_valves,
            refine={"opens": (-50.0, 200.0), "closes": (-50.0, 200.0)},
            either={"gradual": (0.0, 1.0)},
            settled=_settled_valve,
            jointly=lambda params: ("opens",) if params.get("gradual") else (),
            most=MAX_VALVE_LOSS_PER_S,
        ),
    ),
    EffectKind(
        name="radiation-loss",
        # heat -gain ((X - zero)^4 - (Ts - zero)^4 - linear 4 (S - zero)^3 max(X - S, 0)), S being `surroundings`, Ts
        # the ambient signal or S: with `linear` 1 the bend alone, and none of it where X is S
        meaning=Phrase(
            "a loss that grows faster than the temperature difference",
            it="una perdita che cresce più della differenza di temperatura",
            de="ein Verlust, der schneller wächst als der Temperaturunterschied",
        ),
        parameters={
            "gain": Parameter(unit="1/(s degC^3)", low=0.0, rescaled="inverse cube"),
            "surroundings": Parameter(unit="degC", rescaled="mapped", role="ambient"),
            "zero": Parameter(unit="degC", default=ABSOLUTE_ZERO, rescaled="mapped"),
            "linear": Parameter(unit="1", low=0.0, high=1.0, default=0.0, rescaled="stays"),
            **TO_SCALE_OF_X,
        },
        roles=Roles(
            optional=(OptionalRole(role=AMBIENT, without="the walls have the temperature `surroundings`"),),
        ),
        acts="anywhere",
        law=Structural("radiation"),
        bound=Structural("radiation"),
        uppaal=TextLaw(_radiation_text),
        consistent=_has_level,
        candidate=EffectCandidate(
            strength="gain",
            sign=1.0,
            experiment=Phrase(
                "a slow ramp of the load up and down: no loop, but a bend",
                it="una rampa lenta del carico, su e giù: nessun ciclo, ma una curva",
                de="eine langsame Rampe der Last auf und ab: keine Schleife, aber ein Knick",
            ),
            look="hot bare surfaces: paint, insulation, what the machine faces",
            shapes=_walls,
            either={"walls": (1.0, 0.0)},
            unread="walls",
            # Towards the room's walls it goes with the room as well; what it is known by is the bend.
            special=("ambient-coupling",),
        ),
    ),
)
