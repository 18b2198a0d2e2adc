"""Columns that say whether a reading is good: which they are, and which of their words say so."""

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from sim.lab.recordings import UNNAMED_COLUMN, TraceError, list_names, named_after
from sim.lab.recordings.mapping.answer_words import BLANK_IS_GOOD, NO_COLUMN
from sim.lab.recordings.mapping.answers import Answers, Undecided
from sim.lab.recordings.mapping.table import FoundTable, has_numbers
from sim.lab.recordings.mapping.words import named_value

_NAMED = re.compile(
    r"quality|qualit(?:y|à|é|ät|aet)?$|qualität|calidad|(?:^|[._ ])q(?:ual|c)?(?:_\d+)?$|opc.?status|integrity|"
    r"g[üu]e?ltig|valid",
    re.IGNORECASE,
)
_GOOD = re.compile(
    r"good\b.*|ok|valid|gut|gültig|buon[oa]|valid[oae]|bon(?:ne)?|buen[oa]|true|(?:0x0*)?c0|0x0{8}|192(?:\.0+)?|\(?192\)?.*",
    re.IGNORECASE,
)
"""Words of good readings; 192 (hexadecimal C0) is OPC's."""
_SAYS_VALID, _YES = re.compile(r"g[üu]e?ltig|valid", re.IGNORECASE), re.compile(r"1(?:\.0+)?|yes|ja|s[iì]|oui", re.I)
"""A column that is called valid, and what is a yes there; of a quality 1 may mean anything."""
_BAD = re.compile(
    r"(?:bad|uncertain|invalid|not|no|non|error|fault|fail|timeout|stale|unknown|schlecht|ung[üu]e?ltig|unsicher|fehler"
    r"|cattiv[oa]|incert[oa]|errore|guast[oa]|mauvaise?|incertaine?|erreur|mal[oa]|inv[aá]lid[oa]|inciert[oa])\b.*"
    r"|bad_.*|uncertain_.*|false|(?:0x)?0+(?:\.0+)?|0x[48][0-9a-f]{7}",
    re.IGNORECASE,
)
"""Words that are never taken for good ones unless a person says so."""
_OPC_GOOD, _ZERO = re.compile(r"(?:0x0*)?c0|192(?:\.0+)?", re.IGNORECASE), re.compile(r"0+(?:\.0+)?")
_STATUS = re.compile(r"status(?:.?code)?(?:_\d+)?$", re.IGNORECASE)
_TOLD = re.compile(
    r"\{?(?:good|ok|bad|uncertain|gut|schlecht|unsicher|valid|invalid|stale)\b.*|0x[048][0-9a-f]{7}", re.IGNORECASE
)
"""Words of a status that is a quality, and not that of a machine."""
_MAX_QUALITY_WORDS = 30
"""Words that a quality may have: more are notes or readings."""


@dataclass(frozen=True, slots=True)
class FoundQuality:
    """Places of the columns that say it, and the words of good readings; `said` is what was concluded."""

    places: tuple[int, ...] = ()
    good: tuple[str, ...] = ()
    said: str = ""


def find_quality(
    table: FoundTable, taken: Collection[int | None], answers: Answers, *, value: int | None = None
) -> FoundQuality:
    """What the table says of its readings' quality; `value` is the place of the readings in a file with one a row.

    Raises Undecided where no word of it is known, where most readings have none, and where it stands in rows without
    readings; TraceError for a word of good readings that none of its columns has.
    """
    if answers.good == (NO_COLUMN,):
        return FoundQuality()
    words = {
        place: Counter(filter(None, table.column(place)))
        for place in range(len(table.header))
        if place not in taken and is_quality(table, place)
    }
    named = [place for place, own in words.items() if 0 < len(own) <= _MAX_QUALITY_WORDS]
    readings = [value] if value is not None else []
    if value is None:
        # What a person notes has no reading whose quality could be said.
        others = [
            place
            for place, name in enumerate(table.header)
            if place not in taken and place not in named and name != UNNAMED_COLUMN
        ]
        readings = [place for place in others if has_numbers(table, place)] or others
    beside = {place: _neighbour_cells(table, place, named, readings) for place in named}
    # One that stands in rows of its own, as in a file beside, says nothing of the others.
    places = tuple(place for place in named if any(beside[place]))
    if not places:
        places = tuple(_of_other_files(table, named, readings))
        beside |= {place: [cell for cell in table.column(place) if cell] for place in places}
    apart = [table.header[place] for place in named if place not in places]
    if apart and not places:
        raise Undecided(
            table.path,
            f"{apart[0]!r} stands in rows without readings, so that it says of none how good it is; export it beside "
            "the readings that it is of, or read them all as good",
            "good",
            [NO_COLUMN],
        )
    wanted = {word.casefold() for word in answers.good if word != BLANK_IS_GOOD}
    every = sum((words[place] for place in places), Counter[str]())
    if answers.good and (not places or (wanted and not wanted & {word.casefold() for word in every})):
        of = (
            f"the words of {table.header[places[0]]!r} are {list_names(every)}"
            if places
            else "no column says a quality"
        )
        raise TraceError(
            f"{table.path}: {answers.good[0]!r} was given as a word of good readings, and {of}; give one that stands "
            "there, or leave it out"
        )
    if not places:
        return FoundQuality()
    if value is not None and not answers.good:
        places = _telling(table, places, words)
        every = sum((words[place] for place in places), Counter[str]())
    cells = sum((Counter(beside[place]) for place in places), Counter[str]())
    valid = {word for place in places if _SAYS_VALID.search(table.header[place]) for word in words[place]}
    known = {word for word in every if _GOOD.fullmatch(word) or (word in valid and _YES.fullmatch(word))}
    good = [word for word in every if (word.casefold() in wanted if wanted else word in known)]
    mostly_blank = 2 * cells[""] > cells.total()
    if not answers.good and (not good or mostly_blank):
        first, (common, _) = table.header[places[0]], every.most_common(1)[0]
        likely = (BLANK_IS_GOOD if not good else "") if mostly_blank else "" if _BAD.fullmatch(common) else common
        blank = f" (it is blank beside {cells['']} of {cells.total()} readings)" if cells[""] else ""
        choices = [*every, *([BLANK_IS_GOOD] if cells[""] else []), NO_COLUMN]
        raise Undecided(
            table.path, f"words of {first!r} that may mean a good reading{blank}", "good", choices, guess=likely
        )
    good += [""] if BLANK_IS_GOOD in answers.good else []
    bad = Counter({word: count for word, count in cells.items() if word not in good})
    refused = ", ".join(f"{count} x {word!r}" if word else f"{count} x blank" for word, count in bad.most_common(8))
    said = (
        f"{bad.total()} readings are not of a good quality ({refused}): the map's quality refuses them" if bad else ""
    )
    if apart:
        said += f"{'; ' if said else ''}{list_names(map(repr, apart))} stand in rows without readings and are not used"
    return FoundQuality(places, tuple(good), said)


def is_quality(table: FoundTable, place: int) -> bool:
    """Whether a column is called after a quality, or is a status that says nothing but how good readings are."""
    said_by = [table.header[place], table.titles[place]]
    if table.files and named_value(table.header[place]):
        said_by.append(table.files[place])  # a column Value says what it is by its file's name
    if any(map(_NAMED.search, said_by)):
        return True
    if _STATUS.search(table.header[place]) is None:
        return False
    words = {cell.casefold() for cell in table.column(place) if cell}
    return bool(words) and all(map(_TOLD.fullmatch, words))


def _telling(table: FoundTable, places: tuple[int, ...], words: Mapping[int, Counter[str]]) -> tuple[int, ...]:
    """Of several columns that judge the same reading those whose words are known, where the others say nothing more.

    Those say one word, which is no bad one, of all readings that are good by the known ones; 0 is none beside OPC's
    192: Quality 0 beside OPCQuality 192.
    """
    telling = tuple(place for place in places if any(map(_GOOD.fullmatch, words[place])))
    good = [row for row in table.rows if all(_GOOD.fullmatch(row[place]) for place in telling)]
    of_opc = all(_OPC_GOOD.fullmatch(word) for place in telling for word in words[place] if _GOOD.fullmatch(word))
    for place in set(places) - set(telling):
        said = {row[place] for row in good}
        if len(said) != 1 or any(_BAD.fullmatch(word) and not (of_opc and _ZERO.fullmatch(word)) for word in said):
            return places
    return telling or places


def _of_other_files(table: FoundTable, named: Sequence[int], readings: Sequence[int]) -> list[int]:
    """The qualities that are files of their own: the one of all others, or one of each, which it is named after."""
    files = Counter(file for file, name in zip(table.files, table.header, strict=False) if name != UNNAMED_COLUMN)
    judged = {table.files[place] for place in readings} if table.files else set()
    alone = [place for place in named if table.files and table.files[place] and files[table.files[place]] == 1]
    owners = [named_after(table.files[place], judged - {""}) for place in alone]
    if owners == [""] or (owners and judged == set(owners) and len(owners) == len(judged)):
        return alone
    return []


def _neighbour_cells(table: FoundTable, place: int, named: Sequence[int], readings: Sequence[int]) -> list[str]:
    """The cells of a quality in the rows that have one of the readings that it is of: those since the quality before.

    The last one is of those after it as well.
    """
    before = max((each for each in named if each < place), default=-1)
    until = place if place < max(named) else len(table.header)
    own = [each for each in readings if before < each < until] or list(readings)
    return [row[place] for row in table.rows if any(row[each] for each in own)]
