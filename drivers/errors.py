"""What can go wrong on a fieldbus, by whose fault it is; and what the sentence of any error here is: one line.

    DriverError
    ├── AddressError(ValueError)        the configuration names an address that this driver cannot mean
    ├── EncodingError(ValueError)       a value does not fit the tag's type, range or scale
    ├── RecordingError(ValueError)      a recording that is no file, empty, or of no known format
    ├── WriteForbidden(PermissionError) the tag is not in the closed write map; nothing was sent
    ├── WriteUnverified                 the device confirmed the write but reads back something else
    ├── LinkDown(ConnectionError)       no connection: refused, reset, unreachable, closed (`fault`)
    ├── ReplyTimeout(TimeoutError)      no valid reply within the deadline
    ├── ReplyMismatch                   a reply that does not answer the request (unit, function, count, length, echo)
    └── DeviceException(code)           the device refused, and says why

`connect` and `write` raise these; `read` turns them into samples of bad quality. What a caller decides by is a field of
the error, never its sentence.
"""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from enum import Enum
from typing import Any


class LinkFault(Enum):
    """Why there is no connection, where the driver knows it."""

    REFUSED = "refused"  # the host is there, and nothing listens on the port
    UNREACHABLE = "unreachable"  # there is no route to the host
    SILENT = "silent"  # nobody answered within the deadline
    CLOSED = "closed"  # the peer closed the connection
    FOREIGN = "foreign"  # what arrives is another protocol
    CUT = "cut"  # a reply has come in part
    OTHER = "other"


NO_WAY_TO_UNIT = frozenset({10, 11})
"""Codes of a DeviceException that a Modbus gateway gives in the place of a unit that does not answer: they are nothing
that the unit has said (MODBUS Application Protocol V1.1b3, 7)."""
MAX_SENTENCE_CHARACTERS = 1000
"""Characters of a sentence."""


def one_line(text: str) -> str:
    """The text with every character that is not printable as its escape (`\\n`, `\\x1b`)."""
    # As `sim.strict_json.escape_text` does, which the arithmetic of sim takes: that imports nothing of this floor.
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def one_sentence(text: str) -> str:
    """The text as one line that somebody reads to its end: of a quotation without end the middle is left out.

    What is wrong stands before it, what would be right behind.
    """
    line = one_line(text)
    return (
        line
        if len(line) <= MAX_SENTENCE_CHARACTERS
        else f"{line[: MAX_SENTENCE_CHARACTERS // 2]} ... {line[-MAX_SENTENCE_CHARACTERS // 2 :]}"
    )


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The question after a name that is not known: the one that looks most like it, whatever its case; "" if none."""
    by_folded = {name.casefold(): name for name in known}
    close = get_close_matches(word.casefold(), by_folded, n=1, cutoff=0.6)
    return f"did you mean {by_folded[close[0]]!r}?" if close else ""


OWN_PACKAGES = ("drivers", "sim", "gateway")


def missing_part(error: ModuleNotFoundError) -> str:
    """That a part of this program is not installed, as the end of a sentence; "" where another module is missing."""
    if (error.name or "").partition(".")[0] not in OWN_PACKAGES:
        return ""
    return f"needs {error.name}, a part of the program that is not installed here; install decanter-gateway whole"


class OneLineError(Exception):
    """An error whose sentence is one line and steers no terminal, whatever it quotes (`one_sentence`)."""

    def __init__(self, sentence: str = "") -> None:
        super().__init__(one_sentence(sentence))


class DriverError(OneLineError):
    """Base of everything that a driver raises."""


class AddressError(DriverError, ValueError):
    """The address is not in this driver's notation; the message says what would be."""


class EncodingError(DriverError, ValueError):
    """The value cannot be represented in the tag's type, range or scale."""


class RecordingError(DriverError, ValueError):
    """The recording cannot be used; the message says why."""


class WriteForbidden(DriverError, PermissionError):
    """The tag is outside the closed write map. Nothing was sent."""


class WriteUnverified(DriverError):
    """The device confirmed the write, but reading back gave something else."""


class LinkDown(DriverError, ConnectionError):
    """There is no connection: refused, reset, unreachable or closed; `fault` says which, where it is known."""

    def __init__(self, sentence: str = "", *, fault: LinkFault = LinkFault.OTHER) -> None:
        super().__init__(sentence)
        self.fault = fault


class ReplyTimeout(DriverError, TimeoutError):
    """No valid reply arrived within the deadline; `remedy` are settings by which what came may be one."""

    def __init__(self, sentence: str = "", *, remedy: Mapping[str, Any] | None = None) -> None:
        super().__init__(sentence)
        self.remedy = dict(remedy or {})


class NotAsked(ReplyTimeout):
    """Nothing was asked within the deadline, as an answer to an earlier question may still come."""


class ReplyMismatch(DriverError):
    """A reply arrived that does not answer the request; `remedy` are settings by which it may."""

    def __init__(self, sentence: str = "", *, remedy: Mapping[str, Any] | None = None) -> None:
        super().__init__(sentence)
        self.remedy = dict(remedy or {})


class DeviceException(DriverError):
    """The device refused the request; `code` is its own exception code."""

    def __init__(self, code: int, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code
