"""The supervisor process of a plant whose machines are split over several: it has the stores, the log and the socket.

Each worker process (`gateway.plant.worker`) has some of the machines, at its end of a socket pair
(`gateway.plant.channel`). What it wants on record it sends, and this process is the one writer of each store; what is
asked at the control socket is passed on to it. One that ends, or does not answer for HANG_SECONDS, is begun anew with
growing pauses; what its machines had on record stays, and their last picture, with the alarms in it, is shown with what
has become of it.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple
from datetime import UTC, datetime
from functools import partial
from time import monotonic, time
from typing import TYPE_CHECKING, Any

from drivers import json_lines
from drivers.json_lines import NoObject
from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from drivers.tag import Quality, Sample
from gateway.machine import MODEL_PART, RECORDING, PlantRecords
from gateway.machine.reading import PlantClock, unread
from gateway.machine.writing import ArmingError, AuditTrail, disarm_in_log, newest_stamp
from gateway.outside.serving import DeviceImage
from gateway.outside.status import ControlError, GatewayStatus, read_status
from gateway.plant.channel import Message, plain_rows, scan_from
from gateway.plant.control import COMMANDS, ControlScope, answer, disarm_words, meant_machine
from gateway.plant.fleet import MENDED, next_start_sentences, raise_failures
from gateway.plant.log import log_again
from gateway.plant.service import ScanProgress
from gateway.plant.shortfalls import of_plant
from gateway.plant.split import split_over
from gateway.plant.status import snapshot
from gateway.plant.worker_line import PlantWorker, WorkerEnded, WorkerLine
from gateway.settings import Config, changed_machines, configs_to_json
from gateway.store import AuditEntry, AuditRow, HistorianError, Source

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


WORKER = "gateway.plant.worker"
"""The module that is the program of a worker process."""
HANG_SECONDS = 10.0
"""A worker that has not said how its machines are for so long is killed: their PLCs' timers have run out by then."""
STOP_SECONDS = 30.0
"""How long a worker may take to stop its machines in order."""
FRESH_SECONDS = 1.0
"""How long a question about the status waits for a worker before the last picture is given."""
EXIT_SECONDS = 5.0
"""How long a process whose line has ended may take to end itself, and what it has sent to be read."""
LATE_SECONDS = 2.0
"""By how much the answer how the machines are may be late until they are shown as not known."""
ALIVE_SECONDS = 2.0
"""So long a worker has for what it is asked, and as long again for how its machines are, until it is taken to hang. Who
asks at the control socket waits for 5 s."""
LONGEST_LINE = 1 << 26


def _ours(reply: Message) -> dict[str, Any]:
    """A worker's answer as the gateway's own."""
    answer: dict[str, Any] = reply["answer"]
    return answer | ({"pid": os.getpid()} if answer["ok"] else {})


async def _to_its_end(task: asyncio.Task[None]) -> None:
    """Wait for a task that a cancellation meanwhile does not end; that is passed on after it."""
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.shield(task)
        except asyncio.CancelledError as error:
            cancelled = error
    if cancelled is not None:
        raise cancelled


class WorkerPool:
    """The machines of a plant in worker processes: what a `Fleet` is in one.

    `look_seconds` is how often it is looked how the machines are, `on_scan` is told the name of each machine that was
    looked at, and `on_taken_over` (in a thread) the configurations after a reload. `images` are what peers are shown
    of them, by their unit numbers. `open` begins them, `stop` ends them. Raises ConfigError for what cannot be shown to
    peers.
    """

    several = True

    def __init__(
        self,
        configs: Sequence[Config],
        *,
        clock: PlantClock,
        log: FilteringBoundLogger,
        log_failure: Callable[[], str],
        read_anew: Callable[[], Sequence[Config]],
        look_seconds: float,
    ) -> None:
        self.clock, self.log = clock, log
        self.supervisor = Supervisor(self._note_failure)
        self._configs = {config.machine: config for config in configs}
        self._log_failure, self._read_anew, self._look_seconds = log_failure, read_anew, look_seconds
        self._most = configs[0].plant.workers
        self.images = {config.serve.unit: image for config, image in self._images_of(configs)}
        self._workers: dict[int, PlantWorker] = {}
        self._places: dict[str, int] = {}
        self._records: PlantRecords | None = None
        self._records_open, self._trail, self._reloading = asyncio.Event(), asyncio.Lock(), asyncio.Lock()
        self._stopping = False
        self.on_scan: Callable[[str], None] = lambda machine: None
        self.on_taken_over: Callable[[Sequence[Config]], None] = lambda configs: None
        self._asked: Mapping[str, Callable[[PlantWorker, Message], Awaitable[Message]]] = {
            "begin": self._on_begin,
            "refused": self._on_refused,
            "open": self._on_open,
            "ready": self._on_ready,
            "flush": self._on_flush,
            "load": self._on_load,
            "newest": self._on_newest,
            "open trail": self._on_open_trail,
            "audit": self._on_audit,
        }

    # ---------------------------------------------------------------- begin and end

    async def open(self) -> None:
        """Begin all machines. Raises ConfigError, HistorianError or OSError, and nothing is left running then."""
        opened = False
        try:
            self._places = split_over(list(self._configs.values()), self._most, {})
            workers = [self._begin(number) for number in sorted(set(self._places.values()))]
            # As in one process: models that do not suit their machines leave no records behind.
            await asyncio.gather(*(worker.loaded for worker in workers))
            self._records = PlantRecords(
                list(self._configs.values()),
                clock=self.clock,
                log=self.log,
                supervisor=self.supervisor,
                log_failure=self._log_failure,
            )
            self._note_sources(self._configs.values())
            first = next(iter(self._configs.values()))
            if first.page.enabled:
                await self._open_trail(first)  # what people do at the page is on record, whatever is written
            self._records_open.set()
            await asyncio.gather(*(worker.begun for worker in workers))
            opened = True
        finally:
            if not opened:
                await self._end()

    def stopping(self) -> None:
        """Say of every machine that it is being stopped."""
        self._stopping = True

    async def stop(self) -> None:
        """Stop all machines, then close what they have in common."""
        self._stopping = True

        async def stop_one(worker: PlantWorker) -> None:
            worker.retired = True
            if worker.ready:
                with suppress(TimeoutError, WorkerEnded):
                    worker.pictures = (await worker.ask("stop", timeout=STOP_SECONDS))["statuses"]
                    await worker.wait_for_end(EXIT_SECONDS)

        await asyncio.gather(*(stop_one(worker) for worker in self._workers.values()))
        if await self._end():
            self.log.info("stopped", machines=len(self._configs))
        else:
            self.log.error("stopped, with records that could not be stored", reason=self._health(())["failure"])

    async def _end(self) -> bool:
        """End what still runs, and close the records; False if some had to be given up."""
        tasks = [worker.task for worker in self._workers.values() if worker.task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        return self._records is None or await asyncio.to_thread(self._records.close)

    def _note_failure(self, part: str, error: BaseException) -> None:
        message = "a part of the gateway failed and is begun anew"
        trace = None if isinstance(error, WorkerEnded) else error
        self.log.error(message, part=part, reason=str(error) if trace is None else repr(error), exc_info=trace)

    def _images_of(self, configs: Iterable[Config]) -> list[tuple[Config, DeviceImage]]:
        """What peers are to be shown of machines; none where nothing is served. Raises ConfigError."""
        return [(config, DeviceImage(config, self.clock.now)) for config in configs if config.serve.port is not None]

    def _note_sources(self, configs: Iterable[Config]) -> None:
        for config in configs:
            self.records.historian.of(config.machine, config.map.tags)
            for row in config.temperatures:
                self.records.historian.of(config.machine, config.map.tags, row.tag)

    @property
    def configs(self) -> dict[str, Config]:
        """The machines' configurations, by their names."""
        return self._configs

    @property
    def records(self) -> PlantRecords:
        """The stores. Raises HistorianError before they are open."""
        if self._records is None:
            raise HistorianError("the records are not open yet")
        return self._records

    def _begin(self, number: int) -> PlantWorker:
        worker = self._workers[number] = PlantWorker(number)
        worker.task = self.supervisor.task(worker.name, partial(self._keep, worker))
        return worker

    # ---------------------------------------------------------------- one worker process

    def _of(self, worker: PlantWorker) -> list[Config]:
        return [config for name, config in self._configs.items() if self._places.get(name) == worker.number]

    async def _keep(self, worker: PlantWorker) -> None:
        """One process of a worker, from its beginning to its end. Raises WorkerEnded when nobody told it to end."""
        ours, theirs = socket.socketpair()
        with theirs:
            command = [sys.executable, "-m", WORKER, str(theirs.fileno())]
            # A terminal's Ctrl-C and a service manager's SIGTERM go to every process, and it is for this one to stop
            # the others in order: a process begins with the signals blocked that are blocked here, and leaves them so.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
            try:
                process = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=(theirs.fileno(),))  # noqa: S603
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            reader, writer = await asyncio.open_connection(sock=ours, limit=LONGEST_LINE)
        except asyncio.CancelledError:
            # Told to end before its line is there: neither process nor line may be left behind.
            process.kill()
            await asyncio.to_thread(process.wait)
            raise
        line = WorkerLine(process, writer)
        worker.began(line)
        talk = asyncio.create_task(self._listen(worker, line, reader))
        look = asyncio.create_task(self._look(worker, line))
        why = ""
        try:
            await asyncio.wait((talk, look), return_when=asyncio.FIRST_COMPLETED)
            if look.done() and (error := look.exception()) is not None:
                since = datetime.fromtimestamp(time() - HANG_SECONDS, UTC).strftime("%H:%M:%S UTC")
                hung = f"it had not answered since {since} ({HANG_SECONDS:g} s) and was killed"
                why = hung if isinstance(error, TimeoutError) else f"{error}, and it was killed"
            elif talk.done() and (error := talk.exception()) is not None:
                why = f"what it said makes no sense ({error!r}), and it was killed"
            else:
                with suppress(subprocess.TimeoutExpired):
                    await asyncio.to_thread(process.wait, EXIT_SECONDS)
        finally:
            # Who cancels it while it ends by itself must not leave the process, or its line, behind.
            ending = asyncio.create_task(self._put_away(worker, line, (talk, look), why))
            await _to_its_end(ending)
        if worker.retired:
            # A part that returned would be begun anew by the supervisor: this one is over when it is cancelled.
            await asyncio.Future()
        raise WorkerEnded(worker.former)

    async def _put_away(
        self, worker: PlantWorker, line: WorkerLine, tasks: tuple[asyncio.Task[None], asyncio.Task[None]], why: str
    ) -> None:
        """End a process, hear it to its last line, and note why it ended."""
        talk, look = tasks
        line.process.kill()
        look.cancel()
        # What it has sent counts, to the last line.
        await asyncio.wait(tasks, timeout=EXIT_SECONDS)
        talk.cancel()
        await asyncio.gather(talk, look, return_exceptions=True)
        line.close()
        code = await asyncio.to_thread(line.process.wait)
        if not why and code < 0:
            why = f"its process was ended by {signal.Signals(-code).name}"
        names = ", ".join(config.machine for config in self._of(worker))
        why = worker.refusal or why or f"its process ended with code {code}"
        worker.ended(WorkerEnded(f"{worker.name} ({names}): {why}"))

    async def _look(self, worker: PlantWorker, line: WorkerLine) -> None:
        """See how the machines are, again and again. Raises TimeoutError when nothing is said for HANG_SECONDS."""
        await worker.is_ready.wait()
        while not worker.retired:
            reply = await line.ask("statuses", timeout=HANG_SECONDS)
            worker.see(reply["statuses"])
            worker.undelivered = reply["undelivered"]
            worker.progress = {name: ScanProgress(*counts) for name, counts in reply["progress"].items()}
            for name in worker.pictures:
                self.on_scan(name)
            await asyncio.sleep(self._look_seconds)
        await asyncio.Future()

    async def _listen(self, worker: PlantWorker, line: WorkerLine, reader: asyncio.StreamReader) -> None:
        """Hear what a worker says until it ends."""
        with suppress(ConnectionError):
            async for text in reader:
                message = json.loads(text)
                if "reply" in message:
                    line.replied(message)
                elif "tell" in message:
                    self._hear(worker, message)
                elif message["ask"] == "rows":
                    for source, table, rows in message["batch"]:
                        self.records.historian.put(tuple(source), table, plain_rows(rows))
                    line.reply(message, health=self._health(config.machine for config in self._of(worker)))
                else:
                    worker.begin(self._replied(worker, line, message))
                # A worker that says much is heard in turn with the others; and what it asks begins in its order.
                await asyncio.sleep(0)

    def _hear(self, worker: PlantWorker, message: Message) -> None:
        if message["tell"] == "log":
            log_again(self.log.bind(worker=worker.number + 1), message["event"])
        elif message["tell"] == "forget":
            self.records.historian.forget_before(message["moment"])
        elif message["tell"] == "scan" and (image := self.images.get(message["unit"])) is not None:
            image.take(scan_from(message))

    async def _replied(self, worker: PlantWorker, line: WorkerLine, message: Message) -> None:
        try:
            line.reply(message, **await self._asked[message["ask"]](worker, message))
        except Exception as error:  # noqa: BLE001 - it is said, and the process that would wait for ever begun anew
            self.supervisor.failed(f"{worker.name} asks", error)
            line.process.kill()

    async def _on_begin(self, worker: PlantWorker, _: Message) -> Message:
        clock = [self.clock.epoch, self.clock.start, self.clock.speed]
        return {"configs": configs_to_json(self._of(worker)), "clock": clock, "former": worker.former}

    async def _on_refused(self, worker: PlantWorker, message: Message) -> Message:
        error = ConfigError(message["problems"])
        worker.refusal = str(error)
        worker.settle(worker.loaded, error)
        worker.settle(worker.begun, error)
        return {}

    async def _on_open(self, worker: PlantWorker, _: Message) -> Message:
        """The models are read: the machines may be opened once the records are, with all rows of the former process."""
        worker.settle(worker.loaded)
        await self._records_open.wait()
        async with worker.opening:
            await asyncio.gather(*worker.audits)
            await asyncio.to_thread(self.records.historian.flush)
            worker.is_opened = True
        return {}

    async def _on_ready(self, worker: PlantWorker, _: Message) -> Message:
        worker.is_ready.set()
        worker.settle(worker.begun)
        return {}

    async def _on_flush(self, _worker: PlantWorker, message: Message) -> Message:
        return {"done": await asyncio.to_thread(self.records.historian.flush, message["timeout"])}

    async def _on_load(self, _worker: PlantWorker, message: Message) -> Message:
        machine, temperature = message["source"]
        try:
            source: Source = (machine, temperature)
            state = await asyncio.to_thread(self.records.historian.load, source, message["key"])
        except (ValueError, HistorianError) as error:
            return {"state": None, "error": str(error)}
        return {"state": state, "error": ""}

    async def _on_newest(self, _worker: PlantWorker, message: Message) -> Message:
        return {"newest": self.records.historian.newest(message["machine"])}

    async def _on_open_trail(self, _worker: PlantWorker, message: Message) -> Message:
        try:
            trail = await self._open_trail(self._configs[message["machine"]])
        except OSError as error:
            return {"error": str(error), "failure": "", "files": self._files}
        return {"error": "", "failure": trail.audit.failure, "files": self._files}

    async def _open_trail(self, config: Config) -> AuditTrail:
        """The audit log, its signing key made here: once, not by several processes side by side. Raises OSError."""
        async with self._trail:
            trail = await asyncio.to_thread(self.records.open_trail, config)
            await asyncio.to_thread(trail.witnessing.sign, self.clock.now(), trail.witnessing.turn())
            return trail

    async def _on_audit(self, worker: PlantWorker, message: Message) -> Message:
        """Commit the entries, also where the process that has sent them is gone by then."""
        trail = self.records.trail
        if trail is None:
            return {"error": "the audit log is not open", "files": self._files}
        tickets = trail.audit.submit(AuditEntry(*entry) for entry in message["entries"])
        commit = asyncio.gather(*map(asyncio.wrap_future, tickets), return_exceptions=True)
        worker.audits.add(commit)
        commit.add_done_callback(worker.audits.discard)
        stored = await commit
        for outcome in stored:
            if isinstance(outcome, BaseException):
                return {"error": str(outcome) or "the audit log is being closed", "files": self._files}
        return {
            "error": "",
            "files": self._files,
            "ended": {subject: astuple(ended) for subject, ended in trail.audit.ended_elsewhere.items()},
            "rows": [(row.id, row.hash) for row in stored if not isinstance(row, BaseException)],
        }

    @property
    def _files(self) -> tuple[str, str, int]:
        """How the files are that are relied on here (`ReliedFiles.hear`)."""
        files = self.records.files
        return files.complaint, files.note, files.taken

    def _health(self, machines: Iterable[str]) -> Message:
        """How the stores are, for a worker with these machines (`RecordsHealth`)."""
        historian, trail = self.records.historian, self.records.trail
        failed = self.supervisor.complaints
        lost = {name: historian.lost_by(name) for name in machines}
        return {
            "failure": historian.failure,
            "stuck": historian.stuck,
            "note": historian.note or "; ".join(failed[part] for part in RECORDING if part in failed),
            "audit": trail.audit.failure if trail else "",
            "audit_note": trail.audit.note if trail else "",
            "files": self._files,
            "log": self._log_failure(),
            "without": dict(self.records.without),
            "northbound": self.records.unreached(),
            "undelivered": "; ".join(filter(None, (worker.undelivered for worker in self._workers.values()))),
            "lost": {
                name: {"dropped": one.dropped, "refused": one.refused, "what": one.what, "at": one.at}
                for name, one in lost.items()
                if one.dropped or one.refused
            },
        }

    # ---------------------------------------------------------------- status and commands

    def progress(self) -> dict[str, ScanProgress]:
        """How far each machine that is to be read has come, by its name, as its process has said last."""
        found, parts = {}, self.supervisor.parts()
        for name in self._configs:
            worker = self._worker_of(name)
            if worker is None or worker.retired or (worker.ready and name not in worker.progress):
                continue  # it is being stopped
            # While its process is begun anew a machine completes nothing, and each attempt counts as a restart.
            own = worker.progress.get(name, ScanProgress())
            found[name] = ScanProgress(own.completed, own.restarts + parts[worker.name].restarts)
        return found

    @property
    def longest_period(self) -> float:
        """The longest time from one scan of a machine to the next (real s)."""
        return max(config.scan.period for config in self._configs.values()) / self.clock.speed

    def statuses(self) -> dict[str, GatewayStatus]:
        """How all machines are, by their names, as far as anything is known of them."""
        return {name: read_status(picture) for name, picture in self._pictures().items()}

    def pictures(self) -> dict[str, Callable[[], GatewayStatus]]:
        """What gives each machine's status, by its name, as far as anything is known of it."""
        return {name: partial(read_status, picture) for name, picture in self._pictures().items()}

    def _pictures(self) -> dict[str, dict[str, Any]]:
        pictures = {}
        for name in self._configs:
            worker = self._worker_of(name)
            if worker is not None and (picture := worker.pictures.get(name)) is not None:
                pictures[name] = self._with_process(worker, picture)
        return pictures

    def _worker_of(self, name: str) -> PlantWorker | None:
        """The worker that has a machine; None while it is taken from one to another."""
        return self._workers.get(self._places.get(name, -1))

    def _with_process(self, worker: PlantWorker, picture: Mapping[str, Any]) -> dict[str, Any]:
        """A machine's picture with what there is to say of its process; where that says nothing, all grows old."""
        process = self.supervisor.report()[worker.name]
        shown = dict(picture)
        if process["restarts"]:
            shown["parts"] = {**picture["parts"], "process": process}
        passed = monotonic() - worker.seen
        silent = passed > self._look_seconds + LATE_SECONDS
        # Between a process's start and the first look at it, what is known is of the one before.
        running = worker.ready and worker.is_seen
        if worker.retired or (running and not silent):
            return shown | ({"phase": "stopping"} if self._stopping and not worker.retired else {})
        why = self._hung(worker) if running else f"its process is being begun anew: {worker.former}"
        period, scan = picture["scan"]["period"], picture["scan"]
        passed *= self.clock.speed
        silence = (scan["age"] or 0.0) + passed
        aged = {}
        for name, value in picture["values"].items():
            sample = Sample(name, value["value"], Quality[value["quality"]], value["time"], reason=value["reason"])
            now = unread(sample, silence, period)
            told = {"value": now.value, "quality": now.quality.name, "age": value["age"] + passed, "reason": now.reason}
            aged[name] = {**value, **told}
        return shown | {
            "time": picture["time"] + passed,
            "phase": picture["phase"] if running else "starting",
            "values": aged,
            "link": {**picture["link"], "alive": False, "connected": False, "reason": why},
            "scan": {**scan, "age": silence, "late": True},
        }

    def _hung(self, worker: PlantWorker) -> str:
        """That a worker does not answer: which one, whose machines are concerned, and since when."""
        names, silence = ", ".join(config.machine for config in self._of(worker)), monotonic() - worker.seen
        since = datetime.fromtimestamp(time() - silence, UTC).strftime("%H:%M:%S UTC")
        return (
            f"{worker.name} ({names}) has not answered since {since} ({silence:.0f} s ago); it is killed and begun "
            f"anew after {HANG_SECONDS:g} s"
        )

    async def answer(self, line: bytes) -> dict[str, Any]:
        """The reply to a request at the control socket: the worker's whose machine it speaks of."""
        try:
            request = json_lines.parsed(line)
            if request.get("command") == "reload":
                return await answer(ControlScope({}, snapshot, self.reload), line)
            if request.get("command") == "plant":
                return await self._plant(line)
            name = request.get("machine")
            if request.get("command") not in COMMANDS or not isinstance(name, str | None):
                return await answer(ControlScope({}, snapshot), line)  # a refusal, which no machine has to give
            meant = meant_machine(list(self._configs), name)
            if (worker := self._worker_of(meant)) is None:
                raise ControlError(f"machine {meant!r} is being taken over; ask again in a moment")
            if request["command"] == "status":
                return await self._status(worker, meant, line)
            if request["command"] == "disarm" and not worker.ready:
                return await self._disarm(worker, meant, request)
            if not worker.ready:
                raise ControlError(f"{worker.former or worker.name}; it is being begun anew, ask again in a moment")
            return await self._answered(worker, meant, request, line)
        except (NoObject, ControlError, WorkerEnded) as error:
            return {"ok": False, "reason": str(error)}

    async def _answered(
        self, worker: PlantWorker, name: str, request: Mapping[str, Any], line: bytes
    ) -> dict[str, Any]:
        """What a machine's process answers. One that hangs keeps nobody from disarming; else ControlError is raised."""
        asking = asyncio.ensure_future(worker.ask("answer", line=line.decode()))
        while not (await asyncio.wait((asking,), timeout=ALIVE_SECONDS))[0]:
            # What was asked may take its time; a process that says how its machines are is at it.
            with suppress(TimeoutError):
                worker.see((await worker.ask("statuses", timeout=ALIVE_SECONDS))["statuses"])
                continue
            if request["command"] != "disarm":
                asking.cancel()
                raise ControlError(self._hung(worker))
            # Killed now: one that comes round would go on writing until it has read what it was asked.
            worker.kill()
            with suppress(WorkerEnded):
                await asking
            return await self._disarm(worker, name, request)
        return _ours(asking.result())

    async def _status(self, worker: PlantWorker, name: str, line: bytes) -> dict[str, Any]:
        """How one machine is: as its process says now, else as it was last."""
        with suppress(TimeoutError, WorkerEnded):
            reply = _ours(await worker.ask("answer", timeout=FRESH_SECONDS, line=line.decode()))
            if reply["ok"]:
                reply["status"] = self._with_process(worker, reply["status"])
            return reply
        if (picture := self._pictures().get(name)) is None:
            raise ControlError(f"machine {name!r} has not begun yet: {worker.former or worker.name}")
        return _ours({"answer": {"ok": True, "config": str(self._configs[name].path), "status": picture}})

    async def _disarm(self, worker: PlantWorker, name: str, request: Mapping[str, Any]) -> dict[str, Any]:
        """Take back a machine's arming while it has no process: on record, before one that begins looks there."""
        by, reason, process = disarm_words(request)
        async with worker.opening:
            config = self._configs[name]
            if worker.is_opened:
                raise ControlError(f"{worker.name} is beginning; ask again in a moment")
            log, now = config.audit, self.clock.now()

            def disarm() -> AuditRow | None:
                subject, stamp = config.subject, newest_stamp(config)
                return disarm_in_log(log, by, reason, now, stamp, subject=subject, process=process, say=say)

            def say(damage: str) -> None:
                self.log.error("the audit log is damaged", reason=damage)

            try:
                row = await asyncio.to_thread(disarm)
            except (ArmingError, OSError) as error:
                raise ControlError(str(error)) from None
        return {"ok": True, "pid": os.getpid(), "was_armed": row is not None}

    async def _plant(self, line: bytes) -> dict[str, Any]:
        """How all machines are."""

        async def look(worker: PlantWorker) -> dict[str, Any]:
            with suppress(TimeoutError, WorkerEnded):
                reply: dict[str, Any] = (await worker.ask("answer", timeout=FRESH_SECONDS, line=line.decode()))[
                    "answer"
                ]
                if reply["ok"]:
                    worker.see(reply["statuses"])
                return reply
            return {"ok": True}

        replies = await asyncio.gather(*map(look, self._workers.values()))
        if (refused := next((reply for reply in replies if not reply["ok"]), None)) is not None:
            return refused
        return _ours({"answer": {"ok": True, "statuses": self._pictures()}})

    async def reload(self, *, apply: bool = True) -> dict[str, Any]:
        """Read the plant file anew and take over what it changes (`Fleet.reload`)."""
        async with self._reloading:
            try:
                configs = {config.machine: config for config in await asyncio.to_thread(self._read_anew)}
                changes = changed_machines(self._configs, configs)
                shortfalls = await self._shortfalls(
                    {name: config for name, config in configs.items() if name not in changes}
                )
                changes |= {
                    name: (MENDED,)
                    for name, picture in self._pictures().items()
                    if MODEL_PART in picture["parts"] and name in configs and name not in (*changes, *shortfalls)
                }
                stay = {name: place for name, place in self._places.items() if name in configs and name not in changes}
                places = split_over(list(configs.values()), self._most, stay)
                new = [configs[name] for name in changes if name in configs]
                images = self._images_of(new)
                by_place: dict[int, list[Config]] = {}
                for config in new:
                    by_place.setdefault(places[config.machine], []).append(config)
                for number, own in by_place.items():
                    # What a worker that is to be begun will have is looked at by another one.
                    worker = self._workers.get(number) or next(iter(self._workers.values()))
                    reply = await worker.ask("examine", configs=configs_to_json(own), leaving=list(changes))
                    if reply["problems"]:
                        raise ConfigError(reply["problems"])
            except (ConfigError, WorkerEnded) as error:
                raise ControlError(f"the file is refused and everything goes on as it was: {error}") from None
            if apply and changes:
                for name in changes:
                    if name in self._configs:
                        self.images.pop(self._configs[name].serve.unit, None)
                self.images |= {config.serve.unit: image for config, image in images}
                failed = await self._take_over(list(changes), configs, places)
                self.log.warning("the plant file was read anew", machines=", ".join(changes))
                await asyncio.to_thread(self.on_taken_over, list(configs.values()))
                raise_failures(failed)
            shortfalls |= await asyncio.to_thread(of_plant, next(iter(configs.values())))
            return {
                "changes": {name: list(sentences) for name, sentences in changes.items()},
                "applied": apply,
                "next_start": next_start_sentences(shortfalls),
            }

    async def _shortfalls(self, configs: Mapping[str, Config]) -> dict[str, str]:
        """What the machines would go without if they started now, as a worker finds: models are no matter of ours."""
        if not configs:
            return {}
        workers = list(self._workers.values())
        worker = next((one for one in workers if one.is_opened), workers[0])  # not one that is just begun anew
        reply = await worker.ask("shortfalls", configs=configs_to_json(list(configs.values())))
        found: dict[str, str] = reply["shortfalls"]
        return found

    async def _take_over(
        self, names: Sequence[str], configs: Mapping[str, Config], places: Mapping[str, int]
    ) -> dict[str, str]:
        """Stop what goes and what moves, then begin what comes; the processes of other machines are not asked.

        Gives why machines could not be begun as they are configured, by name.
        """
        failed: dict[str, str] = {}
        former, before = self._configs, self._places
        leaving = {name for name in names if self._places.get(name) != places.get(name)}
        self._configs = dict(configs)
        self._places = {name: before[name] for name in configs if name in before and name not in leaving}
        self._note_sources(configs[name] for name in names if name in configs)
        for worker in [
            self._workers[number] for number in sorted({before[name] for name in leaving if name in before})
        ]:
            if self._of(worker):
                await self._changed(worker, [name for name in leaving if before.get(name) == worker.number], former)
            else:
                del self._workers[worker.number]
                worker.retired = True
                with suppress(TimeoutError, WorkerEnded):
                    await worker.ask("stop", timeout=STOP_SECONDS)
                    await worker.wait_for_end(EXIT_SECONDS)
                if worker.task is not None:
                    worker.task.cancel()
        self._places = dict(places)
        for number in sorted({places[name] for name in names if name in configs}):
            if number in self._workers:
                own = [name for name in names if places.get(name) == number]
                failed |= await self._changed(self._workers[number], own, former)
            else:
                self._begin(number)
        return failed

    async def _changed(self, worker: PlantWorker, names: Sequence[str], before: Mapping[str, Config]) -> dict[str, str]:
        """Have a worker's machines of these names as they are configured by now; gives why some could not be begun so.

        A worker that is being begun anew has them so by itself.
        """
        failed: dict[str, str] = {}
        with suppress(WorkerEnded):
            taken = await worker.ask("take over", names=names, configs=configs_to_json(self._of(worker)))
            failed = taken["failed"]
            # One that could not be begun goes on as it was, and so it is when its process is begun anew.
            kept = {name: before[name] for name in names if name in before and name not in taken["taken"]}
            self._configs |= {name: config for name, config in kept.items() if name in self._configs}
            worker.see((await worker.ask("statuses"))["statuses"])
        return failed
