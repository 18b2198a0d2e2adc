"""Whether two sentences say the same: what they differ in when it is a number only, and which numbers those are."""

import re

_MEASURED = re.compile(r"-?\d+(\.\d+(e[+-]?\d+)?|e[+-]?\d+)")
_NUMBER = re.compile(r"(?<![\w.])(?<![A-Za-z_]:)[-+]?\d+(?:[.,:]\d+)*(?:[eE][-+]?\d+)?")


def drop_measurements(text: str) -> str:
    """The text without what is measured anew each time: seconds waited, a value that cannot be.

    Codes and addresses, whole numbers, stay.
    """
    return _MEASURED.sub("#", text)


def without_numbers(text: str) -> str:
    """The text without its numbers, save the digits of a name (T1) and of an address (holding:100)."""
    return _NUMBER.sub("#", text)
