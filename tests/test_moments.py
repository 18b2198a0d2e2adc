"""Moments as people read them."""

from pathlib import Path

import pytest

from gateway.commission.files.recording import read_recording
from sim.moments import exact_moment
from sim.plc.program.replay import read_trace


@pytest.mark.parametrize(
    ("time", "said"),
    [
        (1.743e9, "2025-03-26 14:40:00 UTC"),
        (1.743e9 + 0.25, "2025-03-26 14:40:00.250 UTC"),
        (1.743e9 + 0.9996, "2025-03-26 14:40:01 UTC"),
        (10.0, "10.000 s"),
        (-5.0, "-5.000 s"),
        (1.743e12, "1743000000000.000 s"),
        (float("nan"), "nan s"),
        (float("inf"), "inf s"),
    ],
)
def test_a_moment_is_its_date_or_its_seconds_where_it_has_none(time: float, said: str) -> None:
    assert exact_moment(time) == said


def test_a_recording_that_goes_back_says_from_when_to_when(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("time,T\n1743000005,1\n1743000004.5,1\n", "utf-8")
    with pytest.raises(ValueError, match=r"from 2025-03-26 14:40:05 UTC to 2025-03-26 14:40:04\.500 UTC; sort"):
        read_recording(path)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (("10.0004", "10.0001"), r"from 10\.0004 s to 10\.0001 s; sort"),
        (("1743000005.0003", "1743000005.0001"), r"from 1743000005\.0003 s to 1743000005\.0001 s; sort"),
    ],
)
def test_moments_of_one_millisecond_are_told_apart(rows: tuple[str, str], said: str, tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("time,T\n" + "".join(f"{row},1\n" for row in rows), "utf-8")
    for read in (read_recording, read_trace):
        with pytest.raises(ValueError, match=said):
            read(path)
