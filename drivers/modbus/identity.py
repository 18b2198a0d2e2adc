"""Who a Modbus device says it is, and what of that is pinned: the questions, and what their answers must be (pure).

Two devices of one kind answer the same questions at the same addresses. What tells them apart is what one of them alone
says: an object of its identification (function 43), its server id (function 17), or registers with a serial number.
"""

import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest
from pymodbus.pdu.other_message import ReportDeviceIdRequest

from drivers.errors import ReplyMismatch
from drivers.modbus.address import Area
from drivers.modbus.wire import read_request

OBJECTS = ("vendor", "product code", "revision", "vendor URL", "product", "model", "application")
"""V1.1b3, 6.21: the objects 0 to 6 of an identification."""
SERVER_ID = "server id"
"""What function 17 answers, as text where it is text, else in hexadecimal digits."""
MOST_PARTS = 16
_OBJECT = re.compile(r"object (\d{1,3})")
_PLACE = re.compile(r"(holding|input|coil|discrete):(\d{1,5})(?:-(\d{1,5}))?")
_MOST_REGISTERS = 125
_KEYS = f"{', '.join(OBJECTS)}, object N, {SERVER_ID}, or registers such as holding:300-307"


@dataclass(frozen=True, slots=True)
class PinnedMark:
    """One thing that a device must say: by the name that a person gave, an object, a server id, or registers.

    `object` is the number of an object, -1 for none; `count` registers from `start` of `area`, 0 for none. `expected`
    is a text, or the words.
    """

    name: str
    expected: str | tuple[int, ...]
    object: int = -1
    area: Area = Area.HOLDING
    start: int = 0
    count: int = 0

    def found(self, said: Sequence[int]) -> str | tuple[int, ...]:
        """What registers or a server id say, in the way of what is expected of them."""
        if isinstance(self.expected, tuple):
            return tuple(said)
        if self.count:
            return text_of_registers(said)
        text = text_of_server_id(said)
        return self.expected if not _plain(said) and _digits(self.expected) == text else text


def pinned_marks(given: object) -> tuple[PinnedMark, ...]:
    """The marks of the setting `identity`, a table. Raises ValueError in words."""
    if isinstance(given, tuple) and all(isinstance(mark, PinnedMark) for mark in given):
        return given
    if not isinstance(given, Mapping) or not given:
        raise ValueError(f'must be a table such as {{ "product code" = "750-8212" }}, got {given!r}')
    return tuple(_mark(str(name), expected) for name, expected in given.items())


def _mark(name: str, expected: Any) -> PinnedMark:
    if name in OBJECTS or (match := _OBJECT.fullmatch(name)):
        number = OBJECTS.index(name) if name in OBJECTS else int(match[1]) if match else -1
        if not isinstance(expected, str) or not expected.strip("\0 ") or number > 255:
            raise ValueError(f"{name!r} is {expected!r}; give the text that the device says (decanter plc probe)")
        return PinnedMark(name, _pinned_text(expected), object=number)
    if name == SERVER_ID:
        if not isinstance(expected, str) or not expected.strip("\0 "):
            raise ValueError(f"{name!r} is {expected!r}; give the text that the device says (decanter plc probe)")
        return PinnedMark(name, expected.strip("\0 "))
    match = _PLACE.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} says nothing of who a device is; give one of {_KEYS}")
    start, stop = int(match[2]), int(match[3] or match[2]) + 1
    count = stop - start
    if not (0 <= start < stop <= 0x10000 and count <= _MOST_REGISTERS):
        raise ValueError(f"{name!r} is no stretch of at most {_MOST_REGISTERS} registers; give one as holding:300-307")
    area = Area(match[1])
    if isinstance(expected, str) and not area.is_bits:
        if not expected.strip("\0 "):
            raise ValueError(
                f"{name!r} is {expected!r}, which every device says that was never given a text; give its own"
            )
        if len(expected) > 2 * count:
            raise ValueError(
                f"{name!r} has room for {2 * count} characters and {expected!r} has more; give all its registers"
            )
        return PinnedMark(name, _pinned_text(expected), area=area, start=start, count=count)
    most = 1 if area.is_bits else 0xFFFF
    words = expected if isinstance(expected, list | tuple) else _words(expected, count, area)
    if len(words) != count or not all(type(word) is int and 0 <= word <= most for word in words):
        raise ValueError(f"{name!r} is {expected!r}; give a text, a number, or a list of its {count} words")
    return PinnedMark(name, tuple(words), area=area, start=start, count=count)


def _words(number: object, count: int, area: Area) -> Sequence[int]:
    """A number's words, the high one first; none where it is no number or does not fit."""
    if type(number) is bool and area.is_bits and count == 1:
        return (int(number),)
    if type(number) is not int or area.is_bits or not 0 <= number < 1 << 16 * count:
        return ()
    return struct.unpack(f">{count}H", number.to_bytes(2 * count, "big"))


def _text(data: bytes) -> str:
    """What a device says, without what fills it up: UTF-8 where it is that, else a character a byte."""
    try:
        return data.decode().strip("\0 ")
    except UnicodeDecodeError:
        return data.decode("latin-1").strip("\0 ")


def _pinned_text(expected: str) -> str:
    """As `_text`, of what was written down, perhaps a character a byte."""
    try:
        return _text(expected.encode("latin-1"))
    except UnicodeEncodeError:
        return expected.strip("\0 ")


def text_of_registers(words: Sequence[int]) -> str:
    """The text in registers, without what fills it up."""
    return _text(struct.pack(f">{len(words)}H", *words).split(b"\0", 1)[0])


def text_of_server_id(said: Sequence[int]) -> str:
    """What function 17 said, as text if it is one but for NULs at its ends, else in hexadecimal digits."""
    return _plain(said) or _without_run(bytes(said)).hex()


def _without_run(data: bytes) -> bytes:
    """A server id without whether it runs: who it is does not change with that.

    Behind its number that stands as 0xFF or 0x00 (MODBUS V1.1b3, 6.13), and how long the number is nobody says.
    """
    return data.replace(b"\xff", b"\0")


def _plain(said: Sequence[int]) -> str:
    """A server id that is text but for what stands at its ends; "" for one that is none."""
    plain = _without_run(bytes(said)).strip(b"\0 ")
    return plain.decode("ascii") if all(32 <= byte < 127 for byte in plain) else ""


def _digits(text: str) -> str:
    """What was written down of a server id in hexadecimal digits, as `text_of_server_id` writes it; "" for a text."""
    try:
        return _without_run(bytes.fromhex(text)).hex()
    except ValueError:
        return ""


# ---------------------------------------------------------------- the questions


def server_id_request(unit: int) -> ModbusPDU:
    """Function 17."""
    return ReportDeviceIdRequest(dev_id=unit)


def object_request(unit: int, after: int, number: int) -> ModbusPDU:
    """Function 43/14 for the objects from `after` on, in the category that has object `number`."""
    category = 1 if number < 3 else 2 if number < len(OBJECTS) else 3
    return ReadDeviceInformationRequest(read_code=category, object_id=after, dev_id=unit)


def mark_request(mark: PinnedMark, unit: int) -> ModbusPDU:
    """The question for pinned registers."""
    return read_request(mark.area, mark.start, mark.count, unit)


def identification(said: Sequence[int]) -> tuple[dict[str, str], int]:
    """The objects in a reply to function 43, and the number of the one that follows in another (0: none).

    `said` is code, conformity, more, next, count, objects; some devices count those of later replies too. Raises
    ReplyMismatch where the objects do not fill the reply, or one is said in two ways: it is not known who says it.
    """
    reply = bytes(said)
    if len(reply) < 5:
        return {}, 0
    more, following, count, at = reply[2], reply[3], reply[4], 5
    identity: dict[str, str] = {}
    while at < len(reply) and count:
        number, end = reply[at], at + 2 + (reply[at + 1] if at + 1 < len(reply) else 0)
        name = OBJECTS[number] if number < len(OBJECTS) else f"object {number}"
        text = _text(reply[at + 2 : end])
        if end > len(reply) or identity.setdefault(name, text) != text:
            slip = "is said in two ways" if end <= len(reply) else f"ends {end - len(reply)} bytes behind the reply"
            raise ReplyMismatch(f"the identification cannot be told: {name} {slip}")
        at, count = end, count - 1
    if at < len(reply):
        raise ReplyMismatch(f"the identification cannot be told: {len(reply) - at} bytes follow its last object")
    return identity, following if more == 0xFF else 0


def take_part(heard: dict[str, str], part: Mapping[str, str]) -> None:
    """Add what another reply says. Raises ReplyMismatch where it says in another way what has been said."""
    for name, text in part.items():
        if heard.setdefault(name, text) != text:
            raise ReplyMismatch(f"the identification cannot be told: {name} is said in two ways")


def stranger(mark: PinnedMark, said: str | tuple[int, ...] | None, place: str) -> str:
    """That the device is another one than the pinned one, in words; "" where it says what is expected."""
    if said == mark.expected:
        return ""
    heard = "says nothing of it" if said is None else f"says {_format_mark(said)}"
    return (
        f"another device answers at {place}: of {mark.name} it {heard}, and {_format_mark(mark.expected)} is pinned "
        "(identity); nothing of it is believed, and nothing is written to it"
    )


def _format_mark(said: str | tuple[int, ...]) -> str:
    return repr(list(said) if isinstance(said, tuple) else said)
