"""The product automaton of an alphabet: one location for each combination of channel values, known or not.

Nothing is known at first ("?"), and UNKNOWN leads back there from everywhere. Each announcement fills in one channel,
so "W_ON then A_1" walks "?" -> "ON/?" -> "ON/100-200", and a plant that announces only one channel stays in "ON/?".
Names join the channels' labels with "/" in the alphabet's order: ON and OFF for a switch, "100-200" for a bin,
"300+" for the last one; the first bin is "0-100" when its threshold is positive and "<-5" otherwise.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import groupby, product
from types import MappingProxyType

from sim.sha import SHA, UNKNOWN, Alphabet, Bins, Edge, Flow, Location, Switch

ANY = "any"
"""What a channel is called that may have any of its values."""
Context = tuple[int | None, ...]
"""What is known of each channel: the index of its value among `labels`, or None."""

SWITCH_STEPS = 10
"""A switch in the other position counts as this many bins when the nearest seen location is looked for."""


class LearningError(ValueError):
    """The traces do not allow a model to be learned; the message is one sentence that says why."""


@lru_cache(maxsize=64)
def labels(channel: Switch | Bins) -> tuple[str, ...]:
    """The names of a channel's values: (OFF, ON) for a switch, one per bin for a level."""
    if isinstance(channel, Switch):
        return ("OFF", "ON")
    return tuple(_span(channel, value, value) for value in range(len(channel.thresholds) + 1))


def _span(channel: Bins, low: int, high: int) -> str:
    """The name of the bins from `low` to `high` together: "100-300", "200+"; "any" for all of them."""
    cuts = [f"{value:.12g}" for value in channel.thresholds]
    if low == 0 and high == len(cuts):
        return ANY
    if high == len(cuts):
        return f"{cuts[low - 1]}+"
    if low == 0:
        return f"0-{cuts[high]}" if channel.thresholds[0] > 0 else f"<{cuts[high]}"
    return f"{cuts[low - 1]}-{cuts[high]}"


def announcements(channel: Switch | Bins) -> tuple[str, ...]:
    """The symbols that announce the channel's values, in the order of `labels`."""
    return (channel.falling, channel.rising) if isinstance(channel, Switch) else channel.symbols


def location_name(context: Context, alphabet: Alphabet) -> str:
    """The location's name: "ON/200-300", "?/0-100"; "?" alone when no channel is known."""
    if all(value is None for value in context):
        return "?"
    parts = zip(context, alphabet.channels, strict=True)
    return "/".join("?" if value is None else labels(channel)[value] for value, channel in parts)


def shared_name(members: Sequence[Context], alphabet: Alphabet) -> str:
    """What contexts have in common, as a name: "ON/100-300" of two bins, "ON" where the level may be anything.

    Bins that do not lie side by side are joined by "|".
    """
    parts = [
        _shared_label(channel, {context[place] for context in members})
        for place, channel in enumerate(alphabet.channels)
    ]
    if set(parts) == {"?"}:
        return "?"
    return "/".join(part for part in parts if part != ANY) or ANY


def _shared_label(channel: Switch | Bins, values: set[int | None]) -> str:
    known = sorted(value for value in values if value is not None)
    if not known:
        return "?"
    if len(known) < len(values):
        return ANY
    if isinstance(channel, Switch):
        return labels(channel)[known[0]] if len(known) == 1 else ANY
    # A run of neighbours is one where the value less its rank is the same.
    runs = [[value for _, value in run] for _, run in groupby(enumerate(known), lambda pair: pair[1] - pair[0])]
    return "|".join(_span(channel, run[0], run[-1]) for run in runs)


@lru_cache(maxsize=16)
def contexts(alphabet: Alphabet) -> Mapping[str, Context]:
    """Every location's name and what is known in it; the wholly unknown one first."""
    choices = [(None, *range(len(labels(channel)))) for channel in alphabet.channels]
    return MappingProxyType({location_name(context, alphabet): context for context in product(*choices)})


@lru_cache(maxsize=16)
def edges(alphabet: Alphabet) -> tuple[Edge, ...]:
    """One edge for each location and symbol, UNKNOWN included: deterministic and input-enabled by construction."""
    moves: list[Edge] = []
    for name, context in contexts(alphabet).items():
        for place, channel in enumerate(alphabet.channels):
            for value, symbol in enumerate(announcements(channel)):
                after = (*context[:place], value, *context[place + 1 :])
                moves.append(Edge(name, symbol, location_name(after, alphabet)))
        moves.append(Edge(name, UNKNOWN, location_name((None,) * len(context), alphabet)))
    return tuple(moves)


def product_sha(alphabet: Alphabet, locations: Mapping[str, Location], name: str) -> SHA:
    """The product automaton with the given locations, one for each name of `contexts`."""
    return SHA(
        name=name,
        locations=tuple(locations[each] for each in contexts(alphabet)),
        edges=edges(alphabet),
        initial=location_name((None,) * len(alphabet.channels), alphabet),
    )


def bare_sha(alphabet: Alphabet, noise: float = 0.0) -> SHA:
    """The product automaton with nothing learned: constant flow everywhere."""
    flow = Flow("constant", {"noise": noise})
    return product_sha(alphabet, {name: Location(name, flow) for name in contexts(alphabet)}, "product")


def middle(channel: Bins, value: int) -> float:
    """The middle of a bin, in the signal's unit; an open end is taken as wide as the bin beside it.

    The first bin is closed at 0 when its threshold is positive.
    """
    cuts = channel.thresholds
    if not cuts:
        return 0.0
    width = cuts[0] if len(cuts) == 1 and cuts[0] > 0 else 0.0
    if value == 0:
        below = 0.0 if cuts[0] > 0 else cuts[0] - (cuts[1] - cuts[0] if len(cuts) > 1 else width)
        return (below + cuts[0]) / 2
    if value == len(cuts):
        return cuts[-1] + (cuts[-1] - cuts[-2] if len(cuts) > 1 else width) / 2
    return (cuts[value - 1] + cuts[value]) / 2


def reference(context: Context, alphabet: Alphabet, signal: str) -> float:
    """Where the input `signal` counts as zero in this location: the middle of its bin; 0 when that is not known."""
    for value, channel in zip(context, alphabet.channels, strict=True):
        if isinstance(channel, Bins) and channel.signal == signal and value is not None:
            return middle(channel, value)
    return 0.0


def distance(context: Context, other: Context, alphabet: Alphabet) -> int:
    """How far apart two locations are: bins count by their difference, a switch for ten bins, not knowing for one."""
    total = 0
    for a, b, channel in zip(context, other, alphabet.channels, strict=True):
        if a == b:
            continue
        if a is None or b is None:
            total += 1
        else:
            total += SWITCH_STEPS if isinstance(channel, Switch) else abs(a - b)
    return total


def nearest(context: Context, seen: Sequence[Context], alphabet: Alphabet) -> Context:
    """The seen location that is nearest; among equals the earlier one in the alphabet's order."""
    return min(seen, key=lambda other: (distance(context, other, alphabet), [-1 if v is None else v for v in other]))


def level_signals(alphabet: Alphabet) -> tuple[str, ...]:
    """The level signals of the alphabet, which are what a driven flow may follow."""
    return tuple(channel.signal for channel in alphabet.channels if isinstance(channel, Bins))
