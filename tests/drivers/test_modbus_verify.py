import errno
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import DeviceException, ReplyMismatch
from drivers.modbus.verify import (
    EXCEPTIONS,
    Asked,
    check_reply,
    exception_quality,
    leaves_open,
    parse_request,
    split_frames,
    unpack_words,
)
from drivers.modbus.wire import system_reason
from drivers.tag import Quality
from tests.drivers.scripted import ScriptedPlc, mbap


def request(function: int, address: int, count: int, *, unit: int = 1) -> bytes:
    return mbap(7, unit, struct.pack(">BHH", function, address, count))


@settings(max_examples=80)
@given(function=st.sampled_from([1, 2, 3, 4]), address=st.integers(0, 60), count=st.integers(1, 60))
def test_an_honest_reply_passes_and_any_byte_more_or_less_does_not(function: int, address: int, count: int) -> None:
    sent = request(function, address, count)
    reply = ScriptedPlc().answer(sent)
    check_reply(parse_request(sent), reply)
    for bent in (reply + b"\0", reply[:-1], reply[:8] + bytes([reply[8] ^ 1]) + reply[9:]):
        with pytest.raises(ReplyMismatch):
            check_reply(parse_request(sent), bent)


@pytest.mark.parametrize(
    ("function", "address", "count"), [(1, 0x0305, 20), (2, 0x0300, 17), (3, 0, 11), (4, 0x0300, 3)]
)
def test_a_read_that_is_given_back_is_no_reply(function: int, address: int, count: int) -> None:
    # The first two have the byte count that was asked for.
    sent = request(function, address, count)
    with pytest.raises(ReplyMismatch, match="the request itself"):
        check_reply(parse_request(sent), sent)
    assert leaves_open(parse_request(sent), sent)


@settings(max_examples=60)
@given(frames=st.lists(st.binary(min_size=1, max_size=40), max_size=5), cut=st.integers(0, 400))
def test_a_stream_cut_anywhere_gives_the_same_frames(frames: list[bytes], cut: int) -> None:
    whole = [mbap(n, 1, b"\x03" + body) for n, body in enumerate(frames)]
    stream = b"".join(whole)
    early, rest = split_frames(stream[:cut])
    late, end = split_frames(rest + stream[cut:])
    assert early + late == whole
    assert end == b""


@pytest.mark.parametrize("head", [b"\0\1\0\1\0\3", b"\0\1\0\0\0\2", b"\0\1\0\0\1\xff", b"GET / HTTP/1.1"])
def test_what_cannot_be_a_header_is_said_at_once(head: bytes) -> None:
    with pytest.raises(ReplyMismatch, match="not Modbus TCP"):
        split_frames(head)


@pytest.mark.parametrize("protocol", [0, 1, 0x100, 0x8000])
def test_a_length_is_believed_exactly_from_3_to_254(protocol: int) -> None:
    for length in (*range(400), 0x7FFF, 0x8000, 0xFFFF):
        head = struct.pack(">HHH", 0xFFFF, protocol, length)
        if protocol == 0 and 3 <= length <= 254:
            assert split_frames(head) == ([], head), "the rest may come yet"
            assert split_frames(head + bytes(length)) == ([head + bytes(length)], b"")
            continue
        with pytest.raises(ReplyMismatch, match=rf"\(protocol id {protocol}, length {length}\)"):
            split_frames(head)


def test_of_a_header_that_is_not_whole_each_byte_that_can_be_wrong_is_looked_at() -> None:
    for size in range(6):
        for place in range(size):
            bent = bytearray(size)
            bent[place] = 1
            if place < 2 or place == 5:  # the transaction, and the low byte of the length
                assert split_frames(bytes(bent)) == ([], bytes(bent))
                continue
            with pytest.raises(ReplyMismatch, match=rf"\(it begins with {bent.hex(' ')}\)"):
                split_frames(bytes(bent))


@pytest.mark.parametrize("function", [1, 2, 3, 4, 15, 16])
def test_a_request_is_read_as_it_was_written(function: int) -> None:
    for transaction, unit, address, count in [(0, 0, 0, 1), (0x0102, 3, 0x0405, 0x0607), (65535, 255, 65535, 125)]:
        request = mbap(transaction, unit, struct.pack(">BHH", function, address, count) + b"\x2b\x2b")
        assert parse_request(request) == Asked(transaction, unit, function, address, count)


def test_a_request_for_the_identity_has_neither_address_nor_count() -> None:
    for transaction, unit in [(0x0102, 9), (65535, 0)]:
        assert parse_request(mbap(transaction, unit, b"\x2b\x0e\x01\x00")) == Asked(transaction, unit, 43, 0, 0)


def test_registers_and_bits_come_in_their_order_and_of_a_write_comes_nothing() -> None:
    assert unpack_words(Asked(7, 1, 3, 0, 3), b"\0\1\x80\0\xff\xfe") == (1, 0x8000, 0xFFFE)
    assert unpack_words(Asked(7, 1, 4, 0, 1), b"\1\2") == (0x0102,)
    for function in (1, 2):
        for count in range(1, 18):
            for place in range(count):
                data = (1 << place).to_bytes((count + 7) // 8, "little")
                assert unpack_words(Asked(7, 1, function, 0, count), data) == tuple(
                    int(n == place) for n in range(count)
                )
    for function in (15, 16):
        assert unpack_words(Asked(7, 1, function, 0, 2), b"\0\0\0\2") == ()


READ = Asked(7, 1, 3, 100, 4)
FAR = Asked(7, 1, 16, 65535, 65535)
IDENTITY = Asked(7, 1, 43, 0, 0)
WRITE = Asked(7, 1, 16, 100, 4)


@pytest.mark.parametrize(
    ("question", "reply", "sentence"),
    [
        (READ, mbap(7, 2, b"\x03\x08" + bytes(8)), "from unit 2 and unit 1 was asked"),
        (READ, mbap(7, 1, b"\x04\x08" + bytes(8)), "function 4 and 3 was asked"),
        (READ, mbap(7, 1, b"\x84\x02"), "function 132 and 3 was asked"),
        (READ, mbap(7, 1, b"\x03\x06" + bytes(6)), "8 bytes were asked, the reply announces 6 and has 6"),
        (READ, mbap(7, 1, b"\x03\x06" + bytes(8)), "announces 6 and has 8"),
        (READ, mbap(7, 1, b"\x03\x0a" + bytes(10)), "announces 10 and has 10"),
        (READ, mbap(7, 1, b"\x83\x02\x00"), "1 byte, not 2"),
        (WRITE, mbap(7, 1, struct.pack(">BHH", 16, 100, 3)), "confirms"),
        (WRITE, mbap(7, 1, struct.pack(">BHH", 16, 101, 4)), "confirms"),
        (WRITE, mbap(7, 1, struct.pack(">BHHH", 16, 100, 4, 0)), "confirms"),
        (FAR, mbap(7, 1, struct.pack(">BHH", 16, 65534, 65535)), "confirms fffeffff instead of ffffffff"),
        (IDENTITY, mbap(7, 1, b"\x2b\x0d\x01\x01\x00\x00\x00"), "who are you.*the reply holds no identification"),
        (IDENTITY, mbap(7, 1, b"\x2b\x0e\x01\x01\x00\x00"), "holds no identification"),
    ],
)
def test_a_reply_that_does_not_answer_is_refused_with_what_is_wrong(
    question: Asked, reply: bytes, sentence: str
) -> None:
    with pytest.raises(ReplyMismatch, match=sentence):
        check_reply(question, reply)


def test_what_confirms_passes() -> None:
    check_reply(FAR, mbap(7, 1, struct.pack(">BHH", 16, 65535, 65535)))
    check_reply(IDENTITY, mbap(7, 1, b"\x2b\x0e\x01\x01\x00\x00\x00"))


def test_a_device_may_refuse_any_function() -> None:
    for function in (1, 2, 3, 4, 15, 16, 43):
        question = Asked(7, 1, function, 0, 1)
        for answered in range(0x80, 0x100):
            error = DeviceException if answered == function + 0x80 else ReplyMismatch
            with pytest.raises(error):
                check_reply(question, mbap(7, 1, bytes([answered, 2])))


def test_every_code_of_an_exception_has_its_sentence_and_takes_the_value_away() -> None:
    for code in range(256):
        with pytest.raises(DeviceException) as caught:
            check_reply(READ, mbap(7, 1, bytes([0x83, code])))
        words = EXCEPTIONS[code][0] if code in EXCEPTIONS else "a code that the standard does not know"
        assert str(caught.value) == f"holding:100 count 4: exception {code}, {words}"
        assert exception_quality(code) is (EXCEPTIONS[code][1] if code in EXCEPTIONS else Quality.BAD)
        assert exception_quality(code).is_bad


@pytest.mark.parametrize(("code", "words"), [(2, "illegal data address"), (6, "busy"), (99, "does not know")])
def test_a_device_exception_has_its_code_and_a_sentence(code: int, words: str) -> None:
    with pytest.raises(DeviceException, match=words) as caught:
        check_reply(READ, mbap(7, 1, bytes([0x83, code])))
    assert caught.value.code == code
    assert str(caught.value).startswith("holding:100 count 4: ")


def test_a_connection_that_fails_says_what_the_system_says() -> None:
    refused = OSError(errno.ECONNREFUSED, "Connect call failed ('10.0.0.7', 502)")  # as asyncio puts it
    assert system_reason(refused) == "Connection refused"
    assert system_reason(OSError(-2, "Name or service not known")) == "Name or service not known"
