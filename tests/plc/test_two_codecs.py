"""The PLC's encoding and the gateway's codec were written apart: what one writes the other must read."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import codec
from drivers.tag import DType, Order, Quality, Tag
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.encoding import FLOATS, decode, encode, encode_absent, limits, value_at_rest, words_of_type
from sim.plc.program.plc import Plc
from sim.plc.program.registers import Place, RegisterMap

floats = st.floats(width=32, allow_nan=False, allow_infinity=False)
NUMBERS = [dtype for dtype in DType if dtype not in (DType.BOOL, DType.STRING)]


@given(st.sampled_from(NUMBERS), st.sampled_from(list(Order)), st.data())
def test_a_number_that_the_plc_encodes_is_the_number_that_the_driver_reads(
    dtype: DType, order: Order, data: st.DataObject
) -> None:
    tag = Tag("t", "holding:0", dtype, order)
    # Of a magnitude that something has which is measured: the driver holds no other for good.
    usual = st.floats(2.0**-19, 2.0**39, width=32)
    either = st.one_of(usual, usual.map(lambda number: -number), st.sampled_from([0.0, -0.0]))
    value = data.draw(either if dtype in FLOATS else st.integers(*limits(dtype)))
    words = encode(tag, value)
    assert len(words) == words_of_type(tag) == codec.register_count(tag)
    assert codec.decode(tag, words) == (value, Quality.GOOD, "")
    assert decode(tag, codec.encode(tag, value)) == value


@given(st.integers(0, 15), st.sampled_from(list(Order)), st.booleans())
def test_a_bit_lies_where_the_driver_looks_for_it(bit: int, order: Order, value: bool) -> None:
    tag = Tag("t", "holding:0", DType.BOOL, order, bit=bit)
    registers = RegisterMap(
        path=Path("m"),
        device="d",
        unit=1,
        max_registers=125,
        max_gap=0,
        heartbeat=None,
        tags={"t": tag},
        places={"t": Place("holding", 0)},
        blocks=(),
    )
    plc = Plc(registers, EmulatorClock(0.0, 0.0))
    plc.begin(0.0)
    plc.force("t", value)
    plc.cycle(0.0)
    assert codec.decode(tag, plc.image.read("holding", 0, 1))[0] is value


@pytest.mark.parametrize("dtype", NUMBERS)
@pytest.mark.parametrize("order", list(Order))
def test_a_tag_without_a_value_is_never_good_to_the_driver_where_the_plc_can_say_so(dtype: DType, order: Order) -> None:
    sentinel = limits(dtype)[1] if dtype not in FLOATS else None
    tag = Tag("t", "holding:0", dtype, order, sentinel=sentinel)
    assert value_at_rest(tag) is None
    value, quality, _ = codec.decode(tag, encode_absent(tag))
    assert value is None and quality.is_bad


@given(st.floats(-3000, 3000), st.sampled_from([0.1, 0.01, -0.5, 3.0]), st.floats(-50, 50))
def test_scaling_agrees(value: float, scale: float, offset: float) -> None:
    tag = Tag("t", "holding:0", DType.INT32, scale=scale, offset=offset)
    assert codec.decode(tag, encode(tag, value))[0] == decode(tag, encode(tag, value))
