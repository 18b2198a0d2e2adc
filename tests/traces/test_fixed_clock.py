"""Times that write all their digits are read at once: as the library reads them, one by one, whatever stands there."""

import random

import numpy as np
import pytest

from sim.lab.recordings import ClockColumns, read_clock
from sim.lab.recordings.clock import _fixed_width, _parsed_by_pandas

FORMATS = ("%d.%m.%Y %H:%M:%S", "%Y-%m-%d %H:%M:%S", "%m/%d/%Y %H:%M", "%Y%m%d%H%M%S", "%Y-%m-%dT%H:%M:%S")


def written(format_: str, count: int, seed: int) -> list[str]:
    """Times and what comes near to them: days that no month has, hours 24, letters and signs in between."""
    rng = random.Random(seed)
    texts = []
    for _ in range(count):
        fields = {
            "%Y": f"{rng.choice([1970, 1999, 2024, 2100]):04d}",
            "%m": f"{rng.randint(0, 13):02d}",
            "%d": f"{rng.randint(0, 32):02d}",
            "%H": f"{rng.randint(0, 24):02d}",
            "%M": f"{rng.randint(0, 60):02d}",
            "%S": f"{rng.randint(0, 59):02d}",
        }
        text = format_
        for name, value in fields.items():
            text = text.replace(name, value)
        if rng.random() < 0.2:
            text = text.replace(rng.choice(text), rng.choice(["x", "-", " ", "é", ""]), 1)
        texts.append(text)
    return texts


@pytest.mark.parametrize("format_", FORMATS)
def test_what_is_read_at_once_is_what_the_library_reads(format_: str) -> None:
    texts = written(format_, 600, 1)
    own, theirs = _fixed_width([text for text in texts if text.isascii()], format_), None
    theirs = _parsed_by_pandas([text for text in texts if text.isascii()], format_)
    read = np.isfinite(own)
    assert 0.3 < read.mean() < 0.9 and np.array_equal(own[read], theirs[read])
    # What was not read at once is left to the library, cells of any letters among it.
    wanted = "ISO8601" if format_[:3] == "%Y-" else format_
    clock = ClockColumns(column="t", formats=wanted)
    seconds, _ = read_clock(clock, [texts], "auto")
    known = np.isfinite(_parsed_by_pandas(texts, wanted))
    assert np.array_equal(seconds[known], _parsed_by_pandas(texts, wanted)[known])


def test_a_format_that_writes_less_or_twice_is_left_to_the_library() -> None:
    for format_ in ("%H:%M:%S", "%d %b %Y", "%d.%m.%y", "%d.%d.%Y %m", "%d·%m·%Y"):
        assert np.isnan(_fixed_width(["13.03.2024", "09:58:00"], format_)).all()
    assert _fixed_width([], "%Y%m%d").size == 0
