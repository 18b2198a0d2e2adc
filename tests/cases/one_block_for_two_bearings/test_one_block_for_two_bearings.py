"""A decanter has two bearings and its PLC took in one block: what was written spoke of one, and of none by name."""

import re
from collections.abc import Sequence
from pathlib import Path
from random import Random

import pytest

from drivers.driver import BeforeSending, anyhow, open_driver
from drivers.errors import DriverError, LinkDown, WriteForbidden
from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from drivers.tag import Sample, Tag
from gateway.machine.reading.scan import Scan
from gateway.machine.writing.arming import ArmingError
from gateway.machine.writing.block import Validity
from gateway.machine.writing.writeback import Writer
from gateway.machine.writing.writeback_stage import WritebackStage, open_audit_trail
from gateway.plant.device import make_driver
from gateway.plant.log import open_log
from gateway.settings.config import Config, load_config
from gateway.settings.devices import load_device
from gateway.store.audit import ARMED, CONFIRMED, DISARMED, read
from sim.plc.control import COMMANDS
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.plc import Plc, PlcSettings
from sim.plc.program.registers import read_map
from tests.gateway.support import MAP, JumpClock, config_in, one_machine, plant_file, scan_of

DEVICES = MAP.parent
GEARBOX, FEED = "TCuscinettiRiduttore", "TCuscinettiAlimentazione"
USABLE = Validity(31)
PLACES = {"modbus": {"host": "127.0.0.1", "port": 1}, "can": {"interface": "virtual", "channel": "nowhere"}}
FURTHER = (
    '[[writeback.blocks]]\ntemperature = "TCuscinettiAlimentazione"\naddress = "holding:430"\nsuffix = "Alimentazione"'
)


# ---------------------------------------------------------------- the device file


def device_with(folder: Path, old: str, new: str, *, every: bool = False) -> Path:
    path, text = folder / "device.toml", MAP.read_text()
    assert old in text
    path.write_text(text.replace(old, new, -1 if every else 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            '"holding:430"',
            '"holding:425"',
            r"blocks\[0\]\.address: holding:425 belongs to the block of writeback already",
        ),
        ('"holding:430"', '"holding:0399"', r"blocks\[0\]\.address: holding:400 belongs to the block of writeback"),
        (
            FURTHER,
            f"{FURTHER}\n{FURTHER.replace('430', '500')}",
            r"blocks\[1\]\.suffix: 'Alimentazione' is already used",
        ),
        (FURTHER, FURTHER.replace(FEED, "TCuscinetti"), r"blocks\[0\]\.temperature: 'TCuscinetti' is not a tag"),
        (FURTHER, FURTHER.replace(FEED, GEARBOX), r"writeback speaks of 'TCuscinettiRiduttore' already"),
        (
            'name = "ChallengeAlimentazione"',
            'name = "Ch"',
            r"no tag 'ChallengeAlimentazione', by which the PLC answers",
        ),
        (f'temperature = "{GEARBOX}"   # of which temperature it speaks\n', "", r"writeback\.temperature: is missing"),
        ('suffix = "Alimentazione"', 'suffix = "Due_"', r"writeback\.blocks\[0\]\.suffix: must match"),
        ('suffix = "Alimentazione"', 'suffix = ""', r"writeback\.blocks\[0\]\.suffix: must match"),
    ],
)
def test_what_is_wrong_with_several_blocks_is_a_sentence_each(
    tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    with pytest.raises(ConfigError, match=sentence):
        load_device(device_with(tmp_path, old, new))


def test_reasons_have_one_number_for_all_blocks(tmp_path: Path) -> None:
    first, further = MAP.read_text().split("LastRefusalAlimentazione")
    path = tmp_path / "device.toml"
    path.write_text("LastRefusalAlimentazione".join((first, further.replace('3 = "CRC"', '13 = "CRC"'))))
    with pytest.raises(ConfigError, match="labels of 'LastRefusalAlimentazione' are not those of 'LastRefusal'"):
        load_device(path)


def test_a_file_of_one_block_means_what_it_meant(tmp_path: Path) -> None:
    path = device_with(tmp_path, FURTHER, "")
    path.write_text(path.read_text().replace(f'temperature = "{GEARBOX}"   # of which temperature it speaks\n', ""))
    device = load_device(path)
    (layout,) = device.writebacks
    assert device.writeback is layout and layout.temperature is None and layout.tag("Challenge") == "Challenge"
    assert device.find_block("TFango") is layout, "it speaks of whatever is predicted"
    plc = Plc(read_map(path), EmulatorClock(0.0, 0.0, 1.0), settings=PlcSettings(challenge=65535))
    assert [plc.intake.challenge, *(turn(plc) for _ in range(2))] == [65535, 1, 2], "every number is its own"


def turn(plc: Plc) -> int:
    plc.permit = not plc.permit
    plc.cycle(0.0)
    return plc.intake.challenge


def test_a_block_that_speaks_of_another_bearing_is_not_written_with_this_ones_prediction(tmp_path: Path) -> None:
    one = device_with(tmp_path, FURTHER, "")
    plant = plant_file(tmp_path, device=one)
    with pytest.raises(ConfigError, match=f"no block of .* speaks of '{FEED}' .*only of {GEARBOX}; add a "):
        load_config(plant, {"model.temperature": FEED, "alarms.tags": (FEED,), "writeback.mode": "shadow"})
    config = load_config(plant, {"model.temperature": GEARBOX, "writeback.mode": "shadow"})
    assert config.map.find_block(GEARBOX) is config.map.writeback


# ---------------------------------------------------------------- the drivers' closed write maps


@pytest.mark.parametrize("name", ["decanter_plc.toml", "decanter_can.toml", "decanter_canopen.toml"])
async def test_a_driver_writes_both_blocks_and_nothing_else(name: str, tmp_path: Path) -> None:
    device = load_device(DEVICES / name)
    settings = {**device.settings, **PLACES.get(device.driver, {})}
    driver = open_driver(device.driver, settings, clock=lambda: 0.0, write_map=device.block_words)
    for layout in device.writebacks:
        block = [(word, 0) for word in layout.words]
        with pytest.raises(DriverError) as gone:
            await driver.write(block)  # type: ignore[attr-defined]
        assert isinstance(gone.value, LinkDown), "nothing but the missing connection stands in the way"
        stranger = Tag(block[0][0].name, layout.words[1].address, writable=True)
        with pytest.raises(WriteForbidden, match="not in the write map"):
            await driver.write([(stranger, 0), *block[1:]])  # type: ignore[attr-defined]
    reading = device.by_name["BlocksAcceptedAlimentazione"]
    with pytest.raises(WriteForbidden):
        await driver.write([(reading, 0)])  # type: ignore[attr-defined]
    await driver.close()


def test_neighbouring_blocks_are_two_writes_to_a_device_that_takes_one_in_a_request(tmp_path: Path) -> None:
    device = load_device(device_with(tmp_path, '"holding:430"', '"holding:426"'))
    settings = {"host": "127.0.0.1", "max_registers": 26}
    open_driver("modbus", settings, clock=lambda: 0.0, write_map=device.block_words)
    with pytest.raises(DriverError, match="26 words and the device takes 25"):
        open_driver("modbus", {**settings, "max_registers": 25}, clock=lambda: 0.0, write_map=device.block_words)


# ---------------------------------------------------------------- two blocks of one gateway at one PLC


class DriverOfPlc:
    """A driver whose writes go straight into the software PLC's memory; `sent` is what it has written."""

    def __init__(self, plc: Plc) -> None:
        self.plc = plc
        self.sent: list[tuple[int, list[int]]] = []

    async def write(self, values: Sequence[tuple[Tag, int]], *, before_sending: BeforeSending = anyhow) -> None:
        before_sending()
        address, words = int(values[0][0].address.partition(":")[2]), [word for _, word in values]
        self.sent.append((address, words))
        self.plc.write("gateway", "holding", address, words, 0.0)

    async def open(self) -> None: ...
    async def close(self) -> None: ...
    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        raise AssertionError("scans are made from the PLC's truth")

    def statistics(self) -> dict[str, float]:
        return {}


def scanned(plc: Plc, clock: JumpClock) -> Scan:
    plc.cycle(0.0)
    return scan_of(dict(plc.image.truth), clock.now())


class TwoBearings:
    """A gateway's two blocks, armed or not, and the PLC that takes them in."""

    def __init__(self, config: Config) -> None:
        self.plc = Plc(read_map(MAP), EmulatorClock(0.0, 0.0, 1.0))
        self.plc.begin(0.0)
        self.clock, self.driver = JumpClock(), DriverOfPlc(self.plc)
        self.config = config

    async def offer(self, writing: WritebackStage) -> list[str]:
        """A scan through both blocks; gives what became of each."""
        self.clock.time += 1.0
        scan = scanned(self.plc, self.clock)
        await writing.begin(scan, [1, 2])
        verdicts = []
        for block in writing.blocks:
            attempt = await block.writer.offer(scan, {"age": 0.0}, USABLE)
            assert attempt is not None
            verdicts.append(attempt.verdict)
        self.plc.cycle(0.0)
        return verdicts

    @property
    def usable(self) -> list[bool]:
        return [bool(self.plc.image.truth[name]) for name in ("PredictionUsable", "PredictionUsableAlimentazione")]


async def test_one_arming_lets_both_be_written_as_sessions_of_their_own_and_one_disarming_takes_both_back(
    tmp_path: Path,
) -> None:
    config = config_in(tmp_path, writeback__mode="shadow")
    both = TwoBearings(config)
    supervisor = Supervisor()
    store, historian = one_machine(config.historian.path, config.map.tags, supervisor=supervisor)
    with open_log(config.log.path, "info") as log:
        trail = open_audit_trail(config, historian=historian, supervisor=supervisor, log=log)
        writing = WritebackStage(
            config,
            config.map.writebacks,
            trail,
            clock=both.clock,
            driver=both.driver,
            historian=historian,
            of_blocks=[historian, historian],
            supervisor=supervisor,
            log=log,
            rng=Random(1),
        )
        gearbox, feed = (block.writer for block in writing.blocks)
        assert gearbox.number == feed.number, "the number is of this start, not of a block"
        assert await both.offer(writing) == ["shadow", "shadow"] and both.driver.sent == []
        with pytest.raises(ArmingError, match="needs a reason"):
            await writing.arm("Ada", "", 5.0)
        await writing.arm("Ada", "both bearings", 5.0)
        assert await both.offer(writing) == ["written", "written"] and both.usable == [True, True]
        assert [address for address, _ in both.driver.sent] == [400, 430]
        challenges = [words[22] for _, words in both.driver.sent]
        assert challenges[0] != challenges[1] and all(challenges)

        # What was made for one is refused by the other, and changes nothing of it.
        (_, of_gearbox), (_, of_feed) = both.driver.sent
        before = [intake.accepted for intake in both.plc.intakes]
        both.plc.write("stranger", "holding", 430, of_gearbox, 0.0)
        both.plc.write("stranger", "holding", 400, of_feed, 0.0)
        both.plc.cycle(0.0)
        assert [intake.accepted for intake in both.plc.intakes] == before and both.usable == [True, True]
        assert {intake.last_refusal for intake in both.plc.intakes} == {"another challenge"}

        # The PLC's account of one is not the other's.
        both.plc.write("stranger", "holding", 430, [2, 0], 0.0)
        await both.offer(writing)
        assert (gearbox.counters.refused, feed.counters.refused) == (1, 2)
        assert feed.counters.last_refusal == "length or start" and gearbox.counters.last_refusal == "another challenge"

        both.driver.sent.clear()
        assert await writing.disarm("Bea", "enough", scanned(both.plc, both.clock), [1, 2])
        assert [(address, words[3], words[19]) for address, words in both.driver.sent] == [(400, 0, 1), (430, 0, 2)]
        both.plc.cycle(0.0)
        assert both.usable == [False, False] and not writing.armed
        assert await both.offer(writing) == ["shadow", "shadow"]
        assert trail.close(both.clock.now())
    store.close()
    logged = read(config.audit)
    assert [row.entry.kind for row in logged if row.entry.kind in (ARMED, CONFIRMED, DISARMED)] == [
        ARMED,
        CONFIRMED,
        DISARMED,
    ], "one word of a person is one row, however many blocks"
    written = [row.entry.detail.get("block", "") for row in logged if row.entry.kind == "write"]
    assert written.count("Alimentazione") == written.count("") == 3


async def test_another_writer_of_one_block_is_known_by_that_blocks_tags_alone() -> None:
    layouts, clock = load_device(MAP).writebacks, JumpClock()
    writers = [Writer(layout, clock, "shadow", 101) for layout in layouts]
    reasons = {7: "another writer"}
    for count in (0, 3):
        scan = scan_of(
            {
                **dict.fromkeys(("BlocksAccepted", "BlocksRefused", "BlocksAcceptedAlimentazione"), 0),
                "BlocksRefusedAlimentazione": count,
                "LastRefusalAlimentazione": 7,
                "SessionWriterAlimentazione": 202,
            },
            clock.now(),
        )
        said = [writer.take_counts(scan, reasons) for writer in writers]
    assert said[0] == "" and "number 202 has the session" in said[1]
    assert [writer.counters.other_writer for writer in writers] == [None, 202]


# ---------------------------------------------------------------- the software PLC


def test_no_two_blocks_ever_have_the_same_challenge_also_where_the_counter_begins_anew() -> None:
    for start in (1, 2, 32766, 32767, 65535):
        plc = Plc(read_map(MAP), EmulatorClock(0.0, 0.0, 1.0), settings=PlcSettings(challenge=start))
        plc.begin(0.0)
        for _ in range(6):
            turn(plc)
            first, second = (intake.challenge for intake in plc.intakes)
            assert 1 <= first <= 65535 and 1 <= second <= 65535 and first % 2 == 1 and second % 2 == 0


def test_status_and_acknowledge_bits_of_each_block_and_the_present_keys_for_the_first() -> None:
    plc = Plc(read_map(MAP), EmulatorClock(0.0, 0.0, 1.0))
    plc.begin(0.0)
    assert COMMANDS["acknowledge"](plc, 0.0, bits=5, block="Alimentazione") == {"bits": 5}
    plc.write("stranger", "holding", 430, [0], 0.0)
    plc.cycle(0.0)
    status = COMMANDS["status"](plc, 0.0)
    blocks = status["blocks"]
    assert isinstance(blocks, list) and [block["temperature"] for block in blocks] == [GEARBOX, FEED]
    assert [block["refused"] for block in blocks] == [0, 1] and status["refused"] == 0 and status["acknowledged"] == 0
    assert plc.image.truth["AcknowledgeBitsAlimentazione"] == 5 and plc.image.truth["AcknowledgeBits"] == 0
    with pytest.raises(ValueError, match=re.escape("there is no block 'Due'")):
        COMMANDS["acknowledge"](plc, 0.0, bits=5, block="Due")


def test_the_gateways_driver_may_write_both(tmp_path: Path) -> None:
    config = config_in(tmp_path, writeback__mode="shadow")
    driver = make_driver(config, JumpClock())
    assert {address for _, address in driver._writable_addresses} == {*range(400, 426), *range(430, 456)}  # type: ignore[attr-defined]
