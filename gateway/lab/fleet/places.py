"""Groups of locations in plant words: `running`, `at rest`, `running at 200-300 A`."""

from collections.abc import Mapping

from sim.learning import first_switch, labels, target_groups
from sim.sha import Alphabet


def place_words(alphabet: Alphabet, units: Mapping[str, str]) -> dict[str, str]:
    """The words of each group of `target_groups`; `units` are those of the signals, by name."""
    switch = first_switch(alphabet)
    off, on = ("", "") if switch is None else labels(switch)
    words = {}
    for group in target_groups(alphabet):
        parts = []
        for channel, label in zip(alphabet.channels, group.split("/"), strict=False):
            if channel is switch or group in (off, on):
                parts.append("at rest" if label == off else "running")
            else:
                unit = units.get(channel.signal, "")
                parts.append(f"at {label} {unit}" if unit else f"at {channel.signal} {label}")
        words[group] = " ".join(parts)
    return words
