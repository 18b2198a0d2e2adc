"""A kind of sink that was added as CONTRIBUTING said never ran: the section had its rows and nothing asked for them.

Neither was there an alarm, its path was relative to the working folder, and no check spoke of it.
"""

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from threading import Event
from typing import Annotated, Any

import pytest
from pydantic import Field, TypeAdapter

from drivers.settings import FilePath
from gateway.machine.reading import plant_clock
from gateway.outside.northbound import OutgoingRow, Present, Sink, SinkUnreachable, check_northbound, feed
from gateway.plant.app import run
from gateway.settings import NorthboundSecrets, NorthboundSection, SinkKind, SinkRow, load_config
from gateway.settings.config import _PlantFile
from tests.cli.support import decanter
from tests.gateway.support import Bench, plant_file
from tests.rig.readers import sections_in

TABLE = "[[northbound.toy]]\nname = 'toy'\nfile = 'toys/rows'\n[[alarm]]\nname = 'northbound'\non_delay = 0.0\n"


class ToyRow(SinkRow):
    """`[[northbound.toy]]`: a file to which the names of tables are written, while its folder is there."""

    kind = SinkKind(__name__, "mqtt", ("json",))
    file: FilePath = Field(description="the file's path")

    @property
    def needs_password(self) -> bool:
        return self.name == "secret"


class ToySink:
    dropped = 0

    def __init__(self, file: Path) -> None:
        self._file = file

    def open(self, present: Present) -> None:
        if not self._file.parent.exists():
            raise SinkUnreachable(f"{self._file.parent} is not there")

    def deliver(self, rows: Sequence[OutgoingRow]) -> Iterator[int]:
        with self._file.open("a", encoding="utf-8") as stream:
            stream.writelines(f"{one.row.stream.table}\n" for one in rows)
        yield len(rows)

    def idle(self, seconds: float, stop: Event) -> None:
        stop.wait(seconds)

    def close(self) -> None:
        pass


def make_sink(row: ToyRow, _secrets: NorthboundSecrets, _context: object) -> Sink:
    return ToySink(row.file)


class _Northbound(NorthboundSection):
    toy: Annotated[tuple[ToyRow, ...], Field(strict=False)] = Field((), description="[[northbound.toy]] tables")


class _File(_PlantFile):
    northbound: _Northbound = Field(default_factory=_Northbound, description="a [northbound] table")


@pytest.fixture(autouse=True)
def _a_sink_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.settings.config._PlantFile", _File)
    for name in ("POLL_SECONDS", "FIRST_RETRY", "LONGEST_RETRY"):
        monkeypatch.setattr(feed, name, 0.05)


async def until(there: Callable[[], bool], gateway: asyncio.Task[Mapping[str, Any]]) -> None:
    async with asyncio.timeout(120.0):
        while not there():
            assert not gateway.done(), gateway.result()
            await asyncio.sleep(0.05)


async def test_it_runs_with_its_alarm_and_at_its_path(tmp_path: Path) -> None:
    config, clock = load_config(plant_file(tmp_path, TABLE)), plant_clock(20.0)
    bench = Bench(config, clock)  # type: ignore[arg-type]
    log, rows = tmp_path / "gateway.jsonl", tmp_path / "toys/rows"

    def raised() -> bool:
        lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
        return any('"northbound"' in line and '"unacknowledged"' in line for line in lines)

    gateway = asyncio.create_task(run(config, clock=clock, stop=bench.stop, driver=bench))
    try:
        await until(raised, gateway)
        rows.parent.mkdir()
        await until(lambda: rows.exists() and "samples" in rows.read_text(encoding="utf-8"), gateway)
    finally:
        bench.stop.set()
        await asyncio.wait_for(gateway, 120.0)


def test_it_is_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = plant_file(tmp_path, TABLE)
    said = decanter("plc", "check", "--offline", "--config", path, "--records", tmp_path / "records.jsonl")
    assert "what is on record is told to toy" in said.output
    monkeypatch.setattr(ToyRow, "kind", SinkKind(__name__, "mqtt", ("a_library_that_is_nowhere",)))
    said = decanter("plc", "check", "--offline", "--config", path, "--records", tmp_path / "records.jsonl")
    assert "northbound.toy: needs a_library_that_is_nowhere" in said.output


def test_it_has_its_password_and_its_own_name(tmp_path: Path) -> None:
    (tmp_path / "secrets.toml").touch(0o600)
    secret = TABLE.replace("name = 'toy'", "name = 'secret'")
    config = load_config(plant_file(tmp_path, f"[northbound]\nsecrets = 'secrets.toml'\n{secret}"))
    with pytest.raises(ValueError, match="passwords: has none for 'secret'"):
        check_northbound(config)
    other = "[[northbound.influx]]\nname = 'toy'\nurl = 'https://x.example'\nbucket = 'b'\n"
    with pytest.raises(ValueError, match="'toy' is named twice"):
        load_config(plant_file(tmp_path, TABLE + other))


def test_one_of_which_nobody_says_what_makes_it_cannot_be_had() -> None:
    with pytest.raises(TypeError, match="the sink Forgotten has no kind"):
        type("Forgotten", (SinkRow,), {"__module__": __name__})


AS_WRITTEN = ("DeviceSection.file", "LinkSection.file")
HOME = Path("/plant")


def _paths() -> Iterator[tuple[str, Any]]:
    """The settings of the plant file that hold a path, with their types."""
    for section in sections_in(_File):
        for name, field in section.model_fields.items():
            whole = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
            if "Path" in str(whole) and f"{section.__name__}.{name}" not in AS_WRITTEN:
                yield f"{section.__name__}.{name}", whole


def test_every_path_of_the_plant_file_is_completed_by_its_type() -> None:
    found = dict(_paths())
    assert len(found) >= 18 and "ToyRow.file" in found and "SmtpSection.ca" in found
    for name, kind in found.items():
        given: Any = ["a/b"] if "tuple" in str(kind) else "a/b"
        whole = TypeAdapter(kind).validate_python(given, context=HOME)
        assert whole in (HOME / "a/b", (HOME / "a/b",)), name
