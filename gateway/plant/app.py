"""The gateway as a running program: started, supervised, stopped with nothing left standing in any PLC."""

from __future__ import annotations

import asyncio
import gc
import signal
import sys
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import ExitStack, asynccontextmanager, nullcontext
from dataclasses import asdict
from functools import partial
from pathlib import Path
from random import Random, SystemRandom
from time import monotonic
from typing import TYPE_CHECKING, Any

from drivers.driver import Driver
from drivers.settings import ConfigError
from gateway.machine.reading import Clock, PlantClock, plant_clock
from gateway.machine.writing import SIGN_SECONDS
from gateway.outside.serving import PeerServer
from gateway.outside.status import SAID_BY_CHANGES, ChangeLines, ControlError, GatewayStatus, opening_lines
from gateway.plant.configurations import keep_configuration
from gateway.plant.control import Control
from gateway.plant.fleet import SWITCH_SECONDS, Fleet
from gateway.plant.log import log_file, open_log
from gateway.plant.log_file import LogFile
from gateway.plant.service import ServiceManager, service_manager
from gateway.plant.shortfalls import MESSAGES, NORTHBOUND, PAGE, load_sink_secrets, of_plant
from gateway.plant.status import write_status
from gateway.settings import Config, NorthboundSecrets, load_secrets
from gateway.store import FileRule

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


STATUS_SECONDS = 0.25
CLOCK_TOLERANCE = 5.0
PAGE_STOP_SECONDS = 3.0


async def run(
    *configs: Config,
    clock: Clock | None = None,
    stop: asyncio.Event | None = None,
    status_path: Path | None = None,
    log: FilteringBoundLogger | None = None,
    file: LogFile | None = None,
    driver: Driver | None = None,
    rng: Random | None = None,
    say: Callable[[str], None] | None = None,
    read_anew: Callable[[], Sequence[Config]] | None = None,
    hangup: asyncio.Event | None = None,
    own_process: bool = False,
    service: ServiceManager | None = None,
) -> dict[str, Any]:
    """Run the machines of `configs` until `stop` is set; gives the last status, of several machines one by name each.

    It starts without a PLC and without a model, and outlives the loss of a PLC. When it stops, it writes validity 0
    where it is armed and permitted, saves its state and commits all records. `status_path` is rewritten four times a
    second with one line of JSON, the same as is given at the end. `clock` and `driver` (of the first machine) are the
    configured ones unless given, as is the `log`, with its `file`; `rng` draws this start's numbers as a writer, by
    default from the system's randomness. `say` takes the lines for a person: three for each machine to begin with, then
    one for each change of state. `read_anew` gives the configurations as they are in the file by then, for `reload`,
    which `hangup` asks for too. In an `own_process` what is loaded by the start is never looked through for garbage.
    `service` hears when it is ready and when it stops, and its watchdog is fed by scans.

    Raises ConfigError or HistorianError, before anything runs, for what cannot be opened.
    """
    stop = stop or asyncio.Event()
    clock = clock or plant_clock(configs[0].clock.speed)
    with ExitStack() as opened:
        if log is None:
            file = _log_file(configs[0])
            log = opened.enter_context(open_log(file, configs[0].log.level))
        without = of_plant(configs[0])
        secrets = None
        try:
            secrets = None if NORTHBOUND in without else load_sink_secrets(configs[0])
        except ConfigError as error:  # its files may have changed since the look above
            without[NORTHBOUND] = error.in_one_line
        log_failure: Callable[[], str] = (lambda: "") if file is None else file.complaint
        fleet = Fleet(
            configs,
            clock=clock,
            log=log,
            rng=rng or SystemRandom(),
            log_failure=log_failure,
            driver=driver,
            read_anew=read_anew,
        )
        fleet.start(stop)
        fleet.on_taken_over = partial(_keep_taken, fleet, "reload")
        without.pop(MESSAGES, None)  # whose alarm is another one
        _report_absences(fleet, without)
        reporter = fleet.supervisor.task("status", lambda: _report(fleet, status_path, say))
        opened.enter_context(fleet.supervisor.hearing_all())
        control = Control(fleet, configs[0].control_socket, log)
        serving = {fleet.supervisor.task("control", control.serve)}
        serve = configs[0].serve
        if serve.port is not None:
            peers = PeerServer(serve.host, serve.port, fleet.images, most_clients=serve.most_clients)
            serving.add(fleet.supervisor.task("peers", peers.serve))
        if hangup is not None:
            serving.add(fleet.supervisor.task("hangup", partial(_reload_on_hangup, hangup, fleet)))
        try:
            await asyncio.to_thread(_keep_taken, fleet, "start", configs)
            async with (
                _page(configs, fleet) if configs[0].page.enabled and PAGE not in without else nullcontext(),
                nullcontext() if secrets is None else _northbound(configs[0], secrets, fleet),
            ):
                if own_process:
                    # A full collection looks through everything that lives, and holds up every thread meanwhile: with
                    # all libraries and models it took longer than a scan, each time a feed had handed on some rows.
                    gc.freeze()
                if service is not None:
                    service.tell(f"READY=1\nSTATUS=reading {', '.join(config.machine for config in configs)}")
                    serving.add(fleet.supervisor.task("watchdog", partial(service.watch, fleet)))
                await stop.wait()
        finally:
            if service is not None:
                service.tell("STOPPING=1\nSTATUS=stopping")
            fleet.announce_stop()
            for task in serving:
                task.cancel()
            await asyncio.wait(serving)
            await control.close()
            await fleet.stop()
            reporter.cancel()
            await asyncio.gather(reporter, return_exceptions=True)
            last = fleet.statuses()
            _write(fleet, status_path, last)
    return _plain(fleet, last)


def _keep_taken(fleet: Fleet, note: str, configs: Sequence[Config]) -> None:
    """Keep the configuration that was taken over; a gateway that cannot keep it runs all the same."""
    try:
        keep_configuration(configs, now=fleet.clock.now(), note=note)
    except (OSError, ValueError) as error:
        fleet.log.warning("the configuration could not be kept for the history", reason=str(error))


def _report_absences(fleet: Fleet, without: Mapping[str, str]) -> None:
    """Say, once and in an alarm that stands, what could not be begun."""
    fleet.records.without = {**fleet.records.without, **without}
    for part, reason in without.items():
        fleet.log.error("a part of the gateway could not be begun, and it goes on without", part=part, reason=reason)


def _mail(config: Config, subject: str, text: str, now: float) -> tuple[list[str], dict[str, str]]:
    """Mail a text of the page's by the way of the alarms; see `gateway.outside.notify.mail_text`."""
    from gateway.outside.notify import mail_text

    return mail_text(config.notify, load_secrets(config.notify), subject, text, now)


@asynccontextmanager
async def _page(configs: Sequence[Config], fleet: Fleet) -> AsyncIterator[None]:
    """Serve the page meanwhile, in a thread of its own."""
    # Here and below: a gateway without the page, or that tells nobody, loads nothing of it.
    from gateway.outside.web import PageServer, accounts_problem

    trail = fleet.records.trail
    if trail is None:
        raise RuntimeError("the page is enabled, and the audit log was not opened")
    fleet.records.files.watch("accounts", {configs[0].users: FileRule(late=True, accepts=accounts_problem)})
    page = PageServer(
        configs,
        answer=fleet.answer,
        audit=trail.audit,
        now=fleet.clock.now,
        mail=partial(_mail, configs[0]),
        log=fleet.log,
    )

    async def witness() -> None:
        # A gateway that writes no blocks signs no heads, and what people do is to be witnessed all the same.
        while True:
            await asyncio.to_thread(trail.witnessing.sign, fleet.clock.now(), trail.witnessing.turn())
            await asyncio.sleep(SIGN_SECONDS)

    fleet.on_scan = page.note_scan
    feed = fleet.supervisor.task("page feed", partial(page.feed, fleet.pictures))
    signing = fleet.supervisor.task("page witness", witness)
    thread = fleet.supervisor.thread("page", page.run, stop=page.stop)
    try:
        yield
    finally:
        feed.cancel()
        signing.cancel()
        page.close()
        await asyncio.to_thread(thread.join, PAGE_STOP_SECONDS)


@asynccontextmanager
async def _northbound(config: Config, secrets: NorthboundSecrets, fleet: Fleet) -> AsyncIterator[None]:
    """Tell others meanwhile what is on record, each in a thread of its own."""
    from gateway.outside.northbound import Northbound

    northbound = Northbound(
        config,
        secrets,
        machines=lambda: fleet.configs,
        historian=fleet.records.historian,
        pictures=fleet.pictures,
        answer=fleet.answer,
        now=fleet.clock.now,
        supervisor=fleet.supervisor,
        log=fleet.log,
    )
    fleet.records.unreached = lambda: northbound.sink_complaints
    try:
        # So that it is never looked through for garbage.
        await asyncio.to_thread(northbound.wait_load)
        yield
    finally:
        await asyncio.to_thread(northbound.close)


async def _reload_on_hangup(hangup: asyncio.Event, fleet: Fleet) -> None:
    """Read the plant file anew whenever the event is set; a file that is refused changes nothing."""
    while True:
        await hangup.wait()
        hangup.clear()
        try:
            await fleet.reload()
        except ControlError as error:
            fleet.log.error("the plant file was not taken over", reason=str(error))


def _log_file(config: Config) -> LogFile | None:
    """The file of the log, which keeps no gateway from running: its `complaint` is an alarm's."""
    return None if config.log.path is None else log_file(config.log.path, config.log, patient=True)


# -------------------------------------------------------------------- status


def _plain(fleet: Fleet, statuses: dict[str, GatewayStatus]) -> dict[str, Any]:
    """The one machine's status as it is; by their names where the file may have several."""
    plain = {name: asdict(status) for name, status in statuses.items()}
    # The only one is not there while a reload begins it anew.
    return {"machines": plain} if fleet.several else next(iter(plain.values()), {})


async def _report(fleet: Fleet, path: Path | None, say: Callable[[str], None] | None) -> None:
    warned, complaint = False, ""
    lines: dict[str, ChangeLines] = {}
    while True:
        if path is not None or say is not None:
            statuses = fleet.statuses()
            complaint = _write(fleet, path, statuses, complaint)
            if say is not None:
                for name, status in statuses.items():
                    # A machine that was added while the gateway runs begins with its own lines.
                    known = lines.get(name)
                    said = opening_lines(status) if known is None else known.take(status, monotonic())
                    lines.setdefault(name, ChangeLines())
                    for line in said:
                        say(f"{name}: {line}" if len(statuses) > 1 else line)
            for gone in [name for name in lines if name not in statuses]:
                del lines[gone]
        offset = fleet.clock.wall_offset() if isinstance(fleet.clock, PlantClock) else 0.0
        if abs(offset) > CLOCK_TOLERANCE and not warned:
            fleet.log.warning("the wall clock was changed; times keep to the old one until a restart", offset=offset)
            warned = True
        await asyncio.sleep(STATUS_SECONDS)


def _write(fleet: Fleet, path: Path | None, statuses: dict[str, GatewayStatus], before: str = "") -> str:
    """Write the status file; what stands in its way is logged when it is not what it was `before`, and returned."""
    if path is None:
        return ""
    try:
        write_status(path, _plain(fleet, statuses))
    except OSError as error:
        reason = error.strerror or str(error)
        if reason != before:
            fleet.log.error("the status file cannot be written", path=str(path), reason=reason)
        return reason
    return ""


# -------------------------------------------------------------------- a process of its own


def serve(
    configs: Sequence[Config],
    *,
    clock: Clock | None = None,
    status_path: Path | None = None,
    console: bool = True,
    say: Callable[[str], None] | None = None,
    read_anew: Callable[[], Sequence[Config]] | None = None,
) -> dict[str, Any]:
    """Run until SIGTERM or SIGINT, with logs to the configured file and, if asked, to standard error.

    With `say` (see `run`), the console gets only warnings that no line says.

    The interpreter is told to change threads more often than it would, so that the forecast's thread delays no scan.
    """
    sys.setswitchinterval(SWITCH_SECONDS)

    async def main(log: FilteringBoundLogger) -> dict[str, Any]:
        stop, hangup = asyncio.Event(), asyncio.Event()
        if not sys.stdin or not sys.stdin.isatty():
            # On a terminal SIGHUP says that the terminal is gone, and ends the program as it ends any other.
            asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, hangup.set)
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        return await run(
            *configs,
            clock=clock,
            stop=stop,
            status_path=status_path,
            log=log,
            file=file,
            say=say,
            read_anew=read_anew,
            hangup=hangup,
            own_process=True,
            service=service_manager(),
        )

    file = _log_file(configs[0])
    shown = sys.stderr if console else None
    unless = SAID_BY_CHANGES if say is not None else frozenset[str]()
    with open_log(file, configs[0].log.level, shown, console_without=unless) as log:
        if file is not None and (reason := file.complaint()):
            log.error("the gateway runs without its log", reason=reason)
        return asyncio.run(main(log))
