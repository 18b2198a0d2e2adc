"""The page on Python is run as it stands, and the door says what the commands say, in its own words."""

import ast
import re
import runpy
import time
from dataclasses import fields, replace
from inspect import signature
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import numpy as np
import pandas as pd
import pytest

import decanter_gateway as decanter
from decanter_gateway import start
from gateway.lab.learning import learn
from gateway.lab.python import frames
from sim.lab.recordings import load_traces, parse_map
from sim.lab.recordings.mapping import CHOICES, Answers, draft_map
from tests.rig.no_bands import without_bands
from tests.traces.exports import recording, wide
from tests.traces.test_dialects import EPOCH

PAGE = Path(__file__).parents[2] / "docs" / "python.md"


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three hours of the plant."""
    folder = tmp_path_factory.mktemp("python")
    return wide(folder / "export.csv", of=recording(times=4))


@pytest.fixture(scope="module")
def frame(export: Path) -> pd.DataFrame:
    return pd.read_csv(export, parse_dates=["Time"], index_col="Time")


@pytest.fixture(scope="module")
def names(export: Path) -> dict[str, Any]:
    """What the page's blocks leave behind."""
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    script = export.with_name("page.py")
    script.write_text("\n".join(blocks), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(export.parent)
        without_bands(patch)
        return runpy.run_path(str(script))


def test_the_page_runs_and_its_first_block_is_ten_lines(names: dict[str, Any], export: Path) -> None:
    first = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)[0]
    assert len([line for line in first.splitlines() if "decanter." in line]) == 6
    assert len([line for line in first.splitlines() if line and not line.startswith("import")]) <= 10
    ahead = names["ahead"]
    assert set(ahead["horizon"]) == {60.0, 300.0} and (ahead["q05"] <= ahead["q95"]).all()
    assert ((ahead["due"] - ahead["time"]).dt.total_seconds() == ahead["horizon"]).all()
    assert set(names["worth"].by_horizon["method"]) == {"decanter", "persistence"} and names["worth"].sentences
    assert names["gap"].verdict and (export.parent / "bearing" / "model.json").is_file()
    assert names["answer"].numbers["probability"] == 0.0 and names["errors"]["rmse"].iloc[0] < 2.0
    drivers = names["model"].drivers.set_index("signal")
    assert drivers.loc["Motor_current", "verdict"] == "drives"
    # What is driven by 0.3 degC for each ampere.
    assert drivers.loc["Motor_current", "gain"] == pytest.approx(0.3, rel=0.1)


def test_a_data_frame_is_read_as_its_file_is(frame: pd.DataFrame, export: Path) -> None:
    drafted = draft_map(export, Answers(), now=time.time())
    (trace,), _ = load_traces(export, parse_map(drafted.text, "map"))
    for given in (frame, frame.reset_index(), frame.tz_localize("UTC"), frame.astype(str)):
        read = decanter.read(given)
        (own,) = read.traces
        assert np.array_equal(own.times, trace.times) and own.events == trace.events and own.machine == "recording"
        assert own.origin == "the data frame"
        assert {name: column.tobytes() for name, column in own.signals.items()} == {
            name: column.tobytes() for name, column in trace.signals.items()
        }
        assert read.account[0] in drafted.account[0]
    back = decanter.read(frame).frame()
    assert back["Bearing_temperature"].tolist() == frame["Bearing temperature"].tolist()
    assert list(back["time"]) == list(frame.index.tz_localize("UTC"))


def test_an_index_of_several_levels_is_columns_and_a_time_since_the_beginning_is_seconds(frame: pd.DataFrame) -> None:
    two = pd.concat({"A": frame, "B": frame + 1.0}, names=["Machine"])
    read = decanter.read(two)
    assert [(trace.machine, trace.times.size) for trace in read.traces] == [("A", len(frame)), ("B", len(frame))]
    since = frame.index - frame.index[0]
    for index in (since, since.rename("Time")):
        (trace,) = decanter.read(frame.set_index(index)).traces
        assert trace.times.tolist() == since.total_seconds().tolist()
    (trace,) = decanter.read(frame.assign(Time=since).reset_index(drop=True)).traces
    assert trace.times.tolist() == since.total_seconds().tolist()
    with pytest.raises(ValueError, match=r"^the data frame has 'Time' as a column and in its index; drop one of them$"):
        decanter.read(frame.assign(Time=frame.index))


def test_a_question_names_the_arguments_that_answer_it(frame: pd.DataFrame) -> None:
    doubled = frame.rename(columns={"Bearing temperature": "T 1", "Motor current": "T 2"})
    with pytest.raises(ValueError, match=r"temperature='T 1' or temperature='T 2'$") as raised:
        decanter.read(doubled)
    assert "--" not in str(raised.value)
    assert decanter.read(doubled, temperature="T 1", current="T 2").temperature == "T_1"
    # Each answer that a question may want is an argument of its name.
    known = set(signature(decanter.read).parameters)
    assert {field.name for field in fields(Answers)} <= known


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (pd.DataFrame(), "the data frame has 0 rows and 0 columns; give one with readings"),
        (pd.DataFrame({"a": [1.0, 2.0]}), "the data frame has one column, 'a'; it needs a clock and a temperature"),
        (pd.DataFrame({"a": [1.0, 3.0], "b": [2.0, 1.0]}), "give time= COLUMN"),
        ("nowhere.csv", "nowhere.csv: no such file or directory"),
        (["a.csv", "b.csv"], "give column_map"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(given: object, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)) as raised:
        decanter.read(given)  # type: ignore[arg-type]
    assert "\n" not in str(raised.value) and gettempdir() not in str(raised.value)


def test_a_word_is_one_of_those_that_the_command_takes_and_a_string_is_one_of_several(frame: pd.DataFrame) -> None:
    for name, choices in CHOICES.items():
        with pytest.raises(ValueError, match=rf"^{name}= 'foo': is no answer; give '{choices[0]}'"):
            decanter.read(frame, **{name: "foo"})  # type: ignore[arg-type]
    read = decanter.read(frame, on="1", unit="Bearing temperature=degC")
    assert read.column_map == decanter.read(frame, on=["1"], unit=["Bearing temperature=degC"]).column_map
    with pytest.raises(ValueError, match=r"^method='foo': is no answer; give 'bins', 'lsha'$"):
        decanter.learn(read, method="foo")  # type: ignore[call-overload]
    for name in ("policy", "start"):
        with pytest.raises(ValueError, match=f"^{name}='foo': is no answer; give "):
            decanter.simulate("nowhere", read, **{name: "foo"})  # type: ignore[arg-type]
    # The whole word is what is not known, not its first letter.
    with pytest.raises(ValueError, match=r"^'Motor' cannot drive"):
        decanter.learn(read, drivers="Motor")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"horizons": (300, 60)}, "forecast: horizons: "),
        ({"horizons": (-1,)}, "forecast: horizons: "),
        ({"horizons": 60.0}, "forecast: horizons: "),
        ({"period": 0.0}, "forecast: period: "),
        ({"seed": -1}, "forecast: seed: "),
        ({"moments": 0}, "moments=0: give a whole number from 1"),
        ({"scan": 0.0}, "scan=0.0: no scan is so long; give its seconds, above 0"),
        ({"scan": float("nan")}, "scan=nan: "),
    ],
)
def test_what_cannot_be_forecast_is_one_sentence_before_a_model_is_looked_for(
    frame: pd.DataFrame, given: dict[str, Any], said: str
) -> None:
    recording = decanter.read(frame)
    for function in (decanter.forecast, decanter.judge):
        with pytest.raises(ValueError, match=f"^{re.escape(said)}") as raised:
            function("nowhere", recording, **given)
        assert "\n" not in str(raised.value) and "pydantic" not in str(raised.value)
    for horizons in ([60, 300], (60.0, 300.0), np.array([60.0, 300.0])):
        with pytest.raises(ValueError, match="nowhere"):
            decanter.forecast("nowhere", recording, horizons=horizons)


WRONG: dict[str, tuple[object, ...]] = {
    "moments": (0, 1.5, "many", True),
    "scan": (0.0, float("nan"), "1"),
    "seed": (-1, 0.5, "x"),
    "period": (0.0, "x", None),
    "horizons": ((), (300.0, 60.0), "x", 60.0),
    "since": (float("nan"), "x"),
    "limit": (float("nan"), None),
    "most": (-1, 2.5),
    "runs": (-1, 0, 1.5, "x"),
    "policy": ("x", 1),
    "method": ("x", None),
    "settings": (1,),
    "model": (None, 1, pd.DataFrame(), "no/such/model"),
    "recording": (None, 1, pd.DataFrame(), "no/such/file.csv"),
    "training": (1, "x"),
    "query": ("Pr[", 1, ""),
    "source": (None, 1, [], [1], "no/such/file.csv"),
    "column_map": (1, "no such map"),
    "drivers": ("no such signal", 1),
    "temperature": ("no such signal", 1),
    "stored": ("x", 1),
}
"""What no function takes, by the argument's name."""


@pytest.mark.parametrize("function", ["read", "learn", "forecast", "judge", "diagnose", "simulate", "check"])
def test_each_argument_that_is_wrong_is_one_sentence_in_a_value_error(
    function: str, names: dict[str, Any], frame: pd.DataFrame
) -> None:
    """Walks the signatures: an argument that comes to a function is asked of here as well."""
    called = getattr(decanter, function)
    own = signature(called).parameters
    right = {
        "source": frame,
        "recording": decanter.read(frame),
        "model": names["model"],
        "query": "Pr[<=60](<> Temp > 9)",
    }
    tried = 0
    for name in own:
        for wrong in WRONG.get(name, ()):
            if wrong is None and (function, name) == ("check", "recording"):
                continue
            given = {key: value for key, value in right.items() if key in own} | {name: wrong}
            with pytest.raises(ValueError) as told:
                called(**given)
            assert str(told.value).strip() and len(str(told.value).splitlines()) == 1, (name, wrong)
            tried += 1
    assert tried >= 5


def test_numbers_and_names_may_be_numpys_and_pandas(frame: pd.DataFrame) -> None:
    recording = decanter.read(frame)
    for function in (decanter.forecast, decanter.judge):
        with pytest.raises(ValueError, match="nowhere"):
            function(
                "nowhere", recording, seed=np.int64(3), moments=np.int32(5), scan=np.float64(1.0), period=np.int64(30)
            )
    with pytest.raises(ValueError, match="nowhere"):
        decanter.forecast("nowhere", recording, limit=np.int64(80), since=np.float32(0.0))
    with pytest.raises(ValueError, match="'no such signal' cannot drive"):
        decanter.learn(recording, drivers=pd.Index(["no such signal"]), seed=np.int64(3))  # type: ignore[arg-type]


def test_a_map_and_answers_are_one_too_many(frame: pd.DataFrame) -> None:
    with pytest.raises(ValueError, match="give either column_map or"):
        decanter.read(frame, "decanter", temperature="T")
    with pytest.raises(ValueError, match="settings belong to"):
        decanter.learn(decanter.read(frame), settings=frames.LshaSettings())


def test_signals_that_nobody_looked_at_are_named_with_the_reason(
    frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_bands(monkeypatch)
    monkeypatch.setattr(learn, "MAX_DRIVER_CANDIDATES", 1)
    noise = np.random.default_rng(0).normal(size=(len(frame), 3)).round(2)
    read = decanter.read(frame.assign(**dict(zip(("Oil", "Pump", "Valve"), noise.T, strict=True))))
    (trace,) = read.traces
    begin, middle, end = trace.times[[0, trace.times.size // 2, -1]]
    first, second = trace.between(begin, middle), trace.between(middle, end)
    fewer = {name: column for name, column in second.signals.items() if name != "Valve"}
    model = decanter.learn(replace(read, traces=(first, replace(second, signals=fewer))))
    said = [
        "not looked at: Valve: not every trace has it",
        "not looked at: Pump: no more than 1 beside the alphabet's are",
    ]
    assert list(model.drivers["signal"]) == ["Motor_current", "Oil"]
    assert [each for each in model.warnings if "looked at" in each] == said
    assert model.taught is not None
    shown = list(learn._model_parts(model.taught, Path("model")))
    assert all(sentence in shown for sentence in said)


def test_the_door_shows_what_it_hands_out() -> None:
    handed = {name for name in dir(decanter) if hasattr(frames, name) and not name.startswith("_")}
    assert {"read", "learn", "forecast", "judge", "LearnedModel"} <= handed
    assert all(getattr(decanter, name) is getattr(frames, name) for name in decanter.NAMES)  # type: ignore[attr-defined]
    # The names for the type checker are the same ones.
    door = ast.parse(Path(decanter.__file__).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(door) if isinstance(node, ast.ImportFrom)]
    (checked,) = (node for node in imports if node.module == frames.__name__)
    assert [alias.name for alias in checked.names] == list(decanter.NAMES)  # type: ignore[attr-defined]


def test_what_is_not_handed_out_is_said_and_a_strangers_package_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    # What the functions are made with is not handed out, be it imported or written beside them.
    for name in ("nothing_of_this_name", "re", "pd", "ForecastSection", "_write"):
        with pytest.raises(AttributeError, match=f"module 'decanter_gateway' has no attribute '{name}'"):
            getattr(decanter, name)
    monkeypatch.setattr(start, "stranger", lambda home: "another one's")
    with pytest.raises(ImportError, match="another one's"):
        _ = decanter.simulate


def test_frames_with_times_in_an_unnamed_index_and_names_of_two_levels_are_read() -> None:
    plant = recording()
    values = {"bearing temp": plant.heat, "motor current": plant.current}
    counted = [int((moment - EPOCH).total_seconds()) for moment in plant.moments]
    for index in ([f"{moment:%d.%m.%Y %H:%M:%S}" for moment in plant.moments], counted):
        (trace,) = decanter.read(pd.DataFrame(values, index=index)).traces
        assert trace.times[0] == counted[0] and np.array_equal(trace.signals["bearing_temp"], plant.heat)
    frame = pd.DataFrame(values, index=pd.DatetimeIndex(plant.moments))
    frame.columns = pd.MultiIndex.from_tuples([("bearing", "temp"), ("motor", "current")])
    assert decanter.read(frame).temperature == "bearing_temp"
    frame.columns = pd.MultiIndex.from_tuples([("bearing temp", 0), ("motor current", 0)])
    assert decanter.read(frame).temperature == "bearing_temp_0"
    # Numbers of rows may look like times, beside a column that says them.
    (trace,) = decanter.read(pd.DataFrame({"time": plant.moments, **values}, index=np.add(counted, 86400))).traces
    assert trace.times[0] == counted[0] and sorted(trace.signals) == ["Running", "bearing_temp", "motor_current"]
    with pytest.raises(ValueError, match="no column holds times"):
        decanter.read(pd.DataFrame(values, index=np.arange(plant.heat.size) * 3))
