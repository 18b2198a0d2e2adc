"""The picture of a running machine, taken from its parts, and rewritten as one JSON line that nobody sees half."""

import os
from dataclasses import asdict, fields
from math import isfinite
from pathlib import Path
from typing import Any

from gateway.machine import FollowedTemperature, Machine
from gateway.machine.alarms import BY_PERSONS, AlarmBoard, AlarmState, possible
from gateway.machine.model import ScanPrediction, block_values
from gateway.machine.reading import STALE_PERIODS, Redundant, Scan, unread
from gateway.machine.writing import WritebackStage, read_numbers
from gateway.outside.status import (
    AlarmStatus,
    FamiliarityStatus,
    ForecastStatus,
    GatewayStatus,
    HistorianStatus,
    LinkStatus,
    ModelStatus,
    PastStatus,
    PredictionStatus,
    ScanStatus,
    StrangeStatus,
    TagStatus,
    TemperatureStatus,
    VirtualStatus,
)
from gateway.outside.texts import all_words, strange_sentence
from gateway.settings import PLANT, alarm_subject
from gateway.store import percentile
from sim.strict_json import json_text


def write_status(path: Path, status: object) -> None:
    """Replace the file by one JSON line, in one step. Raises OSError."""
    # A draft beside it and then a rename, which POSIX does in one step: a reader has the old line or the new one.
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    draft.write_text(json_text(status) + "\n", encoding="utf-8")
    draft.replace(path)


def snapshot(machine: Machine) -> GatewayStatus:
    """The machine at this moment; what it has not read for too long is no longer good, as no scan says so any more."""
    config, counters, link, historian = machine.config, machine.counters, machine.link, machine.historian
    now, speed, last = machine.clock.now(), machine.clock.speed, machine.last
    # A device that takes several ticks to answer is late only by as many of its own scans.
    silence, interval = (now - last.time, (1 + last.missed) * config.scan.period) if last else (0.0, config.scan.period)
    tags, samples = config.map.by_name, last.samples if last else {}
    error = machine.surroundings.clock_error
    first, *further = (_temperature(machine, one, now) for one in machine.followed)
    return GatewayStatus(
        machine=config.machine,
        time=now,
        phase=machine.phase,
        speed=speed,
        place=f"{config.links[0].place} ({config.map.name})",
        **{field.name: getattr(first, field.name) for field in fields(first)},
        further=further,
        link=LinkStatus(
            alive=link.alive,
            connected=machine.driver.connected,
            reason=link.reason,
            last_good=link.last_good,
            outages=[outage.plain(speed) for outage in link.outages],
            outage_count=link.count,
        ),
        links=_links(machine),
        scan=ScanStatus(
            count=counters.scans,
            early=counters.early,
            missed=counters.missed,
            period=config.scan.period,
            age=max(silence, 0.0) if last else None,
            late=silence > STALE_PERIODS * interval,
        ),
        values={
            name: TagStatus(
                value=s.value,
                quality=s.quality.name,
                time=s.time,
                age=max(now - s.time, 0.0),
                reason=s.reason,
                unit=tags[name].unit,
            )
            for name, s in ((name, unread(sample, silence, interval)) for name, sample in samples.items())
        },
        events=counters.events,
        recent_events=list(counters.recent),
        alarms={name: alarm.state.value for name, alarm in machine.alarms.alarms.items()},
        alarm_summary=alarm_statuses(machine.alarms, normal=False),
        historian=HistorianStatus(
            path=str(historian.path.absolute()),
            dropped=historian.dropped,
            refused=historian.refused,
            failure=historian.failure,
            complaint=historian.complaint,
        ),
        parts=machine.supervisor.report()
        | {
            part: {"running": False, "restarts": 0, "failure": reason} for part, reason in machine.missing_parts.items()
        },
        clock={
            "believed": not machine.clock_complaint,
            "complaint": machine.clock_complaint,
            "synchronised": None if error is None else isfinite(error),
        },
        driver=dict(machine.driver.statistics()),
        complaints=list(machine.complaints()),
        watched={
            tag: config.find_limit(tag)
            for tag in config.watched_temperatures
            if tag not in {one.tag for one in machine.followed}
        },
        failures=counters.failures,
        last_failure=counters.last_failure,
    )


def _temperature(machine: Machine, one: FollowedTemperature, now: float) -> TemperatureStatus:
    model, prediction = one.model, one.model.prediction if one.model else None
    return TemperatureStatus(
        temperature=one.tag,
        unit=machine.config.map.by_name[one.tag].unit,
        limit=one.config.alarms.limit,
        prediction=None if prediction is None else _prediction(prediction),
        forecast=_forecast(one, machine.last, now),
        model=ModelStatus(**model.report()) if model else None,
        guards=model.guard_report() if model else None,
        writeback=_writeback(machine.writing, one, now),
    )


def alarm_statuses(board: AlarmBoard, *, normal: bool = True) -> list[AlarmStatus]:
    """The alarms as they are, the most urgent first; those that are `normal` too, or not."""
    rows = [
        AlarmStatus(
            name=name,
            tag=alarm.tag,
            priority=alarm.priority,
            state=alarm.state.value,
            active=alarm.active,
            since=alarm.since,
            acknowledged_by=alarm.acknowledged_by,
            response=condition.response,
            consequence=condition.consequence,
            kind=condition.kind,
            standing=alarm.standing,
            raised=alarm.raised,
            first_up=alarm.first_up,
            until=alarm.until,
            by=alarm.by,
            reason=alarm.reason,
            limit=condition.limit,
            own_response=condition.own_response,
            beyond=None if (value := board.newest.get(name)) is None else value > condition.limit,
            of_plant=alarm_subject(name, alarm.tag, "") == PLANT,
            possible=[change.value for change in possible(alarm, latching=condition.latches) if change in BY_PERSONS],
        )
        for name, alarm in board.alarms.items()
        if (condition := board.conditions.get(name)) is not None and (normal or alarm.state is not AlarmState.NORMAL)
    ]
    return sorted(rows, key=lambda row: (row.priority, row.since))


def _prediction(prediction: ScanPrediction) -> PredictionStatus:
    plain = asdict(prediction)
    del plain["events"]
    if (rating := prediction.familiarity) is not None:
        own, sentence = plain["familiarity"], strange_sentence(all_words()["en"], rating.thing)
        plain["familiarity"] = FamiliarityStatus(
            **{**own, "thing": StrangeStatus(**own["thing"]), "sentence": sentence}
        )
    if plain["virtual"] is not None:
        plain["virtual"] = VirtualStatus(**plain["virtual"])
    return PredictionStatus(**plain)


def _links(machine: Machine) -> list[dict[str, Any]]:
    """Every link to the device, the primary first."""
    driver, links = machine.driver, machine.config.links
    places = {link.name: {"driver": link.map.driver, "place": link.place} for link in links}
    if isinstance(driver, Redundant):
        return [link | places[link["name"]] for link in driver.report()]
    alone = {"active": True, "connected": driver.connected, "well": machine.link.alive, "reason": machine.link.reason}
    return [{"name": link.name, **alone, **places[link.name]} for link in links[:1]]


def _forecast(one: FollowedTemperature, last: Scan | None, now: float) -> ForecastStatus | None:
    model = one.model
    forecast = model.outlook.latest if model else None
    if model is None or forecast is None:
        return None
    known = model.prediction is not None and model.prediction.known
    values = block_values(forecast, one.config.block_horizon, last.time if last else forecast.time)
    return ForecastStatus(
        time=forecast.time,
        age=max(now - forecast.time, 0.0),
        usable=known and model.outlook.fresh(now) is not None,
        levels=list(forecast.levels),
        horizons=forecast.horizons.tolist(),
        quantiles=forecast.quantiles.T.tolist(),
        p_limit=[estimate.probability for estimate in forecast.exceedance],
        factors=forecast.factors.tolist(),
        block=values,
        coverage=model.outlook.coverage(),
        postponed=model.outlook.postponed,
        past=[
            None
            if each is None
            else PastStatus(
                moments=each.moments,
                mean=each.mean,
                sigma=each.sigma,
                deviations=each.deviations,
                flagged=each.flagged,
            )
            for each in model.guards.past
        ],
    )


def _writeback(writing: WritebackStage | None, one: FollowedTemperature, now: float) -> dict[str, Any]:
    block = one.block
    if writing is None or block is None:
        return {"mode": "off"}
    writer, last, latencies = block.writer, block.attempt, list(block.latencies)
    return {
        "mode": writer.mode,
        "armed_until": writer.arming.until if writer.arming else None,
        "armed_by": writer.arming.by if writer.arming else None,
        "armed_reason": writer.arming.reason if writer.arming else None,
        **asdict(writer.counters),
        "audit": {"path": str(one.config.audit), "complaint": writing.audit.complaint},
        "block": {
            "address": writer.layout.words[0].address,
            "words": len(writer.layout.words),
            "numbers": read_numbers(writer.layout, last.block.words) if last else {},
        },
        "last_verdict": last.verdict if last else None,
        "last_reason": last.reason if last else "",
        "last_validity": int(last.block.validity) if last else None,
        "sequence": writer.sequence,
        "writer": writer.number,
        "challenge": writer.challenge,
        "rival": writer.rival(now),
        "latency_ms": {"p50": percentile(latencies, 0.5), "p99": percentile(latencies, 0.99)},
    }
