"""What encodings are common: types, orders, scales, offsets, and by how much an address is off (pure tables).

The weights are orders of magnitude from manuals of PLCs, drives and meters, not counts; they rank what the readings
leave equal. Weights of one table need not sum to 1.
"""

from drivers.tag import DType, Order

SHIFTS: dict[int, float] = {0: 0.7, -1: 0.2, 1: 0.08, -2: 0.01, 2: 0.01}
"""Addresses from the given one: manuals that count from 1 are the usual reason for -1."""

# The signed type before its unsigned twin: it stays right for negative values, the other for very large ones only.
TYPES: dict[DType, float] = {
    DType.INT16: 0.28,
    DType.UINT16: 0.24,
    DType.FLOAT32: 0.22,
    DType.INT32: 0.075,
    DType.UINT32: 0.065,
    DType.BCD16: 0.02,
    DType.FLOAT64: 0.02,
    DType.BCD32: 0.008,
    DType.INT64: 0.008,
    DType.UINT64: 0.006,
    DType.INT8: 0.003,
    DType.UINT8: 0.003,
}
ROOMY: dict[DType, tuple[float, float, float]] = {
    DType.INT32: (0.2, -(2.0**15), 2.0**16 - 1),
    DType.UINT32: (0.2, 0.0, 2.0**16 - 1),
    DType.BCD32: (0.2, 0.0, 9999.0),
    DType.INT64: (0.05, -(2.0**31), 2.0**32 - 1),
    DType.UINT64: (0.05, 0.0, 2.0**32 - 1),
}
"""How often these hold a signal although a type of half the size would have been enough, signed or not, and the least
and the greatest number that one of these holds."""
HALF_FULL: dict[DType, float] = {DType.INT16: 2.0**14, DType.INT32: 2.0**30, DType.INT64: 2.0**62}
P_SIGNED_THOUGH_TIGHT = 0.5
"""How often a signal that takes up more than half of a signed type, and never goes below 0, is kept in it."""
FLOATS = frozenset({DType.FLOAT32, DType.FLOAT64})

ONE_REGISTER: dict[Order, float] = {Order.ABCD: 0.95, Order.BADC: 0.05}
"""Orders that differ where there is one register only."""
MORE_REGISTERS: dict[Order, float] = {Order.ABCD: 0.45, Order.CDAB: 0.38, Order.DCBA: 0.09, Order.BADC: 0.08}

SCALES: dict[float, float] = {
    1.0: 0.27,
    0.1: 0.32,
    0.01: 0.18,
    0.001: 0.06,
    0.0001: 0.005,
    10.0: 0.03,
    100.0: 0.01,
    1000.0: 0.004,
    0.5: 0.03,
    0.05: 0.015,
    0.005: 0.006,
    0.2: 0.015,
    0.02: 0.008,
    0.002: 0.004,
    0.25: 0.012,
    0.025: 0.003,
    2.0: 0.01,
    5.0: 0.008,
    20.0: 0.003,
    50.0: 0.003,
    0.125: 0.005,
    0.0625: 0.005,
    0.03125: 0.003,
    0.0078125: 0.003,
    0.00390625: 0.004,
    0.4: 0.004,
    0.3: 0.001,
    0.6: 0.001,
}
FULL_SCALE = (27648, 32767, 65535, 4095, 10000, 32000, 16383, 4000)
"""Counts at full scale of analogue inputs (27648 is Siemens' own)."""
SPANS = (5, 10, 16, 20, 25, 30, 40, 50, 60, 80, 100, 120, 150, 160, 200, 250, 300, 400, 500, 600, 800, 1000, 1500)
"""Engineering units that they stand for."""
FULL_SCALE_WEIGHT = 0.02

OFFSETS: dict[float, float] = {
    0.0: 0.86,
    -40.0: 0.03,
    -50.0: 0.02,
    -100.0: 0.012,
    -273.15: 0.012,
    -273.0: 0.004,
    -20.0: 0.008,
    -30.0: 0.004,
    -200.0: 0.004,
    -10.0: 0.004,
    -125.0: 0.003,
    -25.0: 0.002,
    -60.0: 0.001,
    -150.0: 0.001,
    -210.0: 0.001,
    -250.0: 0.002,
    -1000.0: 0.001,
    4.0: 0.001,
    10.0: 0.001,
    20.0: 0.001,
    32.0: 0.002,
    50.0: 0.001,
    100.0: 0.002,
}

# A number that is a float already is seldom scaled, and less often moved.
FLOAT_SCALES: dict[float, float] = {
    1.0: 0.94,
    0.1: 0.008,
    10.0: 0.006,
    100.0: 0.01,
    0.01: 0.01,
    1000.0: 0.01,
    0.001: 0.01,
}
FLOAT_OFFSETS: dict[float, float] = {0.0: 0.985, -273.15: 0.01, 32.0: 0.001, -40.0: 0.001, -50.0: 0.001}

GRAINS: dict[float, float] = {5.0: 0.03, 1.0: 0.12, 0.5: 0.07, 0.1: 0.2, 0.01: 0.08}
"""To what a source rounds a number before it is stored as a float; the rest is not rounded. (Shares of all floats.)"""

P_ZERO, P_ALL_ONES = 0.3, 0.02
"""How often a register that has nothing to do with the value is 0 (spare, a state without alarm), or 0xFFFF."""
P_FLOAT_HIGH_WORD, FLOAT_HIGH_WORDS = 0.1, (0x3F00, 0x4600)
"""How often it is the high word of a float32, and the high words of the floats from 0.5 to 8192, either sign's."""
P_WORD_UNCHANGED, P_EMPTY_UNCHANGED = 0.5, 0.97
"""How often such a register is the same in the next reading; how often one that is 0 or 0xFFFF is."""
