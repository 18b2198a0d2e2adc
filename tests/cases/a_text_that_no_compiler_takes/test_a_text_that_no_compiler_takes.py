"""`plc codegen` wrote, with exit code 0, what the compiler of the PLC's tool then refused: a BOOL at a word, a block
that is called as a word of the language, a configuration of a name that OpenPLC does not look for, words it has not.

What is asked for is held against the tool before a line is written; iec2c has the last word where it is installed
(`tests/plc_side/test_matiec.py`).
"""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.targets import TARGETS
from gateway.settings.devices import load_device
from tests.plc_side.test_structured_text import PLC

WORDS = (
    "IF",
    "int",
    "TON",
    "CTU",
    "shl",
    "Max",
    "Word to Int",
    "time-of-day",
    "END_CASE",
    "var",
    "r_trig",
    "EN",
    "retain",
)
INNER = ("Gateway", "area", "Seen", "Permit", "PermitSwitch", "Word07", "OwnLogic")


def codegen(*words: str) -> Result:
    return CliRunner().invoke(main, ["plc", "codegen", *words])


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("place", ["%IW3", "%MW10", "%IB0", "%QD2", "%IX", "%X0.0", "IX0.0", "%IX0.0.", "%IX-1.0"])
def test_a_permit_that_is_no_bit_is_refused_with_one_that_is(target: str, place: str) -> None:
    done = codegen("--target", target, "--permit-at", place)
    assert done.exit_code == 2 and "Traceback" not in done.output
    assert "no location of one bit" in done.stderr and TARGETS[target].bit_example in done.stderr


@pytest.mark.parametrize(
    ("target", "place"),
    [
        *(("openplc", place) for place in ("%QX0.9", "%IX3", "%IX1024.0", "%MX0.0")),
        ("codesys", "%IX0.8"),
        ("tia", "%IX0.0"),
        ("tia", "%I0.8"),
    ],
)
def test_a_bit_that_the_tool_has_not_is_refused(target: str, place: str) -> None:
    done = codegen("--target", target, "--permit-at", place)
    assert done.exit_code == 2 and TARGETS[target].tool in done.stderr


@pytest.mark.parametrize(("target", "place"), [("plain", "%IX1.2.3"), ("openplc", "%IX1023.7"), ("tia", "%M10.7")])
def test_a_bit_that_the_tool_has_is_taken(target: str, place: str) -> None:
    done = codegen("--target", target, "--permit-at", place)
    assert done.exit_code == 0 and place in done.stdout


@pytest.mark.parametrize("name", (*WORDS, *INNER))
def test_a_block_is_not_called_as_a_word_of_the_language_or_of_the_text(name: str) -> None:
    done = codegen("--name", name)
    assert done.exit_code == 2
    assert ("is a word of IEC 61131-3" if name in WORDS else "is a variable within the text") in done.stderr


@pytest.mark.parametrize(
    ("target", "location"),
    [("plain", "%M"), ("plain", "%MX"), ("plain", "%MD"), ("openplc", "%MW"), ("openplc", "%IW"), ("tia", "%MW")],
)
def test_a_location_of_registers_is_one_of_words_that_the_tool_has(target: str, location: str) -> None:
    done = codegen("--target", target, "--location", location)
    assert done.exit_code == 2 and repr(location) in done.stderr


def test_openplc_gets_the_names_and_places_that_its_own_build_looks_for() -> None:
    content = codegen("--target", "openplc", "--location", "%QW", "--permit-at", "%IX0.0").stdout
    for words in ("CONFIGURATION Config0\n", "RESOURCE Res0 ON PLC", "Word00 AT %QW400 : WORD;", "AT %QW112 : WORD;"):
        assert words in content


def test_openplc_keeps_the_second_thousand_registers_in_its_memory_and_has_no_third(tmp_path: Path) -> None:
    content = PLC.read_text(encoding="utf-8")
    for start, words in (("1024", "Word00 AT %MW0 : WORD;"), ("1010", "Word13 AT %QW1023 : WORD;")):
        path = tmp_path / f"at_{start}.toml"
        path.write_text(
            content.replace('\naddress = "holding:400"', f'\naddress = "holding:{start}"'),
            encoding="utf-8",
        )
        assert words in generate(load_device(path), "", Program(), TARGETS["openplc"])
    path = tmp_path / "far.toml"
    path.write_text(
        content.replace('\naddress = "holding:400"', '\naddress = "holding:2030"'),
        encoding="utf-8",
    )
    done = codegen("--target", "openplc", "--device", str(path))
    assert done.exit_code == 2 and "holding:2048: the Modbus server of OpenPLC has words only up to" in done.stderr


def test_what_lies_in_inputs_is_answered_in_outputs() -> None:
    content = codegen("--location", "%IW").stdout
    assert "Word00 AT %IW400" in content and "OwnChallenge AT %QW119" in content and "AT %IW119" not in content


def test_a_file_that_the_tool_does_not_import_is_not_written(tmp_path: Path) -> None:
    done = codegen("--target", "tia", "--out", str(tmp_path / "block.st"))
    assert done.exit_code == 2 and "end in .scl" in done.stderr and not list(tmp_path.iterdir())
    assert codegen("--target", "tia", "--out", str(tmp_path / "block.scl")).exit_code == 0
