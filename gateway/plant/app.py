"""The gateway as a running program: started, supervised, stopped with nothing left standing in the PLC."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack, aclosing
from dataclasses import asdict
from pathlib import Path
from random import Random, SystemRandom
from time import monotonic
from typing import TYPE_CHECKING, Any

from drivers.driver import Cautions, Driver
from drivers.errors import DriverError
from gateway.machine import Machine
from gateway.machine.reading import Clock, PlantClock, QualityRules, Scan, plant_clock, scans
from gateway.plant.control import Control
from gateway.plant.device import make_driver, scans_on_change
from gateway.plant.log import log_file, open_log
from gateway.plant.log_file import LogFile
from gateway.plant.status import snapshot, write_status
from gateway.serving import DeviceImage, PeerServer
from gateway.settings import Config
from gateway.status import SAID_BY_CHANGES, ChangeLines, GatewayStatus, opening

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


STATUS_SECONDS = 0.25
RESTART_SECONDS = 1.0
CLOCK_TOLERANCE = 5.0
LAST_WORD_SECONDS = 0.1
SWITCH_SECONDS = 0.0005
"""How often the interpreter changes threads, a tenth of its own 5 ms (`sys.setswitchinterval`)."""


async def run(
    config: Config,
    *,
    clock: Clock | None = None,
    stop: asyncio.Event | None = None,
    status_path: Path | None = None,
    log: FilteringBoundLogger | None = None,
    file: LogFile | None = None,
    driver: Driver | None = None,
    rng: Random | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run until `stop` is set; gives the last status.

    It starts without a PLC and without a model, and outlives the loss of the PLC. When it stops, it writes validity 0
    if it is armed and permitted, saves its state and commits all records. `status_path` is rewritten four times a
    second with one line of JSON. `clock` and `driver` are the configured ones unless given, as is the `log`, with its
    `file`; `rng` draws this start's number as a writer, by default from the system's randomness. `say` takes the lines
    for a person: three to begin with, then one for each change of state.

    Raises ConfigError or HistorianError, before anything runs, for what cannot be opened.
    """
    stop = stop or asyncio.Event()
    clock = clock or plant_clock(config.clock.speed)
    image = None
    if config.serve.port is not None:
        image = DeviceImage(config, clock.now)
    with ExitStack() as opened:
        if log is None:
            file = _log_file(config)
            log = opened.enter_context(open_log(file, config.log.level))
        machine = Machine(
            config,
            driver=driver or make_driver(config, clock),
            clock=clock,
            log=log,
            rng=rng or SystemRandom(),
            log_failure=(lambda: "") if file is None else file.complaint,
        )
        reporter = machine.supervisor.task("status", lambda: _report(machine, status_path, say))
        opened.enter_context(machine.supervisor.hearing_all())
        control = Control(machine, config.control_socket, snapshot)
        serving = {machine.supervisor.task("control", control.serve)}
        if image is not None and config.serve.port is not None:
            peers = PeerServer(
                config.serve.host,
                config.serve.port,
                {config.serve.unit: image},
                most_clients=config.serve.most_clients,
            )
            serving.add(machine.supervisor.task("peers", peers.serve))
        try:
            await _supervised(machine, stop, image)
        finally:
            machine.phase = "stopping"
            for task in serving:
                task.cancel()
            await asyncio.wait(serving)
            await control.close()
            # First the PLC, while the link stands; then what is computed; then what is kept, so that all of it is in
            # there.
            await _withdrawn(machine, "stop")
            block = machine.block
            if block is not None and block.writer.armed and machine.link.alive:
                # What the PLC says of the last blocks, once its program has had a cycle's time to count them.
                await asyncio.sleep(max(LAST_WORD_SECONDS, config.device.heartbeat_period))
                now = machine.clock.now()
                samples = {sample.tag: sample for sample in await machine.driver.read(config.map.tags)}
                last = Scan(number=machine.counters.scans, time=now, samples=samples, missed=0, duration=0.0)
                block.take_counts(last)
            if machine.model is not None:
                await machine.model.close()
            machine.save(machine.clock.now())
            await machine.driver.close()
            complete = await asyncio.to_thread(machine.close)
            if complete:
                machine.log.info("stopped", scans=machine.counters.scans, events=machine.counters.events)
            else:
                failure = machine.historian.complaint or (block.audit.failure if block else "")
                machine.log.error("stopped, with records that could not be stored", reason=failure)
            reporter.cancel()
            await asyncio.gather(reporter, return_exceptions=True)
            machine.phase = "stopped"
            _write(machine, status_path, snapshot(machine))
    return asdict(snapshot(machine))


def _log_file(config: Config) -> LogFile | None:
    """The file of the log, which keeps no gateway from running: its `complaint` is an alarm's."""
    return None if config.log.path is None else log_file(config.log.path, config.log, patient=True)


async def _supervised(machine: Machine, stop: asyncio.Event, image: DeviceImage | None) -> None:
    """Scan until the stop; whatever fails is logged, made known to the PLC, and begun anew a second later."""
    config, clock, log = machine.config, machine.clock, machine.log
    for caution in machine.driver.cautions() if isinstance(machine.driver, Cautions) else ():
        log.warning("this works today and should not stay so", reason=caution)
    try:
        await machine.driver.open()
    except DriverError as error:
        log.warning("the device does not answer yet; it is tried again all the time", reason=str(error))
    while not stop.is_set():
        try:
            rules = QualityRules(config.scan.period, config.map.heartbeat, config.device.heartbeat_period * clock.speed)
            machine.phase = "running"
            urgent = machine.urgent if scans_on_change(config) else None
            # Closed here and now, not when the collector comes by: the device must not be read by two streams of scans.
            async with aclosing(
                scans(
                    machine.driver,
                    config.map.tags,
                    clock,
                    rules,
                    stop=stop,
                    urgent=urgent,
                    supervisor=machine.supervisor,
                )
            ) as stream:
                async for scan in stream:
                    if image is not None:
                        image.take(scan)
                    await machine.take(scan)
        except Exception as error:  # noqa: BLE001 - the supervisor's part for the scans: it is said, and begun anew
            machine.supervisor.failed("scans", error)
            machine.counters.failures, machine.counters.last_failure = machine.counters.failures + 1, repr(error)
            machine.begin_anew()
            # The PLC is told before the pause: for this second nobody stands behind what the last block said.
            await _withdrawn(machine, "failure")
            await asyncio.wait([asyncio.ensure_future(stop.wait())], timeout=RESTART_SECONDS)


async def _withdrawn(machine: Machine, why: str) -> None:
    """Validity 0 if possible; the PLC's own timer covers the rest."""
    try:
        await machine.withdraw(why)
    except (DriverError, OSError) as error:
        machine.log.warning("validity 0 could not be written", reason=str(error))


# -------------------------------------------------------------------- status


async def _report(machine: Machine, path: Path | None, say: Callable[[str], None] | None) -> None:
    warned, complaint, lines = False, "", ChangeLines()
    if say is not None:
        for line in opening(snapshot(machine)):
            say(line)
    while True:
        if path is not None or say is not None:
            status = snapshot(machine)
            complaint = _write(machine, path, status, complaint)
            if say is not None:
                for line in lines.take(status, monotonic()):
                    say(line)
        offset = machine.clock.wall_offset() if isinstance(machine.clock, PlantClock) else 0.0
        if abs(offset) > CLOCK_TOLERANCE and not warned:
            machine.log.warning("the wall clock was changed; times keep to the old one until a restart", offset=offset)
            warned = True
        await asyncio.sleep(STATUS_SECONDS)


def _write(machine: Machine, path: Path | None, status: GatewayStatus, before: str = "") -> str:
    """Write the status file; what stands in its way is logged when it is not what it was `before`, and returned."""
    if path is None:
        return ""
    try:
        write_status(path, status)
    except OSError as error:
        reason = error.strerror or str(error)
        if reason != before:
            machine.log.error("the status file cannot be written", path=str(path), reason=reason)
        return reason
    return ""


# -------------------------------------------------------------------- a process of its own


def serve(
    config: Config,
    *,
    clock: Clock | None = None,
    status_path: Path | None = None,
    console: bool = True,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run until SIGTERM or SIGINT, with logs to the configured file and, if asked, to standard error.

    With `say` (see `run`), the console gets only warnings that no line says.

    The interpreter is told to change threads more often than it would, so that the forecast's thread delays no scan.
    """
    sys.setswitchinterval(SWITCH_SECONDS)

    async def main(log: FilteringBoundLogger) -> dict[str, Any]:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        return await run(config, clock=clock, stop=stop, status_path=status_path, log=log, file=file, say=say)

    file = _log_file(config)
    shown = sys.stderr if console else None
    unless = SAID_BY_CHANGES if say is not None else frozenset[str]()
    with open_log(file, config.log.level, shown, console_without=unless) as log:
        if file is not None and (reason := file.complaint()):
            log.error("the gateway runs without its log", reason=reason)
        return asyncio.run(main(log))
