"""What a file or a request holds came out of its refusal as it was: NUL and ESC on the terminal, two lines for one."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.can.dbc import Dbc
from drivers.errors import OneLineError
from drivers.settings import ConfigError, read_toml
from gateway.commission.files.cells import read_sheet
from gateway.settings import load_config
from sim.files import ArtefactError, file_error
from sim.lab.checking.language import QueryError, parse_query
from sim.lab.recordings import load_map, load_traces
from sim.plc.program import InputError
from sim.plc.record.recording import read_recording
from tests.gateway.support import ROOT, two_modes

STEERING = "\x1b[2J\nadmin: armed\0\x85\u2028\u202e"
ESCAPED = r"\x1b[2J\nadmin: armed\x00\x85\u2028\u202e"


def of_traces(path: Path) -> object:
    return load_traces(path, load_map(ROOT / "config/traces/decanter.toml"))


@pytest.mark.parametrize(
    ("content", "read"),
    [
        ("\x1bVERSION", Dbc),
        ("time\x7f,a\n0,1\n", of_traces),
        ('"b\\u0085" = 1\n' + (ROOT / "config/traces/decanter.toml").read_text(), load_map),
        ('["a\\u001b\\u000a"]\n[device]\n"b\\u0085" = 1\n', load_config),
        ("a\x1b;b\n1;2\n", lambda path: read_sheet(path, {"name": ("name",)}, ("name",))),
    ],
)
def test_what_is_refused_is_quoted_with_escapes(tmp_path: Path, content: str, read: Callable[[Path], object]) -> None:
    path = tmp_path / "x.csv"
    path.write_text(content)
    with pytest.raises((OneLineError, ConfigError)) as raised:
        read(path)
    problems = getattr(raised.value, "problems", (str(raised.value),))
    assert all(problem.isprintable() for problem in problems) and "\\" in str(raised.value)


@pytest.mark.parametrize("row", ['{"k": "run", "n": 1}', '{"k": ["run"]}', "[" * 100_000, "1" + "0" * 5000, "[]"])
def test_a_recording_with_a_row_that_nobody_wrote_is_refused_with_its_line(tmp_path: Path, row: str) -> None:
    path = tmp_path / "x.jsonl"
    path.write_text(f"\n{row}\n")
    try:
        recording = read_recording(path)
    except InputError as error:
        assert "line 2" in str(error) or "digits" in str(error)
    else:
        assert recording.damaged == 1


def test_a_query_is_quoted_with_escapes() -> None:
    with pytest.raises(QueryError) as raised:
        parse_query("Pr[<=5](<> Temp > \x1b)", two_modes())
    assert str(raised.value).isprintable()


def subclasses(kind: type[Exception]) -> list[type[Exception]]:
    return [kind, *(below for direct in kind.__subclasses__() for below in subclasses(direct))]


@pytest.mark.parametrize("kind", subclasses(OneLineError), ids=lambda kind: kind.__name__)
def test_no_error_of_a_parser_or_a_driver_is_more_than_one_line(kind: type[Exception]) -> None:
    for arguments in ((STEERING,), (7, STEERING), ("column", STEERING)):
        with suppress(TypeError, ValueError, AttributeError):  # one that takes other arguments
            assert str(kind(*arguments)).isprintable()
    assert str(OneLineError(STEERING)) == ESCAPED


def test_a_name_of_a_file_and_several_problems_are_one_line_each(tmp_path: Path) -> None:
    assert ESCAPED in str(file_error(f"{STEERING}.json", 3, "is no model")) and isinstance(
        file_error("", 1, ""), ArtefactError
    )
    with pytest.raises(ConfigError) as raised:
        read_toml(tmp_path / "a\nb\x1b.toml")
    assert len(raised.value.problems) == 1 and str(raised.value).isprintable()
    assert str(ConfigError(["a\nb", "c"])) == "a\\nb\nc"
