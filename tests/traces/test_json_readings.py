"""JSON that keeps readings otherwise than an object a row: pairs, frames of columns, readings within a row, by type."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.lab.recordings import TraceError
from sim.lab.recordings.json_readings import name_pairs, spread_readings
from sim.lab.recordings.sources import _collect_rows, open_source
from tests.traces.exports import recording, written
from tests.traces.test_dialects import EPOCH, asked, is_the_plant, mapped

PLANT = recording()
COLUMNS: dict[str, list[float]] = {
    "bearing_temp": PLANT.heat.tolist(),
    "motor_current": PLANT.current.tolist(),
    "running": PLANT.running.tolist(),
}
SECONDS = [int((moment - EPOCH).total_seconds()) for moment in PLANT.moments]


def series(form: Callable[[str, list[float]], Any]) -> list[Any]:
    return [form(name, values) for name, values in COLUMNS.items()]


def pairs(values: list[float], *, scale: int = 1, value_first: bool = False) -> list[list[Any]]:
    own = [[second * scale, value] for second, value in zip(SECONDS, values, strict=True)]
    return [pair[::-1] for pair in own] if value_first else own


def history(values: list[float]) -> list[Any]:
    return [
        {"value": {"doubleValue": value}, "timestamp": {"timeInSeconds": second, "offsetInNanos": 0}, "quality": "GOOD"}
        for second, value in zip(SECONDS, values, strict=True)
    ]


def frame(name: str, values: list[float]) -> Any:
    fields = [{"name": "Time", "type": "time"}, {"name": "Value", "type": "number", "labels": {"tag": name}}]
    return {"schema": {"refId": "A", "fields": fields}, "data": {"values": [[s * 1000 for s in SECONDS], values]}}


def within(name: str, value: str, more: dict[str, Any]) -> str:
    return "\n".join(
        json.dumps({"timestamp": second * 1000, "values": [
            {name: tag, value: cell, **more, "t": second * 1000} for tag, cell in zip(COLUMNS, row, strict=True)
        ], "seq": place % 256})
        for place, (second, *row) in enumerate(zip(SECONDS, *COLUMNS.values(), strict=True))
    )  # fmt: skip


FORMS: dict[str, Callable[[], str]] = {
    "pairs by name": lambda: json.dumps({name: pairs(values, scale=1000) for name, values in COLUMNS.items()}),
    "pairs in series": lambda: json.dumps({"series": series(lambda name, each: {"name": name, "data": pairs(each)})}),
    "value before time": lambda: json.dumps(
        series(lambda name, each: {"target": name, "datapoints": pairs(each, value_first=True)})
    ),
    "a matrix of labels": lambda: json.dumps(
        {"status": "success", "data": {"resultType": "matrix", "result": series(lambda name, each: {
            "metric": {"__name__": name, "job": "plc"}, "values": [[second, str(cell)] for second, cell in pairs(each)]
        })}}
    ),
    "frames of columns": lambda: json.dumps({"results": {"A": {"status": 200, "frames": series(frame)}}}),
    "readings in a row": lambda: within("name", "value", {"dataType": "Float"}),
    "readings with ids": lambda: within("id", "v", {"q": True}),
    "newest first": lambda: json.dumps(
        {name: [{"ts": second * 1000, "value": str(cell)} for second, cell in reversed(pairs(each))]
         for name, each in COLUMNS.items()}
    ),
    "a value by its type": lambda: json.dumps(
        {"entries": series(lambda name, each: {"propertyAlias": f"/d1/{name}", "history": history(each)})}
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_json_that_keeps_readings_otherwise_is_the_plants(form: str, tmp_path: Path) -> None:
    export = tmp_path / "export.json"
    export.write_text(FORMS[form]() + "\n", encoding="utf-8")
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == SECONDS[0] and report.refused == 0


def test_pairs_whose_time_nobody_can_tell_are_refused(tmp_path: Path) -> None:
    """Two readings of one moment are none, whichever of them is called first."""
    export = tmp_path / "export.json"
    export.write_text(json.dumps({name: [[value, value] for value in each] for name, each in COLUMNS.items()}))
    assert "time" in asked(export, tmp_path / "m.toml")


@pytest.mark.parametrize("none", ["-", "NULL", "(null)", ""])
def test_a_reading_stands_in_the_column_of_its_type_beside_words_for_no_value(none: str, tmp_path: Path) -> None:
    rows = [
        f"D1,{name},{moment:%Y-%m-%d %H:%M:%S}.000000000,{none if name == 'running' else cell},"
        f"{cell if name == 'running' else none}"
        for moment, *row in zip(PLANT.moments, *COLUMNS.values(), strict=True)
        for name, cell in zip(COLUMNS, row, strict=True)
    ]
    header = "machine,measure_name,time,measure_value::double,measure_value::bigint"
    (trace,), report, _ = mapped(written(tmp_path / "e.csv", header, rows), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert report.refused == 0


def text_of(*lines: Any) -> str:
    return "\n".join(map(json.dumps, lines)) + "\n"


def fields_of(names: list[str], *more: dict[str, Any]) -> Any:
    columns = [[second * 1000 for second in SECONDS], *(COLUMNS[name] for name in names)]
    fields = [{"name": "Time", "type": "time", "labels": {}}, *({"name": "Value", **each} for each in more)]
    return {"schema": {"fields": fields}, "data": {"values": columns}}


NAMES = list(COLUMNS)
FRAMES: dict[str, Any] = {
    "equal names, labels": fields_of(NAMES, *({"labels": {"tag": name}} for name in NAMES)),
    "equal names, shown names": fields_of(NAMES, *({"config": {"displayName": name}} for name in NAMES)),
    "own names": fields_of(NAMES, *({"name": name} for name in NAMES)),
    "a frame each, own names": [fields_of([name], {"name": name}) for name in NAMES],
    "a frame each, its name": [
        {**frame, "schema": {**frame["schema"], "name": name}} for name in NAMES for frame in [fields_of([name], {})]
    ],
    "the time comes last": [
        {"schema": {"fields": frame["schema"]["fields"][::-1]}, "data": {"values": frame["data"]["values"][::-1]}}
        for name in NAMES
        for frame in [fields_of([name], {"labels": {"tag": name}})]
    ],
}


@pytest.mark.parametrize("form", FRAMES)
def test_the_fields_of_a_frame_are_told_apart_by_what_stands_there(form: str, tmp_path: Path) -> None:
    export = tmp_path / "export.json"
    export.write_text(json.dumps({"results": {"A": {"frames": FRAMES[form]}}}), encoding="utf-8")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert np.allclose(trace.signals["motor_current"][np.isfinite(trace.signals["motor_current"])], PLANT.current)


def test_fields_of_a_frame_that_nothing_tells_apart_are_refused() -> None:
    """The last of them took the place of the others."""
    with pytest.raises(TraceError, match="tell apart"):
        name_pairs(fields_of(NAMES, {}, {}, {}))
    (row, *_) = name_pairs(fields_of(NAMES[:1], {"name": "bearing_temp"}))["rows"]
    assert row["name"] == "bearing_temp"


@pytest.mark.parametrize("key", ["name", "device", "lot"])
@pytest.mark.parametrize("machine", ["1000000001", "30:83:98:00:00:01", "2024-01-A"])
def test_readings_within_a_row_keep_whose_they_are(key: str, machine: str) -> None:
    row = {key: machine, "timestamp": "1710323880000", "values": [{"name": "temp", "v": "5", "t": "1710323880007"},
                                                                  {"name": "amps", "v": None}]}  # fmt: skip
    own = {"machine" if key == "name" else key: machine}
    assert spread_readings(row) == [
        {**own, "time": "1710323880007", "name": "temp", "value": "5"},
        {**own, "time": "1710323880000", "name": "amps", "value": None},
    ]


def test_two_machines_by_their_names_are_two_traces(tmp_path: Path) -> None:
    export = tmp_path / "export.jsonl"
    export.write_text(text_of(*(
        {"name": machine, "time": second * 1000 + late, "readings": [
            {"name": tag, "value": cell} for tag, cell in zip(COLUMNS, row, strict=True)
        ]}
        for second, *row in zip(SECONDS, *COLUMNS.values(), strict=True)
        for machine, late in (("pump1", 0), ("pump2", 400))
    )), encoding="utf-8")  # fmt: skip
    traces, _, _ = mapped(export, tmp_path / "m.toml")
    assert len(traces) == 2
    for trace in traces:
        is_the_plant(trace, tmp_path / "m.toml")


def test_a_list_of_rows_is_read_as_its_lines_are(tmp_path: Path) -> None:
    for name, value, more in (("name", "value", {}), ("id", "v", {"q": True})):
        lines = within(name, value, more)
        texts = {"lines.json": lines, "list.json": f"[{','.join(lines.splitlines())}]"}
        for file, text in texts.items():
            (tmp_path / file).write_text(text, encoding="utf-8")
        first, second = (open_source(tmp_path / file).read() for file in texts)
        assert first == second


def test_points_of_a_series_are_not_taken_for_readings_of_a_moment() -> None:
    series = [
        {"name": name, "data": [{"id": f"{name}{at}", "time": str(at), "value": "1"} for at in range(3)]}
        for name in NAMES
    ]
    rows = _collect_rows(series)
    assert [row["name"] for row in rows] == [name for name in NAMES for _ in range(3)]


DATE_FORMS = ["%d.%m.%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%Y%m%d%H%M%S", "%Y-%m-%dT%H:%M:%SZ"]


@pytest.mark.parametrize("form", DATE_FORMS)
def test_a_date_is_the_time_of_a_pair_beside_a_reading_that_rises(form: str) -> None:
    """By every date that columns are read by: the reading that rose was taken for the time."""
    dates = [moment.strftime(form) for moment in PLANT.moments]
    for place in (0, 1):
        rows: list[list[Any]] = [[date, str(20 + at / 10)][:: 1 - 2 * place] for at, date in enumerate(dates)]
        rows[1][place] = None
        named = name_pairs({"bearing_temp": rows})["bearing_temp"]
        assert [row["value"] for row in named] == [str(20 + at / 10) for at in range(len(rows))]
        assert named[2]["time"] == dates[2]


RISES = [20 + at / 10 for at in range(60)]
UNTOLD: dict[str, list[list[Any]]] = {
    "elapsed beside a reading that rises": [[at // 2, heat] for at, heat in enumerate(RISES)],
    "two readings": [[heat, 4 + at * 7 % 5] for at, heat in enumerate(RISES)],
    "two dates": [["2024-03-13 09:58:00", "2024-03-13 10:58:00"]] * 60,
    "a word": [[at, "auto"] for at in range(60)],
}


@pytest.mark.parametrize("form", UNTOLD)
def test_pairs_are_refused_where_either_cell_may_be_the_time(form: str) -> None:
    with pytest.raises(TraceError, match="nobody can tell the time"):
        name_pairs({"name": "bearing", "data": UNTOLD[form]})


def test_pairs_that_count_from_0_are_refused_and_limits_are_none() -> None:
    """A spectrum became readings: its frequencies count on as elapsed times do, and its amplitudes rise and fall."""
    for step in (10.0, 0.5):
        spectrum = [[at * step, heat] for at, heat in enumerate(COLUMNS["bearing_temp"])]
        with pytest.raises(TraceError, match="nobody can tell the time"):
            name_pairs({"fft": spectrum})
        assert name_pairs({"fft": spectrum, "t": pairs(COLUMNS["bearing_temp"])})["fft"] == spectrum
    # Limits beside the readings are no pairs of a time.
    limits = [[0, "green"], [80, "red"]]
    assert name_pairs({"limits": limits, "t": pairs(COLUMNS["bearing_temp"])})["limits"] == limits


@pytest.mark.parametrize("depth", [60, 500, 100_000])
@pytest.mark.parametrize("within", [("[", "]"), ('{"a":', "}")])
def test_json_that_is_nested_too_deep_is_refused_as_that(depth: int, within: tuple[str, str], tmp_path: Path) -> None:
    """The sentence was that of the interpreter's stack."""
    opened, closed = within
    export = tmp_path / "e.json"
    export.write_text(f'{{"t": {opened * depth}1{closed * depth}, "rows": [{{"time": 1, "value": 2}}]}}', "utf-8")
    assert "its JSON holds lists or objects more than 50 deep" in asked(export, tmp_path / "m.toml")


def test_a_field_of_a_reading_is_no_time_by_its_name_alone() -> None:
    row = {"time": "2024-01-01T00:00:00Z", "readings": [{"name": "m1", "T": "61.2", "value": "3"}]}
    assert spread_readings(row) == [{"time": row["time"], "name": "m1", "T": "61.2", "value": "3"}]
    blank = {"time": row["time"], "readings": [{"name": "m1", "": "61.2", "value": "3"}]}
    assert spread_readings(blank) == [{"time": row["time"], "name": "m1", "": "61.2", "value": "3"}]
    alone = {"readings": [{"name": "m1", "t": "0", "value": "3"}]}
    assert spread_readings(alone) == [{"name": "m1", "time": "0", "value": "3"}]
    both = {"readings": [{"name": "m1", "ts": row["time"], "time": "7", "value": "3"}]}
    assert spread_readings(both) == [{"name": "m1", "time": row["time"], "ts.time": "7", "value": "3"}]
    dated = {"time": row["time"], "readings": [{"name": "m1", "t": "2024-01-01T00:00:01Z", "value": "3"}]}
    assert spread_readings(dated) == [{"time": "2024-01-01T00:00:01Z", "name": "m1", "value": "3"}]


@pytest.mark.parametrize("other", [None, {"de": "Wärme"}])
def test_a_tag_keeps_its_name_beside_another_one(other: Any) -> None:
    (found,) = spread_readings({"readings": [{"tag": "heat", "name": other, "value": "3"}]})
    assert found == {"name": "heat", "tag.name": other, "value": "3"}


def test_labels_called_like_what_a_reading_has_tell_whose_it_is() -> None:
    times = [1_700_000_000_000, 1_700_000_060_000]
    for label, column in (("name", "name"), ("value", "label.value"), ("time", "label.time")):
        fields = [{"name": "Time", "type": "time"}, *({"name": "Value", "labels": {label: tag}} for tag in ("a", "b"))]
        document = {"schema": {"name": "A", "fields": fields}, "data": {"values": [times, [1, 2], [3, 4]]}}
        found = [(row[column], row["time"], row["value"]) for row in name_pairs(document)["rows"]]
        assert found == [("a", times[0], 1), ("a", times[1], 2), ("b", times[0], 3), ("b", times[1], 4)], label


def test_a_frame_of_two_rows_is_no_pair_and_a_temperature_no_time() -> None:
    fields = [{"name": "time"}, {"name": "T"}]
    found = name_pairs(
        {"schema": {"fields": fields}, "data": {"values": [[1_700_000_000_000, 1_700_000_060_000], [60, 59]]}}
    )
    assert [(row["name"], row["value"]) for row in found["rows"]] == [("T", 60), ("T", 59)]


def test_a_first_line_that_is_nested_too_deep_costs_its_row(tmp_path: Path) -> None:
    """The JSON broke off, it said; farther down such a line was counted as refused."""
    rows = [json.dumps(dict(zip(("time", *COLUMNS), each, strict=True)))
            for each in zip(SECONDS, *COLUMNS.values(), strict=True)]  # fmt: skip
    deep = '{"time": ' + "[" * 60 + "]" * 60 + "}"
    for place in (0, 100):
        export = tmp_path / f"e{place}.jsonl"
        export.write_text("\n".join([*rows[:place], deep, *rows[place:]]), encoding="utf-8")
        (trace,), report, _ = mapped(export, tmp_path / f"{place}.toml")
        is_the_plant(trace, tmp_path / f"{place}.toml")
        assert report.refused == 1, place
