"""The acceptance report on a phone was 1,109 pixels wide, as each exit code's sentence stood in one line; on paper the
annex was printed over the lines to sign on, a path broke in its middle, and a reading's time was 1.7954e+09.

Seen in Chromium and on the PDF's pages; here is what can be told without either.
"""

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from fpdf import FPDF

from gateway.commission.acceptance.blocks import Heading, Signatures, Text
from gateway.commission.acceptance.paper import paper
from sim.lab.pages import page_environment
from tests.plc_side.test_report import made, record

SENTENCE = "9 of 25 readings are not good, Assorbimento the first: the device says not available and stays so"
FILE = "/opt/decanter/impianto/config/devices/a_long_name_of_a_device.toml"


class Outline(HTMLParser):
    """The classes of what each sentence stands in, and the headings within sections."""

    def __init__(self, content: str) -> None:
        super().__init__()
        self.stack: list[tuple[str, str]] = []
        self.around: dict[str, list[tuple[str, str]]] = {}
        self.feed(content)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.stack.append((tag, dict(attrs).get("class") or ""))

    def handle_endtag(self, tag: str) -> None:
        assert self.stack.pop()[0] == tag, "what is opened is closed"

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.around[data.strip()] = [*self.stack]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Outline:
    readings = [{"tag": "Coppia", "time": 1_795_000_000.25, "value": 65535}]
    one = record("read", 1, SENTENCE, result={"readings": readings}, configuration={FILE: "ab" * 32})
    out, _ = made(tmp_path_factory.mktemp("wide"), one)
    return Outline((out / "report.html").read_text(encoding="utf-8"))


def test_a_sentence_of_a_record_can_be_broken_into_lines(page: Outline) -> None:
    style = page_environment("gateway.commission.acceptance").get_template("page.html").render()
    word = re.search(r"^\.word \{[^}]*\}", style, re.MULTILINE)
    assert word is not None and "nowrap" in word[0], "a word is kept in one line, which no sentence may be"
    classes = [name for _, names in page.around[f"Exit code 1: {SENTENCE}"] for name in names.split()]
    assert "word" not in classes and "bad" in classes


def test_each_part_is_a_section_and_a_record_is_within_one(page: Outline) -> None:
    for heading in ("Open points", "Checks", "Signatures", "Annex: configuration", "Annex: records"):
        assert [tag for tag, _ in page.around[heading]][-2:] == ["section", "h2"], heading
    record_heading = next(text for text in page.around if text.endswith(". read"))
    assert [tag for tag, _ in page.around[record_heading]][-2:] == ["section", "h3"]


def test_a_path_stands_where_there_is_room_and_a_time_is_a_date(page: Outline) -> None:
    assert f"{FILE}, SHA-256 {'ab' * 32}" in page.around
    assert not any("e+09" in text for text in page.around)
    assert any(re.fullmatch(r"2026-11-\d\d \d\d:\d\d:\d\d UTC", text) for text in page.around)


def test_nothing_is_printed_over_the_lines_to_sign_on(monkeypatch: pytest.MonkeyPatch) -> None:
    printed: list[tuple[str, float]] = []

    def noted(name: str) -> None:
        original = getattr(FPDF, name)

        def write(sheet: FPDF, *words: Any, **keys: Any) -> Any:
            printed.append((str(words[2]) if len(words) > 2 else "", sheet.get_y()))
            return original(sheet, *words, **keys)

        monkeypatch.setattr(FPDF, name, write)

    noted("cell")
    noted("multi_cell")
    blocks = [Heading("Report"), Signatures(("engineer", "operator")), Heading("Annex", 2), Text("all of it")]
    assert paper(blocks, "Report", "foot", 0.0).startswith(b"%PDF-")
    places = dict(printed)
    assert places["Annex"] >= places["operator: name, date, signature"] + 5, "mm, the height of the line's text"


@pytest.mark.parametrize("room", ["sim/lab/discrepancy/output", "sim/lab/judge", "gateway/commission/acceptance"])
def test_a_table_has_its_head_on_each_sheet_of_paper(room: str) -> None:
    """A row of headings that is no `thead` stood alone at the foot of a page, and nowhere on the next one."""
    for path in (Path(__file__).parents[3] / room / "templates").iterdir():
        rows = re.findall(r"(\S*)\s*<tr><th\b", path.read_text(encoding="utf-8"))
        assert all(before.endswith("<thead>") for before in rows), path


def test_the_ranking_has_its_parts_in_sections_too() -> None:
    template = (Path(__file__).parents[3] / "sim/lab/judge/templates/ranking.html").read_text(encoding="utf-8")
    assert template.count("<section>") == template.count("</section>") == template.count("<h2>")
