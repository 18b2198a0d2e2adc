"""A kind of alarm is one complete object: what is missing in it cannot be constructed, all else is made from it."""

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import pytest

from gateway.outside.texts import LANGUAGES, all_words
from gateway.settings import ALARM_KINDS, AlarmKind
from gateway.settings.alarm_kinds import always, flag_value, yes_or_no
from sim.phrase import Phrase
from tests.gateway.support import config_in
from tests.gateway.test_alarm_desk import QUICK, standing
from tests.rig.alarm_page import kind_table

TOY: dict[str, Any] = {
    "subject": "machine",
    "title": Phrase("toy", it="gioco", de="Spiel"),
    "past": Phrase("it was a toy", it="era un gioco", de="es war ein Spiel"),
    "watches": "whether the clock stands",
    "response": Phrase("wind it up", it="caricarlo", de="aufziehen"),
    "consequence": Phrase("it stops", it="si ferma", de="sie bleibt stehen"),
    "applies": always,
    "limit": yes_or_no,
    "finding": lambda signs: flag_value(signs.good("AcknowledgeBits") == 0),
}


def test_it_can_be_had() -> None:
    assert AlarmKind(**TOY).priority == 2


@pytest.mark.parametrize("name", [field.name for field in fields(AlarmKind) if field.default is MISSING])
def test_one_without_a_part_cannot_be_had(name: str) -> None:
    with pytest.raises(TypeError, match=name):
        AlarmKind(**{key: part for key, part in TOY.items() if key != name})


@pytest.mark.parametrize(
    "part",
    [
        {"title": Phrase("toy", it="gioco")},
        {"response": Phrase("wind it up")},
        {"past": Phrase("it was a toy", it="era un gioco")},
        {"watches": ""},
        {"consequence": Phrase("it stops")},
        {"finding": None},
        {"subject": "watched"},
        {"subject": "predicted"},
    ],
)
def test_one_whose_parts_do_not_fit_cannot_be_had(part: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="the kind of alarm 'toy'"):
        AlarmKind(**{**TOY, **part})


async def test_a_row_is_all_that_an_alarm_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ALARM_KINDS, "toy", AlarmKind(**TOY))  # type: ignore[arg-type]
    row = '[[alarm]]\nname = "toy"\npriority = 4\n'
    async with standing(config_in(tmp_path, QUICK + row)) as stand:
        await stand.scan()
        assert stand.state("toy") == "unacknowledged" and stand.machine.alarms.alarms["toy"].priority == 4
    words = all_words.__wrapped__()
    assert [words[language].say("kind.toy") for language in LANGUAGES] == ["toy", "gioco", "Spiel"]
    assert [words[language].say("response.toy") for language in LANGUAGES] == ["wind it up", "caricarlo", "aufziehen"]
    assert "| `toy` | machine | 2 |" in kind_table()
