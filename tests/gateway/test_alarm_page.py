"""`docs/alarms.md` and its drawing say what the tables say, no more and no less."""

import xml.etree.ElementTree as ET

from gateway.machine.alarms import HIDDEN, LETTERS, TRANSITIONS, AlarmState, diagram
from gateway.settings import ALARM_KINDS
from gateway.settings.alarm_kinds import AlarmRow
from gateway.settings.config import AlarmSection
from tests.rig.alarm_page import MADE, PAGE, PICTURE, made


def test_the_page_and_its_drawing_are_made_from_the_tables_of_today() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"<!-- made: {name} -->" in page for name in MADE)
    assert page == made(page), "python -m tests.rig.alarm_page"
    assert PICTURE.read_text(encoding="utf-8") == diagram(), "python -m tests.rig.alarm_page"


def test_the_drawing_has_every_state_and_every_change() -> None:
    texts = {element.text for element in ET.fromstring(diagram()).iter() if element.tag.endswith("text")}  # noqa: S314
    assert {f"{LETTERS[state]} {state}" for state in AlarmState} <= texts
    words = {word for text in texts for label in str(text).split(" / ") for word in [label.partition(",")[0]]}
    assert {row.change.value for row in TRANSITIONS} <= words
    arrows = [element for element in ET.fromstring(diagram()).iter() if element.get("marker-end")]  # noqa: S314
    among = {(row.source, row.target) for row in TRANSITIONS if (row.source in HIDDEN) == (row.target in HIDDEN)}
    assert len(arrows) == len({pair for pair in among if pair[0] is not pair[1]}) + 2 * len(HIDDEN)


def test_every_key_and_every_kind_is_on_the_page() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for key in (*AlarmRow.model_fields, *AlarmSection.model_fields):
        assert f"`{key}`" in page or f"\n    {key} = " in page, key
    for kind in ALARM_KINDS.values():
        assert kind.response and kind.consequence and kind.watches
