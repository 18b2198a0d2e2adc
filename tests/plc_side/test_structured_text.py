"""The generated Structured Text: plain IEC 61131-3, typed strictly, and right about every block."""

import re
from pathlib import Path
from random import Random

import pytest
from blark.parse import parse_source_code
from lark.exceptions import LarkError

from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.targets import TARGETS
from gateway.commission.writeback.vectors import vectors
from gateway.settings.devices import load_device
from sim.plc.program.registers import read_map
from sim.plc.program.writeback import decode_block
from tests.plc_side.sides import Compiled, present
from tests.plc_side.structured_text import Mistake, Text, parser

CONFIG = Path(__file__).parents[2] / "config"
DOCS = Path(__file__).parents[2] / "docs" / "conformance"
DEVICES = CONFIG / "devices"
PLC = DEVICES / "decanter_plc.toml"


def text(path: Path = PLC, target: str = "plain", **keys: object) -> str:
    return generate(load_device(path), "", Program(**keys), TARGETS[target])  # type: ignore[arg-type]


def map_with(folder: Path, *changes: tuple[str, str]) -> Path:
    content = PLC.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in content
        content = content.replace(old, new)
    path = folder / "changed.toml"
    path.write_text(content, encoding="utf-8")
    return path


def fewer_fields(folder: Path) -> Path:
    """A layout of 16 words in another order, as for a PLC that takes 16 registers in a request."""
    content = PLC.read_text(encoding="utf-8")
    gone = "band_low|band_high|horizon_low|horizon_high|minutes_low|minutes_high|anomaly|input_quality"
    content = re.sub(rf'\n    {{ name = "(?:{gone})".*', "", content)
    version = re.search(r'\n    { name = "layout_version".*', content)
    validity = re.search(r'\n    { name = "validity".*', content)
    assert version and validity
    content = content.replace(validity[0], "").replace(version[0], validity[0] + version[0])
    path = folder / "fewer.toml"
    path.write_text(content, encoding="utf-8")
    return path


@pytest.mark.parametrize("target", ["plain", "openplc", "codesys"])
@pytest.mark.parametrize("name", ["decanter_plc.toml", "decanter_can.toml", "decanter_canopen.toml"])
def test_it_is_in_the_grammar_of_the_second_edition(name: str, target: str) -> None:
    parsed = Text(text(DEVICES / name, target))
    parsed.arrays.pop("DECANTER_WRITEBACK_ANSWERS", None)
    assert set(parsed.blocks) == {"DECANTER_WRITEBACK", "DECANTER_WRITEBACK_MAIN"}
    assert parsed.arrays == {"DECANTER_WRITEBACK_WORDS": (0, 25, "WORD")}


def test_a_kept_parser_that_is_not_ours_reads_it_too() -> None:
    """It takes seconds for a text: the block, which is the same for all of them, is read once."""
    plain = text().partition("CONFIGURATION")[0]  # TwinCAT's dialect has no configuration in the text
    example = "(* An example of its use"
    block, *program = text(target="codesys", permit_at="%IX0.0").partition(example)
    assert block == plain.partition(example)[0] and "END_FUNCTION_BLOCK" in block
    assert parse_source_code(plain).exception is None
    assert parse_source_code("".join(program)).exception is None


async def test_the_text_for_codesys_takes_arrays_and_passes_the_suite() -> None:
    """Its program has its areas as arrays, one a block and one of the answers: all that is to be set are addresses."""
    device = load_device(PLC)
    program = Text(text(target="codesys")).new("DECANTER_WRITEBACK_MAIN")
    assert program.places == {"area": "%IW0", "areaalimentazione": "%IW30", "answers": "%QW0"}
    block = next(step for step in vectors(device.writeback) if step.words)
    program.values["permitswitch"] = True
    program.call(0)
    program.call(20)
    words = present(block.words, program.values["answers"][7])
    program.values["area"] = dict(enumerate(words))
    program.call(40)
    assert [program.values["answers"][place] for place in (1, 3, 4, 6)] == [1, 1, 0, 1], "permit, counts, usable"
    assert program.values["answers"][8] == words[23], "the session's writer"


def test_the_text_for_tia_is_the_plain_one_in_siemens_spelling() -> None:
    """No compiler of Siemens is here: the text is held, letter by letter, against the one that matiec compiles."""
    written = text(target="tia", permit_at="%I0.0")
    block, _, program = written.partition("END_FUNCTION_BLOCK\n")
    assert 'Gateway : "DECANTER_WRITEBACK";' in program and "Permit := %I0.0" in program
    assert '"DECANTER_WRITEBACK_REGISTERS".Holding[119] := UINT_TO_WORD(#Gateway.Challenge);' in program
    assert "Holding : Array[0..455] of Word;" in program and "CONFIGURATION" not in written and " AT " not in block
    declared = set(re.findall(r"^    (\w+)(?: \{.*\})? : ", block.partition("\nBEGIN\n")[0], re.MULTILINE))
    body = re.sub(r"\(\*.*?\*\)", "", block.partition("\nBEGIN\n")[2], flags=re.DOTALL)
    bare = {name for name in re.findall(r"(?<![#.\w])[A-Za-z]\w*", body) if name in declared}
    assert len(declared) > 60 and not bare, "every name of the block's own has its #"
    plain = block
    for old, new in (
        (r"#(?=[A-Za-z]\w*)(?<!\w#)", ""),
        (r'FUNCTION_BLOCK "(\w+)"\n.*\nVERSION : 0.1\n', r"FUNCTION_BLOCK \1\n"),
        (r"Array\[0\.\.25\] of Word", "DECANTER_WRITEBACK_WORDS"),
        (r" \{InstructionName := 'TON_TIME'; LibVersion := '1\.0'\} : TON_TIME", " : TON"),
        (r"(SHL|ROL)\(IN := (.+?), N := (\d+)\)", r"\1(\2, \3)"),
        (r"\nBEGIN\n", ""),
    ):
        plain = re.sub(old, new, plain)
    ours = text().partition("END_FUNCTION_BLOCK\n")[0]
    assert plain.partition("FUNCTION_BLOCK")[2] == ours.partition("FUNCTION_BLOCK")[2]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("(* 2. Is there", "// 2. Is there\n(* Is there"),
        ("END_FUNCTION_BLOCK", "METHOD Reset : BOOL\nEND_METHOD\nEND_FUNCTION_BLOCK"),
        ("Checksum : WORD;", "Checksum : REF_TO WORD;"),
        ("Checksum := WORD#16#FFFF;", "Checksum := WORD#16#FFFF; pointer^ := 1;"),
        ("Position : INT;", "Position : INT; Position2 : INT := ;"),
        ("BlocksAccepted + UINT#1", "BlocksAccepted + UINT#1 ?"),
        ("Drift : BOOL;", "On : BOOL;"),
        ("Drift : BOOL;", "Dr__ift : BOOL;"),
    ],
)
def test_the_grammar_refuses_what_the_second_edition_does_not_have(old: str, new: str) -> None:
    content = text()
    assert old in content
    with pytest.raises(LarkError):
        parser().parse(content.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("WORD_TO_UINT(Words[6])", "Words[6]"),
        ("Checksum := WORD#16#FFFF;", "Checksum := UINT#65535;"),
        ("FOR Position := 0 TO 25 DO", "FOR Position := 0 TO 26 DO"),
        ("Taken := FALSE;", "Taken := WORD#16#0000;"),
        ("Changed := FALSE;", "NeverDeclared := FALSE;"),
        ("BlocksAccepted := UINT#0;", "Words[0] := 5.5;"),
    ],
)
def test_the_interpreter_is_as_strict_about_types_as_a_compiler(tmp_path: Path, old: str, new: str) -> None:
    content = text()
    assert old in content
    program = Text(content.replace(old, new, 1)).new("DECANTER_WRITEBACK_MAIN")
    block = next(step for step in vectors(load_device(PLC).writeback) if step.words)
    with pytest.raises((Mistake, KeyError)):
        program["Gateway"].values["blocksaccepted"] = 0xFFFF
        for ms in (0, 20, 40):
            program.call(ms)
            program.values["permitswitch"] = True
            for place, word in enumerate(present(block.words, program["Gateway"]["Challenge"])):
                program.values[f"word{place:02d}"] = word


async def test_the_numbers_that_it_gives_are_those_of_the_block_as_the_emulator_reads_them() -> None:
    layout = read_map(PLC).block
    assert layout is not None
    random, side = Random(3), Compiled(PLC)
    own = load_device(PLC).writeback
    await side.permit(True)
    side.run()
    for step in vectors(own, seed=5):
        words = [*step.words]
        if len(words) != len(layout.fields) or step.refused or step.permit is False:
            continue
        await side.write(0, present(words, (await side.account()).challenge))
        await side.account()
        expected = decode_block(layout, words)
        for name in (
            "temperature_now",
            "band_low",
            "age",
            "p_limit",
            "minutes_median",
            "location",
            "anomaly",
            "alarms",
        ):
            camel = "".join(part.capitalize() for part in name.split("_"))
            if name == "alarms" or side.block[f"{camel}Known"]:
                assert side.block[camel] == pytest.approx(expected[name], rel=1e-5, abs=1e-5), name
    assert random.random() and side.block["Alarms"] == 0


async def test_an_unknown_number_is_said_to_be_unknown_and_keeps_its_last_value() -> None:
    side = Compiled(PLC)
    own = load_device(PLC).writeback
    await side.permit(True)
    side.run()
    steps = {step.name: step for step in vectors(own)}
    await side.write(0, present(steps["a whole new block is accepted"].words, (await side.account()).challenge))
    await side.account()
    assert side.block["TemperatureNowKnown"] and side.block["TemperatureNow"] == pytest.approx(45.12)
    assert not side.block["MinutesMedianKnown"], "the limit is not reached within the forecast"
    # Right behind the first block in its session: its sequence is brought up to it.
    unknown = steps["numbers that are not known are no fault"].words
    await side.write(0, present((unknown[0], 42, *unknown[2:-1], 42), (await side.account()).challenge))
    await side.account()
    assert not side.block["TemperatureNowKnown"] and side.block["TemperatureNow"] == pytest.approx(45.12)


async def test_the_warning_is_the_plants_own_whenever_the_prediction_is_not_usable() -> None:
    side = Compiled(PLC)
    own = load_device(PLC).writeback
    await side.permit(True)
    high = next(step for step in vectors(own) if step.name == "the greatest numbers are accepted")
    await side.write(0, present(high.words, (await side.account()).challenge))
    await side.account()
    assert side.block["PLimit"] > 0.5 and side.program["BearingWarning"] is True, "the prediction warns"
    await side.permit(False)
    side.run()
    assert side.program["BearingWarning"] is False, "without a permit it does not"
    side.program.values["ownlogic"] = True
    side.run()
    assert side.program["BearingWarning"] is True, "the plant's own logic always does"
    await side.permit(True)
    side.program.values["ownlogic"] = False
    await side.wait(own.timeout + 0.1 if own else 0.0)
    assert side.program["BearingWarning"] is False, "and the prediction not after its time"


async def test_what_stands_in_the_memory_at_the_start_is_not_taken_for_new() -> None:
    own = load_device(PLC).writeback
    block = next(step for step in vectors(own) if step.words)
    side = Compiled(PLC)
    fresh = Text(generate(side.device, "GATEWAY_BLOCK", Program())).new("GATEWAY_BLOCK_MAIN")
    for place, word in enumerate(block.words):
        fresh.values[f"word{place:02d}"] = word
    fresh.values["permitswitch"] = True
    for ms in range(0, 200, 20):
        fresh.call(ms)
    assert fresh["Gateway"]["BlocksAccepted"] == 0 and fresh["Gateway"]["Usable"] is False


async def test_a_block_that_comes_in_several_frames_is_looked_at_when_it_is_whole() -> None:
    own = load_device(PLC).writeback
    block = next(step for step in vectors(own) if step.words)
    device = load_device(PLC)
    one = Text(generate(device, "GATEWAY_BLOCK")).new("GATEWAY_BLOCK")
    area = dict.fromkeys(range(26), 0)
    one.call(0, Words=area, Permit=True)
    for place, word in enumerate(present(block.words, one["Challenge"])):
        area[place] = word
        one.call(20 * (place + 1), Words=area, Settled=place == 25)
    assert (one["BlocksAccepted"], one["BlocksRefused"], one["Usable"]) == (1, 0, True)


def test_the_plcs_heartbeat_rounds_to_one_and_the_counters_to_zero() -> None:
    one = Text(generate(load_device(PLC), "GATEWAY_BLOCK")).new("GATEWAY_BLOCK")
    one.values |= {"plcheartbeat": 0xFFFF, "blocksrefused": 0xFFFF}
    one.call(0)
    assert one["PlcHeartbeat"] == 1
    one.call(20, Words=dict.fromkeys(range(26), 1))
    assert one["BlocksRefused"] == 0


def test_registers_with_swapped_bytes_are_answered_swapped(tmp_path: Path) -> None:
    swapped = map_with(
        tmp_path,
        ('name = "BlocksAccepted"\n', 'name = "BlocksAccepted"\norder = "BADC"\n'),
        ('address = "holding:113"\ndtype = "bool"\n', 'address = "holding:113"\ndtype = "bool"\norder = "BADC"\n'),
    )
    content = text(swapped)
    assert "ROL(UINT_TO_WORD(Gateway.BlocksAccepted), 8)" in content
    assert "OwnWritepermit OR WORD#16#0100" in content
    Text(content)


def test_names_from_the_map_cannot_end_a_comment_or_leave_ascii(tmp_path: Path) -> None:
    odd = map_with(tmp_path, ('name = "decanter"', 'name = "centrifuga n° 3"'), ('"WritePermit"', '"Write*)Permit"'))
    content = generate(load_device(odd.rename(tmp_path / "mappa*) è.toml")), "", Program())
    assert content.isascii() and "CENTRIFUGA_N_3_WRITEBACK" in content
    Text(content)


def test_locations_are_the_registers_addresses_and_can_be_elsewhere() -> None:
    assert "Word00 AT %MW400 : WORD;" in text() and "AT %MW112 : WORD;" in text()
    elsewhere = text(prefix="%QW", permit_at="%IX0.0", cycle=50)
    assert "Word25 AT %QW425 : WORD;" in elsewhere and "PermitSwitch AT %IX0.0 : BOOL;" in elsewhere
    assert "INTERVAL := T#50ms" in elsewhere
    Text(elsewhere)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"prefix": "MW"}, "no prefix of a location"),
        ({"permit_at": "here"}, "no location"),
        ({"permit_at": "%IX0.0 : BOOL; END_VAR"}, "no location"),
    ],
)
def test_a_location_that_is_none_is_refused(keys: dict[str, str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        text(**keys)


def test_a_device_without_a_block_and_a_name_that_is_none_are_refused(tmp_path: Path) -> None:
    bare = tmp_path / "bare.toml"
    bare.write_text('[device]\nname = "x"\ndriver = "modbus"\n[[tags]]\nname = "a"\naddress = "holding:1"\n')
    with pytest.raises(ValueError, match=r"has no \[writeback\] table"):
        generate(load_device(bare))
    with pytest.raises(ValueError, match="makes no identifier"):
        generate(load_device(PLC), "°°°")
    with pytest.raises(ValueError, match="makes no identifier"):
        generate(load_device(PLC), "program")


def test_the_shipped_text_is_the_one_that_is_generated_today() -> None:
    shipped = (DOCS / "decanter_plc.st").read_text(encoding="ascii")
    assert shipped == text(), "make it anew: decanter plc codegen --out docs/conformance/decanter_plc.st"
