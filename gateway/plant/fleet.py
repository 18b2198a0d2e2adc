"""The machines of one gateway: each is read, supervised and stopped by itself, on records that all have in common.

A machine that fails, is slow or loses its device costs the others nothing: it has a task, a link, deadlines and a
supervisor of its own. What is common is opened before the first machine and closed after the last.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import aclosing, suppress
from functools import partial
from random import Random
from typing import TYPE_CHECKING, Any

from drivers.connections import Connections
from drivers.driver import Cautions, Driver
from drivers.errors import DriverError
from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from gateway.machine import MODEL_PART, Machine, PlantRecords
from gateway.machine.model import LoadedModels, load_models, models_at_start
from gateway.machine.reading import Clock, QualityRules, Scan, scans
from gateway.outside.serving import DeviceImage
from gateway.outside.status import ControlError, GatewayStatus
from gateway.plant.control import ControlScope, answer
from gateway.plant.device import make_driver, scans_on_change
from gateway.plant.plant_check import check_plant, limit_doubts, unfit_models
from gateway.plant.service import ScanProgress
from gateway.plant.shared_connections import connection_groups
from gateway.plant.shortfalls import MESSAGES, prepare_notifier
from gateway.plant.status import snapshot
from gateway.settings import Config, changed_machines, load_plant

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

    from gateway.outside.notify import Notifier


SWITCH_SECONDS = 0.0005
"""How often a process with machines changes threads, a tenth of Python's own 5 ms (`sys.setswitchinterval`)."""
RESTART_SECONDS = 1.0
LAST_WORD_SECONDS = 0.1
MENDED = "its model can be read again"
"""What a reload says of a machine that went without."""
FORECASTS_AT_ONCE = 2
"""Each takes some ten megabytes while it is made, and they would share one interpreter; two, so that a slow one does
not keep all others waiting."""


class Fleet:
    """The machines of a running gateway, by name in the order of the file; `start` it within a running loop.

    `several` is whether the plant file has [[machine]] tables. A machine that is begun anew is not there meanwhile, but
    among those `changing`.
    `images` are what peers are shown of them, by their unit numbers; `on_scan` is told the name of each machine that
    was scanned, when all of its stages are done, `on_taken_over` (in a thread) the configurations after a reload.

    Raises ConfigError, HistorianError or AuditError for what cannot be opened; nothing is left open then. `driver` is
    used for the first machine, by default all have those of their configurations. `read_anew` gives the configurations
    as they are in the file by now.
    """

    def __init__(
        self,
        configs: Sequence[Config],
        *,
        clock: Clock,
        log: FilteringBoundLogger,
        rng: Random,
        log_failure: Callable[[], str] = lambda: "",
        driver: Driver | None = None,
        read_anew: Callable[[], Sequence[Config]] | None = None,
    ) -> None:
        self.clock, self.log, self._rng = clock, log, rng
        self.several = configs[0].several
        self._read_anew = read_anew or partial(load_plant, configs[0].path)
        self._reloading, self._turns = asyncio.Lock(), asyncio.Semaphore(FORECASTS_AT_ONCE)
        self.on_scan: Callable[[str], None] = lambda machine: None
        self.on_taken_over: Callable[[Sequence[Config]], None] = lambda configs: None
        self.supervisor = Supervisor(self._note_failure)
        self.machines: dict[str, Machine] = {}
        self._running: dict[str, _Running] = {}
        self._stop = asyncio.Event()
        self.changing = set[str]()
        self._connections = Connections()
        self.images: dict[int, DeviceImage] = {}
        drivers = {config.machine: self._driver(config) for config in configs[1 if driver else 0 :]}
        if driver is not None:
            drivers[configs[0].machine] = driver
        # What can be refused is read first: a model that does not suit its machine leaves no records behind.
        models = {config.machine: models_at_start(config) for config in configs}
        make_notifier, untold = _notifier_at_start(configs[0])
        self.records = PlantRecords(configs, clock=clock, log=log, supervisor=self.supervisor, log_failure=log_failure)
        self.notifier = make_notifier and make_notifier(now=clock.now, supervisor=self.supervisor, log=log)
        if (notifier := self.notifier) is not None:
            self.records.undelivered = lambda: notifier.complaint
        elif untold:
            self._report_absence(MESSAGES, untold)
            self.records.undelivered = lambda: untold
        alone = len(configs) == 1
        opened = False
        try:
            if configs[0].page.enabled:
                self.records.open_trail(configs[0])  # what people do at the page is on record, whatever is written
            for config in configs:
                name = config.machine
                loaded, without = models[name]
                self.machines[name] = self._open_machine(config, drivers[name], loaded, alone=alone, without=without)
            opened = True
        finally:
            if not opened:
                if self.notifier is not None:
                    self.notifier.close()
                self.records.close()

    def _driver(self, config: Config) -> Driver:
        """A machine's driver: units behind one gateway take turns on its connection, the only device has its own."""
        return make_driver(config, self.clock, self._connections if config.several else None)

    def _report_absence(self, part: str, reason: str) -> None:
        self.log.error("a part of the gateway could not be begun, and it goes on without", part=part, reason=reason)

    def _open_machine(
        self, config: Config, driver: Driver, models: Sequence[LoadedModels], *, alone: bool, without: str = ""
    ) -> Machine:
        """A machine on the common records. A gateway's only one needs no name in front of what is said of its parts."""
        if without:
            self._report_absence(f"{config.machine}: {MODEL_PART}", without)
        log = self.log if alone else self.log.bind(machine=config.machine)
        for doubt in limit_doubts(config, models):
            log.warning("a limit is worth a look", reason=doubt)
        for unfit in unfit_models(config, models):
            log.warning("an unfit model runs", reason=unfit)
        supervisor = self.supervisor if alone else Supervisor()
        if not alone:
            self.supervisor.include(config.machine, supervisor)
        machine = Machine(
            config,
            driver=driver,
            clock=self.clock,
            log=log,
            rng=self._rng,
            models=models,
            records=self.records,
            supervisor=supervisor,
            turns=self._turns,
            without=without,
        )
        if self.notifier is not None:
            from gateway.outside.notify import attach_machine

            attach_machine(self.notifier, machine)
        if config.serve.port is not None:
            self.images[config.serve.unit] = DeviceImage(config, self.clock.now)
        return machine

    def _note_failure(self, part: str, error: BaseException) -> None:
        message = "a part of the gateway failed and is begun anew"
        self.log.error(message, part=part, reason=repr(error), exc_info=error)

    def start(self, stop: asyncio.Event) -> None:
        """Begin to read all machines, until `stop` is set: no scan begins after that.

        They begin a part of the period apart, so that their requests do not all come at one moment.
        """
        self._stop = stop
        for place, (name, machine) in enumerate(self.machines.items()):
            pause = place / len(self.machines) * machine.config.scan.period
            self._running[name] = _Running(machine, stop, self._scan_taker(machine), taken=self._note_scan, pause=pause)

    def _note_scan(self, machine: str) -> None:
        self.on_scan(machine)

    async def reload(self, *, apply: bool = True) -> dict[str, Any]:
        """Read the plant file anew and take over what it changes; a machine that it does not touch loses no scan.

        Gives the changes as sentences by machine, whether they were taken over, and what the next start would go
        without or do to no use. Raises ControlError, and everything
        goes on as it was, for a file that cannot be used and for a change of what all machines have in common.
        """
        async with self._reloading:
            try:
                configs = {config.machine: config for config in await asyncio.to_thread(self._read_anew)}
                changes = changed_machines({name: one.config for name, one in self.machines.items()}, configs)
                changes |= self._find_new_sharers(changes, configs)
                # Those of machines that are begun anew are read when they are examined, and refuse the file.
                stay = [config for name, config in configs.items() if name not in changes]
                known = await asyncio.to_thread(lambda: {config.machine: models_at_start(config) for config in stay})
                changes |= {
                    name: (MENDED,)
                    for name, one in self.machines.items()
                    if one.without and name in configs and name not in changes and name in known and not known[name][1]
                }
                models = await self.examine([configs[name] for name in changes if name in configs], list(changes))
            except ConfigError as error:
                raise ControlError(f"the file is refused and everything goes on as it was: {error}") from None
            failed: dict[str, str] = {}
            if apply:
                failed = await self.replace_machines(list(changes), configs, models)
                if changes:
                    self.log.warning("the plant file was read anew", machines=", ".join(changes))
                    await asyncio.to_thread(self.on_taken_over, list(configs.values()))
            raise_failures(failed)
            known |= {name: (tuple(loaded), "") for name, loaded in models.items()}
            found = await asyncio.to_thread(check_plant, list(configs.values()), known)
            return {
                "changes": {name: list(sentences) for name, sentences in changes.items()},
                "applied": apply,
                "next_start": [
                    f"{one.machine or one.part}: "
                    + ("the next start would go without: " if one.grave else "")
                    + one.sentence
                    for one in found
                ],
            }

    def _find_new_sharers(self, changes: Collection[str], configs: Mapping[str, Config]) -> dict[str, tuple[str, ...]]:
        """Machines that have a connection to themselves, as the only one of their file, and are to share it now."""
        found = dict[str, tuple[str, ...]]()
        for group in connection_groups(list(configs.values())):
            for name in [config.machine for config in group if config.machine not in changes]:
                others = ", ".join(config.machine for config in group if config.machine != name)
                if others and not self.machines[name].config.several:
                    found[name] = (f"shares its connection with {others}",)
        return found

    async def examine(self, configs: Sequence[Config], leaving: Collection[str]) -> dict[str, Sequence[LoadedModels]]:
        """The models of machines that may be begun, while the former configuration runs; those `leaving` are stopped
        before.

        Raises ConfigError for what a start would refuse, such as what one connection cannot be to several machines.
        """
        models: dict[str, Sequence[LoadedModels]] = {}
        connections = Connections()
        staying = [machine.config for name, machine in self.machines.items() if name not in leaving]
        for group in connection_groups([*staying, *configs]):
            # Of all others nothing is made anew, as their scans go on meanwhile.
            for config in group if any(config in group for config in configs) else ():
                make_driver(config, self.clock, connections if config.several else None)
        for config in configs:
            models[config.machine] = await asyncio.to_thread(load_models, config)
        return models

    async def replace_machines(
        self, names: Sequence[str], configs: Mapping[str, Config], models: Mapping[str, Sequence[LoadedModels]]
    ) -> dict[str, str]:
        """Have the machines of these names as they are in `configs`: begun, begun anew, or stopped.

        Gives why machines could not be begun so, by name; they go on as they were, where that can be.
        """
        self.changing.update(names)
        try:
            return await self._replace_machines(names, configs, models)
        finally:
            self.changing.clear()

    async def _replace_machines(
        self, names: Sequence[str], configs: Mapping[str, Config], models: Mapping[str, Sequence[LoadedModels]]
    ) -> dict[str, str]:
        before = {name: machine.config for name, machine in self.machines.items()}
        self.several = any(config.several for config in configs.values())
        # All are stopped before any is begun: two may change places, and what is said of a connection is said of all
        # that share it. Machines that stay keep it meanwhile.
        ended = await asyncio.gather(*(self._retire(name) for name in names if name in before), return_exceptions=True)
        for error in ended:
            if isinstance(error, BaseException):
                self.log.error("a machine did not end well", reason=repr(error))
        failed: dict[str, str] = {}
        for name in names:
            if (after := configs.get(name)) is not None:
                try:
                    await self._begin(after, models.get(name))
                except (ConfigError, OSError) as error:
                    self.log.error("a machine cannot be begun as the file has it now", machine=name, reason=str(error))
                    failed[name] = str(error)
        for former in [before[name] for name in failed if name in before]:
            try:
                await self._begin(former, None, patient=True)
            except (ConfigError, OSError) as error:
                self.log.error("a machine cannot go on as it was", machine=former.machine, reason=str(error))
        # In the order of the file from now on.
        order = [name for name in configs if name in self.machines]
        for name in order:
            self.machines[name] = self.machines.pop(name)
        return failed

    async def _retire(self, name: str) -> None:
        """Stop a machine, with nothing left standing in its PLC, and forget it."""
        machine, running = self.machines[name], self._running.pop(name)
        try:
            await running.stop()
        finally:
            # What goes on from it is read from the file: an alarm that was acknowledged just now, too.
            await asyncio.to_thread(self.records.historian.flush)
            self.supervisor.exclude(name)
            # Of a connection that it shared with others it hears no more.
            machine.supervisor.exclude("device")
            del self.machines[name]
            self.images.pop(machine.config.serve.unit, None)
            if machine.writing is not None:
                # Nobody finds it any more. What was said to it is said of the machine that is begun in its place, too.
                await machine.writing.settle()

    async def _begin(self, config: Config, models: Sequence[LoadedModels] | None, *, patient: bool = False) -> None:
        """Begin a machine while others run, with its models or those that it names; `patient`: as at a start.

        Raises ConfigError or OSError, and it has no part in a connection then.
        """
        # In threads: to read and verify models takes longer than the other machines' scans may wait.
        without = ""
        if models is not None:
            loaded = models
        elif patient:
            loaded, without = await asyncio.to_thread(models_at_start, config)
        else:
            loaded = await asyncio.to_thread(load_models, config)
        driver = self._driver(config)
        try:
            machine = await asyncio.to_thread(self._open_machine, config, driver, loaded, alone=False, without=without)
        except BaseException:
            await driver.close()
            raise
        self.machines[config.machine] = machine
        self._running[config.machine] = _Running(machine, self._stop, self._scan_taker(machine), taken=self._note_scan)

    @property
    def configs(self) -> dict[str, Config]:
        """The machines' configurations, by their names."""
        return {name: machine.config for name, machine in self.machines.copy().items()}

    def progress(self) -> dict[str, ScanProgress]:
        """How far each machine that is to be read has come, by its name; none that is being stopped."""
        failures = {name: machine.counters.failures for name, machine in self.machines.items()}
        return {name: ScanProgress(one.completed, failures.get(name, 0)) for name, one in self._running.items()}

    @property
    def longest_period(self) -> float:
        """The longest time from one scan of a machine to the next (real s)."""
        periods = [machine.config.scan.period for machine in self.machines.values()]
        return max(periods, default=0.0) / self.clock.speed

    def statuses(self) -> dict[str, GatewayStatus]:
        """How all machines are, by their names."""
        return {name: snapshot(machine) for name, machine in self.machines.items()}

    def pictures(self) -> dict[str, Callable[[], GatewayStatus]]:
        """What takes each machine's status, by its name: one that nobody looks at costs nothing."""
        return {name: partial(snapshot, machine) for name, machine in self.machines.items()}

    async def answer(self, line: bytes) -> dict[str, Any]:
        """The reply to a request at the control socket."""
        return await answer(ControlScope(self.machines, snapshot, self.reload, self.changing), line)

    def _scan_taker(self, machine: Machine) -> Callable[[Scan], None] | None:
        """Who takes a machine's scans for its peers; None where nothing is served."""
        return None if machine.config.serve.port is None else self.images[machine.config.serve.unit].take

    def announce_stop(self) -> None:
        """Say of every machine that it is being stopped."""
        for machine in self.machines.values():
            machine.phase = "stopping"

    async def stop(self) -> None:
        """Stop all machines, then close what they have in common."""
        ended = await asyncio.gather(*(one.stop() for one in self._running.values()), return_exceptions=True)
        if self.notifier is not None:
            await asyncio.to_thread(self.notifier.close)
        complete = await asyncio.to_thread(self.records.close)
        for machine in self.machines.values():
            machine.phase = "stopped"
        counts = [machine.counters for machine in self.machines.values()]
        if complete:
            self.log.info("stopped", scans=sum(c.scans for c in counts), events=sum(c.events for c in counts))
        else:
            trail = self.records.trail
            failure = self.records.historian.complaint or (trail.audit.failure if trail else "")
            self.log.error("stopped, with records that could not be stored", reason=failure)
        # What one machine's end has raised keeps no other one from ending well.
        for error in ended:
            if isinstance(error, BaseException):
                raise error


def raise_failures(failed: Mapping[str, str]) -> None:
    """Raise ControlError for machines that could not be begun as the file has them now, with the reasons."""
    if failed:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in failed.items())
        raise ControlError(
            f"the file was taken over, but for what could not be begun as it has it and goes on as it was: {reasons}"
        )


class _Running:
    """A machine that is being read, from its making until `stop`; the first scan comes after `pause` (plant s).

    No scan begins once the whole `gateway` is to stop; what has to be done then `stop` does. `completed` counts the
    scans whose stages are all done.
    """

    def __init__(
        self,
        machine: Machine,
        gateway: asyncio.Event,
        show: Callable[[Scan], None] | None,
        *,
        taken: Callable[[str], None],
        pause: float = 0.0,
    ) -> None:
        self._machine, self._show, self._taken, self._pause = machine, show, taken, pause
        self.completed = 0
        self._stop, self._over = _Stop(gateway), asyncio.Event()
        tasks = {"scans": self._scan_loop, "stop": self._stop.follow}
        self._tasks = {machine.supervisor.task(name, work) for name, work in tasks.items()}

    async def stop(self) -> None:
        """Stop reading; then everything is taken back at the PLC, and kept, as far as it can be reached."""
        machine = self._machine
        machine.phase = "stopping"
        self._stop.set()
        # Scans that are cancelled from outside, with all else in the loop, never come to say that they are over.
        tasks = {*self._tasks, asyncio.ensure_future(self._over.wait())}
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        # First the PLC, while the link stands; then what is computed; then what is kept, so that all of it is in there.
        await _try_withdraw(machine, "stop")
        writing = machine.writing
        if writing is not None and writing.armed and machine.link.alive:
            # What the PLC says of the last blocks, once its program has had a cycle's time to count them.
            await asyncio.sleep(max(LAST_WORD_SECONDS, machine.config.device.heartbeat_period))
            now = machine.clock.now()
            samples = {sample.tag: sample for sample in await machine.driver.read(machine.config.map.tags)}
            last = Scan(number=machine.counters.scans, time=now, samples=samples, missed=0, duration=0.0)
            for block in writing.blocks:
                block.take_counts(last)
        await machine.finish()
        await machine.driver.close()

    async def _scan_loop(self) -> None:
        """Scan until the stop; whatever fails is logged, made known to the PLC, and begun anew a second later."""
        machine, stop = self._machine, self._stop
        config, clock, log = machine.config, machine.clock, machine.log
        for caution in machine.driver.cautions() if isinstance(machine.driver, Cautions) else ():
            log.warning("this works today and should not stay so", reason=caution)
        try:
            await machine.driver.open()
        except DriverError as error:
            log.warning("the device does not answer yet; it is tried again all the time", reason=str(error))
        if self._pause:
            await _pause(stop, self._pause / clock.speed)
        while not stop.is_set():
            try:
                rules = QualityRules(
                    config.scan.period, config.map.heartbeat, config.device.heartbeat_period * clock.speed
                )
                machine.phase = "running"
                urgent = machine.urgent if scans_on_change(config) else None
                # Closed here and now, not when the collector comes by: no two streams of scans shall read the device.
                async with aclosing(
                    scans(
                        machine.driver,
                        config.map.tags,
                        clock,
                        rules,
                        derived=config.map.derived,
                        stop=stop,
                        urgent=urgent,
                        supervisor=machine.supervisor,
                    )
                ) as stream:
                    async for scan in stream:
                        if self._show is not None:
                            self._show(scan)
                        await machine.take(scan)
                        self.completed += 1
                        self._taken(config.machine)
            except Exception as error:  # noqa: BLE001 - the supervisor's part for the scans: it is said, and begun anew
                machine.supervisor.failed("scans", error)
                machine.counters.failures, machine.counters.last_failure = machine.counters.failures + 1, repr(error)
                machine.begin_anew()
                # The PLC is told before the pause: for this second nobody stands behind what the last block said.
                await _try_withdraw(machine, "failure")
                await _pause(stop, RESTART_SECONDS)
        # A part that returned would be begun anew by its supervisor: this one is over when `stop` ends it.
        self._over.set()
        await asyncio.Future()


async def _pause(stop: asyncio.Event, seconds: float) -> None:
    """Wait so long (real s), or until the stop."""
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await stop.wait()


def _notifier_at_start(config: Config) -> tuple[Callable[..., Notifier] | None, str]:
    """What makes the notifier (None: nobody is told), and why nobody can be ("": all can)."""
    try:
        return prepare_notifier(config), ""
    except ConfigError as error:
        return None, error.in_one_line


class _Stop(asyncio.Event):
    """Set when a machine is to stop, by itself or with the whole gateway; `follow` wakes those who wait."""

    def __init__(self, gateway: asyncio.Event) -> None:
        super().__init__()
        self._gateway = gateway

    def is_set(self) -> bool:
        """Whether either is to stop."""
        return super().is_set() or self._gateway.is_set()

    async def follow(self) -> None:
        """Be set with the gateway's."""
        await self._gateway.wait()
        self.set()
        await asyncio.Future()


async def _try_withdraw(machine: Machine, why: str) -> None:
    """Validity 0 if possible; the PLC's own timer covers the rest."""
    try:
        await machine.withdraw(why)
    except (DriverError, OSError) as error:
        machine.log.warning("validity 0 could not be written", reason=str(error))
