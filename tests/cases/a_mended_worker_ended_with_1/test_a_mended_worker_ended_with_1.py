"""A gateway one of whose processes had been begun anew ended with 1 when it was stopped in order, weeks later.

The service manager took the stop for a failure. What is mended is none; what still lacks its process is.
"""

import asyncio
import io
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.supervision import Supervisor
from gateway.cli.plant.run import run as run_command
from gateway.plant import worker_pool
from tests.gateway.support import plant_file
from tests.gateway.test_worker_pool import named, plant_of, pool_of

WELL = {"historian": {"failure": "", "dropped": 0, "refused": 0}}


def exit_of(parts: object, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    ended = {"machines": {"mute": {**WELL, "parts": parts}}}
    monkeypatch.setattr("gateway.plant.serve", lambda *_args, **_keys: ended)
    return CliRunner().invoke(run_command, ["--config", str(plant_file(folder))]).exit_code


async def test_a_stop_after_a_process_was_begun_anew_is_no_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_pool, "WORKER", "tests.gateway.stub_worker")
    async with asyncio.timeout(120.0), pool_of(plant_of(tmp_path, *named("a", "b")), io.StringIO()) as pool:
        worker = pool._workers[1]
        worker.kill()
        while not (worker.ready and worker.former):
            await asyncio.sleep(0.002)
    part = pool.supervisor.report()["worker 2"]
    assert part["restarts"] == 1 and "SIGKILL" in str(part["failure"])
    assert exit_of({"process": part}, tmp_path, monkeypatch) == 0


@pytest.mark.parametrize(("mended", "code"), [(True, 0), (False, 1)])
def test_a_process_that_is_not_mended_is_a_failure(
    mended: bool, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = {"running": False, "restarts": 3, "failure": "worker 1 (mute): its process was ended by SIGKILL"}
    assert exit_of({"process": {**part, "mended": mended}}, tmp_path, monkeypatch) == code


async def test_what_failed_is_mended_once_it_is_begun_anew() -> None:
    supervisor, begun, failing = Supervisor(), asyncio.Event(), asyncio.Event()

    async def work() -> None:
        if not failing.is_set():
            failing.set()
            raise LookupError
        begun.set()
        await asyncio.Event().wait()

    task = supervisor.task("work", work)
    async with asyncio.timeout(60.0):
        await failing.wait()
        assert supervisor.report()["work"]["mended"] is False
        await begun.wait()
    assert supervisor.report()["work"] == {
        "running": True, "restarts": 1, "failure": "LookupError()", "mended": True,
    }  # fmt: skip
    task.cancel()
    await asyncio.wait({task})
    assert supervisor.report()["work"]["mended"] is True
