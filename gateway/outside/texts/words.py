"""Every word that a browser shows: a key, and its text in each language. Most stand in one table (`texts.toml`)."""

import re
import tomllib
from collections.abc import Mapping
from functools import cache, lru_cache
from math import isclose
from pathlib import Path

from gateway.settings import ALARM_KINDS
from sim.phrase import translate

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_FIGURE = re.compile(rf"{_NUMBER.pattern}(?: [^ .;:,()]+)?")
_PARTS = {
    **dict.fromkeys(("time", "late", "code", "count"), _NUMBER.pattern),
    **dict.fromkeys(("value", "limit", "step"), _FIGURE.pattern),
    "number": rf"{_NUMBER.pattern}|-?inf|nan",
}
"""What stands in a driver's sentence in the place of this name; of any other name it is any text."""
LONGEST_REASON = 400
"""Letters of a sentence that is put into words."""
LANGUAGES = ("en", "it", "de")
"""The first one is what a browser gets that asks for none of them."""


class Words:
    """The texts of one language by their keys (`section.name`)."""

    def __init__(self, language: str, texts: Mapping[str, str]) -> None:
        self.language, self.texts = language, texts

    def say(self, key: str, **parts: object) -> str:
        """The text with its parts in their places. Raises KeyError for a key or a part that is not there."""
        return self.texts[key].format_map(parts)

    def of_code(self, key: str) -> str:
        """The text of a code such as a quality (`section.code`); the code itself where there is none."""
        return self.texts.get(key.replace(" ", "_"), key.partition(".")[2])

    def reason(self, sentence: str) -> str:
        """A driver's sentence on why something is not read, in this language; "" for one that has no words in it."""
        return sentence if self.language == LANGUAGES[0] else _worded(self.language, sentence)

    def by_whom(self, who: str) -> str:
        """Who did something, a name and the address that it was done from: one word behind the last `at`."""
        found = re.fullmatch(r"(.*) at (\S+)", who)
        return self.say("word.by_at", name=found[1], place=found[2]) if found else who

    def number(self, value: float, digits: int) -> str:
        """A number as this language writes it: the decimal sign is its own."""
        text = f"{value:.{digits}f}"
        return text if self.language == "en" else text.replace(".", ",")

    def minutes(self, seconds: float) -> str:
        """Seconds of a horizon in minutes, which need not be whole ones: 90 s are 1.5."""
        minutes = seconds / 60.0
        return self.number(minutes, next((digits for digits in (0, 1) if isclose(round(minutes, digits), minutes)), 2))


@lru_cache(maxsize=256)
def _worded(language: str, sentence: str) -> str:
    # The readings of one request that failed say the same: it is looked for once. No driver's own is longer than that.
    if len(sentence) > LONGEST_REASON:
        return ""
    for key, pattern in _reason_patterns():
        if (found := pattern.fullmatch(sentence)) is None:
            continue
        parts = {
            name: part.replace(".", ",", 1) if _FIGURE.fullmatch(part) else part
            for name, part in found.groupdict().items()
        }
        if "reason" in parts:
            parts["reason"] = _worded(language, found["reason"])
        if parts.get("reason") != "":
            return all_words()[language].say(f"reason.{key}", **parts)
    return ""


@cache
def _reason_patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    """What a driver says, as patterns of its English sentences by their keys.

    One that holds another sentence is tried before it: those that begin with words of their own first, of these the
    longest, which says most.
    """
    texts = all_words()[LANGUAGES[0]].texts
    own = {key.removeprefix("reason."): text for key, text in texts.items() if key.startswith("reason.")}

    def place(text: str) -> tuple[bool, int]:
        return text.startswith("{") and not text.startswith("{time}"), -len(text)

    return tuple(
        (key, re.compile(re.sub(r"\\\{(\w+)\\\}", _any_part, re.escape(text))))
        for key, text in sorted(own.items(), key=lambda one: place(one[1]))
    )


def _any_part(place: re.Match[str]) -> str:
    # A number is a number, and no hint behind it: a sentence of another kind is not cut to fit.
    return rf"(?P<{place[1]}>{_PARTS.get(place[1], '.+?')})"


@cache
def all_words() -> dict[str, Words]:
    """The words of every language."""
    table = tomllib.loads((Path(__file__).parent / "texts.toml").read_text(encoding="utf-8"))
    own = _own_words()
    return {
        language: Words(
            language,
            {f"{section}.{key}": rows[language] for section, keys in table.items() for key, rows in keys.items()}
            | {key: translate(language, text) for key, text in own.items()},
        )
        for language in LANGUAGES
    }


def _own_words() -> dict[str, str]:
    """The texts that stand beside what they speak of, by their keys."""
    # Here: a gateway that neither has a model nor serves a page says nothing of effects.
    from sim.effects import EFFECTS

    kinds = {name.replace(" ", "_"): kind for name, kind in ALARM_KINDS.items()}
    named = {name: (kind, kind.candidate) for name, kind in EFFECTS.items() if kind.candidate is not None}
    return {
        **{f"kind.{key}": kind.title for key, kind in kinds.items()},
        **{f"past.{key}": kind.past for key, kind in kinds.items()},
        **{f"response.{key}": kind.response for key, kind in kinds.items()},
        **{f"consequence.{key}": kind.consequence for key, kind in kinds.items()},
        **{f"effect.{name}": kind.meaning for name, (kind, _) in named.items()},
        **{f"experiment.{name}": candidate.experiment for name, (_, candidate) in named.items()},
    }


def preferred_language(accepted: str) -> str:
    """The language of an `Accept-Language` header: ours that has the greatest weight (RFC 9110, 12.5.4)."""
    weighted = []
    for place, part in enumerate(accepted[:500].split(",")):
        match = re.fullmatch(r"\s*([A-Za-z]{1,8})(?:-[A-Za-z0-9-]*)?\s*(?:;\s*q=([01](?:\.[0-9]{0,3})?)\s*)?", part)
        if match and match[1].lower() in LANGUAGES:
            weighted.append((-float(match[2] or 1), place, match[1].lower()))
    return min(weighted)[2] if weighted else LANGUAGES[0]
