"""The documentation's prose is finished: no name stands where a figure was to be put in."""

import re
from pathlib import Path

import pytest

from drivers.tag import Quality

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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_name_of_a_constant_stands_in_for_a_figure(page: Path) -> None:
    assert placeholders(page.read_text(encoding="utf-8")) == []


def test_such_names_are_found_in_prose_alone() -> None:
    text = "It takes MEMORY, is SENSOR_FAILURE. AGREEMENT\n```\nEXAMPLE\n```\n`CODE_NAME`, README.md: RARE_COVERAGE."
    assert placeholders(text) == ["MEMORY", "AGREEMENT", "RARE_COVERAGE"]
