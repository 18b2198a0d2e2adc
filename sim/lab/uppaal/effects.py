"""Effects in UPPAAL's words: terms of the rate, hybrid clocks for the housing and the sensor, a valve that is polled.

`Temp` stays what the sensor reads. Without a lag or an offset it is X itself; else X is a hybrid clock of its own, or
`Temp` less what the sensor reads too much. A dead time is in the times of events and readings already (`replay`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim.effects import (
    EffectRefusal,
    Structural,
    TextLaw,
    affects_location,
    effect_kind,
    heat_lag,
    of_feature,
    parameter,
    unknown,
)
from sim.engine import Plant, compile_plant
from sim.lab.uppaal.document import Arrow, number
from sim.lab.uppaal.players import array
from sim.lab.uppaal.replay import Clocks, signals_before
from sim.lab.uppaal.words import FreshNames
from sim.sha import SHA, Effect

Inputs = Mapping[str, tuple[str, str]]
"""signal -> (its value, the flag that it was read)."""

NO_STEP_S = 1e12
"""Seconds at which no more steps of the sensor come."""


@dataclass(frozen=True, slots=True)
class EffectTexts:
    """The texts that effects add to a machine.

    `x` is the expression of X, `clock` the hybrid clock that moves at X's rate. `constants` are lines for the global
    declarations, `declared` for the machine's own.
    `terms` has for each location what is added to its rate, `rates` the other hybrid clocks' rates, `bounds` what else
    an invariant says. `opening` are updates at the start after `settled`, which puts the jump variable into X and what
    follows it; `left` are those of each location before that, `resets` those on a channel. `arrows` are (guard,
    updates) of loops at every place; `polled` says that a valve is looked at each tick, `offset` is what the sensor
    reads too much.
    """

    x: str = "Temp"
    clock: str = "Temp"
    constants: tuple[str, ...] = ()
    declared: tuple[str, ...] = ()
    terms: Mapping[str, str] | None = None
    rates: tuple[str, ...] = ()
    bounds: tuple[str, ...] = ()
    opening: tuple[str, ...] = ()
    settled: tuple[str, ...] = ("Temp = jump",)
    left: Mapping[str, tuple[str, ...]] | None = None
    resets: Mapping[str, tuple[str, ...]] | None = None
    arrows: tuple[tuple[str, tuple[str, ...]], ...] = ()
    polled: bool = False
    offset: str = ""

    def rate(self, location: str, own: str) -> str:
        """The rate of X in a location, whose flow has the rate `own`."""
        return own + (self.terms or {}).get(location, "")

    def invariant(self, rate: str) -> str:
        """The invariant's rates and bounds, X moving at `rate`."""
        return " && ".join([*self.bounds, f"{self.clock}' == {rate}", *self.rates])

    def loops(self, place: str) -> list[Arrow]:
        """The edges from a place to itself."""
        return [Arrow(place, place, guard=guard, update=", ".join(updates)) for guard, updates in self.arrows]


def effect_texts(
    sha: SHA, names: FreshNames, inputs: Inputs, own: tuple[str, str], channels: Mapping[str, str], clocks: Clocks
) -> EffectTexts:
    """The texts of an automaton's effects; those of a plain machine without any.

    `own` are the machine's variables for the jump and for the seconds since the last one.
    """
    if not sha.effects:
        return EffectTexts(settled=(f"Temp = {own[0]}",))
    return _LineCollector(sha, names, inputs, own=own, channels=channels, clocks=clocks).finish()


class _LineCollector:
    """Collects the lines of one automaton."""

    def __init__(
        self,
        sha: SHA,
        names: FreshNames,
        inputs: Inputs,
        *,
        own: tuple[str, str],
        channels: Mapping[str, str],
        clocks: Clocks,
    ) -> None:
        self.sha, self.names, self.inputs = sha, names, inputs
        self.jump, self.age = own
        self.channels, self.clocks = channels, clocks
        self.plant: Plant = compile_plant(sha)
        self.constants: list[str] = ["// What acts on top of the flows."]
        self.declared: list[str] = []
        self.rates: list[str] = []
        self.opening: list[str] = []
        self.following: list[str] = []
        self.resets: dict[str, list[str]] = {}
        self.left: dict[str, tuple[str, ...]] = {}
        self.x = "Temp"
        self.offset = ""

    def constant(self, kind: str, value: float) -> str:
        name = self.names.fresh(kind)
        self.constants.append(f"const double {name} = {number(value)};")
        return name

    def finish(self) -> EffectTexts:
        bounds, arrows = self._sensor()
        heats = [(effect, self._heat(effect)) for effect in self.sha.effects]
        late = "".join(map(self._late_term, self.plant.late, self.clocks.late))
        offsets = self._offset_terms()
        terms = {
            place.name: "".join(text for effect, text in heats if affects_location(effect, place.name))
            + late
            + offsets[place.name]
            for place in self.sha.locations
        }
        shown = f"Temp = {self.jump} + {self.offset}" if self.offset else f"Temp = {self.jump}"
        settled = [f"{self.x} = {self.jump}" if self.plant.lags else shown, *self.following]
        return EffectTexts(
            x=self.x,
            clock=self.x if self.plant.lags else "Temp",
            constants=tuple(self.constants),
            declared=tuple(self.declared),
            terms=terms,
            rates=tuple(self.rates),
            bounds=bounds,
            opening=tuple(self.opening),
            settled=tuple(settled),
            left=self.left,
            resets={channel: tuple(updates) for channel, updates in self.resets.items()},
            arrows=arrows,
            polled=self.plant.thermostat is not None or self.plant.disturbance is not None,
            offset=self.offset,
        )

    # -------------------------------------------------------------- the sensor

    def _sensor(self) -> tuple[tuple[str, ...], tuple[tuple[str, tuple[str, ...]], ...]]:
        """Names X, and says how `Temp` follows it; (bounds, loops) of the steps of an offset."""
        bounds, arrows = self._steps()
        reading = f"(Temp - {self.offset})" if self.offset else "Temp"
        if not self.plant.lags:
            self.x = reading
            return bounds, arrows
        rate = self.constant("LAG_RATE", self.plant.lag_rate)
        clocks = [self.names.fresh("core")]
        clocks += [self.names.fresh(f"lag_{place}") for place in range(1, self.plant.lags)]
        self.x = clocks[0]
        self.declared += ["// X itself and the lags before the sensor's last, which Temp is.", *map(_hybrid, clocks)]
        for before, after in zip(clocks, [*clocks[1:], "Temp"], strict=True):
            value = reading if after == "Temp" else after
            self.rates.append(f"{after}' == {rate} * ({before} - {value})")
        shown = f"Temp = {self.jump} + {self.offset}" if self.offset else f"Temp = {self.jump}"
        self.opening += [*(f"{clock} = {self.jump}" for clock in clocks), shown]
        return bounds, arrows

    def _steps(self) -> tuple[tuple[str, ...], tuple[tuple[str, tuple[str, ...]], ...]]:
        steps = sorted(
            (effect.params["at"] - self.clocks.start, effect.params["size"])
            for effect in of_feature(self.sha, "sensor offset")
        )
        if not steps:
            return (), ()
        self.offset = self.names.fresh("wrong")
        now = sum(size for at, size in steps if at <= 0)
        self.declared += ["// What the sensor reads too much.", f"double {self.offset} = {number(now)};"]
        # Steps at or before the start are in the first value; the rest are edges, taken when an invariant forces them.
        later = [(round(at, 6), size) for at, size in steps if at > 0]
        if not later:
            return (), ()
        index, times, sizes = (self.names.fresh(name) for name in ("next_s", "STEP_TIMES", "STEPS"))
        self.declared.append(f"int {index} = 0;")
        self.constants.append(array("double", times, [*(number(at) for at, _ in later), number(NO_STEP_S)]))
        self.constants.append(array("double", sizes, [*(number(size) for _, size in later), "0.0"]))
        step = f"{sizes}[{index}]"
        updates = (f"{self.offset} = {self.offset} + {step}", f"Temp = Temp + {step}", f"{index} = {index} + 1")
        return (f"time <= {times}[{index}]",), ((f"time >= {times}[{index}]", updates),)

    # -------------------------------------------------------------- heats

    def _heat(self, effect: Effect) -> str:
        """The term of a rate, with its sign; "" for what acts on the sensor alone. Raises ValueError."""
        match effect_kind(effect).uppaal:
            case TextLaw(term=term):
                return term(self, effect)
            case Structural(feature="housing"):
                coupling = self.constant("COUPLING", effect.params["coupling"])
                tau = self.constant("TAU", effect.params["tau"])
                clock = self.names.fresh("housing")
                self.declared += ["// The temperature of the housing.", _hybrid(clock)]
                self.rates.append(f"{clock}' == ({self.x} - {clock}) / {tau}")
                self.opening.append(f"{clock} = {self.jump}")  # as warm as the machine at the start
                return f" + {coupling} * ({clock} - {self.x})"
            case Structural(feature="thermostat"):
                return _thermostat(self, effect)
            case Structural(feature="disturbance"):
                sigma, memory = (self.constant(name.upper(), effect.params[name]) for name in ("sigma", "memory"))
                heat = self.names.fresh("heat")
                self.declared += ["// The heat that comes and goes; held between two draws.", f"double {heat} = 0.0;"]
                # Between draws it keeps the part exp(-seconds / MEMORY), and what is new keeps its variance at SIGMA^2:
                # exact at the draws, whatever the tick.
                kept = f"exp(-{self.age} / {memory})"
                fresh = f"{sigma} * sqrt(1.0 - {kept} * {kept}) * random_normal(0.0, 1.0)"
                self.following.append(f"{heat} = {heat} * {kept} + {fresh}")
                self.opening.append(f"{heat} = {sigma} * random_normal(0.0, 1.0)")
                return f" + {heat}"
            case Structural(feature="machine offset"):
                return ""  # times each location's own rate: in `_offset_terms`
            case Structural(feature="dead time" | "sensor lag" | "sensor offset"):
                return ""  # in the replay's times, and in `_sensor`
            case EffectRefusal(reason=reason):
                raise ValueError(f"effects of the kind {effect.kind!r} have no text: {reason}")
            case text:
                raise unknown("the UPPAAL export", effect.kind, text)

    def _late_term(self, effect: Effect, begin: float) -> str:
        """The term of what comes late, in every location; its clock is the late source, from `begin` (degC/s) on."""
        part = effect_kind(effect).late
        if part is None:
            raise unknown("the UPPAAL export", effect.kind, part)
        clock, lag = self.names.fresh("late"), self.constant("LAG", heat_lag(effect))
        source, coming = (
            f"({part.text.term(self, each).removeprefix(' + ')})" for each in (effect, signals_before(effect))
        )
        known = " * ".join(dict.fromkeys(self.inputs[signal][1] for signal in effect.signals.values()))
        self.declared += ["// The heat of the signals that comes late, in degC/s.", _hybrid(clock)]
        # Before its signals are read it waits where their first reading will find it.
        self.rates.append(f"{clock}' == {known} * ({coming} - {clock}) / {lag}")
        self.opening.append(f"{clock} = {number(begin)}")
        return f" + {known} * ({clock} - {source})"

    def _offset_terms(self) -> dict[str, str]:
        """For each location what the machine's own offset adds to the rate."""
        if self.plant.machine is None:
            return dict.fromkeys(self.plant.places, "")
        sigma, offset = self.constant("SIGMA", self.plant.machine.params["sigma"]), self.names.fresh("own")
        self.declared += ["// What this machine's targets lie above or below.", f"double {offset} = 0.0;"]
        self.opening.append(f"{offset} = {sigma} * random_normal(0.0, 1.0)")
        rates = {name: float(self.plant.rate[row]) for name, row in self.plant.places.items()}
        return {name: f" + {number(rate)} * {offset}" if rate else "" for name, rate in rates.items()}

    def since(self, effect: Effect) -> tuple[str, str]:
        """(flag that the effect's event was there, clock of the seconds since)."""
        clock, begun = self.names.fresh("running"), self.names.fresh("begun")
        number_of = [acting.effect for acting in self.plant.startups].index(effect)
        since = self.clocks.since[number_of]
        known = since < NO_STEP_S
        self.declared += [f"// Since {effect.event}.", f"clock {clock};", f"int {begun} = {int(known)};"]
        if known:
            self.opening.append(f"{clock} = {number(since)}")
        channel = self.channels.get(effect.event)
        if channel is not None:
            self.resets.setdefault(channel, []).extend([f"{clock} = 0", f"{begun} = 1"])
        return begun, clock

    def moment(self, name: str, time: float) -> str:
        """Declares an absolute time (s) as a constant on the document's `time`."""
        return self.constant(name, time - self.clocks.start)

    def read(self, effect: Effect, role: str) -> tuple[str, str]:
        """(value, flag) of the signal that fills a role."""
        return self.inputs[effect.signals[role]]

    def degrees(self, effect: Effect, role: str) -> str:
        """A temperature signal in the scale of X."""
        value = self.read(effect, role)[0]
        scale, shift = parameter(effect, "scale"), parameter(effect, "shift")
        if (scale, shift) == (1.0, 0.0):
            return value
        return f"({self.constant('SCALE', scale)} * {value} + {self.constant('SHIFT', shift)})"


def _hybrid(clock: str) -> str:
    return f"hybrid clock {clock};"


def _thermostat(writer: _LineCollector, effect: Effect) -> str:
    """The valve is looked at in updates; what a run went too far meanwhile is taken back, to first order in the tick.

    The moment of the crossing lies where the straight line since the last look meets the threshold.
    """
    order = ("loss", "sink", "opens", "closes")
    loss, sink, opens, closes = (writer.constant(name.upper(), effect.params[name]) for name in order)
    valve, turn, last = (writer.names.fresh(name) for name in ("opened", "turn", "last"))
    writer.declared += [
        "// Whether the thermostat is open; how it turned and where X was when it was last looked at.",
        f"int {valve} = 0;",
        f"int {turn} = 0;",
        f"double {last} = 0.0;",
    ]
    jump, age = writer.jump, writer.age
    looked = f"({jump} >= {opens} || ({valve} == 1 && {jump} > {closes}) ? 1 : 0)"
    over = f"{age} * ({jump} - ({turn} == 1 ? {opens} : {closes})) / ({jump} - {last})"
    back = f"({turn} == 0 ? {jump} : {jump} - {turn} * {over} * {loss} * ({jump} - {sink}))"
    turned = (f"{turn} = {looked} - {valve}", f"{valve} = {valve} + {turn}", f"{jump} = {back}")
    for place in writer.sha.locations:
        if affects_location(effect, place.name):
            writer.left[place.name] = turned
    writer.following += [f"{valve} = {looked}", f"{last} = {jump}"]
    return f" - {valve} * {loss} * ({writer.x} - {sink})"


def export_refusal(sha: SHA, tick: int, dropped: Sequence[str]) -> str:
    """Why these effects cannot be exported so ("": they can)."""
    if of_feature(sha, "thermostat") and not tick:
        return "the thermostat is looked at once a tick; give a tick of at least 1 s"
    if of_feature(sha, "disturbance") and not tick:
        return "the disturbance of heat is drawn once a tick; give a tick of at least 1 s"
    starts = [effect.event for effect in sha.effects if effect.event in dropped]
    if starts:
        return f"an event {starts[0]!r}, since which start-up heat counts, is passed over; use the policy 'resync'"
    return ""
