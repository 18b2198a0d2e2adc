"""What the HMI shows, as a number with the resolution that it is shown with, or as a state (pure)."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.errors import OneLineError

_RELATIVE_TOLERANCE = 1e-9
"""What binary fractions may add to an error, as a share of the value (of 1 at least)."""
_FLOAT32_EPSILON = 2.0**-23
_SPACES = "'’ \u00a0\u202f"
_NUMBER = re.compile(rf"([+-]?)([.,]?\d[\d.,{_SPACES}]*)")
_STATES = {"on": True, "true": True, "yes": True, "off": False, "false": False, "no": False}


class ReadingError(OneLineError, ValueError):
    """The text is nothing that an HMI shows; the message says what would be."""


@dataclass(frozen=True, slots=True)
class ShownNumber:
    """A number as it is shown: its last digit counts `step`."""

    value: float
    step: float

    def __str__(self) -> str:
        decimals = max(0, len(f"{self.step:.9f}".rstrip("0").partition(".")[2]))
        return f"{self.value:.{decimals}f}"

    def rounding_mask(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the values the HMI shows like this if it rounds."""
        return np.asarray(np.abs(values - self.value) <= 0.5 * self.step + self._slack)

    def truncation_mask(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the values it shows like this if it cuts digits off, towards 0.

        Not one that is the next number that it can show, as near as a float32 comes to it.
        """
        towards_zero = (values - self.value) * (1.0 if self.value >= 0 else -1.0)
        below_next = self.step - max(self._slack, _FLOAT32_EPSILON * abs(self.value))
        return np.asarray((towards_zero >= -self._slack) & (towards_zero < below_next))

    @property
    def _slack(self) -> float:
        return _RELATIVE_TOLERANCE * max(1.0, abs(self.value))


def parse_display(text: str) -> ShownNumber | bool:
    """`72.4`, `72,4`, `1'250`, `1.250,5`, `-3`, or `on` and `off`. Raises ReadingError.

    One comma or point is a decimal one; several, or one of each, separate thousands but for the last of another kind.
    """
    plain = text.strip()
    if plain.lower() in _STATES:
        return _STATES[plain.lower()]
    match = _NUMBER.fullmatch(plain)
    if match is None:
        raise ReadingError(f"{text!r} is no reading; give the number as the HMI shows it, such as 72.4, or on or off")
    sign, digits = match[1], re.sub(f"[{_SPACES}]", "", match[2])
    marks = [mark for mark in digits if mark in ".,"]
    whole, decimals = digits, ""
    if len(marks) > 1 and len(set(marks)) == 1:
        groups = re.split(r"[.,]", digits)
        # Groups of three are thousands; anything else is no number, and is refused below by its marks.
        if len(groups[0]) in (1, 2, 3) and all(len(group) == 3 for group in groups[1:]):
            whole = "".join(groups)
    elif marks:
        whole, _, decimals = digits.rpartition(marks[-1])
        whole = re.sub(r"[.,]", "", whole)
    if not (whole + decimals).isdecimal():
        raise ReadingError(f"{text!r} is no reading; give the number as the HMI shows it, such as 72.4")
    value = float(f"{whole or '0'}.{decimals or '0'}")
    return ShownNumber(-value if sign == "-" else value, 10.0 ** -len(decimals))
