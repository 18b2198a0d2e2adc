"""Inputs near a valid one: a short program of bytes, drawn by hypothesis, edits an example."""

from collections.abc import Sequence
from struct import Struct

from hypothesis import strategies as st

TOKENS = (
    b"", b"\0", b"\xff", b"\n", b"\r\n", b'"', b"'", b",", b";", b":", b"=", b"[", b"]", b"{", b"}", b"(", b")", b"-",
    b"-1", b"0", b"65536", b"4294967296", b"1e999", b"1e-999", b"nan", b"inf", b"0x21001510", b"9" * 500, b"0" * 40,
    b"\x1b[2J", b"\xc2\x85", b"\xe2\x80\xa8", b"\xe2\x80\xae", b"\\n", b"\\u001b", b"\r", b"\t", b"\xef\xbb\xbf",
    b"\xed\xa0\x80", b"\\ud800", b"[" * 300, b"(" * 300, b"a." * 300, b"true", b"null", b"%s%n", b"/../..",
)  # fmt: skip
"""What breaks parsers: ends, quotation marks, brackets, numbers beyond every type, nesting, steering of terminals."""

_MOST_EDITS = 4
_EDIT = Struct("<BIBBB8s")
"""One edit: what is done, where, over how many bytes, how often, with which token or example, bytes of its own."""


AT_ONCE = 8
"""Inputs of one draw: most of what hypothesis costs is for each draw, whatever its size."""


def near(examples: Sequence[bytes]) -> st.SearchStrategy[list[bytes]]:
    """AT_ONCE inputs, each one of the examples after up to four edits: see `edited`.

    The programs have a fixed length and are drawn together, which costs a fortieth of drawing each choice. All zeros
    leave the first example as it is, so that a failure shrinks towards it.
    """
    size = 2 + _MOST_EDITS * _EDIT.size

    def inputs(programs: bytes) -> list[bytes]:
        return [edited(examples, programs[at : at + size]) for at in range(0, len(programs), size)]

    return st.binary(min_size=AT_ONCE * size, max_size=AT_ONCE * size).map(inputs)


def edited(examples: Sequence[bytes], program: bytes) -> bytes:
    """An example after a program's edits: bytes cut, doubled, put in from TOKENS, the program or another example."""
    data = examples[program[0] % len(examples)]
    for number in range(program[1] % (_MOST_EDITS + 1)):
        kind, place, length, often, which, own = _EDIT.unpack_from(program, 2 + number * _EDIT.size)
        at, span = place % (len(data) + 1), length % 41
        match kind % 6:
            case 0:
                data = data[:at] + data[at + span :]
            case 1:
                data = data[:at] + TOKENS[which % len(TOKENS)] + data[at + span :]
            case 2:
                data = data[:at] + data[at : at + span] * (2 + often % 19) + data[at + span :]
            case 3:
                data = data[:at] + own[: often % 9] + data[at + span :]
            case 4:
                other = examples[which % len(examples)]
                begin = int.from_bytes(own[:4], "little") % (len(other) + 1)
                data = data[:at] + other[begin : begin + span] + data[at + span :]
            case _:
                data = data[:at]
    return data
