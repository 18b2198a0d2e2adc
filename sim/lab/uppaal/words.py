"""Names for what an export declares: none is a word of UPPAAL's, none is used twice."""

from collections.abc import Iterable, Mapping

from sim.lab.checking.query import RESERVED_WORDS, identifiers

OWN = frozenset(
    [
        "Machine",
        "Player",
        "Inputs",
        "Environment",
        "i_1",
        "N_E",
        "EVENTS",
        "EVENT_TIMES",
        "next_i",
        "N_R",
        "READING_TIMES",
        "next_r",
        "Choose",
        "Wait",
        "Done",
        "N_L",
        "CUMULATIVE",
        "here",
        "stay",
        "u",
        "next",
    ]
)
"""What every exported model declares under these names."""


class FreshNames:
    """Gives each thing an identifier of its own; `fresh` remembers what it gave."""

    def __init__(self, locations: Iterable[str]) -> None:
        self.locations: Mapping[str, str] = identifiers(list(locations))
        self._taken = {*RESERVED_WORDS, *OWN, *self.locations.values()}

    def fresh(self, base: str) -> str:
        """`base`, or `base_2`, `base_3` ... where it is taken. `base` must be letters, digits and underscores."""
        candidate, count = base, 1
        while candidate in self._taken:
            count += 1
            candidate = f"{base}_{count}"
        self._taken.add(candidate)
        return candidate


def spell_names(names: Iterable[str]) -> Mapping[str, str]:
    """Any names as bases of identifiers (letters, digits, underscores), one to one."""
    return identifiers(list(names))
