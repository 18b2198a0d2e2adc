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
    quads = (data[at : at + 4] for at in range(2, len(data) - 3, 4))
    codes = (_code(quad, conversion) for quad in quads if quad not in (b"\0\0\0\0", b"\xff\xff\xff\xff"))
    return [code for code in codes if code is not None]


def lamp(data: bytes, name: str) -> int:
    """The lamp's two bits. `data` has at least one byte; raises KeyError for a lamp that there is not."""
    return data[0] >> LAMPS[name] & 3


def _code(quad: bytes, conversion: int | None) -> TroubleCode | None:
    old = quad[3] >> 7
    spn = _spn(quad, conversion if old else 4)
    fmi, count = quad[2] & 0x1F, quad[3] & 0x7F
    return None if (spn, fmi, count) == (0, 0, 0) else TroubleCode(spn, fmi, count)


def _spn(quad: bytes, version: int | None) -> int | None:
    top = quad[2] >> 5
    if version is None:
        return None
    if version == 1:
        return quad[0] << 11 | quad[1] << 3 | top
    if version == 2:
        return quad[1] << 11 | quad[0] << 3 | top
    return top << 16 | quad[1] << 8 | quad[0]
