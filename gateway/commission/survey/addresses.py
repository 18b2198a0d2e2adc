"""Addresses as the two sides call them: the PDU address of the frame, and the reference number of manuals and HMIs."""

import re
from dataclasses import dataclass

from drivers.errors import OneLineError

_FIRST = {"coil": 0, "discrete": 1, "input": 3, "holding": 4}
_TABLES = {str(digit): table for table, digit in _FIRST.items()}
_PDU = re.compile(r"(coil|discrete|input|holding):(\d{1,5})")
_REFERENCE = re.compile(r"([0134])(\d{4,5})")
_STRETCH = re.compile(r"(.+?)-(\d{1,6})")
_FIRST_FIVE_DIGIT_NUMBER = 9999
LAST_ADDRESS = 65535


class AddressTextError(OneLineError, ValueError):
    """The text is no address; the message says what would be one."""


@dataclass(frozen=True, slots=True, order=True)
class Register:
    """One register, coil or input: its table and its PDU address (0..65535)."""

    table: str
    number: int

    def __str__(self) -> str:
        return f"{self.table}:{self.number}"

    @property
    def reference(self) -> str:
        """The number that manuals and HMIs print, counted from 1: 40101, or 400101 style beyond the first 9999."""
        digits = 4 if self.number < _FIRST_FIVE_DIGIT_NUMBER else 5
        return f"{_FIRST[self.table]}{self.number + 1:0{digits}d}"

    @property
    def is_bit(self) -> bool:
        """True in the tables of single bits."""
        return self.table in ("coil", "discrete")

    def shift(self, by: int) -> "Register":
        """The one so many addresses on."""
        return Register(self.table, self.number + by)


def parse_register(text: str) -> Register:
    """`holding:100`, or a reference number such as 40101 or 400101. Raises AddressTextError."""
    stripped = text.strip().lower()
    if match := _PDU.fullmatch(stripped):
        register = Register(match[1], int(match[2]))
    elif match := _REFERENCE.fullmatch(stripped):
        register = Register(_TABLES[match[1]], int(match[2]) - 1)
    else:
        raise AddressTextError(
            f"{text!r} is no register; give its PDU address such as holding:100, or its number such as 40101"
        )
    if not 0 <= register.number <= LAST_ADDRESS:
        raise AddressTextError(f"{text!r} is beyond the addresses, which are 0 to {LAST_ADDRESS}")
    return register


def parse_stretch(text: str) -> tuple[Register, int]:
    """`holding:0-499` (or 40001-40500) as its first register and how many. Raises AddressTextError."""
    match = _STRETCH.fullmatch(text.strip())
    if match is None:
        return parse_register(text), 1
    first = parse_register(match[1])
    last = parse_register(match[2]) if _REFERENCE.fullmatch(match[1]) else Register(first.table, int(match[2]))
    if last.table != first.table or not first.number <= last.number <= LAST_ADDRESS:
        raise AddressTextError(f"{text!r} is no stretch of one table; give the first and the last, as holding:0-499")
    return first, last.number - first.number + 1


def reference_number(address: str) -> str:
    """The reference number of a driver's address; "" where the link has none (CAN, CANopen)."""
    try:
        return parse_register(address).reference
    except AddressTextError:
        return ""
