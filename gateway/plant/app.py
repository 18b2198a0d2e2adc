"""The gateway as a running program: started, supervised, stopped with nothing left standing in the PLC."""

import asyncio
import signal
import sys
from collections.abc import Mapping
from contextlib import ExitStack, aclosing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from structlog.typing import FilteringBoundLogger

from drivers.driver import Cautions, Driver
from drivers.errors import DriverError
from gateway.machine.model.outlook import block_values
from gateway.machine.pipeline import Gateway
from gateway.machine.reading.clock import Clock, PlantClock, plant_clock
from gateway.machine.reading.quality import QualityRules
from gateway.machine.reading.redundant import Redundant
from gateway.machine.reading.scan import Scan, scans
from gateway.machine.records import percentile
from gateway.plant.config import Config
from gateway.plant.control import Control
from gateway.plant.log import open_log
from gateway.plant.startup import scans_on_change
from gateway.plant.status import write_status

STATUS_SECONDS = 0.25
RESTART_SECONDS = 1.0
CLOCK_TOLERANCE = 5.0
LAST_WORD_SECONDS = 0.1
SWITCH_SECONDS = 0.0005


async def run(
    config: Config,
    *,
    clock: Clock | None = None,
    stop: asyncio.Event | None = None,
    status_path: Path | None = None,
    log: FilteringBoundLogger | None = None,
    driver: Driver | None = None,
) -> dict[str, Any]:
    """Run until `stop` is set; gives the last status.

    It starts without a PLC and without a model, and outlives the loss of the PLC. When it stops, it writes validity 0
    if it is armed and permitted, saves its state and commits all records. `status_path` is rewritten four times a
    second with one line of JSON. `clock` and `driver` are the configured ones unless given.

    Raises ConfigError or HistorianError, before anything runs, for what cannot be opened.
    """
    stop = stop or asyncio.Event()
    clock = clock or plant_clock(config.clock.speed)
    with ExitStack() as opened:
        log = log or opened.enter_context(open_log(config.log.path, config.log.level))
        gateway = Gateway(config, clock, log, driver)
        reporter = asyncio.create_task(_report(gateway, status_path), name="status")
        control = await _opened_control(gateway)
        try:
            await _supervised(gateway, stop)
        finally:
            gateway.phase = "stopping"
            await control.close()
            await _stopped(gateway)
            reporter.cancel()
            await asyncio.gather(reporter, return_exceptions=True)
            gateway.phase = "stopped"
            _say(gateway, status_path)
    return snapshot(gateway)


async def _opened_control(gateway: Gateway) -> Control:
    """The local socket; a gateway that cannot have one runs without it, and says so."""
    control = Control(gateway, gateway.config.control_socket, snapshot)
    try:
        await control.open()
    except OSError as error:
        gateway.log.warning("other programs cannot ask this gateway", reason=error.strerror or str(error))
    return control


async def _supervised(gateway: Gateway, stop: asyncio.Event) -> None:
    """Scan until the stop; whatever fails is logged, made known to the PLC, and begun anew a second later."""
    log = gateway.log
    for caution in gateway.driver.cautions() if isinstance(gateway.driver, Cautions) else ():
        log.warning("this works today and should not stay so", reason=caution)
    try:
        await gateway.driver.open()
    except DriverError as error:
        log.warning("the device does not answer yet; it is tried again all the time", reason=str(error))
    while not stop.is_set():
        try:
            await _scanned(gateway, stop)
        except Exception as error:
            log.exception("a part of the gateway failed and is begun anew", reason=str(error))
            gateway.tally.failures, gateway.tally.last_failure = gateway.tally.failures + 1, repr(error)
            gateway.begin_anew()
            await _withdrawn(gateway, "failure")
            await _pause(stop, RESTART_SECONDS)


async def _scanned(gateway: Gateway, stop: asyncio.Event) -> None:
    config, clock = gateway.config, gateway.clock
    rules = QualityRules(config.scan.period, config.map.heartbeat, config.device.heartbeat_period * clock.speed)
    gateway.phase = "running"
    urgent = gateway.urgent if scans_on_change(config) else None
    async with aclosing(scans(gateway.driver, config.map.tags, clock, rules, stop, urgent)) as stream:
        async for scan in stream:
            await gateway.take(scan)


async def _withdrawn(gateway: Gateway, why: str) -> None:
    """Validity 0 if possible; the PLC's own timer covers the rest."""
    try:
        await gateway.withdraw(why)
    except (DriverError, OSError) as error:
        gateway.log.warning("validity 0 could not be written", reason=str(error))


async def _heard(gateway: Gateway) -> None:
    """What the PLC says of the last blocks, once its program has had a cycle's time to count them."""
    config, writer = gateway.config, gateway.writer
    if writer is None or not writer.armed or not gateway.link.alive:
        return
    await asyncio.sleep(max(LAST_WORD_SECONDS, config.device.heartbeat_period))
    now = gateway.clock.now()
    samples = {sample.tag: sample for sample in await gateway.driver.read(config.map.tags)}
    writer.heard(Scan(gateway.tally.scans, now, samples, 0, 0.0), gateway.refusals)


async def _stopped(gateway: Gateway) -> None:
    await _withdrawn(gateway, "stop")
    await _heard(gateway)
    if gateway.outlook is not None:
        await gateway.outlook.close()
    await gateway.pickup.close()
    gateway.save(gateway.clock.now())
    await gateway.driver.close()
    complete = await asyncio.to_thread(gateway.close)
    if complete:
        gateway.log.info("stopped", scans=gateway.tally.scans, events=gateway.tally.events)
    else:
        failure = gateway.historian.failure or (gateway.audit.failure if gateway.audit else "")
        gateway.log.error("stopped, with records that could not be stored", reason=failure)


async def _pause(stop: asyncio.Event, seconds: float) -> None:
    await asyncio.wait([asyncio.ensure_future(stop.wait())], timeout=seconds)


# -------------------------------------------------------------------- status


async def _report(gateway: Gateway, path: Path | None) -> None:
    warned, complaint = False, ""
    while True:
        complaint = _say(gateway, path, complaint)
        offset = gateway.clock.wall_offset() if isinstance(gateway.clock, PlantClock) else 0.0
        if abs(offset) > CLOCK_TOLERANCE and not warned:
            gateway.log.warning("the wall clock was changed; times keep to the old one until a restart", offset=offset)
            warned = True
        await asyncio.sleep(STATUS_SECONDS)


def _say(gateway: Gateway, path: Path | None, before: str = "") -> str:
    """Write the status file; what stands in its way is logged when it is not what it was `before`, and returned."""
    if path is None:
        return ""
    try:
        write_status(path, snapshot(gateway))
    except OSError as error:
        reason = error.strerror or str(error)
        if reason != before:
            gateway.log.error("the status file cannot be written", path=str(path), reason=reason)
        return reason
    return ""


def snapshot(gateway: Gateway) -> dict[str, Any]:
    """Everything worth showing, as plain values; times are plant seconds UTC, what ends in _s real seconds."""
    speed, tally, link = gateway.clock.speed, gateway.tally, gateway.link
    return {
        "time": gateway.clock.now(),
        "phase": gateway.phase,
        "link": {
            "alive": link.alive,
            "connected": gateway.driver.connected,
            "last_good": link.last_good,
            "outages": [outage.plain(speed) for outage in link.outages],
            "outage_count": link.count,
        },
        "links": _links(gateway),
        "scan": {
            "count": tally.scans,
            "early": tally.early,
            "missed": tally.missed,
            "period": gateway.config.scan.period,
        },
        "values": _values(gateway),
        "prediction": _prediction(gateway),
        "forecast": _forecast(gateway),
        "model": gateway.model_report(),
        "guards": gateway.guard_report(),
        "events": tally.events,
        "recent_events": [list(event) for event in tally.recent],
        "alarms": {name: alarm.state.value for name, alarm in gateway.alarms.items()},
        "writeback": _writeback(gateway),
        "historian": {"dropped": gateway.historian.dropped, "failure": gateway.historian.failure},
        "driver": dict(gateway.driver.statistics()),
        "complaints": list(gateway.complaints()),
        "failures": tally.failures,
        "last_failure": tally.last_failure,
    }


def _links(gateway: Gateway) -> list[dict[str, Any]]:
    """Every link to the device, the primary first."""
    driver, links = gateway.driver, gateway.config.links
    places = {link.name: {"driver": link.map.driver, "place": link.place} for link in links}
    if isinstance(driver, Redundant):
        return [one | places[one["name"]] for one in driver.report()]
    alone = {"active": True, "connected": driver.connected, "well": gateway.link.alive, "reason": ""}
    return [{"name": link.name, **alone, **places[link.name]} for link in links[:1]]


def _values(gateway: Gateway) -> dict[str, Any]:
    samples = gateway.last.samples if gateway.last else {}
    return {
        name: {"value": s.value, "quality": s.quality.name, "time": s.time, "reason": s.reason}
        for name, s in samples.items()
    }


def _prediction(gateway: Gateway) -> Mapping[str, Any] | None:
    p = gateway.prediction
    if p is None:
        return None
    return {key: value for key, value in asdict(p).items() if key != "events"}


def _forecast(gateway: Gateway) -> dict[str, Any] | None:
    made = gateway.outlook.latest if gateway.outlook else None
    if made is None:
        return None
    now = gateway.last.time if gateway.last else made.time
    return {
        "time": made.time,
        "levels": list(made.levels),
        "horizons": made.horizons.tolist(),
        "quantiles": made.quantiles.T.tolist(),
        "p_limit": [estimate.probability for estimate in made.exceedance],
        "factors": made.factors.tolist(),
        "block": block_values(made, gateway.config.block_horizon, now),
    }


def _writeback(gateway: Gateway) -> dict[str, Any]:
    writer, latencies = gateway.writer, gateway.tally.latencies
    if writer is None:
        return {"mode": "off"}
    last = gateway.attempt
    return {
        "mode": writer.mode,
        "armed_until": writer.arming.until if writer.arming else None,
        "armed_by": writer.arming.by if writer.arming else None,
        **asdict(writer.counters),
        "audit": {"path": str(gateway.config.audit), "complaint": writer.audit.complaint if writer.audit else ""},
        "last_verdict": last.verdict if last else None,
        "last_reason": last.reason if last else "",
        "last_validity": int(last.block.validity) if last else None,
        "sequence": writer.sequence,
        "latency_ms": {"p50": percentile(list(latencies), 0.5), "p99": percentile(list(latencies), 0.99)},
    }


# -------------------------------------------------------------------- a process of its own


def serve(
    config: Config, *, clock: Clock | None = None, status_path: Path | None = None, console: bool = True
) -> dict[str, Any]:
    """Run until SIGTERM or SIGINT, with logs to the configured file and, if asked, to standard error.

    The interpreter is told to change threads more often than it would, so that the forecast's thread delays no scan.
    """
    sys.setswitchinterval(SWITCH_SECONDS)

    async def main(log: FilteringBoundLogger) -> dict[str, Any]:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        return await run(config, clock=clock, stop=stop, status_path=status_path, log=log)

    with open_log(config.log.path, config.log.level, sys.stderr if console else None) as log:
        return asyncio.run(main(log))
