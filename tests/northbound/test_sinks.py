"""PostgreSQL and InfluxDB, real servers: exact counts and values over outages, and what a server will not have."""

import json
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode
from urllib.request import Request, urlopen

import psycopg
import pytest

from gateway.lab.fleet.sources import find_sources
from gateway.outside.northbound.influx import InfluxSink, format_row
from gateway.outside.northbound.postgres import PostgresSink
from gateway.settings import InfluxRow, PostgresRow
from gateway.store import FollowedRow, RowPosition, RowStream
from sim.lab.recordings import load_map
from tests.gateway.support import EPOCH
from tests.northbound.rig import MAPS, TABLES, Plant, assert_as_on_record
from tests.rig.servers import Line, free_port, program, running, until

INITDB, POSTGRES, INFLUXD = program("initdb"), program("postgres"), program("influxd")


# ---------------------------------------------------------------- PostgreSQL


@dataclass
class Database:
    port: int

    def query(self, text: str) -> list[tuple[Any, ...]]:
        place = {"host": "127.0.0.1", "port": self.port, "dbname": "postgres", "user": "postgres"}
        with psycopg.connect(**place, autocommit=True) as connection:  # type: ignore[arg-type]
            cursor = connection.execute(text)  # type: ignore[arg-type]
            return cursor.fetchall() if cursor.description else []

    def row(self, port: int, **keys: Any) -> PostgresRow:
        given = {"name": "db", "host": "127.0.0.1", "port": port, "database": "postgres", "user": "postgres"}
        return PostgresRow.model_validate({**given, "table_schema": "plant", **keys})


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    """A server of its own, which root may not run: then it is user nobody's."""
    if INITDB is None or POSTGRES is None:
        pytest.skip("needs PostgreSQL's server (apt-get install postgresql)")
    folder = Path(tempfile.mkdtemp(prefix="decanter-postgres-", dir="/tmp"))
    other: dict[str, Any] = {"user": "nobody", "group": "nogroup", "extra_groups": []} if os.getuid() == 0 else {}
    if other:
        shutil.chown(folder, "nobody", "nogroup")
    here = Database(free_port())
    try:
        make = [INITDB, "-D", str(folder / "data"), "-U", "postgres", "-A", "trust", "--no-sync", "--no-instructions"]
        subprocess.run([*make, "-E", "UTF8", "--locale", "C"], check=True, capture_output=True, cwd=folder, **other)
        command = [POSTGRES, "-D", str(folder / "data"), "-p", str(here.port), "-k", str(folder), "-F"]
        with running(command, here.port, end=signal.SIGINT, cwd=folder, **other):
            until(lambda: _is_ready(here))
            yield here
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _is_ready(database: Database) -> bool:
    try:
        return bool(database.query("SELECT 1"))
    except psycopg.OperationalError:
        return False


def test_postgres_has_every_row_once_over_an_outage_and_a_kill(plant: Plant, database: Database) -> None:
    line = Line(database.port)
    feed = plant.feed(PostgresSink(database.row(line.port), None))
    plant.scan(5)
    until(lambda: feed.delivered == plant.count)
    line.cut()
    plant.scan(120)
    until(lambda: feed.reason)
    line.mend()
    until(lambda: feed.delivered == plant.count)
    feed.stop()
    feed.join()
    assert plant.store.flush(60.0)
    # A gateway that was killed has forgotten how far it was: all of it comes again, and nothing is there twice.
    for machine in ("one", "two"):
        plant.store.view(machine).save("northbound it", plant.now(), {})
    plant.store.flush(60.0)
    again = plant.feed(PostgresSink(database.row(database.port), None))
    until(lambda: again.delivered == plant.count)
    for table in TABLES:
        kept = plant.rows(table)
        assert database.query(f"SELECT count(*) FROM plant.{table}") == [(len(kept),)] and kept  # noqa: S608
    found = database.query(
        "SELECT machine, tag, extract(epoch FROM time)::float8, value, text, quality, unit FROM plant.samples "
        "ORDER BY machine, tag, time"
    )
    wanted = [
        (
            machine,
            row["tag"],
            row["time"],
            None if isinstance(row["value"], str) else row["value"],
            row["value"] if isinstance(row["value"], str) else None,
            row["quality"].name,
            row["unit"],
        )
        for machine, _, row in plant.rows("samples")
    ]
    assert found == sorted(wanted, key=lambda row: (row[0], row[1], row[2]))
    assert database.query("SELECT DISTINCT node, free_run FROM plant.predictions") == [("gateway", None)]
    assert database.query("SELECT DISTINCT quantiles FROM plant.forecasts") == [([1.0, 2.0, 3.0],)]
    address = f"postgresql://postgres:unused@127.0.0.1:{database.port}/postgres"
    fleet = find_sources(address, load_map(MAPS / "decanter.toml"), "plant")
    assert [source.machine for source in fleet] == ["one", "two"] and len({each.content() for each in fleet}) == 2
    for source in fleet:
        (trace,) = source.read(load_map(MAPS / "decanter.toml")).traces
        assert_as_on_record(trace, plant)
        assert "unused" not in trace.origin, "a password stays where it is"
    database.query("DROP SCHEMA plant CASCADE")
    with pytest.raises(ValueError, match=r'/postgres: relation "plant\.samples" does not exist'):
        find_sources(address, load_map(MAPS / "decanter.toml"), "plant")


def test_what_postgres_will_not_have_is_counted_and_costs_itself(plant: Plant, database: Database) -> None:
    database.query("CREATE SCHEMA strict")
    sink = PostgresSink(database.row(database.port, table_schema="strict", tables=["samples"]), None)
    sink.open({})
    database.query("ALTER TABLE strict.samples ADD CHECK (value IS NULL OR value <> 25.0)")
    feed = plant.feed(sink, tables=("samples",))
    plant.scan(20)
    until(lambda: feed.delivered + feed.refused == 8 * plant.scans)
    over = sum(row["value"] == 25.0 for _, _, row in plant.rows("samples"))
    assert feed.refused == over > 0 and any(
        "strict.samples" in str(line) or "check" in str(line) for line in plant.logged
    )
    assert database.query("SELECT count(*) FROM strict.samples") == [(feed.delivered,)]
    database.query("DROP SCHEMA strict CASCADE")


def test_rows_older_than_the_bound_are_left_out_and_counted(plant: Plant, database: Database) -> None:
    plant.scan(150)
    row = database.row(database.port, table_schema="late", tables=["samples"])
    feed = plant.feed(PostgresSink(row, None), tables=("samples",), backlog=50.0)
    until(lambda: feed.delivered == 50 * 8)
    ((oldest,),) = database.query("SELECT extract(epoch FROM min(time))::float8 FROM late.samples")
    assert oldest >= EPOCH + 100.0 and feed.lost == 0
    feed.stop()
    feed.join()
    plant.scan(120)
    later = plant.feed(PostgresSink(row, None), tables=("samples",), backlog=50.0)
    until(lambda: later.delivered + later.lost == 120 * 8)
    assert later.lost == 69 * 8 and any(line["event"] == "rows are not handed on" for line in plant.logged)
    database.query("DROP SCHEMA late CASCADE")


# ---------------------------------------------------------------- InfluxDB


@dataclass
class Influx:
    port: int

    def query(self, text: str, **keys: str) -> Any:
        url = f"http://127.0.0.1:{self.port}/query?{urlencode({'q': text, 'epoch': 'u', **keys})}"
        with urlopen(Request(url, method="POST")) as answer:
            return json.loads(answer.read())["results"][0].get("series", [])


@pytest.fixture(scope="module")
def influx(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Influx]:
    if INFLUXD is None:
        pytest.skip("needs InfluxDB (apt-get install influxdb)")
    folder, here = tmp_path_factory.mktemp("influx"), Influx(free_port())
    (folder / "influxdb.conf").write_text(
        f'reporting-disabled = true\nbind-address = "127.0.0.1:{free_port()}"\n[meta]\ndir = "{folder}/meta"\n'
        f'[data]\ndir = "{folder}/data"\nwal-dir = "{folder}/wal"\n[monitor]\nstore-enabled = false\n'
        f'[http]\nbind-address = "127.0.0.1:{here.port}"\nlog-enabled = false\n',
        encoding="utf-8",
    )
    with running([INFLUXD, "run", "-config", str(folder / "influxdb.conf")], here.port):
        yield here


@pytest.mark.parametrize("version", [1, 2])
def test_influx_has_every_row_once_over_an_outage(plant: Plant, influx: Influx, version: int) -> None:
    name = f"plant{version}"
    influx.query(f"CREATE DATABASE {name}")
    line = Line(influx.port)
    # A server of version 1.8 takes a bucket `database/policy` at the address of version 2.
    kept_in = {"database": name} if version == 1 else {"bucket": f"{name}/autogen"}
    if version == 2 and not answers_version_2(influx):
        pytest.skip("this InfluxDB has no /api/v2/write (1.8 or newer has)")
    row = InfluxRow.model_validate({"name": "tsdb", "url": f"http://127.0.0.1:{line.port}", **kept_in})
    feed = plant.feed(InfluxSink(row, None, None))
    plant.scan(3)
    until(lambda: feed.delivered == plant.count)
    line.cut()
    plant.scan(60)
    until(lambda: feed.reason)
    line.mend()
    until(lambda: feed.delivered == plant.count)
    assert feed.refused == 0
    for table, field in (("samples", "quality"), ("predictions", "mean"), ("forecasts", "q50"), ("alarms", "state")):
        (series,) = influx.query(f'SELECT count("{field}") FROM {table}', db=name)  # noqa: S608
        assert series["values"] == [[0, len(plant.rows(table))]]
    (series,) = influx.query("SELECT value FROM samples WHERE machine='two' AND \"tag\"='T'", db=name)
    rows = [row for machine, _, row in plant.rows("samples") if (machine, row["tag"]) == ("two", "T")]
    assert series["values"] == [[round(1e6 * row["time"]), row["value"]] for row in rows if row["value"] is not None]
    (recipe,) = influx.query("SELECT last(text) FROM samples WHERE \"tag\"='Recipe'", db=name)
    assert recipe["values"][0][1] == "é,=\\"


def answers_version_2(influx: Influx) -> bool:
    with closing(
        InfluxSink(InfluxRow(name="x", url=f"http://127.0.0.1:{influx.port}", bucket="none"), None, None)
    ) as sink:
        sink.open({})
        return sink._post(b"")[0] != 404


def test_a_server_that_is_not_there_and_a_point_that_it_will_not_have(plant: Plant, influx: Influx) -> None:
    influx.query("CREATE DATABASE odd")
    row = InfluxRow.model_validate({"name": "tsdb", "url": f"http://127.0.0.1:{influx.port}", "database": "odd"})
    sink = InfluxSink(row, None, None)
    sink.open({})
    assert sink._post(b'samples,node=gateway,machine=one,tag=Run,unit=x value="text" %d' % (1e6 * EPOCH))[0] == 204
    feed = plant.feed(sink, tables=("samples",))
    plant.scan(10)
    until(lambda: feed.delivered + feed.refused == 8 * plant.scans)
    numbers = sum(isinstance(row["value"], float) for _, _, row in plant.rows("samples"))
    assert feed.refused == numbers > 0 and "field type conflict" in str(plant.logged)
    gone = plant.feed(InfluxSink(row.model_copy(update={"url": f"http://127.0.0.1:{free_port()}"}), None, None))
    until(lambda: gone.reason)
    assert "cannot be reached: Connection refused" in gone.reason


def test_lines_bear_any_name_and_any_value() -> None:
    stream = RowStream("o n,e=", "", "samples", 1)
    values = {"tag": "a\\", "time": 1.5, "value": 'q"\\\n', "quality": 0, "sent": None, "unit": ""}
    row = FollowedRow(stream=stream, key=3, time=1.5, values=values, position=RowPosition(3, 1.5))
    assert format_row(row, "box") == (
        'samples,node=box,machine=o\\ n\\,e\\=,tag=a\\\ufffd text="q\\"\\\\ ",quality="GOOD",row=3i 1500000'
    )
