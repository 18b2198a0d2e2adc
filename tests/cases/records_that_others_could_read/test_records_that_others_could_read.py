"""Outside the unit, which has a umask of its own, records and copies of plant files were everybody's to read."""

import asyncio
import os
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.commission.files import commit, with_machine
from gateway.plant.app import run
from gateway.settings import load_plant
from gateway.store import open_historian
from tests.gateway.support import Bench, JumpClock, config_in, two_modes

OF_THE_PLANT = {"plant.toml", "model.json"}
PUBLIC = {"audit.pub"}
OTHERS_MAY_READ = 0o004


@pytest.fixture(autouse=True)
def open_umask() -> Iterator[None]:
    """Nothing is taken away from what a program asks for."""
    before = os.umask(0)
    yield
    os.umask(before)


def modes(folder: Path) -> dict[Path, int]:
    """The modes of all files and folders below one; drafts come and go meanwhile."""
    found = dict[Path, int]()
    for root, folders, files in os.walk(folder):
        for name in (*folders, *files):
            with suppress(FileNotFoundError):
                found[Path(root, name)] = Path(root, name).stat().st_mode
    return found


def too_open(folder: Path) -> list[str]:
    """The files that others may read, or the group may write."""
    found = modes(folder)
    # In a folder that is closed to others no file needs to be.
    closed = {path for path, mode in found.items() if stat.S_ISDIR(mode) and not mode & 0o077}
    files = {path: mode for path, mode in found.items() if stat.S_ISREG(mode) and closed.isdisjoint(path.parents)}
    known = OF_THE_PLANT | PUBLIC
    return sorted(f"{path.name}: {mode:o}" for path, mode in files.items() if path.name not in known and mode & 0o027)


async def test_what_a_gateway_keeps_is_for_its_owner_and_its_group(tmp_path: Path) -> None:
    text = '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "test"\nminutes = 480\n'
    config = config_in(tmp_path, text, model=two_modes())
    bench = Bench(config, JumpClock(), armed=True, stop_after=30)
    seen = list[str]()

    async def look() -> None:
        while not bench.stop.is_set():
            seen.extend(too_open(tmp_path))  # a write-ahead log is there for as long as the gateway runs
            await asyncio.sleep(0)

    looking = asyncio.create_task(look())
    await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
    await looking
    assert not seen and not too_open(tmp_path)
    for name in ("history.sqlite", "audit.sqlite", "audit.heads.jsonl", "audit.key", "gateway.jsonl"):
        assert (tmp_path / name).is_file(), name
    assert config.audit_key.stat().st_mode & 0o777 == 0o600
    assert config.audit_key.with_suffix(".pub").stat().st_mode & OTHERS_MAY_READ, "it is public"


def test_the_copy_of_a_plant_file_is_read_by_no_others_than_the_file_itself(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    config.path.chmod(0o600)
    backup = commit(with_machine(config.path, "south", {"host": "127.0.0.2"}), load_plant)
    assert backup is not None
    assert {path.stat().st_mode & 0o777 for path in (backup, config.path)} == {0o600}


def test_the_records_of_commissioning_are_too(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    open_historian(config.historian.path).close()
    records = tmp_path / "records.jsonl"
    done = CliRunner().invoke(
        main, ["plc", "check", "--offline", "--config", str(config.path), "--records", str(records)]
    )
    assert done.exit_code in (0, 1), done.output
    assert records.is_file() and not too_open(tmp_path)
