"""The answers that are words of their own."""

from collections.abc import Mapping

NO_COLUMN = "none"
"""The answer that a part is played by no column."""
BLANK_IS_GOOD = "blank"
"""The answer that a reading is good where its quality is not written."""
CHOICES: Mapping[str, tuple[str, ...]] = {
    "dates": ("day", "month", "year"),
    "stored": ("each row", "on change"),
    "duplicates": ("average", "last", "keep", "spread"),
    "clock_back": ("refuse", "split", "sort"),
}
"""The answers that are one of a few words: what comes first in 03/04/2024, how values were stored, what becomes of rows
with the same time, and of a clock that goes back."""
