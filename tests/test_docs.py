"""The documentation's prose is finished: no name stands where a figure was to be put in."""

import re
from pathlib import Path

from drivers.tag import Quality
from tests.rig.decision_index import INDEX, NAMED, dangling, index, records

ROOT = Path(__file__).parent.parent
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")])

NAMES = {
    *(
        "ASCII",
        "AUTOSAR",
        "DOCTYPE",
        "EEMUA",
        "FEMTO",
        "NAMUR",
        "PRONOSTIA",
        "SCADA",
        "SIGKILL",
        "SIGTERM",
        "STLSQ",
        "UPPAAL",
    ),
    "CODESYS",
    *("HSTS", "OWASP"),
    *("CAN_SOCKETCAN", "ARIMA", "CLOCK_MONOTONIC", "FALSE", "UNKNOWN", "UNCERTAIN"),
    # What a reader puts a name of his own in for, and the vectors of the export's program.
    *("MODEL", "SYMBOL", "EVENT_TIMES", "READING_TIMES", "STEP_TIMES"),
}
"""Words in capitals that are the right words, besides the qualities of a reading."""


def placeholders(text: str) -> list[str]:
    """Words in capitals in the prose of a page, outside of code, that are no known names."""
    prose = re.sub(r"`[^`]*`", "", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))
    # Not parts of paths, addresses or file names.
    words = re.findall(r"(?<![\w/.@-])[A-Z][A-Z_]{4,}(?![\w/]|\.\w)", prose)
    return [word for word in words if word not in NAMES and word not in Quality.__members__]


def test_no_name_of_a_constant_stands_in_for_a_figure() -> None:
    found = {str(page.relative_to(ROOT)): placeholders(page.read_text(encoding="utf-8")) for page in PAGES}
    assert {page: names for page, names in found.items() if names} == {}


def test_such_names_are_found_in_prose_alone() -> None:
    text = "It takes MEMORY, is SENSOR_FAILURE. AGREEMENT\n```\nEXAMPLE\n```\n`CODE_NAME`, README.md: RARE_COVERAGE."
    assert placeholders(text) == ["MEMORY", "AGREEMENT", "RARE_COVERAGE"]


def test_the_index_of_decisions_is_made_of_the_records() -> None:
    assert INDEX.read_text(encoding="utf-8") == index(), "python -m tests.rig.decision_index"


def test_every_record_that_is_named_is_there() -> None:
    assert dangling() == []


def test_a_record_that_is_gone_is_found_wherever_it_is_named() -> None:
    text = "as record 0001 and decisions 0002, 0003 say (0004, 0005); [0006](x), decisions/0008; mode 0660 (0.0012)"
    numbers = [number for match in NAMED.finditer(text) for number in re.findall(r"\d{4}", match[0])]
    assert numbers == ["0001", "0002", "0003", "0004", "0005", "0006", "0008"]


def test_no_number_of_a_record_is_given_twice() -> None:
    given = [number for one in records() for number in (one.number, *one.takes_in)]
    assert len(given) == len(set(given))


def test_the_glossary_defines_each_word_once() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (?!word|term)([^|-][^|]*?) \|", text, flags=re.MULTILINE)
    words = [word for row in rows for word in re.split(r", | / ", row)]
    assert len(words) > 250
    assert [word for word in words if words.count(word) > 1] == []
