"""A DBC file's statements, and which of them keep the rest from being read.

A slip in one message costs that one. What belongs to a message (its signals, values, comments, attributes) is one part;
parts are left out until the others are read, first what is said of a message, then signals of it, then the message.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

_BEGINS = re.compile(
    r"(?:VERSION|NS_|BS_|BU_|BO_|BO_TX_BU_|EV_|ENVVAR_DATA_|EV_DATA_|SGTYPE_|SIGTYPE_VALTYPE_|CM_|BA_DEF_|BA_DEF_DEF_|BA_"
    r"|BA_DEF_REL_|BA_REL_|BA_DEF_DEF_REL_|BA_SGTYPE_|VAL_|VAL_TABLE_|SIG_GROUP_|SIG_VALTYPE_|SIG_TYPE_REF_|SG_MUL_VAL_|CAT_"
    r"|CAT_DEF_|FILTER|BU_SG_REL_|BU_EV_REL_|BU_BO_REL_)(?=[\s:]|$)"
)
_OF_A_MESSAGE = re.compile(
    r"(?:BO_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_|BO_TX_BU_|CM_\s+(?:BO_|SG_)|BA_\s+\"[^\"]*\"\s+(?:BO_|SG_))\s+(\d+)(?!\w)"
)
_DECIDES = re.compile(
    r"SIG_VALTYPE_\s|SG_MUL_VAL_\s|BA_\s+\"(?:E2E[^\"]*|VFrameFormat)\"\s|SG_\s+\S+\s+(?:M|m\d+M?)\s*:"
)
"""What says how other signals of its message are decoded, or when: without it they would be read wrongly."""
_MOST_TRIALS = 400
"""Readings of parts of a file, each of a part only; a file with more slips than that finds is refused whole."""
_END = '\nCM_ "";\n'
"""What a part of a file ends with, so that a statement without an end shows."""
_SHOWN = 70


@dataclass(frozen=True, slots=True)
class DbcStatement:
    """A statement, or a signal's line in one: its text, its line in the file (1..), the message that it is of."""

    text: str
    line: int
    message: int | None
    reason: str = ""

    def __str__(self) -> str:
        first = " ".join(self.text.split())
        return f"line {self.line}: {first[:_SHOWN]}{'...' if len(first) > _SHOWN else ''} is left out ({self.reason})"


def statements(text: str) -> list[DbcStatement]:
    """The file's statements in their order; a signal is one of its own, after its message."""
    found: list[list[str]] = []
    lines: list[int] = []
    inside = listing = False
    for number, line in enumerate(text.splitlines(keepends=True), start=1):
        plain = line.strip()
        begins = not inside and _BEGINS.match(plain) is not None
        # The list of keywords behind NS_ is none of statements; BS_ ends it.
        listing = plain.startswith("NS_") if begins and plain.startswith(("NS_", "BS_")) else listing
        if (
            not found
            or (begins and (not listing or plain.startswith("NS_")))
            or (not inside and plain.startswith("SG_ "))
        ):
            found.append([])
            lines.append(number)
        found[-1].append(line)
        inside ^= len(re.findall(r'(?<!\\)"', line)) % 2 == 1
    parts: list[DbcStatement] = []
    message: int | None = None
    for chunk, number in zip(found, lines, strict=True):
        statement = "".join(chunk)
        if not statement.lstrip().startswith("SG_ "):
            match = _OF_A_MESSAGE.match(statement.lstrip())
            message = int(match[1]) if match else None
        parts.append(DbcStatement(statement, number, message))
    return parts


def spell_numbers(text: str) -> str:
    """Numbers as DBC has them: `.25` of a signal is 0.25."""
    return re.sub(r"(?m)^(\s*SG_ .*)$", lambda line: re.sub(r"([(,|\[]-?)\.(?=\d)", r"\g<1>0.", line[1]), text)


def readable(text: str, problem_of: Callable[[str], str]) -> tuple[str, list[DbcStatement]]:
    """The text without what keeps it from being read, and what that is; "" where nothing helps.

    `problem_of` says of a text why it cannot be read, "" where it can. Lines keep their numbers.
    """
    parts = statements(text)
    trials, reason = 0, ""
    reasons: dict[int, str] = {}

    def good(kept: Iterable[DbcStatement]) -> bool:
        nonlocal trials, reason
        trials += 1
        reason = problem_of(_join_statements(kept) + _END) if trials <= _MOST_TRIALS else "the file has too many slips"
        return not reason

    def search(base: list[DbcStatement], groups: Sequence[list[DbcStatement]]) -> list[DbcStatement]:
        """What of these groups is read together with the base."""
        together = [part for group in groups for part in group]
        if not groups or good(base + together):
            return together
        if len(groups) > 1:
            half = len(groups) // 2
            return search(base, groups[:half]) + search(base, groups[half:])
        reasons.update(dict.fromkeys((part.line for part in together), reason))
        if len(together) == 1:
            return []
        # One message: its own statement and all signals at first, then what is said of them, then its signals.
        own = [part for part in together if part.text.lstrip().startswith(("BO_ ", "SG_ "))]
        if own and good(base + own):
            said = [part for part in together if part not in own]
            return own + search(base + own, [[part] for part in said])
        signals = [part for part in own if part.text.lstrip().startswith("SG_ ")]
        heads = [part for part in own if part not in signals]
        if heads and signals and good(base + heads):
            kept = heads + search(base + heads, [[part] for part in signals])
            return kept + search(base + kept, [[part] for part in together if part not in own])
        return []

    common = search([], [[part] for part in parts if part.message is None])
    ordered = sorted((part for part in parts if part.message is not None), key=lambda part: part.message or 0)
    groups = [list(group) for _, group in groupby(ordered, key=lambda part: part.message)]
    kept = {part.line for part in (*common, *search(common, groups))}
    left = [
        replace(part, reason=reasons.get(part.line, ""))
        for part in parts
        if part.line not in kept and part.text.strip()
    ]
    decided = {part.message: part.line for part in left if _DECIDES.match(part.text.lstrip())}
    if decided.keys() - {part.message for part in parts if part.text.lstrip().startswith("BO_ ")}:
        # Nobody knows which message it would have told how to be decoded.
        return "", left
    whole = [part for part in parts if part.message in decided and part.line in kept]
    kept -= {part.line for part in whole}
    left += [
        replace(part, reason=f"line {decided[part.message]}, by which it is decoded, cannot be read")
        for part in whole
        if part.text.lstrip().startswith("BO_ ")
    ]
    left.sort(key=lambda part: part.line)
    lost = {part.message for part in left if part.text.lstrip().startswith("BO_ ")}
    # With a message goes all that is said of it.
    left = [part for part in left if part.message not in lost or part.text.lstrip().startswith("BO_ ")]
    return ("" if trials > _MOST_TRIALS else _join_statements(part for part in parts if part.line in kept)), left


def _join_statements(parts: Iterable[DbcStatement]) -> str:
    """The statements in their lines."""
    text, line = "", 1
    for part in sorted(parts, key=lambda part: part.line):
        text += "\n" * (part.line - line) + part.text
        line = part.line + part.text.count("\n")
    return text
