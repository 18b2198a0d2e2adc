"""A named effect and the effects of the automaton that it stands for: what is fitted is what will be executed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sim.effects import drop_features, effect_kind
from sim.lab.discrepancy.fitting.candidates import CatalogueEntry, entry_of_effect
from sim.lab.learning import first_switch
from sim.sha import Effect, Model, switch_locations


@dataclass(frozen=True, slots=True)
class Named:
    """An effect in the model: its catalogue `entry`, the signal of each role, and all its parameters by name.

    `existing` is the effect that the model had before, whose signals, locations and event it keeps.
    """

    entry: CatalogueEntry
    signals: Mapping[str, str]
    params: Mapping[str, float]
    existing: Effect | None = None

    @property
    def strength(self) -> float:
        """The parameter that scales it."""
        return self.params[self.entry.strength]

    @property
    def free(self) -> tuple[str, ...]:
        """The parameters that a fit moves: the strength first, then those of the shape that are fitted jointly."""
        return (self.entry.strength, *self.entry.candidate.jointly(self.params))

    @property
    def point(self) -> list[float]:
        """The values of `free`."""
        return [self.params[name] for name in self.free]

    def with_point(self, point: Sequence[float]) -> "Named":
        """The same effect at other values of `free`."""
        moved = dict(zip(self.free, point, strict=True))
        return replace(self, params=self.entry.candidate.settled({**self.params, **moved}))


def model_effects(model: Model) -> tuple[Named, ...]:
    """The effects that a model has already and that have a strength. Raises ValueError for a kind that has none.

    What is random in it is none of them: heat with a memory is the noise that a fit begins from, and a machine's own
    offset is in the targets, which are fitted to that machine.
    """
    named = []
    for effect in drop_features(model.sha, "disturbance", "machine offset").effects:
        defaults = {
            name: each.default for name, each in effect_kind(effect).parameters.items() if each.default is not None
        }
        params = {**defaults, **effect.params}
        named.append(Named(entry_of_effect(effect), dict(effect.signals), params, effect))
    return tuple(named)


def automaton_effects(named: Named, model: Model) -> tuple[Effect, ...]:
    """A named effect as the automaton takes it, and what else its shape stands for.

    That is a lag for the blur of a dead time, and the same effect of another strength where the machine rests.
    """
    candidate, effect = named.entry.candidate, main_effect(named, model)
    more = None if candidate.besides is None else candidate.besides(named.params)
    share = named.params.get(candidate.at_rest, 1.0)
    if share != 1.0 and named.existing is None:
        running = set(running_locations(model))
        where = effect.locations or tuple(location.name for location in model.sha.locations)
        turns, rests = (tuple(name for name in where if (name in running) == runs) for runs in (True, False))
        if turns and rests:
            resting = {**effect.params, candidate.strength: share * named.strength}
            return replace(effect, locations=turns), replace(effect, params=resting, locations=rests)
    return (effect, *(() if more is None else (Effect(*more),)))


def main_effect(named: Named, model: Model) -> Effect:
    """The effect that bears a named one's name."""
    kind, candidate = named.entry.kind, named.entry.candidate
    if named.existing is not None:
        return replace(named.existing, params={**named.existing.params, candidate.strength: named.strength})
    unread = candidate.unread != "" and bool(named.params.get(candidate.unread))
    signals = {role: signal for role, signal in named.signals.items() if role in kind.required_roles or not unread}
    acts, everywhere = kind.action_place(signals), tuple(location.name for location in model.sha.locations)
    where: tuple[str, ...] = ()
    if acts != "everywhere":
        where = running_locations(model) if acts == "running" else everywhere
        # A constant flow holds a temperature of which nothing is known: there a heat would only add up.
        flows = model.sha.by_name
        where = tuple(name for name in where if flows[name].flow.kind != "constant") or where
    switch = first_switch(model.alphabet)
    return Effect(
        named.entry.name,
        {name: value for name, value in named.params.items() if name in kind.parameters},
        signals,
        locations=where if len(where) < len(everywhere) else (),
        event=switch.rising if kind.from_event and switch is not None else "",
        line=named.entry.line,
    )


def running_locations(model: Model) -> tuple[str, ...]:
    """The locations in which the machine may run, in the automaton's order: all of them without a switch."""
    locations = tuple(location.name for location in model.sha.locations)
    switch = first_switch(model.alphabet)
    if switch is None:
        return locations
    where = switch_locations(model.sha, model.alphabet).get(switch.signal)
    return () if where is None else tuple(name for name in locations if name in where.on or name in where.either)
