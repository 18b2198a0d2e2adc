"""Every word that a browser shows: a key, and its text in each language. Most stand in one table (`texts.toml`)."""

import re
import tomllib
from collections.abc import Mapping
from functools import cache
from math import isclose
from pathlib import Path

from gateway.settings import ALARM_KINDS
from sim.phrase import translate

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
