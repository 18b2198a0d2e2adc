"""`decanter historian`: what is exported is what is on record, read back by pandas."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from gateway.cli.plant import records as historian_commands
from gateway.lab.fleet.sources import find_sources
from gateway.store import TABLE_COLUMNS, HistorianError, row_streams
from sim.lab.recordings import load_map
from tests.cli.support import decanter, only_object, refused
from tests.gateway.support import EPOCH, MAP
from tests.northbound.rig import MACHINES, MAPS, TABLES, Plant, assert_as_on_record


@pytest.fixture
def file(plant: Plant) -> Path:
    """The plant file of a filled historian."""
    plant.scan(150)
    path = plant.folder / "plant.toml"
    path.write_text(f'[device]\nfile = "{MAP}"\n[historian]\npath = "h.sqlite"\n', encoding="utf-8")
    return path


def exported(file: Path, name: str, *words: Any) -> pd.DataFrame:
    out = file.with_name(name)
    said = only_object(decanter("historian", "export", out, *words, "--config", file, "--json").stdout)
    table = pd.read_parquet(out) if out.suffix == ".parquet" else pd.read_csv(out, parse_dates=["time"])
    assert said["rows"] == len(table) and said["bytes"] == out.stat().st_size
    assert not list(file.parent.glob(".*.parquet*")) + list(file.parent.glob(".*.csv*"))
    return table


def test_every_table_is_exported_whole_and_the_same_in_both_formats(plant: Plant, file: Path) -> None:
    for name in TABLES:
        kept = plant.rows(name)
        tables = [exported(file, f"{name}.{end}", "--table", name, "--since", "all") for end in ("csv", "parquet")]
        for table in tables:
            assert list(table.columns) == [column.name for column in TABLE_COLUMNS[name]]
            assert list(table["machine"]) == [machine for machine, *_ in kept] and len(table) == len(kept)
            seconds = (table["time"] - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
            assert seconds.tolist() == pytest.approx([row["time"] for *_, row in kept], abs=1e-6)
    samples = pd.read_parquet(file.with_name("samples.parquet"))
    numbers = [row["value"] if not isinstance(row["value"], str) else None for *_, row in plant.rows("samples")]
    assert samples["value"].astype(object).where(samples["value"].notna(), None).tolist() == numbers
    assert set(samples["text"].dropna()) == {"é,=\\"} and set(samples["quality"]) == {"GOOD", "TIMEOUT"}
    assert samples["unit"].iloc[0] == "degC"
    forecasts = pd.read_parquet(file.with_name("forecasts.parquet"))
    assert forecasts["quantiles"].iloc[0].tolist() == [1.0, 2.0, 3.0]
    assert json.loads(pd.read_csv(file.with_name("forecasts.csv"))["quantiles"].iloc[0]) == [1.0, 2.0, 3.0]


def test_a_fleet_is_read_from_what_was_exported_as_the_historian_has_it(plant: Plant, file: Path) -> None:
    exported(file, "samples.parquet", "--since", "all")
    column_map = load_map(MAPS / "decanter.toml")
    fleet = find_sources(str(file.with_name("samples.parquet")), column_map, "")
    assert [source.machine for source in fleet] == sorted(MACHINES)
    for source in fleet:
        (trace,) = source.read(column_map).traces
        assert_as_on_record(trace, plant)
    exported(file, "events.parquet", "--table", "events", "--since", "all")
    with pytest.raises(ValueError, match=r"events\.parquet: holds no samples"):
        find_sources(str(file.with_name("events.parquet")), column_map, "")
    file.with_name("no.parquet").write_text("text")
    for name, words in (("no.parquet", "is no Parquet file"), ("nowhere.parquet", "no such file")):
        with pytest.raises(ValueError, match=words):
            find_sources(str(file.with_name(name)), column_map, "")


def test_a_span_a_machine_and_a_tag_are_what_is_exported_and_shown(plant: Plant, file: Path) -> None:
    table = exported(file, "few.csv", "--since", "60s", "--machine", "two", "--tag", "T")
    assert set(table["machine"]) == {"two"} and set(table["tag"]) == {"T"} and len(table) == 61
    words = ("--since", pd.Timestamp(EPOCH + 10, unit="s").isoformat(), "--until", "100s", "--machine", "one")
    table = exported(file, "span.parquet", *words, "--tag", "Run")
    assert len(table) == 40 and set(table["value"].dropna()) == {0.0, 1.0}
    rows = only_object(
        decanter("historian", "query", "samples", "--tag", "T", "--last", 3, "--config", file, "--json").stdout
    )
    assert [row["value"] for row in rows["rows"]] == [
        row["value"] for one, _, row in plant.rows("samples") if (one, row["tag"]) == ("two", "T")
    ][-3:]
    words = ("--machine", "one", "--tag", "T", "--every", "60", "--since", "all")
    means = only_object(decanter("historian", "query", "samples", *words, "--config", file, "--json").stdout)["rows"]
    good = [row["value"] for one, _, row in plant.rows("samples") if (one, row["tag"]) == ("one", "T") and row["value"]]
    assert sum(row["count"] for row in means) == len(good) and means[0]["low"] == min(good)
    shown = decanter("historian", "query", "alarms", "--config", file).stdout
    assert "over limit T" in shown and "unacknowledged" in shown


def test_what_cannot_be_exported_is_refused_in_a_sentence(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*words: Any) -> Any:
        return decanter("historian", "export", *words, "--config", file)

    refused(run(file.with_name("x.xlsx")), 2, "ends neither in .csv nor in .parquet")
    refused(
        run(file.with_name("x.csv"), "--machine", "three"), 2, "has no rows of a machine 'three'", ", ".join(MACHINES)
    )
    refused(run(file.with_name("x.csv"), "--since", "yesterday"), 2, "neither a time nor a span")
    refused(run(file.with_name("x.csv"), "--since", "10s", "--until", "20s"), 2, "is not after")
    refused(run(file.parent / "none" / "x.csv"), 2, "cannot be written (no such file or directory)")
    refused(
        decanter("historian", "query", "alarms", "--every", "60", "--config", file), 2, "--every is of a tag's samples"
    )
    with closing(sqlite3.connect(file.with_name("h.sqlite"))) as connection:
        connection.execute("PRAGMA user_version = 2")
        with pytest.raises(HistorianError, match="has layout 2; a gateway of this version converts it"):
            row_streams(connection, MACHINES)
        connection.execute("PRAGMA user_version = 3")

    def absent(name: str) -> Any:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(historian_commands, "import_module", absent)
    refused(run(file.with_name("x.parquet")), 2, "pip install 'decanter-gateway[parquet]'")
    assert not file.with_name("x.parquet").exists()


def test_the_tables_are_described() -> None:
    found = only_object(decanter("historian", "tables", "--json").stdout)["tables"]
    assert set(found) == set(TABLES) and all(row["meaning"] for rows in found.values() for row in rows)
    assert "what its condition looked at" in decanter("historian", "tables").stdout
