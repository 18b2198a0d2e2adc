"""docs/effects.md: its table against the program's, and what adds a row followed literally."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gateway.outside.texts import LANGUAGES, all_words
from sim.effects import heating, kind
from sim.effects.kinds import EFFECTS
from sim.engine.moment_equations import moments
from sim.engine.schedules import schedule
from tests.effects.engines import LEARNERS, check_one_course
from tests.sha import effect_reference

DOCS = Path(__file__).parents[2] / "docs"
BLOCKS = re.findall(r"```python\n(.*?)```", (DOCS / "effects.md").read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of the page's kind, once its row and its example stand where the page says."""
    row, example = BLOCKS
    family: dict[str, Any] = {**vars(kind), **vars(heating)}
    exec(row, family)  # noqa: S102 - the page is the test
    made = family["ROW"]
    monkeypatch.setitem(EFFECTS, made.name, made)
    written: dict[str, Any] = {**vars(effect_reference), "HEATS": {}, "EFFECTS": {}}
    exec(example, written)  # noqa: S102
    for table in ("HEATS", "EFFECTS"):
        for name, entry in written[table].items():
            monkeypatch.setitem(getattr(effect_reference, table), name, entry)
    return str(made.name)


def test_the_pages_kind_follows_its_written_equation(added: str) -> None:
    sha = effect_reference.without_noise(effect_reference.plant("linear", effect_reference.EFFECTS[added]))
    events, inputs = effect_reference.course(3)
    outputs = np.arange(0.0, 3000.0, 60.0)
    found = moments(schedule(sha, events, outputs, inputs=inputs), 21.0).mean
    np.testing.assert_allclose(found, effect_reference.reference(sha, events, outputs, inputs, 21.0), atol=3e-5)


@pytest.mark.parametrize("learner", LEARNERS)
def test_every_engine_takes_it_from_the_row(added: str, learner: str) -> None:
    check_one_course(added, learner, 0.0)


def test_the_page_says_it_in_each_language_from_the_row(added: str, monkeypatch: pytest.MonkeyPatch) -> None:
    words = all_words.__wrapped__()
    assert [words[language].say(f"effect.{added}")[:6] for language in LANGUAGES] == ["heat o", "calore", "Wärme "]
    assert words["de"].say(f"experiment.{added}") == "bei einer Last eine Stunde die Fenster öffnen"
    monkeypatch.setitem(EFFECTS, added, replace(EFFECTS[added], meaning="heat of wet air"))
    words = all_words.__wrapped__()
    assert words["en"].say(f"effect.{added}") == "heat of wet air"
    assert words["it"].say(f"effect.{added}") == words["de"].say(f"effect.{added}") == "heat of wet air (en)"


def test_the_table_of_the_docs_is_the_table_of_the_program() -> None:
    text = (DOCS / "effects.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")
    ]
    written = {row[0]: row for row in rows if row[0] in EFFECTS}
    assert list(written) == list(EFFECTS)
    for name, row in written.items():
        assert row[1:3] == [EFFECTS[name].meaning, EFFECTS[name].acts]
        assert all(role in row[3] for role in (*EFFECTS[name].required_roles, *EFFECTS[name].optional))
