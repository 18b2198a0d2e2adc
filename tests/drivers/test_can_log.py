"""Recorded CAN logs: every format that can be read here, garbage of all kinds, and their replay as a device."""

import gzip
import random
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from itertools import accumulate, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.frame import CanFrame
from drivers.driver import Driver, Explains, open_driver, open_recording
from drivers.errors import AddressError, DriverError, LinkDown, RecordingError
from drivers.tag import DType, Quality, Sample, Tag
from drivers.vehicle.log import FORMATS, open_log, require_frames
from drivers.vehicle.replay import Timeline
from tests.drivers.can_frames import candump, isotp

SPEED = Tag("speed", "obd:0C", unit="rpm")
COOLANT = Tag("coolant", "obd:05", unit="degC")
VIN = Tag("vin", "obd:vin", DType.STRING)
WORDS = "vin, calibration, unit_name, codes, pending, permanent"
TAGS = (SPEED, COOLANT, VIN)


def answer(parameter: int, data: bytes) -> bytes:
    return isotp(bytes([0x41, parameter]) + data)[0]


def trip(seconds: int, start: float = 1000.0) -> list[CanFrame]:
    """Each second the speed (100 rpm more each time) and the coolant's temperature (1 degC more)."""
    frames = []
    for second in range(seconds):
        speed = answer(0x0C, (400 * second).to_bytes(2, "big"))
        frames.append(CanFrame(start + second, 0x7E8, False, speed))
        frames.append(CanFrame(start + second + 0.1, 0x7E8, False, answer(0x05, bytes([40 + second]))))
    return frames


@dataclass
class Clock:
    now: float = 0.0

    def __call__(self) -> float:
        return self.now


def decoded(path: Path, tags: Sequence[Tag] = TAGS, **given: Any) -> tuple[list[Sample], dict[str, int]]:
    recorded = open_recording("can-log", path, given, tags)
    samples = list(recorded.samples(lambda _, __: None))
    return samples, dict(recorded.counts())


def written(path: Path, frames: Iterable[CanFrame]) -> Path:
    """The frames as python-can writes them in the format of the file's suffix."""
    with can.Logger(str(path)) as logger:
        for frame in frames:
            logger.on_message_received(
                can.Message(
                    timestamp=frame.time, arbitration_id=frame.id, is_extended_id=frame.extended, data=frame.data,
                    channel=0, is_fd=frame.fd,
                )
            )  # fmt: skip
    return path


# ------------------------------------------------------------------ formats


MF4 = pytest.param(".mf4", marks=pytest.mark.skipif(find_spec("asammdf") is None, reason="asammdf is not installed"))


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".csv", MF4])
def test_a_log_of_each_format_gives_the_values_that_were_written(suffix: str, tmp_path: Path) -> None:
    frames = [
        *trip(30),
        *(
            CanFrame(1031 + n * 0.01, 0x18DAF110, True, data)
            for n, data in enumerate(isotp(b"\x49\x02\x01" + b"V" * 17))
        ),
    ]
    samples, counts = decoded(written(tmp_path / f"trip{suffix}", frames))
    assert counts["log_frames"] == len(frames)
    assert {quality for _, quality in ((s.tag, s.quality) for s in samples)} == {Quality.GOOD}
    assert [s.value for s in samples if s.tag == "speed"] == [100.0 * n for n in range(30)]
    assert [s.value for s in samples if s.tag == "coolant"] == list(range(30))
    assert [s.value for s in samples if s.tag == "vin"] == ["V" * 17]
    steps = [b.time - a.time for a, b in pairwise(samples)]
    assert steps[0] == pytest.approx(0.1, abs=2e-3)


def test_a_compressed_log_is_read_too_and_the_format_may_be_given(tmp_path: Path) -> None:
    text = candump(trip(5)).encode()
    (tmp_path / "trip.log.gz").write_bytes(gzip.compress(text))
    (tmp_path / "trip.txt").write_bytes(text)
    assert decoded(tmp_path / "trip.log.gz")[0] == decoded(tmp_path / "trip.txt", format="candump")[0]


def test_mf4_without_its_package_is_one_clear_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.vehicle.log.find_spec", lambda _: None)
    path = tmp_path / "trip.mf4"
    path.write_bytes(b"MDF     4.11    ")
    with pytest.raises(RecordingError, match="MF4 logs need the package asammdf, which is not installed here"):
        open_log(path)


# ------------------------------------------------------------------ garbage


@pytest.mark.parametrize("suffix", sorted({f".{name}" for name in FORMATS} | {".log", ".log.gz"} - {".candump"}))
def test_what_is_no_log_is_one_sentence(suffix: str, tmp_path: Path) -> None:
    noise = random.Random(3).randbytes(20_000)
    (tmp_path / f"empty{suffix}").touch()
    (tmp_path / f"noise{suffix}").write_bytes(noise)
    (tmp_path / f"prose{suffix}").write_text("This is not a log.\n" * 50)
    (tmp_path / f"folder{suffix}").mkdir()
    for name in ("empty", "noise", "prose", "folder", "absent"):
        with pytest.raises(RecordingError) as caught:
            decoded(tmp_path / f"{name}{suffix}")
        assert str(caught.value).startswith(str(tmp_path / f"{name}{suffix}"))
        assert "\n" not in str(caught.value)


def test_an_unknown_suffix_is_one_sentence_with_the_known_ones(tmp_path: Path) -> None:
    path = tmp_path / "trip.dat"
    path.write_text(candump(trip(1)))
    with pytest.raises(RecordingError, match=r"give it as one of candump, asc, trc, csv, blf, mf4"):
        decoded(path)
    with pytest.raises(RecordingError, match="'pcap' is no format of CAN logs"):
        decoded(path, format="pcap")


def test_bad_lines_are_counted_and_cost_no_other_line(tmp_path: Path) -> None:
    lines = candump(trip(10)).splitlines(keepends=True)
    bad = [
        "(1.0) can0 7E8#0341054\n", "(nan) can0 7E8#0341054000000000\n", "(1.0) can0 7E8\n", "#\n",
        "(1.0) can0 FFFFF#00\n", "(1.0) can0 7E8#034105400000000000\n", "\x00\xff\x00\n",
        "(1.0) can0 FFF#0341054000000000\n", "x" * 100_000 + "\n",
    ]  # fmt: skip
    mixed = [part for line, extra in zip(lines, [*bad, *[""] * len(lines)], strict=False) for part in (line, extra)]
    path = tmp_path / "trip.log"
    path.write_bytes("".join(mixed).encode("latin-1"))
    samples, counts = decoded(path)
    (tmp_path / "clean.log").write_text("".join(lines))
    assert samples == decoded(tmp_path / "clean.log")[0]
    assert (counts["log_frames"], counts["log_refused"]) == (20, len(bad))


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc"])
def test_bad_lines_of_other_text_formats_cost_no_other_line(suffix: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"trip{suffix}", trip(10))
    clean = decoded(path)[0]
    lines = path.read_text().splitlines(keepends=True)
    middle = next(n for n, line in enumerate(lines) if " 7E8" in line or "07E8" in line or "0x7e8" in line) + 4
    broken = lines[middle].replace("7E8", "7ZZ").replace("0x7e8", "0xzz")
    path.write_text("".join([*lines[:middle], broken, "\x01noise\n", *lines[middle:]]))
    assert decoded(path)[0] == clean


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".csv"])
def test_a_log_cut_anywhere_gives_what_lies_before_the_cut_and_no_other_value(suffix: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"trip{suffix}", trip(40))
    whole, content = decoded(path)[0], path.read_bytes()
    for cut in range(len(content) - 1, len(content) // 2, -len(content) // 40):
        path.write_bytes(content[:cut])
        try:
            samples, _ = decoded(path)
        except RecordingError:
            continue
        good = [s for s in samples if s.quality.is_good]
        assert good == whole[: len(good)]


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 30))
def test_a_damaged_blf_never_crashes_or_hangs(tmp_path_factory: pytest.TempPathFactory, seed: int, hits: int) -> None:
    content = bytearray(blf())
    place = random.Random(seed)
    for _ in range(hits):
        content[place.randrange(len(content))] = place.randrange(256)
    path = tmp_path_factory.getbasetemp() / "damaged.blf"
    path.write_bytes(content)
    try:
        decoded(path)
    except DriverError as error:
        assert str(path) in str(error)


@cache
def blf() -> bytes:
    """An uncompressed BLF: damage in a compressed one is found by its checksum."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "trip.blf"
        with can.BLFWriter(str(path), compression_level=0) as writer:
            for frame in trip(40):
                message = can.Message(
                    timestamp=frame.time, arbitration_id=frame.id, is_extended_id=False, data=frame.data
                )
                writer.on_message_received(message)
        return path.read_bytes()


def test_an_uncompressed_blf_with_an_object_of_no_length_ends_there(tmp_path: Path) -> None:
    place = blf().rindex(b"LOBJ")
    path = tmp_path / "stuck.blf"
    path.write_bytes(blf()[: place + 6] + (3).to_bytes(2, "little") + bytes(4) + blf()[place + 12 :])
    samples, counts = decoded(path)
    assert (len(samples), counts["log_broken"]) == (79, 1)
    assert all(s.quality.is_good for s in samples)


def test_error_remote_and_fd_frames_are_counted_and_are_no_values(tmp_path: Path) -> None:
    path = tmp_path / "trip.log"
    error = "(1.0) can0 20000004#0001000000000000\n(1.0) can0 20000088#0000000000000000\n"
    remote = "(1.1) can0 7E8#R\n(1.1) can0 7E8#R8\n"
    fd = "(1.2) can0 7E8##10341057B00000000\n(1.2) can0 18FEEE00##0" + "00" * 64 + "\n"
    path.write_text(error + remote + fd + candump(trip(2)))
    samples, counts = decoded(path, [*TAGS, Tag("truck", "spn:110")])
    assert (counts["log_error_frames"], counts["log_remote_frames"], counts["log_frames"]) == (2, 2, 6)
    assert [s.value for s in samples] == [0.0, 0, 100.0, 1]


def test_ten_thousand_random_frames_give_no_good_value_that_they_do_not_hold(tmp_path: Path) -> None:
    noise = random.Random(11)
    frames = [
        CanFrame(n * 0.001, identifier, identifier > 0x7FF, noise.randbytes(noise.randrange(9)))
        for n in range(10_000)
        for identifier in (
            noise.choice([0x7DF, 0x7E8, 0x123, 0x18DAF110, 0x18FEEE00, 0x1CECFF00, 0x1CEBFF00, noise.getrandbits(29)]),
        )
    ]
    path = tmp_path / "noise.log"
    path.write_text(candump(frames))
    tags = [*TAGS, Tag("truck", "spn:110"), Tag("codes", "dm1:codes", DType.STRING)]
    samples, counts = decoded(path, tags)
    assert counts["log_frames"] == 10_000
    good = [s for s in samples if s.quality.is_good and s.tag in ("speed", "coolant", "truck")]
    assert good
    for sample in good:
        assert _holds(frames[round(sample.time / 0.001)], sample)
    transport = sum(count for name, count in counts.items() if name.startswith("tp_"))
    assert counts["frames"] == 10_000 == counts["single"] + counts["not_j1939"] + transport


def _holds(frame: CanFrame, sample: Sample) -> bool:
    """Whether a frame says the sample's number, read here by hand."""
    data = frame.data
    if sample.tag == "truck":
        return frame.id & 0x03FFFFFF == 0x00FEEE00 and data[0] <= 0xFA and data[0] - 40 == sample.value
    parameter, length = {"speed": (0x0C, 2), "coolant": (0x05, 1)}[sample.tag]
    body = data[1 : 1 + data[0]]
    at = next((n for n in range(1, len(body)) if body[n] == parameter), -1)
    raw = int.from_bytes(body[at + 1 : at + 1 + length], "big")
    value = raw / 4 if sample.tag == "speed" else raw - 40
    return frame.id in (0x7E8, 0x18DAF110) and body[0] == 0x41 and at > 0 and value == sample.value


def test_an_address_or_a_setting_that_means_nothing_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "trip.log"
    path.write_text(candump(trip(1)))
    with pytest.raises(AddressError, match="it: "):
        decoded(path, [Tag("it", "obd:zz")])
    with pytest.raises(DriverError, match=r"colour: there is no such key; known are .*dbc"):
        decoded(path, colour="red")
    with pytest.raises(DriverError, match="answer_timeouts: speed: -1 must be seconds above 0"):
        decoded(path, answer_timeouts={"speed": -1})
    with pytest.raises(DriverError, match="driver 'modbus' has no recordings; give a device of can or can-log"):
        open_recording("modbus", path, {}, TAGS)


def test_a_log_without_a_data_frame_says_what_it_has_instead(tmp_path: Path) -> None:
    path = tmp_path / "errors.log"
    path.write_text("(1.0) can0 20000004#0001000000000000\n")
    log = open_log(path)
    assert list(log.frames()) == []
    with pytest.raises(RecordingError, match="there is no data frame in this candump log: 1 error frames"):
        require_frames(log)


# ------------------------------------------------------------------ plain fields


def test_plain_fields_and_obd_tags_come_from_the_same_log(tmp_path: Path) -> None:
    path = tmp_path / "mixed.log"
    path.write_text(candump([*trip(2), CanFrame(1003.0, 0x181, False, b"\0\0\x34\x12\0\0\0\0")]))
    samples, _ = decoded(path, [SPEED, Tag("plain", "0x181:16|16")])
    assert Counter(s.tag for s in samples) == {"speed": 2, "plain": 1}
    assert samples[-1].value == 0x1234


def test_only_the_bus_that_is_asked_for_is_listened_to(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    path.write_text(candump(trip(3), "can0") + candump(trip(2, 2000.0), "can1"))
    assert len(decoded(path, [SPEED], bus="can1")[0]) == 2
    assert len(decoded(path, [SPEED])[0]) == 5


# ------------------------------------------------------------------ the line of times


@settings(max_examples=200)
@given(st.lists(st.floats(-1e9, 1e12), min_size=1, max_size=50))
def test_the_line_of_times_never_goes_back_and_no_pause_is_longer_than_allowed(logged: list[float]) -> None:
    line = Timeline(60.0)
    played = [line.play_time(time) for time in logged]
    assert played[0] == 0.0
    for before, after in pairwise(played):
        assert before <= after <= before + 60.0 + 1e-3


def test_times_that_jitter_keep_their_line_and_a_clock_set_back_goes_on() -> None:
    line = Timeline(60.0)
    assert [line.play_time(time) for time in (100.0, 101.0, 100.5, 102.0)] == [0.0, 1.0, 1.0, 2.0]
    assert [line.play_time(time) for time in (50.0, 51.0)] == [2.0, 3.0]
    assert line.play_time(5000.0) == 63.0
    assert line.counts == {"back": 2, "shortened": 1}


# ------------------------------------------------------------------ the driver


def replayed(path: Path, clock: Clock, **given: Any) -> Driver:
    return open_driver("can-log", {"log": str(path), **given}, clock=clock)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "trip.log"
    path.write_text(candump(trip(20)))
    return path


async def test_the_log_begins_when_it_is_opened_and_a_value_has_the_moment_at_which_it_was_played(log: Path) -> None:
    clock = Clock(5000.0)
    driver = replayed(log, clock)
    assert isinstance(driver, Driver)
    await driver.open()
    clock.now = 5003.05
    speed, coolant = await driver.read([SPEED, COOLANT])
    assert (speed.value, speed.quality, speed.time, speed.sent) == (300.0, Quality.GOOD, pytest.approx(5003.0), None)
    assert (coolant.value, coolant.time) == (2, pytest.approx(5002.1))
    assert driver.connected


async def test_a_moment_of_beginning_and_a_speed_can_be_given(log: Path) -> None:
    clock = Clock(200.0)
    driver = replayed(log, clock, start=100.0, speed=0.1)
    await driver.open()
    (speed,) = await driver.read([SPEED])
    assert (speed.value, speed.time) == (1000.0, pytest.approx(200.0))


async def test_values_age_and_the_end_of_the_log_is_silence(log: Path) -> None:
    clock = Clock()
    driver = replayed(log, clock, answer_timeout=4.0, answer_timeouts={"coolant": 100.0})
    await driver.open()
    clock.now = 23.9
    speed, coolant, vin = await driver.read(TAGS)
    assert (speed.value, speed.quality) == (None, Quality.TIMEOUT)
    assert speed.reason == "told 4.9 s ago, limit 4 s; the log has ended"
    assert (coolant.value, coolant.quality, coolant.time) == (19, Quality.GOOD, pytest.approx(19.1))
    assert (vin.value, vin.quality) == (None, Quality.WAITING_FOR_INITIAL_DATA)
    clock.now = 30.0
    await driver.read([SPEED])
    assert not driver.connected


async def test_with_loop_the_log_begins_anew(log: Path) -> None:
    clock = Clock()
    driver = replayed(log, clock, loop=True)
    await driver.open()
    clock.now = 19.1 + 1.0 + 3.05
    (speed,) = await driver.read([SPEED])
    assert (speed.value, speed.quality) == (300.0, Quality.GOOD)
    assert driver.statistics()["rounds"] == 2


async def test_it_answers_in_the_order_asked_and_says_of_a_bad_address_what_is_wrong(log: Path) -> None:
    clock = Clock()
    driver = replayed(log, clock)
    await driver.open()
    clock.now = 1.0
    bad = Tag("bad", "holding:3")
    samples = await driver.read([COOLANT, bad, SPEED, SPEED])
    assert [sample.tag for sample in samples] == ["coolant", "bad", "speed", "speed"]
    assert samples[1].quality is Quality.CONFIGURATION_ERROR
    assert "address 'holding:3' is not known here" in samples[1].reason
    assert samples[2] == samples[3]
    assert await driver.read([]) == []


async def test_before_open_and_after_close_nothing_is_good_and_close_may_be_called_twice(log: Path) -> None:
    clock = Clock()
    driver = replayed(log, clock)
    for _ in range(2):
        assert {s.quality for s in await driver.read(TAGS)} == {Quality.NOT_CONNECTED}
        await driver.open()
        clock.now += 1.0
        assert (await driver.read([SPEED]))[0].quality is Quality.GOOD
        await driver.close()
        await driver.close()
        assert not driver.connected


async def test_a_log_that_has_gone_is_waited_for(log: Path) -> None:
    clock = Clock()
    driver = replayed(log, clock)
    log.rename(log.with_suffix(".away"))
    with pytest.raises(LinkDown, match="is not there any more"):
        await driver.open()
    assert (await driver.read([SPEED]))[0].quality is Quality.NOT_CONNECTED
    log.with_suffix(".away").rename(log)
    assert (await driver.read([SPEED]))[0].value == 0.0


def test_it_explains_what_it_plays_and_what_cannot_be_read(log: Path) -> None:
    driver = replayed(log, Clock(), speed=2.0, answer_timeouts={"speed": 3.0})
    assert isinstance(driver, Explains)
    assert driver.explain([SPEED, Tag("bad", "obd:zz")]) == (
        f"bad: 'zz' is neither a parameter such as 0C nor one of {WORDS}",
        f"{log} is replayed at 2 times its speed",
        "obd:0C, bad after 3 s: speed",
    )


def test_a_log_that_cannot_be_used_is_refused_before_anything_runs(tmp_path: Path) -> None:
    path = tmp_path / "noise.log"
    path.write_text("no log\n")
    for keys, words in (
        ({"log": str(path)}, "there is no data frame"),
        ({"log": str(tmp_path)}, "is a folder"),
        ({}, "log: is missing; give the path"),
        ({"log": str(path), "speed": 0.0}, "speed: must be at least 1e-06, got 0.0"),
    ):
        with pytest.raises(DriverError, match=words):
            open_driver("can-log", keys, clock=Clock())


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 3000), min_size=1, max_size=40))
async def test_polled_at_any_moments_the_replay_gives_what_the_whole_log_says_at_that_time(
    tmp_path_factory: pytest.TempPathFactory, steps: list[int]
) -> None:
    path = tmp_path_factory.getbasetemp() / "steps.log"
    path.write_text(candump(trip(20)))
    clock = Clock()
    driver = replayed(path, clock, answer_timeout=1000.0)
    await driver.open()
    for milliseconds in accumulate(steps):
        clock.now = milliseconds / 1000
        (speed,) = await driver.read([SPEED])
        assert speed.value == 100.0 * min(19, milliseconds // 1000)
