"""Inputs near a valid one: hypothesis draws an example and a few edits of it, so that a failure shrinks."""

from collections.abc import Sequence

from hypothesis import strategies as st

TOKENS = (
    b"", b"\0", b"\xff", b"\n", b"\r\n", b'"', b"'", b",", b";", b":", b"=", b"[", b"]", b"{", b"}", b"(", b")", b"-",
    b"-1", b"0", b"65536", b"4294967296", b"1e999", b"1e-999", b"nan", b"inf", b"0x21001510", b"9" * 500, b"0" * 40,
    b"\x1b[2J",
    b"\xed\xa0\x80", b"\\ud800", b"[" * 300, b"(" * 300, b"a." * 300, b"true", b"null", b"%s%n", b"/../..",
)  # fmt: skip
"""What breaks parsers: ends, quotation marks, brackets, numbers beyond every type, nesting, terminal escapes."""


@st.composite
def near(draw: st.DrawFn, examples: Sequence[bytes]) -> bytes:
    """One of the examples after up to four edits: bytes cut, doubled, put in from TOKENS or another example."""
    data = draw(st.sampled_from(examples))
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(data)))
        span = draw(st.integers(0, 40))
        match draw(st.integers(0, 5)):
            case 0:
                data = data[:at] + data[at + span :]
            case 1:
                data = data[:at] + draw(st.sampled_from(TOKENS)) + data[at + span :]
            case 2:
                data = data[:at] + data[at : at + span] * draw(st.integers(2, 20)) + data[at + span :]
            case 3:
                data = data[:at] + draw(st.binary(max_size=8)) + data[at + span :]
            case 4:
                other = draw(st.sampled_from(examples))
                begin = draw(st.integers(0, len(other)))
                data = data[:at] + other[begin : begin + span] + data[at + span :]
            case _:
                data = data[:at]
    return data
