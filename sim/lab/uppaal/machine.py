"""The automaton as a UPPAAL template: flows as rates, entries as random draws, noise as exact jumps in updates."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

from sim.lab.uppaal.document import Arrow, Template, TemplateLocation, comment_text, number
from sim.lab.uppaal.effects import EffectTexts
from sim.lab.uppaal.words import FreshNames, spell_names
from sim.sha import RELAXING_FLOWS, SHA, Distribution, Location, draw_parameter, draw_temperature, mode_parameter

Move = tuple[str, str, str]
"""Source (a location's name), the channel on which it receives, target."""

Constant = Callable[[str, float], str]
"""Declares a constant of a kind and gives its identifier."""


@dataclass(frozen=True, slots=True)
class Variables:
    """The identifiers of the machine's own variables; `inputs` gives signal -> (value, flag that it was read)."""

    mode: str
    jump: str
    since: str
    clamps: str
    taken: str
    low: str
    high: str
    max_rate: str
    tick: str
    inputs: Mapping[str, tuple[str, str]]


def variables(names: FreshNames, signals: Iterable[str]) -> Variables:
    """Names for the machine's own variables: what a location is called already is avoided."""
    inputs = {
        signal: (names.fresh(f"u_{word}"), names.fresh(f"known_{word}"))
        for signal, word in spell_names(signals).items()
    }
    return Variables(
        mode=names.fresh("m"),
        jump=names.fresh("jump"),
        since=names.fresh("since"),
        clamps=names.fresh("clamps"),
        taken=names.fresh("taken"),
        low=names.fresh("LOW"),
        high=names.fresh("HIGH"),
        max_rate=names.fresh("MAX_RATE"),
        tick=names.fresh("TICK"),
        inputs=inputs,
    )


@dataclass(frozen=True, slots=True)
class Part:
    """One location in UPPAAL's words: its constants, its rate, and the updates when it is left and when entered.

    `noisy` says whether there is noise to draw while the machine stays.
    """

    constants: tuple[str, ...]
    rate: str
    leave: tuple[str, ...]
    enter: tuple[str, ...]
    noisy: bool


def part(location: Location, names: FreshNames, known: Variables, max_rate: float, more: EffectTexts) -> Part:
    """The texts of one location. Raises ValueError for numbers that UPPAAL has no word for."""
    identifier = names.locations[location.name]
    word = spell_names([identifier])[identifier]
    constants: list[str] = []

    def constant(kind: str, value: float) -> str:
        name = names.fresh(f"{kind}_{word}")
        constants.append(f"const double {name} = {number(value)};")
        return name

    flow = location.flow
    own = {kind: constant(kind.upper(), flow.params[kind]) for kind in ("k", "t0", "tau") if kind in flow.params}
    # The flow's own part of the rate of X, then what the effects add, then the limit on both together.
    rate = "0.0"
    if flow.kind in RELAXING_FLOWS:
        target = known.mode
        for driving in flow.inputs:
            value, read = known.inputs[driving.signal]
            gain, reference = constant("GAIN", driving.gain), constant("REF", driving.reference)
            target += f" + {read} * {gain} * ({value} - {reference})"
        rate = f"{own['k']} * ({target} - {more.x})"
    elif flow.kind == "logarithmic":
        rate = f"{known.mode} / ({own['t0']} + age)"
    elif flow.kind == "transient":
        rate = f"{known.mode} * exp(-age / {own['tau']}) / {own['tau']}"
    elif flow.kind == "linear":
        rate = known.mode
    rate = more.rate(location.name, rate)
    if isfinite(max_rate) and rate != "0.0":
        rate = f"fmax(-{known.max_rate}, fmin({rate}, {known.max_rate}))"
    # The standard deviation of what the noise has added since it was last drawn; empty without noise.
    deviation = ""
    if flow.params["noise"]:
        noise = constant("NOISE", flow.params["noise"])
        deviation = f"{noise} * sqrt({known.since})"
        if flow.kind in RELAXING_FLOWS:
            # Ornstein-Uhlenbeck: the variance gathered in s seconds is noise^2 (1 - exp(-2 k s)) / (2 k), exactly.
            deviation = f"{noise} * sqrt((1.0 - exp(-2.0 * {own['k']} * {known.since})) / (2.0 * {own['k']}))"
    jump = f"{more.x} + {deviation} * random_normal(0.0, 1.0)" if deviation else more.x
    fresh, law = draw_temperature(location), draw_parameter(location)
    enter = [f"{known.jump} = {draw(fresh, constant)}", *clamp(known)] if fresh else []
    if flow.kind != "constant":  # which has no use for a mode parameter
        mode = draw(law, constant) if law else constant("M", mode_parameter(location)[0])
        enter.append(f"{known.mode} = {mode}")
    return Part(
        tuple(constants),
        rate,
        (f"{known.jump} = {jump}", *(more.left or {}).get(location.name, ()), *clamp(known)),
        tuple(enter),
        bool(deviation),
    )


def draw(law: Distribution, constant: Constant) -> str:
    """One draw from a law, by the functions that UPPAAL has had since statistical model checking came."""
    p = law.params
    if law.kind in ("normal", "lognormal"):
        middle = constant("MU", p["mu"])
        normal = f"random_normal({middle}, {constant('SIGMA', p['sigma'])})" if p["sigma"] else middle
        return f"exp({normal})" if law.kind == "lognormal" else normal
    if law.kind == "exponential":
        return f"-{constant('MEAN', p['mean'])} * ln(1.0 - random(1.0))"
    # Weibull by its inverse, from random(1.0) alone: u lies in [0, 1), so that ln is never asked for 0.
    shape, scale = constant("SHAPE", p["shape"]), constant("SCALE", p["scale"])
    return f"{scale} * pow(-ln(1.0 - random(1.0)), 1.0 / {shape})"


def clamp(known: Variables) -> tuple[str, ...]:
    """Holds the jump variable inside the model's range and counts."""
    x, low, high = known.jump, known.low, known.high
    return (
        f"{known.clamps} = {known.clamps} + ({x} < {low} || {x} > {high} ? 1 : 0)",
        f"{x} = fmax({low}, fmin({x}, {high}))",
    )


@dataclass(frozen=True, slots=True)
class Beginning:
    """Where the machine starts: location, seconds spent there already, first temperature, its law where it has one."""

    location: str
    age: float
    temperature: float
    law: Distribution | None = None


def machine(
    sha: SHA,
    names: FreshNames,
    known: Variables,
    *,
    moves: Sequence[Move],
    begin: Beginning,
    tick: int,
    more: EffectTexts,
) -> tuple[str, Template]:
    """The machine's constants (for the global declarations) and its template `Machine`, not laid out yet.

    `tick` (s) bounds the time between two draws of the noise; 0 draws it at events only. `more` is what effects add.
    Raises ValueError for numbers that UPPAAL has no word for.
    """
    parts = {location.name: part(location, names, known, sha.max_rate, more) for location in sha.locations}
    places = []
    for location in sha.locations:
        each = parts[location.name]
        # Time may not pass the moment at which the noise is due: the tick's edge is taken then.
        bound = f"{known.since} <= {known.tick} && " if tick and (each.noisy or more.polled) else ""
        places.append(
            TemplateLocation(
                names.locations[location.name],
                invariant=f"{bound}{more.invariant(each.rate)}",
                comment=f"{comment_text(location.name)}: {location.flow.kind}, entry {location.entry}",
            )
        )
    start = TemplateLocation(names.fresh("start"), kind="committed")
    extra: list[str] = []

    def constant(kind: str, value: float) -> str:
        extra.append(f"const double {(name := names.fresh(f'{kind}_start'))} = {number(value)};")
        return name

    first = draw(begin.law, constant) if begin.law else "Temp"
    first = f"{first} - {more.offset}" if more.offset else first
    opening = (f"{known.jump} = {first}", *clamp(known), *more.settled, *more.opening, f"age = {number(begin.age)}")
    mode = [update for update in parts[begin.location].enter if update.startswith(f"{known.mode} = ")]
    arrows = [Arrow(start.name, names.locations[begin.location], update=join_updates(*opening, *mode))]
    for source, channel, target in moves:
        resets = (*(more.resets or {}).get(channel, ()), f"{known.since} = 0", "age = 0")
        updates = (*parts[source].leave, *parts[target].enter, *more.settled, *resets)
        text = join_updates(*updates, f"{known.taken} = {known.taken} + 1")
        arrows.append(Arrow(names.locations[source], names.locations[target], sync=f"{channel}?", update=text))
    for name, each in parts.items():
        if tick and (each.noisy or more.polled):
            # The noise of the seconds gone by is drawn, and the stay goes on.
            place, text = names.locations[name], join_updates(*each.leave, *more.settled, f"{known.since} = 0")
            arrows.append(Arrow(place, place, guard=f"{known.since} >= {known.tick}", update=text))
        arrows += more.loops(names.locations[name])
    comments = [
        f"// {names.locations[location.name]}: {comment_text(location.name)}, {location.flow.kind}"
        for location in sha.locations
    ]
    constants = [
        line for comment, each in zip(comments, parts.values(), strict=True) for line in (comment, *each.constants)
    ]
    declared = "\n".join(
        (
            "// The temperature; seconds since the entry, since the noise was last drawn, since the start.",
            f"hybrid clock Temp = {number(begin.temperature)};",
            f"clock age, {known.since}, time;",
            "// The mode parameter of the present stay, and the temperature on its way through an update.",
            f"double {known.mode} = 0.0;",
            f"double {known.jump} = 0.0;",
            "// How often the temperature was put back to the border of its range; how many events found an edge.",
            f"int {known.clamps} = 0;",
            f"int {known.taken} = 0;",
            *more.declared,
        )
    )
    return "\n".join([*constants, *more.constants, *extra]), Template(
        "Machine", declared, (start, *places), tuple(arrows), start.name
    )


def join_updates(*updates: str) -> str:
    """Updates in their order, as one label."""
    return ", ".join(updates)
