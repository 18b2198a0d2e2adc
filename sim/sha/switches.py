"""In which locations a switch is on: what the symbols of the ways there say of it."""

from collections.abc import Mapping
from dataclasses import dataclass

from sim.sha.automaton import SHA
from sim.sha.events import Alphabet, Switch
from sim.sha.trace import UNKNOWN


@dataclass(frozen=True, slots=True)
class SwitchLocations:
    """Where the last word on a switch is always that it is `on`, and where it may be `either`; in their order."""

    on: tuple[str, ...]
    either: tuple[str, ...]


def switch_locations(sha: SHA, alphabet: Alphabet) -> Mapping[str, SwitchLocations]:
    """By signal, for each switch that any way of the automaton turns on."""
    found = {channel.signal: _locations(sha, channel) for channel in alphabet.channels if isinstance(channel, Switch)}
    return {signal: where for signal, where in found.items() if where.on or where.either}


def _locations(sha: SHA, switch: Switch) -> SwitchLocations:
    says = {switch.rising: True, switch.falling: False, UNKNOWN: None}
    leaving: dict[str, list[tuple[str, str]]] = {}
    for edge in sha.edges:
        leaving.setdefault(edge.source, []).append((edge.symbol, edge.target))
    reached: set[tuple[str, bool | None]] = {(sha.initial, None)}
    front = list(reached)
    for here, position in front:  # grows while it is walked
        new = {(target, says.get(symbol, position)) for symbol, target in leaving.get(here, ())} - reached
        reached |= new
        front += sorted(new, key=str)
    names = [location.name for location in sha.locations]
    return SwitchLocations(
        tuple(name for name in names if (name, True) in reached and (name, False) not in reached),
        tuple(name for name in names if (name, True) in reached and (name, False) in reached),
    )
