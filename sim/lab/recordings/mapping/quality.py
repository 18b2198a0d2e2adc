"""Columns that say whether a reading is good: which they are, and which of their words say so."""

import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass

from sim.lab.recordings.mapping.answers import NONE, Answers, Undecided
from sim.lab.recordings.mapping.table import FoundTable

_NAMED = re.compile(
    r"quality|qualit(?:y|à|é|ät|aet)?$|qualität|calidad|(?:^|[._ ])q(?:ual|c)?$|opc.?status|g[üu]e?ltig|valid",
    re.IGNORECASE,
)
_GOOD = re.compile(
    r"good\b.*|ok|valid|gut|gültig|buon[oa]|valid[oae]|bon(?:ne)?|buen[oa]|true|(?:0x0*)?c0|192(?:\.0+)?|\(?192\)?.*",
    re.IGNORECASE,
)
"""Words of good readings; 192 (hexadecimal C0) is OPC's."""
_MOST_WORDS = 30
"""Words that a quality may have: more are notes or readings."""


@dataclass(frozen=True, slots=True)
class FoundQuality:
    """Places of the columns that say it, and the words of good readings; `said` is what was concluded."""

    places: tuple[int, ...] = ()
    good: tuple[str, ...] = ()
    said: str = ""


def quality_of(table: FoundTable, taken: Collection[int | None], answers: Answers) -> FoundQuality:
    """What the table says of its readings' quality.

    Raises Undecided where no word of it is known.
    """
    words = {
        place: Counter(filter(None, table.column(place)))
        for place, name in enumerate(table.header)
        if place not in taken and _NAMED.search(name)
    }
    # One that stands in rows of its own, as in a file beside, says nothing of the others.
    least = len(table.rows) / 2
    places = tuple(place for place, own in words.items() if 0 < len(own) <= _MOST_WORDS and own.total() >= least)
    every = sum((words[place] for place in places), Counter[str]())
    if not places or answers.good == (NONE,):
        return FoundQuality()
    good = tuple(word for word in every if word in answers.good or (not answers.good and _GOOD.fullmatch(word)))
    if not good and len(every) > 1:
        raise Undecided(
            table.path,
            f"words of {table.header[places[0]]!r} that may mean a good reading",
            "good",
            [*every, NONE],
            guess=every.most_common(1)[0][0],
        )
    bad = every.total() - sum(every[word] for word in good)
    others = ", ".join(f"{count} x {word!r}" for word, count in every.most_common(8) if word not in good)
    said = (
        f"{bad} readings are not of a good quality ({others}): the map's quality refuses them" if bad and good else ""
    )
    return FoundQuality(places, good, said) if good else FoundQuality()
