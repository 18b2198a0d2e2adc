"""`decanter plc guess`: known encodings are found from what the HMI shows, and a second reading removes the ties."""

import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.guess import verdict
from drivers.codec import encode
from drivers.tag import DType, Order, Tag
from gateway.commission.encodings.advice import advise
from gateway.commission.encodings.reading import ReadingError, ShownNumber, parse_display
from gateway.commission.encodings.scoring import EncodingCandidate, Observation, rank
from tests.commission.bench import answer, at, force, plc
from tests.plc.bench import Process, running

STRANGERS = {
    96: 17,
    97: 0,
    98: 3,
    99: 4711,
    100: 812,
    101: 22009,
    102: 9000,
    103: 61000,
    104: 0,
    105: 5,
    106: 1,
    107: 0,
}


def shown(words: dict[int, int], text: str) -> Observation:
    """The strangers with these registers among them, and what the HMI showed."""
    memory = STRANGERS | words
    reading = parse_display(text)
    assert isinstance(reading, ShownNumber)
    return Observation(96, tuple(memory[number] for number in sorted(memory)), reading)


def stored(tag: Tag, value: float) -> dict[int, int]:
    return {int(tag.address.partition(":")[2]) + place: word for place, word in enumerate(encode(tag, value))}


def first(found: list[EncodingCandidate]) -> tuple[int, DType, Order, float, float]:
    best = found[0]
    return best.address, best.dtype, best.order, best.scale, best.offset


@pytest.mark.parametrize(
    ("tag", "value", "text"),
    [
        (Tag("", "holding:100", DType.INT16, Order.ABCD, 0.1), 72.4, "72.4"),
        (Tag("", "holding:99", DType.INT16, Order.ABCD, 0.1), -7.3, "-7.3"),
        (Tag("", "holding:101", DType.FLOAT32, Order.ABCD), 72.418, "72.4"),
        (Tag("", "holding:100", DType.FLOAT32, Order.CDAB), 72.418, "72,4"),
        (Tag("", "holding:100", DType.FLOAT32, Order.DCBA), 1449.97, "1450.0"),
        (Tag("", "holding:99", DType.FLOAT32, Order.BADC), 3.14159, "3.142"),
        (Tag("", "holding:100", DType.INT32, Order.CDAB, 0.01), 123456.78, "123456.78"),
        (Tag("", "holding:100", DType.INT16, Order.ABCD, 0.1, -40.0), 24.5, "24.5"),
        (Tag("", "holding:100", DType.BCD16, Order.ABCD, 0.1), 72.4, "72.4"),
        (Tag("", "holding:100", DType.FLOAT64, Order.ABCD), 1013.2512, "1013.25"),
        (Tag("", "holding:100", DType.INT16, Order.BADC, 0.1), 72.4, "72.4"),
        (Tag("", "holding:100", DType.INT16, Order.ABCD, 0.5), 36.5, "36.5"),
    ],
    ids=lambda value: f"{value.dtype} {value.order} {value.address}" if isinstance(value, Tag) else str(value),
)
def test_one_reading_puts_a_usual_encoding_first(tag: Tag, value: float, text: str) -> None:
    found = rank([shown(stored(tag, value), text)], 100)
    address = int(tag.address.partition(":")[2])
    assert first(found) == (address, tag.dtype, tag.order, tag.scale, tag.offset)
    assert sum(one.share for one in found) <= 1.0 + 1e-9


def test_a_siemens_full_scale_of_27648_counts_is_found_from_two_readings() -> None:
    tag = Tag("", "holding:100", DType.INT16, Order.ABCD, 150 / 27648)
    readings = [shown(stored(tag, value), text) for value, text in ((72.413, "72.4"), (31.27, "31.3"))]
    assert first(rank(readings, 100))[3] == pytest.approx(150 / 27648)


def test_the_second_reading_leaves_only_what_explains_both() -> None:
    tag = Tag("", "holding:100", DType.INT32, Order.ABCD)
    one = rank([shown(stored(tag, 724.0), "724")], 100)
    assert (one[0].dtype, one[0].address) != (DType.INT32, 100)  # so far a 16-bit number at 101 explains it as well
    advice = advise(one, [shown(stored(tag, 724.0), "724")])
    limits = (advice.above, advice.twins_above)
    assert any(limit is not None and 724.0 < limit < 1e6 for limit in limits) and advice.sentences
    both = rank([shown(stored(tag, 724.0), "724"), shown(stored(tag, 300_000.0), "300000")], 100)
    assert first(both)[:3] == (100, DType.INT32, Order.ABCD)


def test_a_second_reading_from_where_the_advice_says_separates_every_tie() -> None:
    words = {100: 724, 101: 1448}  # 72.4 as tenths at 100, and as twentieths at 101
    start = shown(words, "72.4")
    found = rank([start], 100)
    advice = advise(found, [start])
    value = advice.above if advice.above is not None else advice.twins_above
    assert value is not None
    moved = shown({**words, 100: round(10 * value)}, f"{round(10 * value) / 10:.1f}")
    again = rank([start, moved], 100)
    tied = {(one.address, one.scale, one.offset) for one in advice.ties}
    assert tied.isdisjoint((one.address, one.scale, one.offset) for one in again if one.share > 0.01)


def test_nothing_is_found_where_nothing_explains_the_reading() -> None:
    words = dict.fromkeys(range(96, 108), 0)
    assert rank([shown(words, "72.4")], 100) == []
    assert advise([], []).sentences == ()


def test_without_a_reading_there_is_no_guess() -> None:
    with pytest.raises(ValueError, match="at least one reading"):
        rank([], 100)


@pytest.mark.parametrize(
    ("text", "value", "step"),
    [
        ("72.4", 72.4, 0.1),
        ("72,40", 72.4, 0.01),
        ("-3", -3.0, 1.0),
        ("1'250", 1250.0, 1.0),
        ("1.250,5", 1250.5, 0.1),
        ("1,250,000", 1_250_000.0, 1.0),
        (".5", 0.5, 0.1),
        ("12\u202f345,6", 12345.6, 0.1),
    ],
)
def test_a_reading_is_understood_as_hmis_write_it(text: str, value: float, step: float) -> None:
    found = parse_display(text)
    assert isinstance(found, ShownNumber)
    assert (found.value, found.step) == (pytest.approx(value), pytest.approx(step))


@pytest.mark.parametrize("text", ["", "warm", "1.2.3", "12-3", "--4", "5 °C"])
def test_what_is_no_reading_is_refused(text: str) -> None:
    with pytest.raises(ReadingError, match="is no reading"):
        parse_display(text)


def test_of_random_encodings_nine_in_ten_are_first_after_one_reading_and_nearly_all_after_two() -> None:
    verdicts = [verdict(seed) for seed in range(70_001, 70_061)]
    assert sum(one.one for one in verdicts) >= 0.88 * len(verdicts)
    assert sum(one.two for one in verdicts) >= 0.96 * len(verdicts), [one.described for one in verdicts if not one.two]


@pytest.fixture(scope="module")
def device() -> Iterator[Process]:
    with running() as process:
        force(process, "TCuscinettiRiduttore", 72.4375)
        force(process, "Assorbimento", 80.5)
        force(process, "TFango", 21.7)
        yield process


def test_the_bearing_temperature_is_found_although_the_manual_counts_from_1(device: Process, tmp_path: Path) -> None:
    data = answer(tmp_path, "guess", "holding:106", "72.44", *at(device))
    best = data["candidates"][0]
    assert (best["address"], best["dtype"], best["order"], best["shift"]) == ("holding:105", "float32", "CDAB", -1)
    assert best["reference"] == "40106"


def test_a_second_call_adds_its_reading_to_the_first_ones(device: Process, tmp_path: Path) -> None:
    answer(tmp_path, "guess", "holding:101", "80.5", *at(device))
    force(device, "Assorbimento", 120.0)
    data = answer(tmp_path, "guess", "holding:101", "120.0", *at(device))
    assert data["readings"] == 2
    best = data["candidates"][0]
    assert (best["address"], best["scale"], best["values"]) == ("holding:101", 0.1, pytest.approx([80.5, 120.0]))
    fresh = answer(tmp_path, "guess", "holding:101", "120.0", "--fresh", *at(device))
    assert fresh["readings"] == 1


def test_neighbours_that_are_refused_do_not_hide_the_value(device: Process, tmp_path: Path) -> None:
    number = device.fault("illegal_register", registers=["holding:108", "holding:111"])
    data = answer(tmp_path, "guess", "holding:109", "21.7", *at(device))
    device.order("clear", number=number)
    assert data["observation"] == {"base": 109, "words": data["observation"]["words"], "reading": "21.7"}
    assert data["candidates"][0]["address"] == "holding:109" and data["candidates"][0]["scale"] == 0.1


def test_a_flag_is_found_by_both_of_its_states(device: Process, tmp_path: Path) -> None:
    force(device, "CicloAttivo", True)
    one = answer(tmp_path, "guess", "holding:100", "on", *at(device))
    assert not one["settled"] and "the other state" in one["advice"][0]
    force(device, "CicloAttivo", False)
    two = answer(tmp_path, "guess", "holding:100", "off", *at(device))
    assert {"address": "holding:100", "bit": 2, "shift": 0} in two["bits"]
    assert two["settled"]


def test_a_reading_that_fits_nothing_fails_the_check(device: Process, tmp_path: Path) -> None:
    result = plc(tmp_path, "guess", "holding:106", "31.72", *at(device))
    assert result.exit_code == 1
    assert "is it the right register" in result.stderr


def test_what_cannot_be_read_or_understood_is_usage(device: Process, tmp_path: Path) -> None:
    assert plc(tmp_path, "guess", "holding:106", "warm", *at(device)).exit_code == 2
    assert plc(tmp_path, "guess", "register 7", "3", *at(device)).exit_code == 2
    assert plc(tmp_path, "guess", "holding:106", *at(device)).exit_code == 2


def test_the_test_s_own_floats_are_what_they_should_be() -> None:
    tag = Tag("", "holding:100", DType.FLOAT32, Order.CDAB)
    high, low = struct.unpack(">2H", struct.pack(">f", 72.5))
    assert stored(tag, 72.5) == {100: low, 101: high}


def test_what_the_source_rounds_to_holds_for_all_readings() -> None:
    """Twice a multiple of a half in one order, and twice something that only the neighbour's word makes of it."""
    words = ({99: 0, 100: 0xC158, 101: 0x35B5}, "-13.5"), ({99: 0, 100: 0xC190, 101: 0x16C6}, "-18.0")
    one, two = (shown(stored_words, text) for stored_words, text in words)
    shares = [{(row.address, row.order): row.share for row in rank(seen, 100)} for seen in ([one], [one, two])]
    ratios = [each[99, Order.CDAB] / each[100, Order.ABCD] for each in shares]
    assert ratios[1] > 0.5 * ratios[0]


@pytest.mark.parametrize(("raw", "best"), [(812, DType.INT16), (17503, DType.UINT16), (35557, DType.UINT16)])
def test_a_type_of_its_size_comes_before_a_wider_or_a_fuller_one(raw: int, best: DType) -> None:
    seen = [Observation(100, (word, 4711), ShownNumber(word / 10, 0.1)) for word in (raw, raw - 90)]
    assert rank(seen, 100)[0].dtype is best
