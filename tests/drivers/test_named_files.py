"""Files that a person names: a pipe is refused at once by every reader, and no number or nesting is a traceback."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

import sim.files
import sim.plc.program
from drivers import settings
from drivers.can.dbc import Dbc
from drivers.canopen.eds import load_sheet
from drivers.soft.recorded import load_csv
from drivers.vehicle.log import open_log
from gateway.commission.files.cells import read_sheet
from gateway.commission.files.recording import read_recording
from sim.lab.formats.find import find_model
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.proof.word import parse_word

ROOT = Path(__file__).parents[2]
BIG = "1" * 1_000_000


READERS: dict[str, Callable[[Path], object]] = {
    "a model": find_model,
    "an artefact": sim.files.read_text,
    "a configuration": settings.read_toml,
    "a column map": load_map,
    "a trace": lambda path: load_traces(path, load_map(ROOT / "config" / "traces" / "decanter.toml")),
    "a file of the software PLC": lambda path: sim.plc.program.read_text(path, "a trace"),
    "a recording of a simulated device": lambda path: load_csv(path, "time", loop=False),
    "an I/O list": lambda path: read_sheet(path, {}, ()),
    "a recording": read_recording,
    "an electronic data sheet": lambda path: load_sheet(path, 1),
    "a DBC": Dbc,
    "a CAN log": lambda path: open_log(path, "candump"),
}


@pytest.mark.parametrize("name", READERS)
def test_a_named_pipe_is_refused_and_not_waited_for(name: str, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    # Both ends are open: a reader that does open it waits for bytes that never come, until pytest's own limit.
    held = os.open(pipe, os.O_RDWR)
    try:
        with pytest.raises(Exception, match="named pipe, not a file") as refused:
            READERS[name](pipe)
    finally:
        os.close(held)
    assert "pipe.csv" in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("an artefact", f'{{"format": {BIG}}}'),
        ("a configuration", f"port = {BIG}\n"),
        ("a column map", f"a = 1\nb = {BIG}\n"),
        ("a file of the software PLC", f"0,{BIG}\n"),
    ],
)
def test_a_number_of_a_million_digits_is_one_short_sentence(name: str, text: str, tmp_path: Path) -> None:
    file = tmp_path / "big.txt"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"big.txt: .*line \d has a number of 1000000 digits") as refused:
        READERS[name](file)
    assert len(str(refused.value)) < 300 and "set_int_max_str_digits" not in str(refused.value)


@pytest.mark.parametrize("text", [f"a@{BIG}", f"{BIG}@1"])
def test_a_word_of_a_million_signs_is_refused_before_it_is_divided(text: str) -> None:
    with pytest.raises(ValueError, match="and 100000 is the most") as refused:
        parse_word(text)
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize("name", ["a configuration", "a column map"])
def test_toml_nested_beyond_what_can_be_read_is_told(name: str, tmp_path: Path) -> None:
    file = tmp_path / "deep.toml"
    file.write_text("a = " + "[" * 50_000, encoding="utf-8")
    with pytest.raises(ValueError, match=r"deep.toml: .*nested too deep"):
        READERS[name](file)
