"""A slip in a column map was answered with a list of thirty names; the one that was meant is asked for."""

import re
from pathlib import Path

import pytest

from sim.lab.recordings import load_map, load_traces
from tests.validation.places import MAPS

GOOD = """
format = "wide"
temperature = "Bearing"
[clock]
column = "time"
formats = "seconds"
[signals]
Bearing = { column = "T bearing", unit = "degC" }
Motor = {}
"""


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        (GOOD.replace('temperature = "Bearing"', 'temperature = "Baering"'), "did you mean 'Bearing'?"),
        (GOOD + "[derived]\nOn = { signal = 'motor', above = 1.0 }", "did you mean 'Motor'?"),
        (GOOD + "[effects]\ncurrent = 'Moter'", "did you mean 'Motor'?"),
        (GOOD.replace('column = "time"', 'column = "time"\ntimezone = "Europe/Rom"'), "did you mean 'Europe/Rome'?"),
        (GOOD.replace("formats", "format"), "did you mean 'formats'?"),
        (GOOD.replace("temperature =", "temprature ="), "did you mean 'temperature'?"),
        (GOOD + "[alphabet]\nchanels = []", "did you mean 'channels'?"),
    ],
)
def test_a_name_in_the_map(tmp_path: Path, text: str, meant: str) -> None:
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(ValueError, match=re.escape(meant)):
        load_map(tmp_path / "m.toml")


def test_a_column_that_the_file_calls_otherwise(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(GOOD)
    (tmp_path / "a.csv").write_text("time,T_bearing,Motor\n0,20,1\n")
    with pytest.raises(ValueError, match=r"there is no column 'T bearing'.* did you mean 'T_bearing'"):
        load_traces(tmp_path / "a.csv", load_map(tmp_path / "m.toml"))


def test_the_name_of_a_map() -> None:
    with pytest.raises(ValueError, match=r"there is no such column map; did you mean 'skab'\?"):
        load_map(MAPS / "skabb.toml")
