"""JSON that keeps readings otherwise than an object a row: pairs, frames of columns, readings within a row, by type."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

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
