"""A worker process: some machines of a plant, whose records, log, status and commands are its supervisor's.

It is begun by `gateway.plant.worker_pool`, never by a person: `python -m gateway.plant.worker FD`, where FD is its end
of a socket pair. It ends when it is told to, or with its supervisor.
"""

from __future__ import annotations

import asyncio
import gc
import signal
import socket
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from ctypes import CDLL
from functools import partial
from random import SystemRandom
from typing import Any

from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from gateway.machine import PlantRecords
from gateway.machine.model import LoadedModels
from gateway.machine.reading import PlantClock, Scan
from gateway.plant.allocator import keep_freed_memory
from gateway.plant.channel import Message, SupervisorChannel, scan_message
from gateway.plant.control import ControlScope, answer
from gateway.plant.fleet import SWITCH_SECONDS, Fleet
from gateway.plant.log import handed_logger
from gateway.plant.shortfalls import of_machines
from gateway.plant.status import snapshot
from gateway.plant.worker_records import WorkerRecords
from gateway.settings import Config, configs_from_json
from sim.strict_json import strict

_SIGNAL_AT_PARENTS_DEATH = 1


def main() -> None:
    """Work for the supervisor at the other end of the socket whose number is the first argument."""
    # A process that is stopped hears no line end: the kernel ends it with the process that has begun it (prctl(2)).
    CDLL(None).prctl(_SIGNAL_AT_PARENTS_DEATH, signal.SIGKILL)
    sys.setswitchinterval(SWITCH_SECONDS)
    asyncio.run(_work(socket.socket(fileno=int(sys.argv[1]))))


async def _work(sock: socket.socket) -> None:
    loop, requests = asyncio.get_running_loop(), asyncio.Queue[Message]()
    lines = Supervisor()

    def on_request(message: Message) -> None:
        loop.call_soon_threadsafe(requests.put_nowait, message)

    channel = SupervisorChannel(sock, lines, on_request)
    begin = channel.ask("begin")
    configs, clock = configs_from_json(begin["configs"]), PlantClock(*begin["clock"])
    if any(row.model for config in configs for row in config.temperatures):
        keep_freed_memory()
    log = handed_logger(lambda event: channel.tell("log", event=event), configs[0].log.level)

    def open_records(supervisor: Supervisor) -> PlantRecords:
        channel.ask("open")
        return WorkerRecords(configs, channel, clock=clock, log=log, supervisor=supervisor)

    def show(config: Config, scan: Scan) -> None:
        channel.tell("scan", **scan_message(config.serve.unit, scan))

    try:
        fleet = Fleet(configs, clock=clock, log=log, rng=SystemRandom(), open_records=open_records, show=show)
    except (ConfigError, OSError) as error:
        channel.ask("refused", problems=list(error.problems) if isinstance(error, ConfigError) else [str(error)])
        channel.close()
        return
    fleet.supervisor.include("worker", lines)
    with fleet.supervisor.hearing_all():
        work = _Requests(fleet, channel)
        if begin["former"]:
            for machine in fleet.machines.values():
                machine.supervisor.failed("process", RuntimeError(begin["former"]))
        fleet.start(work.stop)
        serving = fleet.supervisor.task("requests", partial(work.serve, requests))
        gc.freeze()  # as in `gateway.plant.app.run`
        channel.ask("ready")
        await work.stop.wait()
        fleet.stopping()
        await fleet.stop()
        serving.cancel()
        await asyncio.wait([serving])
    work.stopped()
    channel.close()


class _Requests:
    """What the supervisor asks of the machines, until `stop` is set by it."""

    def __init__(self, fleet: Fleet, channel: SupervisorChannel) -> None:
        self.stop = asyncio.Event()
        self._fleet, self._channel = fleet, channel
        self._scope = ControlScope(fleet.machines, snapshot, changing=fleet.changing)
        self._models: Mapping[str, Sequence[LoadedModels]] = {}
        self._tasks = set[asyncio.Task[None]]()
        self._last = 0

    async def serve(self, requests: asyncio.Queue[Message]) -> None:
        """Answer each request in its own time."""
        kinds: dict[str, Callable[[Message], Awaitable[Message]]] = {
            "answer": self._answer,
            "statuses": self._statuses,
            "examine": self._examine,
            "shortfalls": self._shortfalls,
            "take over": self._take_over,
        }
        while True:
            message = await requests.get()
            if message["ask"] == "stop":
                self._last = message["id"]
                self.stop.set()
                continue
            task = asyncio.create_task(self._replied(message["id"], kinds[message["ask"]](message)))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def stopped(self) -> None:
        """Answer the request to stop, now that all is done."""
        self._channel.reply(self._last, self._plain_statuses())

    async def _replied(self, number: int, work: Awaitable[Message]) -> None:
        try:
            content = await work
        except Exception as error:  # noqa: BLE001 - it is said here, as part of the machines' process, and there
            self._fleet.supervisor.failed("requests", error)
            content = {"failed": repr(error)}
        self._channel.reply(number, content)

    async def _answer(self, message: Message) -> Message:
        return {"answer": strict(await answer(self._scope, message["line"].encode()))}

    async def _statuses(self, _: Message) -> Message:
        return self._plain_statuses()

    def _plain_statuses(self) -> Message:
        plain: dict[str, Any] = strict({name: snapshot(one) for name, one in self._fleet.machines.items()})
        progress = {name: (one.completed, one.restarts) for name, one in self._fleet.progress().items()}
        notifier = self._fleet.notifier
        undelivered = "" if notifier is None else notifier.complaint
        return {"statuses": plain, "progress": progress, "undelivered": undelivered}

    async def _examine(self, message: Message) -> Message:
        """What keeps machines from being begun as they are in these configurations; their models are kept for it."""
        try:
            self._models = await self._fleet.examine(configs_from_json(message["configs"]), message["leaving"])
        except ConfigError as error:
            return {"problems": list(error.problems)}
        return {"problems": []}

    async def _shortfalls(self, message: Message) -> Message:
        """The models that the machines of these configurations would go without if they started now."""
        return {"shortfalls": await asyncio.to_thread(of_machines, configs_from_json(message["configs"]))}

    async def _take_over(self, message: Message) -> Message:
        """The machines of these names as they are in the configurations of all of this worker's, in their order."""
        configs = {config.machine: config for config in configs_from_json(message["configs"])}
        failed = await self._fleet.take_over(message["names"], configs, self._models)
        self._models = {}
        running = self._fleet.machines
        taken = [name for name in configs if name in running and running[name].config == configs[name]]
        return {"taken": taken, "failed": failed}


if __name__ == "__main__":
    main()
