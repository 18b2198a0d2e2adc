"""DM1, the active trouble codes of J1939-73: lamps, and SPN, FMI and occurrence count of each code (pure)."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

PGN = 0xFECA
LAMPS: Mapping[str, int] = {"protect": 0, "warning": 2, "stop": 4, "mil": 6}
"""Lamp by name, and its first bit in the first byte: two bits, 0 off, 1 on, 2 and 3 neither."""


class TroubleCode(NamedTuple):
    """One code; `spn` is None where the conversion method is an older one and nobody said which."""

    spn: int | None
    fmi: int
    occurrences: int

    def __str__(self) -> str:
        return f"SPN {'?' if self.spn is None else self.spn} FMI {self.fmi} OC {self.occurrences}"


def trouble_codes(data: bytes, conversion: int | None = None) -> Sequence[TroubleCode]:
    """The codes in the message's bytes 3 on, four bytes each; those that stand for "none" are left out.

    `conversion` (1, 2 or 3) says how codes with the conversion method bit set write their SPN; without the bit it is
    version 4, the present one, whose layout version 3 shares.
    """
    codes = []
    for at in range(2, len(data) - 3, 4):
        low, middle, high, last = quad = data[at : at + 4]
        if quad in (b"\0\0\0\0", b"\xff\xff\xff\xff"):
            continue
        # The top bit of the last byte: written by an older method, of which the message does not say which.
        version = conversion if last >> 7 else 4
        top, spn = high >> 5, None
        if version == 1:
            spn = low << 11 | middle << 3 | top
        elif version == 2:
            spn = middle << 11 | low << 3 | top
        elif version is not None:
            spn = top << 16 | middle << 8 | low
        code = TroubleCode(spn, high & 0x1F, last & 0x7F)
        # Beside the method bit the rest can still be all zeros: "none", too.
        if code != (0, 0, 0):
            codes.append(code)
    return codes


def lamp(data: bytes, name: str) -> int:
    """The lamp's two bits. `data` has at least one byte; raises KeyError for a lamp that there is not."""
    return data[0] >> LAMPS[name] & 3
