import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import DeviceException, ReplyMismatch
from drivers.modbus.verify import Asked, asked, check_reply, split_frames
from tests.drivers.scripted import ScriptedPlc, mbap


def request(function: int, address: int, count: int, *, unit: int = 1) -> bytes:
    return mbap(7, unit, struct.pack(">BHH", function, address, count))


@settings(max_examples=80)
@given(function=st.sampled_from([1, 2, 3, 4]), address=st.integers(0, 60), count=st.integers(1, 60))
def test_an_honest_reply_passes_and_any_byte_more_or_less_does_not(function: int, address: int, count: int) -> None:
    sent = request(function, address, count)
    reply = ScriptedPlc().answer(sent)
    check_reply(asked(sent), reply)
    for bent in (reply + b"\0", reply[:-1], reply[:8] + bytes([reply[8] ^ 1]) + reply[9:]):
        with pytest.raises(ReplyMismatch):
            check_reply(asked(sent), bent)


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


READ = Asked(7, 1, 3, 100, 4)
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
    ],
)
def test_a_reply_that_does_not_answer_is_refused_with_what_is_wrong(
    question: Asked, reply: bytes, sentence: str
) -> None:
    with pytest.raises(ReplyMismatch, match=sentence):
        check_reply(question, reply)


@pytest.mark.parametrize(("code", "words"), [(2, "illegal data address"), (6, "busy"), (99, "does not know")])
def test_a_device_exception_has_its_code_and_a_sentence(code: int, words: str) -> None:
    with pytest.raises(DeviceException, match=words) as caught:
        check_reply(READ, mbap(7, 1, bytes([0x83, code])))
    assert caught.value.code == code
    assert str(caught.value).startswith("holding:100 count 4: ")
