"""`verdict.json` of a model: whether it may be used, said once where it was made, by a table of criteria."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Literal, get_args

from sim.files import file_error, read_text
from sim.strict_json import json_text

VERDICT_FILE = "verdict.json"
FORMAT, VERSION = "decanter-verdict", 1

FORECAST_CRITERION = "forecast"
"""The criterion of what a model foresaw unseen, beside persistence."""

Word = Literal["fit", "limited", "unfit", "not known"]
"""May this model be used: yes; yes, where what is not known does not matter; no; nobody can say yet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedCriterion:
    """One criterion of a verdict: kept, not kept, or None where it limits the model or is not known.

    `sentence` says by which figure, `next_step` what to do about one that is not kept ("" for one that is).
    """

    criterion: str
    kept: bool | None
    sentence: str
    next_step: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ForeseenUnit:
    """The mean CRPS (in the model's unit) of a cycle or day; `moments` names the forecasts that it is the mean of."""

    crps: float
    moments: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ForeseenHorizon:
    """What was held out at a `horizon` (s), by cycle, or day, of each recording."""

    horizon: float
    units: Mapping[str, ForeseenUnit]


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelVerdict:
    """The `word`, all criteria behind it, and the figures by which another version is held against it."""

    word: Word
    criteria: tuple[JudgedCriterion, ...]
    foreseen: tuple[ForeseenHorizon, ...] = ()

    @property
    def reasons(self) -> tuple[JudgedCriterion, ...]:
        """The gravest criteria: those that are not kept, else those that limit it; of a fit one its forecast's."""
        for kept in (False, None):
            if found := tuple(each for each in self.criteria if each.kept is kept):
                return found
        return tuple(each for each in self.criteria if each.criterion == FORECAST_CRITERION)

    @property
    def why(self) -> str:
        """The reasons, and what to do next."""
        reasons = "; ".join(each.sentence for each in self.reasons)
        steps = "; ".join(dict.fromkeys(each.next_step for each in self.reasons if each.next_step))
        return f"{reasons}{f'; next: {steps}' if steps else ''}"

    @property
    def sentence(self) -> str:
        """The word with its reasons and what to do next."""
        return f"{self.word}{': ' if self.why else ''}{self.why}"

    def plain(self) -> dict[str, Any]:
        """As JSON carries it, without the file's head."""
        return asdict(self)

    def as_command_json(self) -> dict[str, Any]:
        """As a command tells it: with its sentence."""
        return {**self.plain(), "sentence": self.sentence}

    def text(self) -> str:
        """The file's content."""
        return json_text({"format": FORMAT, "version": VERSION, **self.plain()}, indent=1) + "\n"


NO_VERDICT_TEXT = (
    "not judged where it was made: `decanter model judge validation` or `judge skill` say what it foresees"
)
"""What there is to say of a model without a verdict."""


def rate_criteria(criteria: Sequence[JudgedCriterion], *, told: bool) -> Word:
    """ "unfit" when one is not kept; else "not known" where nothing was `told` of forecasts; else "limited"
    when one could not be looked at or limits it, else "fit"."""
    kept = {each.kept for each in criteria}
    if False in kept:
        return "unfit"
    return "not known" if not told else "limited" if None in kept else "fit"


def read_verdict(folder: Path) -> ModelVerdict | None:
    """That of the model in `folder`; None where it has none. Raises ArtefactError for one that cannot be used."""
    file = folder / VERDICT_FILE
    if not file.is_file():
        return None
    text = read_text(file)
    try:
        document: dict[str, Any] = json.loads(text)
        if document["format"] != FORMAT or document["version"] != VERSION:
            raise ValueError("it is of another format")
        if document["word"] not in get_args(Word):
            raise ValueError(f"{document['word']!r} is no verdict")
        return ModelVerdict(
            word=document["word"],
            criteria=tuple(_criterion(each) for each in document["criteria"]),
            # A verdict of a former release keeps no figures.
            foreseen=tuple(_foreseen_horizon(each) for each in document.get("foreseen", ())),
        )
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError) as error:
        raise file_error(
            file, None, f"cannot be used as a verdict ({str(error)[:80]}); learn the model again"
        ) from None


def _criterion(plain: Mapping[str, Any]) -> JudgedCriterion:
    if plain["kept"] not in (True, False, None):
        raise ValueError(f"{plain['kept']!r} says nothing of a criterion")
    texts = {name: str(plain[name]) for name in ("criterion", "sentence", "next_step")}
    return JudgedCriterion(kept=plain["kept"], **texts)


def _foreseen_horizon(plain: Mapping[str, Any]) -> ForeseenHorizon:
    units = {
        str(name): ForeseenUnit(crps=float(unit["crps"]), moments=str(unit["moments"]))
        for name, unit in plain["units"].items()
    }
    horizon = float(plain["horizon"])
    if not all(isfinite(value) and value >= 0 for value in (horizon, *(unit.crps for unit in units.values()))):
        raise ValueError("a figure of what it foresaw is no number of at least 0")
    return ForeseenHorizon(horizon=horizon, units=units)
