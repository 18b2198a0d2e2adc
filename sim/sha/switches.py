"""In which locations a switch is on and how high a level is: what the symbols of the ways there say of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

from sim.sha.automaton import SHA
from sim.sha.events import Alphabet, Bins, Switch
from sim.sha.trace import UNKNOWN

_Word = TypeVar("_Word", bool, int)


@dataclass(frozen=True, slots=True)
class SwitchLocations:
    """Where a last word on a switch is always that it is `on`, where it may be `either`, and where it is always `off`;
    in their order. A location that is reached without a word on it only is none of them."""

    on: tuple[str, ...]
    either: tuple[str, ...]
    off: tuple[str, ...]


def switch_locations(sha: SHA, alphabet: Alphabet) -> Mapping[str, SwitchLocations]:
    """By signal, for each switch that any way of the automaton turns on."""
    found = {channel.signal: _locations(sha, channel) for channel in alphabet.channels if isinstance(channel, Switch)}
    return {signal: where for signal, where in found.items() if where.on or where.either}


def _locations(sha: SHA, switch: Switch) -> SwitchLocations:
    reached = _last_words(sha, {switch.rising: True, switch.falling: False, UNKNOWN: None})
    words = [
        (location.name, (location.name, True) in reached, (location.name, False) in reached)
        for location in sha.locations
    ]
    return SwitchLocations(
        tuple(name for name, on, off in words if on and not off),
        tuple(name for name, on, off in words if on and off),
        tuple(name for name, on, off in words if off and not on),
    )


def level_of_locations(sha: SHA, bins: Bins) -> Mapping[str, float]:
    """By location, which of the bins the last word on the signal says, counted from 0; their mean where it may be
    several. A location that is reached without a word on it has none."""
    found: dict[str, set[int]] = {}
    numbers: dict[str, int | None] = {symbol: number for number, symbol in enumerate(bins.symbols)}
    for name, number in _last_words(sha, numbers | {UNKNOWN: None}):
        if number is not None:
            found.setdefault(name, set()).add(number)
    return {name: sum(levels) / len(levels) for name, levels in found.items()}


def _last_words(sha: SHA, says: Mapping[str, _Word | None]) -> set[tuple[str, _Word | None]]:
    """(location, what the last symbol that `says` something said on a way there), for each way there is."""
    leaving: dict[str, list[tuple[str, str]]] = {}
    for edge in sha.edges:
        leaving.setdefault(edge.source, []).append((edge.symbol, edge.target))
    reached: set[tuple[str, _Word | None]] = {(sha.initial, None)}
    front = list(reached)
    for here, position in front:  # grows while it is walked
        new = {(target, says.get(symbol, position)) for symbol, target in leaving.get(here, ())} - reached
        reached |= new
        front += sorted(new, key=str)
    return reached
