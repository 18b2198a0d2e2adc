"""What a running machine shows of itself: one snapshot, rewritten as one JSON line that a reader never sees half."""

import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gateway.machine import Machine
from gateway.machine.model import block_values
from gateway.machine.reading import Redundant
from gateway.store import percentile
from sim.strict_json import json_text


def write_status(path: Path, status: Mapping[str, Any]) -> None:
    """Replace the file by one JSON line, in one step. Raises OSError."""
    # A draft beside it and then a rename, which POSIX does in one step: a reader has the old line or the new one.
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    draft.write_text(json_text(status) + "\n", encoding="utf-8")
    draft.replace(path)


def snapshot(machine: Machine) -> dict[str, Any]:
    """Everything worth showing, as plain values; times are plant seconds UTC, what ends in _s real seconds."""
    speed, counters, link = machine.clock.speed, machine.counters, machine.link
    prediction = machine.model.prediction if machine.model else None
    return {
        "time": machine.clock.now(),
        "phase": machine.phase,
        "link": {
            "alive": link.alive,
            "connected": machine.driver.connected,
            "reason": link.reason,
            "last_good": link.last_good,
            "outages": [outage.plain(speed) for outage in link.outages],
            "outage_count": link.count,
        },
        "links": _links(machine),
        "scan": {
            "count": counters.scans,
            "early": counters.early,
            "missed": counters.missed,
            "period": machine.config.scan.period,
        },
        "values": {
            name: {"value": s.value, "quality": s.quality.name, "time": s.time, "reason": s.reason}
            for name, s in (machine.last.samples if machine.last else {}).items()
        },
        "prediction": None
        if prediction is None
        else {key: value for key, value in asdict(prediction).items() if key != "events"},
        "forecast": _forecast(machine),
        "model": machine.model.report() if machine.model else None,
        "guards": machine.model.guard_report() if machine.model else None,
        "events": counters.events,
        "recent_events": [list(event) for event in counters.recent],
        "alarms": {name: alarm.state.value for name, alarm in machine.alarms.alarms.items()},
        "writeback": _writeback(machine),
        "historian": {
            "dropped": machine.historian.dropped,
            "refused": machine.historian.refused,
            "failure": machine.historian.failure,
            "complaint": machine.historian.complaint,
        },
        "parts": machine.supervisor.report(),
        "clock": {"believed": not machine.clock_complaint, "complaint": machine.clock_complaint},
        "driver": dict(machine.driver.statistics()),
        "complaints": list(machine.complaints()),
        "failures": counters.failures,
        "last_failure": counters.last_failure,
    }


def _links(machine: Machine) -> list[dict[str, Any]]:
    """Every link to the device, the primary first."""
    driver, links = machine.driver, machine.config.links
    places = {link.name: {"driver": link.map.driver, "place": link.place} for link in links}
    if isinstance(driver, Redundant):
        return [link | places[link["name"]] for link in driver.report()]
    alone = {"active": True, "connected": driver.connected, "well": machine.link.alive, "reason": machine.link.reason}
    return [{"name": link.name, **alone, **places[link.name]} for link in links[:1]]


def _forecast(machine: Machine) -> dict[str, Any] | None:
    forecast = machine.model.outlook.latest if machine.model else None
    if forecast is None:
        return None
    now = machine.last.time if machine.last else forecast.time
    return {
        "time": forecast.time,
        "levels": list(forecast.levels),
        "horizons": forecast.horizons.tolist(),
        "quantiles": forecast.quantiles.T.tolist(),
        "p_limit": [estimate.probability for estimate in forecast.exceedance],
        "factors": forecast.factors.tolist(),
        "block": block_values(forecast, machine.config.block_horizon, now),
    }


def _writeback(machine: Machine) -> dict[str, Any]:
    block = machine.block
    if block is None:
        return {"mode": "off"}
    writer, last, latencies = block.writer, block.attempt, list(block.latencies)
    return {
        "mode": writer.mode,
        "armed_until": writer.arming.until if writer.arming else None,
        "armed_by": writer.arming.by if writer.arming else None,
        **asdict(writer.counters),
        "audit": {"path": str(machine.config.audit), "complaint": block.audit.complaint},
        "last_verdict": last.verdict if last else None,
        "last_reason": last.reason if last else "",
        "last_validity": int(last.block.validity) if last else None,
        "sequence": writer.sequence,
        "writer": writer.number,
        "challenge": writer.challenge,
        "rival": writer.rival(machine.clock.now()),
        "latency_ms": {"p50": percentile(latencies, 0.5), "p99": percentile(latencies, 0.99)},
    }
