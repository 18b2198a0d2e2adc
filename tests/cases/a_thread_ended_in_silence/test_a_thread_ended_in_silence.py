"""The forecast, the control socket and what drivers keep going ended; nobody said so, or began them anew."""

import asyncio
import json
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest
from can.interfaces.virtual import VirtualBus
from click.testing import CliRunner

from drivers.can.bus.pump import Pump
from drivers.can.driver import CanDriver
from drivers.canopen.node import RemoteNode
from drivers.errors import DriverError
from drivers.link import Link
from drivers.supervision import Supervisor
from gateway.cli.plant.commands import run as run_command
from gateway.machine.pipeline import Machine
from gateway.machine.reading.device_stream import DeviceStream
from gateway.machine.writing.witnessing import HeadWitnessing
from gateway.plant.app import run
from gateway.plant.control import Control, ControlScope
from gateway.settings.config import load_config
from tests.drivers.bench_can import can_bench
from tests.drivers.bench_canopen import canopen_bench
from tests.drivers.scripted import ScriptedPlc
from tests.gateway.support import ROOT, Bench, PacedClock, config_in, logged, plant_file, two_modes

POOL = "asyncio_"
"""The threads of the event loop's pool begin so: what they carry are tasks that somebody waits for."""


@pytest.fixture(autouse=True)
def _prompt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.supervision.FIRST_PAUSE", 0.01)
    monkeypatch.setattr("gateway.plant.fleet.RESTART_SECONDS", 0.0)
    monkeypatch.setattr("gateway.plant.control.LOOK_SECONDS", 0.01)


def failing_once(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, error: BaseException | None = None) -> None:
    """The next call of this function raises something that nobody has thought of."""
    real, calls = getattr(owner, name), []

    def failing(*args: Any, **keys: Any) -> Any:
        calls.append(args)
        if len(calls) == 1:
            raise error or LookupError("nobody has thought of it")
        return real(*args, **keys)

    monkeypatch.setattr(owner, name, failing)


class Living:
    """The threads and tasks that are there now; `strangers` are those of later that last and that nobody knows."""

    def __init__(self) -> None:
        self.before = self._now()

    @staticmethod
    def _now() -> set[Any]:
        threads = {thread for thread in threading.enumerate() if not thread.name.startswith(POOL)}
        return threads | {task for task in asyncio.all_tasks() if not task.done()}

    async def strangers(self, supervisor: Supervisor, seconds: float = 0.3) -> list[str]:
        seen = self._now() - self.before
        await asyncio.sleep(seconds)
        # Those of one scan or one request come and go, and their owner waits for them.
        lasting = {carrier for carrier in seen & self._now() if not supervisor.knows(carrier)}
        return sorted(str(getattr(carrier, "name", carrier)) for carrier in lasting)


LINKS: dict[str, tuple[str, dict[str, Any]]] = {
    "modbus": ("decanter_plc.toml", {}),
    "can": ("decanter_can.toml", {"interface": "virtual", "channel": "silence"}),
    "canopen": ("decanter_canopen.toml", {"interface": "virtual", "channel": "silence", "node": 5}),
}


@asynccontextmanager
async def running(folder: Path, links: list[str], machines: list[Machine]) -> AsyncIterator[Machine]:
    """A gateway over these links, once it has made some scans; `machines` is where its making is noted."""
    plc = ScriptedPlc()
    await plc.start()
    LINKS["modbus"][1].update(host="127.0.0.1", port=plc.port)
    rows = []
    for link in links:
        file, settings = LINKS[link]
        own = {"name": link, "file": str(ROOT / "config/devices" / file), **settings}
        rows += ["[[device.links]]", *(f"{key} = {json.dumps(value)}" for key, value in own.items())]
    path = plant_file(folder, model=two_modes())
    _, _, rest = path.read_text(encoding="utf-8").partition("[model]")
    path.write_text(
        "\n".join(["[device]", *rows, "[scan]\nperiod = 0.05\n[writeback]\nmode = 'shadow'", "[model]" + rest]),
        encoding="utf-8",
    )
    stop = asyncio.Event()
    gateway = asyncio.create_task(run(load_config(path), stop=stop))
    try:
        async with asyncio.timeout(120.0):
            while not machines or machines[-1].counters.scans < 3:
                assert not gateway.done(), gateway.result()
                await asyncio.sleep(0.01)
        yield machines[-1]
    finally:
        stop.set()
        await gateway
        await plc.stop()


@pytest.fixture
def machines(monkeypatch: pytest.MonkeyPatch) -> list[Machine]:
    """The machines that are made, as they are made."""
    made: list[Machine] = []
    real = Machine.__init__

    def noting(self: Machine, *args: Any, **keys: Any) -> None:
        real(self, *args, **keys)
        made.append(self)

    monkeypatch.setattr(Machine, "__init__", noting)
    return made


@pytest.mark.parametrize("links", [["canopen"], ["modbus", "can"]], ids="+".join)
async def test_nothing_lasts_in_a_running_gateway_that_its_supervisor_does_not_know(
    tmp_path: Path, machines: list[Machine], links: list[str]
) -> None:
    living = Living()
    async with running(tmp_path, links, machines) as machine:
        supervisor = machine.supervisor
        # The gateway itself, and what the scripted PLC has for its connection, are of this test.
        own = [name for name in await living.strangers(supervisor) if "run()" not in name and "_serve" not in name]
        assert own == []
        parts = supervisor.report()
        assert {"historian", "audit", "status", "control"} <= set(parts)
        prefix = "device: " if len(links) == 1 else f"device: {links[0]}: "
        assert parts[f"{prefix}link"]["running"]
        if "can" in links or "canopen" in links:
            assert any(name.endswith("bus receiver") and part["running"] for name, part in parts.items())


@pytest.mark.parametrize("bench", [can_bench, canopen_bench])
async def test_nothing_lasts_in_a_driver_that_it_does_not_say(bench: Callable[[], AsyncIterator[Any]]) -> None:
    made = bench()
    one = await anext(made)
    try:
        living = Living()
        await one.open()
        assert await living.strangers(one.driver.supervisor, 0.1) == []
        report = one.driver.supervisor.report()
        assert set(report) == ({"link", "watch"} if bench is can_bench else {"link", "node", "error register"})
        assert all(part["running"] for part in report.values())
    finally:
        await anext(made, None)


async def thrown() -> None:
    """A callback, a thread and a task of nobody's that end with an error."""

    def fail() -> None:
        raise LookupError("nobody has thought of it")

    asyncio.get_running_loop().call_soon(fail)
    threading.Thread(target=fail, name="stray").start()


PARTS: dict[str, tuple[Any, str]] = {
    "status": ("gateway.plant.app", "_report"),
    "control": (Control, "_is_there"),
    "scans": (Machine, "take"),
    "forecast": ("gateway.machine.model.outlook", "run_job"),
    "signing": (HeadWitnessing, "sign"),
    "event loop": (None, ""),
    "stray": (None, ""),
}


@pytest.mark.parametrize("part", PARTS)
async def test_a_part_that_dies_is_in_status_log_and_alarm_and_is_begun_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    writeback = {
        "writeback__mode": "shadow",
        "forecast__horizons": [10.0],
        "forecast__runs": 20,
        "forecast__period": 1.0,
    }
    config = config_in(tmp_path, model=two_modes(), **writeback)
    bench = Bench(config, PacedClock(pause_s=0.005))
    bench.stop_after = 40
    await_at_open = bench.open

    async def opened() -> None:
        # Not before it runs: what is opened at the start is refused there.
        owner, name = PARTS[part]
        monkeypatch.setattr("gateway.machine.writing.writeback_stage.SIGN_SECONDS", 1.0)
        if owner is None:
            await thrown()
        else:
            failing_once(monkeypatch, __import__(owner, fromlist=[name]) if isinstance(owner, str) else owner, name)
        await await_at_open()

    monkeypatch.setattr(bench, "open", opened)
    status = await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
    assert status["parts"][part]["restarts"] == 1 and "nobody has thought of it" in status["parts"][part]["failure"]
    said = [row for row in logged(tmp_path) if row["event"].startswith("a part of the gateway failed")]
    assert part in {row["part"] for row in said} and "Traceback" in said[0]["exception"]
    assert status["alarms"]["records" if part == "signing" else "parts"] == "unacknowledged"
    assert status["scan"]["count"] > 30


OF_DRIVERS = {
    "can: bus receiver": (VirtualBus, "recv"),
    "can: watch": (CanDriver, "_notice_silence"),
    "can: link": (Link, "_pause"),
    "can: news of the device": (DeviceStream, "_listen"),
    "canopen: bus receiver": (VirtualBus, "recv"),
    "canopen: node": (RemoteNode, "_present"),
}


@pytest.mark.parametrize("which", OF_DRIVERS)
async def test_what_a_driver_keeps_going_is_begun_anew_and_the_bus_is_heard_again(
    tmp_path: Path, machines: list[Machine], monkeypatch: pytest.MonkeyPatch, which: str
) -> None:
    link, _, part = which.partition(": ")
    failing_once(monkeypatch, *OF_DRIVERS[which])
    if part == "link":  # its first attempt is refused, so that it has to pause
        failing_once(monkeypatch, CanDriver, "_connect", OSError("no bus yet"))
    async with running(tmp_path, [link], machines) as machine:
        name = part if part == "news of the device" else f"device: {part}"
        async with asyncio.timeout(120.0):
            while not (report := machine.supervisor.report()).get(name, {}).get("restarts"):
                await asyncio.sleep(0.01)
            while not report[name]["running"] or not machine.driver.statistics()["connects"]:
                await asyncio.sleep(0.01)
                report = machine.supervisor.report()
            while machine.alarms.alarms["parts"].state != "unacknowledged":
                await asyncio.sleep(0.01)
            with can.Bus(interface="virtual", channel="silence") as other:
                before = machine.driver.statistics()["frames"]
                while machine.driver.statistics()["frames"] == before:
                    other.send(can.Message(arbitration_id=0x701, is_extended_id=False, data=b"\5"))
                    await asyncio.sleep(0.01)
        assert report[name]["restarts"] == 1


async def test_an_attempt_to_connect_that_fails_unforeseen_keeps_nobody_waiting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    failing_once(monkeypatch, CanDriver, "_connect")
    made = can_bench()
    one = await anext(made)
    try:
        async with asyncio.timeout(120.0):
            with pytest.raises(DriverError, match="nobody has thought of it"):
                await one.driver.open()
            while not one.driver.statistics()["connects"]:
                await asyncio.sleep(0.01)
    finally:
        await anext(made, None)


async def test_a_frame_that_cannot_be_taken_does_not_keep_the_others_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[can.Message] = []
    failed = asyncio.Event()

    def take(message: can.Message) -> None:
        taken.append(message)
        if len(taken) == 1:
            raise LookupError("nobody has thought of it")

    asyncio.get_running_loop().set_exception_handler(lambda _loop, _context: failed.set())
    with can.Bus(interface="virtual", channel="frames") as other:
        pump = Pump(can.Bus(interface="virtual", channel="frames"), take, lambda reason: None)
        for number in range(5):
            other.send(can.Message(arbitration_id=number, is_extended_id=False))
        async with asyncio.timeout(120.0):
            await failed.wait()
            while len(taken) < 5:
                await asyncio.sleep(0.01)
        pump.close()


async def test_no_way_to_end_is_silent() -> None:
    """SystemExit of a thread, a cancellation that is not the task's own, a return that nobody asked for."""
    supervisor, stop = Supervisor(), threading.Event()
    ends: Iterator[Callable[[], None]] = iter((leave, lambda: None, lambda: None))

    def thread() -> None:
        next(ends, stop.wait)()

    async def task() -> None:
        rounds.append(1)
        if len(rounds) == 1:
            raise asyncio.CancelledError
        if len(rounds) == 2:
            raise SystemExit
        await asyncio.Event().wait()

    rounds: list[int] = []
    carrier, kept = supervisor.thread("thread", thread, stop=stop), supervisor.task("task", task)
    async with asyncio.timeout(120.0):
        while supervisor.report()["thread"]["restarts"] != 3 or supervisor.report()["task"]["restarts"] != 2:
            await asyncio.sleep(0.01)
    assert carrier.is_alive() and not kept.done() and "nobody told it" in supervisor.complaint
    stop.set()
    kept.cancel()
    await asyncio.wait({kept})
    carrier.join(60.0)
    assert not carrier.is_alive()
    assert not any(part["running"] for part in supervisor.report().values())


def leave() -> None:
    raise SystemExit(0)


async def test_a_control_socket_that_was_removed_is_made_anew(tmp_path: Path) -> None:
    path, lines = tmp_path / "socket", []
    log = SimpleNamespace(warning=lambda *args, **keys: lines.append(keys))
    control = Control(ControlScope({}, lambda _machine: {}), path, log)  # type: ignore[arg-type,return-value]
    serving = asyncio.create_task(control.serve())
    try:
        async with asyncio.timeout(120.0):
            while not path.is_socket():
                await asyncio.sleep(0.01)
            path.unlink()
            while not path.is_socket():
                await asyncio.sleep(0.01)
        _, writer = await asyncio.open_unix_connection(path)
        writer.close()
    finally:
        serving.cancel()
        await asyncio.wait({serving})
        await control.close()
    assert lines == [] and not path.exists()


def test_the_exit_code_says_that_a_part_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = {"device: node": {"running": True, "restarts": 2, "failure": "LookupError('x')"}}
    ended = {"historian": {"failure": "", "dropped": 0, "refused": 0}, "parts": parts}
    monkeypatch.setattr("gateway.plant.serve", lambda *_args, **_keys: ended)
    result = CliRunner().invoke(run_command, ["--config", str(plant_file(tmp_path))])
    assert result.exit_code == 1 and "device: node (2): LookupError('x')" in result.stderr
