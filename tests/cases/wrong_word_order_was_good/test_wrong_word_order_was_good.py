"""A float bound in a wrong word order read 2.4e-41 degC: good in `check`, followed by `run`, zone green, no alarm."""

import re
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import structlog

from drivers.codec import decode, encode
from drivers.errors import EncodingError
from drivers.tag import DType, Order, Quality, Sample, Tag
from gateway.commission.hmi import HmiReading, compare
from gateway.machine.reading.link_health import LinkHealth
from gateway.machine.reading.quality import DeviceAge, QualityRules, judge
from gateway.repeated import drop_measurements
from tests.commission.bench import answer, at, force, plc
from tests.gateway.support import scan_of
from tests.plc.bench import DECANTER, Process, running

T = Tag("T", "holding:105", DType.FLOAT32, Order.ABCD, unit="degC")
HEAT = "TCuscinettiRiduttore"


def words(value: float, order: Order, dtype: DType = DType.FLOAT32) -> list[int]:
    """The registers of a device that has this order."""
    return encode(replace(T, order=order, dtype=dtype), value)


@pytest.mark.parametrize("dtype", [DType.FLOAT32, DType.FLOAT64])
@pytest.mark.parametrize("held", list(Order))
@pytest.mark.parametrize("value", [40.8, 40.0, -40.8, 23.5, 1450.0])
def test_a_float_in_a_wrong_order_is_not_good_and_the_right_one_is_named(
    dtype: DType, held: Order, value: float
) -> None:
    for read in Order:
        number, quality, reason = decode(replace(T, dtype=dtype, order=read), words(value, held, dtype))
        if read is held:
            assert (number, quality) == (pytest.approx(value), Quality.GOOD)
        elif number is None:
            assert quality is Quality.DATA_ENCODING_INVALID
            assert f"swapped: as {held} it reads {value}" in reason, reason
        else:
            # Now and then the bytes of a wrong order make a number like any other; the tag's range refuses it, and
            # the reading after it (see below).
            assert quality is Quality.GOOD and 1e-6 <= abs(number) <= 1e12


def test_the_readings_of_the_report_name_the_order_that_is_right() -> None:
    for value, shown in ((40.0, "40.0"), (40.8, "40.8")):
        _, quality, reason = decode(T, words(value, Order.CDAB))
        assert quality is Quality.DATA_ENCODING_INVALID
        assert f"the words look swapped: as CDAB it reads {shown}" in reason


@pytest.mark.parametrize(("dtype", "form"), [(DType.FLOAT32, ">f"), (DType.FLOAT64, ">d")])
@pytest.mark.parametrize("number", [1e-44, 2.4e-41, -1e-39, 9e-31, -9e-31, 1.1e30, -3e38])
def test_what_nobody_measures_is_not_good_whatever_the_other_orders_say(dtype: DType, form: str, number: float) -> None:
    raw = struct.pack(form, number)
    value, quality, reason = decode(
        replace(T, dtype=dtype, low=-1e39, high=1e39), struct.unpack(f">{len(raw) // 2}H", raw)
    )
    assert (value, quality) == (None, Quality.DATA_ENCODING_INVALID)
    assert "than anything measured" in reason


@pytest.mark.parametrize("dtype", [DType.FLOAT32, DType.FLOAT64])
def test_both_zeros_are_good_and_a_nan_is_a_sensors_unless_its_words_are_swapped(dtype: DType) -> None:
    tag = replace(T, dtype=dtype)
    for order in Order:
        assert decode(tag, words(0.0, order, dtype))[:2] == (0.0, Quality.GOOD)
    assert decode(tag, words(-0.0, Order.ABCD, dtype))[1] is Quality.GOOD
    quiet = struct.unpack(">2H" if dtype is DType.FLOAT32 else ">4H", struct.pack(
        ">f" if dtype is DType.FLOAT32 else ">d", float("nan")))  # fmt: skip
    assert decode(tag, quiet)[1:] == (Quality.SENSOR_FAILURE, "the device sent nan")
    _, quality, reason = decode(T, [0xFFC1, 0x4223])  # 40.999...: its low word is the high one of a NaN
    assert quality is Quality.SENSOR_FAILURE and "as CDAB it reads 41.0" in reason


def test_small_numbers_are_good_where_no_other_order_makes_a_usual_one_or_the_tag_expects_them() -> None:
    assert decode(T, [0x3380, 0x0000])[:2] == (2.0**-24, Quality.GOOD)  # a remainder of a PLC's arithmetic
    vacuum = [0x3333, 0x4223]  # 4.17e-8, and as CDAB 40.8
    assert decode(T, vacuum)[1] is Quality.DATA_ENCODING_INVALID
    assert decode(replace(T, low=0.0, high=1e-3), vacuum)[1] is Quality.GOOD
    assert decode(replace(T, low=1e-9, high=1000.0), vacuum)[1] is Quality.GOOD
    # On a bus that has one order nobody is told to try another.
    assert decode(T, vacuum, one_order=True)[1] is Quality.GOOD
    assert "swapped" not in decode(T, [0, 0x4220], one_order=True)[2]


def test_a_swapped_integer_that_is_measured_is_uncertain_and_bits_and_counters_are_not_accused() -> None:
    measured = Tag("T", "holding:105", DType.INT32, Order.ABCD, 0.1, unit="degC")
    for value in (40.8, -40.8, 3000.0):
        registers = encode(replace(measured, order=Order.CDAB), value)
        read, quality, reason = decode(measured, registers)
        assert quality is Quality.UNCERTAIN and isinstance(read, float) and abs(read) > 1000.0
        assert f"as CDAB it reads {value}" in reason
        _, quality, reason = decode(replace(measured, low=-50.0, high=3000.0), registers)
        assert quality is Quality.OUT_OF_RANGE and f"as CDAB it reads {value}" in reason
        assert decode(replace(measured, order=Order.CDAB), registers)[1] is Quality.GOOD
    assert decode(measured, [1, 1])[1] is Quality.GOOD
    assert decode(Tag("Alarms", "holding:1", DType.UINT32), [0x0008, 0])[1] is Quality.GOOD


def test_of_drawn_temperatures_no_swapped_reading_but_the_first_is_ever_good() -> None:
    """A wrong order makes a usual number of one reading in five: it is not believed after one that was none."""
    rng = np.random.default_rng(5)
    for held in (Order.CDAB, Order.BADC, Order.DCBA):
        age, seen = DeviceAge(), []
        for now in range(60):
            value, quality, reason = decode(T, words(float(rng.normal(40.8, 0.3)), held))
            sample = Sample("T", value, quality, float(now), float(now), reason)
            age, judged = judge(age, [T], [sample], float(now), QualityRules(1.0))
            seen.append(judged["T"].quality)
        first_doubt = seen.index(Quality.DATA_ENCODING_INVALID)
        assert first_doubt < 5
        assert not any(quality.is_good for quality in seen[first_doubt:])


def test_once_the_order_is_put_right_the_tag_is_good_again_after_ten_periods() -> None:
    age, qualities = DeviceAge(), []
    bad = Sample("T", None, Quality.DATA_ENCODING_INVALID, 0.0, 0.0, "the device sent 4e-41")
    for now in range(13):
        sample = bad if now == 0 else Sample("T", 40.8, Quality.GOOD, float(now), float(now))
        age, judged = judge(age, [T], [sample], float(now), QualityRules(1.0))
        qualities.append(judged["T"].quality)
    assert set(qualities[1:10]) == {Quality.UNCERTAIN}
    assert qualities[-1] is Quality.GOOD


def test_run_says_it_once_although_the_number_is_another_one_in_each_scan() -> None:
    with structlog.testing.capture_logs() as logs:
        health, age = LinkHealth(structlog.get_logger()), DeviceAge()
        for now, value in enumerate((40.8, 40.9, 41.2, 40.0)):
            number, quality, reason = decode(T, words(value, Order.CDAB))
            sample = Sample("T", number, quality, float(now), float(now), reason)
            age, judged = judge(age, [T], [sample], float(now), QualityRules(1.0))
            health.take(replace(scan_of({}, float(now)), samples=judged))
    own = [line for line in logs if line.get("tag") == "T"]
    assert len(own) == 1 and "as CDAB it reads 40.8" in own[0]["reason"]
    assert len({drop_measurements(decode(T, words(value, Order.CDAB))[2]) for value in (40.0, 41.0, 42.0)}) == 1


def test_verify_names_the_order_in_which_the_plc_has_what_the_hmi_shows() -> None:
    point = compare(replace(T, dtype=DType.INT32), HmiReading("T", "408"), [408 << 16], 0.0)
    assert not point.ok and "as CDAB it reads 408.0" in point.reason
    read = decode(T, words(40.1, Order.BADC))
    missing = compare(T, HmiReading("T", "40.1"), [], 0.0, missing=read[2])
    assert "no good reading" in missing.reason and "as BADC it reads 40.1" in missing.reason


def test_what_is_written_is_never_what_would_not_be_believed() -> None:
    assert encode(T, 1e-40) == [0, 0]
    with pytest.raises(EncodingError, match="larger than anything measured"):
        encode(T, 2e30)


# ---------------------------------------------------------------- the commands, on a PLC that holds CDAB


@pytest.fixture(scope="module")
def device() -> Iterator[Process]:
    with running() as process:
        force(process, HEAT, 40.8)
        yield process


@pytest.fixture(scope="module")
def swapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The device file of the PLC with the orders left out."""
    path = tmp_path_factory.mktemp("swapped") / "plc.toml"
    path.write_text(re.sub(r"(?m)^order = .*\n", "", DECANTER.read_text(encoding="utf-8")), encoding="utf-8")
    return path


def test_check_soak_verify_and_read_say_that_the_words_look_swapped(
    device: Process, swapped: Path, tmp_path: Path
) -> None:
    where = ("--device", swapped, *at(device))
    check = answer(tmp_path, "check", *where)
    (row,) = [row for row in check["readings"] if row["tag"] == HEAT]
    assert check["exit"] == 1 and row["quality"] == "DATA_ENCODING_INVALID" and row["value"] is None
    assert any("as CDAB it reads 40.8" in step["sentence"] for step in check["steps"])
    soak = answer(tmp_path, "soak", "--seconds", 0.5, "--period", 0.1, *where)
    assert soak["exit"] == 1 and soak["bad_tags"][HEAT] == soak["scans"]
    (kind,) = [reason for reason in soak["reasons"] if "as CDAB it reads 40.8" in reason]
    assert soak["reasons"][kind] == soak["scans"]
    shown = tmp_path / "hmi.csv"
    shown.write_text(f"Tag,Value\n{HEAT},40.8\n", encoding="utf-8")
    verify = answer(tmp_path, "verify", "--against", shown, "--only", HEAT, *where)
    assert verify["exit"] == 1 and "as CDAB it reads 40.8" in verify["points"][0]["reason"]
    # What was compared is not said to be "not compared yet".
    assert verify["left"][HEAT].startswith("compared and did not agree")
    read = plc(tmp_path, "read", HEAT, *where)
    assert read.exit_code == 1 and "as CDAB it reads 40.8" in read.stderr
