"""Groups of locations in plant words: `running`, `at rest`, `running at 200-300 A`."""

from collections.abc import Mapping

from sim.lab.learning import contexts, first_switch, labels, target_groups
from sim.sha import Alphabet


def place_words(alphabet: Alphabet, units: Mapping[str, str]) -> dict[str, str]:
    """The words of each group of `target_groups`; `units` are those of the signals, by name."""
    switch, known = first_switch(alphabet), contexts(alphabet)
    words = {} if switch is None else dict(zip(labels(switch), ("at rest", "running"), strict=True))
    for group in target_groups(alphabet):
        if group in words:
            continue
        parts = []
        for channel, value in zip(alphabet.channels, known[group], strict=True):
            if channel is switch:
                parts.append("running")  # a location of its own is one in which the machine runs
            elif value is not None:
                unit, label = units.get(channel.signal, ""), labels(channel)[value]
                parts.append(f"at {label} {unit}" if unit else f"at {channel.signal} {label}")
        words[group] = " ".join(parts)
    return words
