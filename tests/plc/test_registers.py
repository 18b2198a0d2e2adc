"""The register map: what is read, and the sentence for what cannot be."""

from pathlib import Path

import pytest

from drivers.tag import Order
from sim.plc.program.checks import InputError
from sim.plc.program.image import ProcessImage
from sim.plc.program.registers import Place, read_map
from tests.plc.bench import DECANTER

GOOD = """
[device]
name = "plc"
driver = "modbus"
unit = 7
max_gap = 2
[[tags]]
name = "A"
address = "holding:10"
[[tags]]
name = "B"
address = "holding:12"
dtype = "float32"
"""
BLOCK = """
[writeback]
address = "holding:40"
layout_version = 2
timeout_s = 2.0
fields = [ {name="layout_version"}, {name="sequence"}, {name="heartbeat"}, {name="validity"},
  {name="challenge"}, {name="writer"}, {name="crc"},
  {name="sequence_copy"} ]
"""


def test_the_decanters_map_is_read() -> None:
    registers = read_map(DECANTER)
    assert registers.tags["TCuscinettiRiduttore"].order is Order.CDAB
    assert registers.places["TCuscinettiAlimentazione"] == Place("holding", 107, 2)
    assert registers.heartbeat == "PlcHeartbeat"
    assert registers.block is not None
    assert registers.block.place == Place("holding", 400, 26)
    assert registers.block.fields[7].signed and registers.block.fields[7].scale == 0.01


@pytest.mark.parametrize(
    ("find", "put", "words"),
    [
        ('address = "holding:10"', 'address = "register:10"', ["tag 'A'", "address", "register:10", "holding:N"]),
        ('address = "holding:10"', 'address = "holding:70000"', ["'A'", "beyond 65535"]),
        ('address = "holding:10"', 'address = "holding:13"', ["'B'", "holding:13", "belongs to 'A'"]),
        ('name = "B"', 'name = "A"', ["tags[1].name: 'A' is already used"]),
        ('dtype = "float32"', 'dtype = "float23"', ["tags[1].dtype", "float23", "uint16"]),
        (
            'dtype = "float32"',
            'dtype = "float32"\nscal = 2',
            ["tags[1].scal: there is no such key", "mean 'scale'"],
        ),
        ('dtype = "float32"', 'dtype = "float32"\nscale = 0', ["tags[1].scale", "scale 0"]),
        ('dtype = "float32"', 'dtype = "float32"\nbit = 3', ["tag 2 (B): bit: ", "bool"]),
        ('dtype = "float32"', 'dtype = "string"', ["tag 2 (B): length: "]),
        ('dtype = "float32"', 'dtype = "int16"\nsentinel = 70000', ["tag 2 (B): sentinel: ", "70000"]),
        ("unit = 7", "unit = 700", ["[device]: unit: ", "700", "0..255"]),
        ("unit = 7", 'heartbeat = "C"', ["device.heartbeat: 'C' is not a tag"]),
        ("unit = 7", 'heartbeat = "B"', ["'B'", "plain uint16"]),
        ("unit = 7", "unit = ", ["is not TOML", "line"]),
        ('{name="crc"},', "", ["writeback.fields: 'crc' is missing"]),
        ('"holding:40"', '"holding:11"', ["'B'", "'[writeback]'"]),
        ('"holding:40"', '"input:40"', ["[writeback]", "function 16"]),
        ("timeout_s = 2.0", "timeout_s = 0", ["writeback.timeout_s: must be more than 0"]),
        ("layout_version = 2", "", ["writeback.layout_version: is missing"]),
    ],
)
def test_a_bad_map_is_refused_in_one_sentence(tmp_path: Path, find: str, put: str, words: list[str]) -> None:
    text = GOOD + BLOCK
    assert find in text
    path = tmp_path / "bad.toml"
    path.write_text(text.replace(find, put, 1))
    with pytest.raises(InputError) as caught:
        read_map(path)
    for word in (str(path), *words):
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_map_that_is_not_there_or_is_empty_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_map(tmp_path / "none.toml")
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(InputError, match="device: is missing"):
        read_map(tmp_path / "empty.toml")
    (tmp_path / "empty.toml").write_text('tags = []\n[device]\nname = "plc"\ndriver = "modbus"\n')
    with pytest.raises(InputError, match=r"tags: must not be empty.*at least one"):
        read_map(tmp_path / "empty.toml")


def test_two_bits_may_share_a_register_but_not_a_bit(tmp_path: Path) -> None:
    path = tmp_path / "bits.toml"
    head = '[device]\nname = "plc"\ndriver = "modbus"\n'
    bit = '[[tags]]\nname = "{}"\naddress = "holding:1"\ndtype = "bool"\nbit = {}\n'
    path.write_text(head + bit.format("A", 0) + bit.format("B", 1))
    assert len(read_map(path).tags) == 2
    path.write_text(head + bit.format("A", 1) + bit.format("B", 1))
    with pytest.raises(InputError, match="belongs to 'A'"):
        read_map(path)


SCALED = """
[device]
name = "inverter"
driver = "modbus"
[[tags]]
name = "V"
address = "holding:10"
dtype = "int16"
scale_from = "holding:12"
sentinel = -32768
[[tags]]
name = "I"
address = "holding:11"
dtype = "int16"
scale_from = "holding:12"
"""


def test_values_are_served_with_the_factor_by_which_they_all_fit(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(SCALED)
    image = ProcessImage(read_map(tmp_path / "map.toml"))

    def served() -> tuple[float, float]:
        image.serve()
        volts, amperes, power = (word - (word >> 15 << 16) for word in image.read("holding", 10, 3))
        return volts * 10.0**power, amperes * 10.0**power

    image.learn({"V": 3.123456, "I": 0.5})
    assert image.read("holding", 10, 3) == [0, 0, 0]
    assert served() == pytest.approx((3.1235, 0.5), abs=1e-12)
    image.learn({"V": 230.46})
    assert served() == pytest.approx((230.46, 0.5), abs=1e-12)
    # A factor that grows rounds what shares it; what is true is what the registers say.
    changed = image.learn({"I": 1000.26})
    assert changed == pytest.approx({"V": 230.5, "I": 1000.3}) and served() == pytest.approx((230.5, 1000.3))
    assert image.learn({"V": None}) == {"V": None}
    image.serve()
    assert image.read("holding", 10, 1) == [0x8000]
    # With a tag that is frozen its factor stands, and what is told by it.
    image.learn({"V": 231.0, "I": 9000.0})
    image.serve(lambda name: name == "V")
    assert image.read("holding", 10, 3) == [0x8000, 10003, 0xFFFF]
    assert served() == pytest.approx((231.0, 9000.0))


def test_a_tag_at_a_factors_register_says_the_factor(tmp_path: Path) -> None:
    own = '[[tags]]\nname = "SF"\naddress = "holding:12"\ndtype = "int16"\n'
    (tmp_path / "map.toml").write_text(SCALED + own)
    image = ProcessImage(read_map(tmp_path / "map.toml"))
    image.learn({"V": 230.4})
    image.serve()
    assert image.truth["SF"] == -2 and image.read("holding", 10, 3) == [23040, 0, 0xFFFE]
    for wrong in (own.replace("int16", "uint16"), own + "scale = 0.1\n", own.replace(":12", ":11")):
        (tmp_path / "map.toml").write_text(SCALED + wrong)
        with pytest.raises(InputError, match=r"factor of 'V'|belongs to 'I'"):
            read_map(tmp_path / "map.toml")
    (tmp_path / "map.toml").write_text(SCALED.replace('scale_from = "holding:12"', 'scale_from = "coil:12"'))
    with pytest.raises(InputError, match="is one bit; give a register"):
        read_map(tmp_path / "map.toml")
