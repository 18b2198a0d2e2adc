"""`decanter plc replay`: a recording through the whole gateway in shadow, on a clock as fast as it can be."""

import asyncio
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import aclosing
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from random import Random
from typing import Any

from drivers.driver import open_driver
from gateway.commission.files import SiteRecording, read_recording
from gateway.commission.options import SharedOptions
from gateway.commission.session import Site, Target, perform
from gateway.console import CommandResult, Part, Progress, Rows, progress
from gateway.entry import sentences
from gateway.machine import Machine
from gateway.machine.reading import QualityRules, scans
from gateway.plant import open_log
from gateway.settings import Config, HistorianSection, WritebackSection, load_config
from gateway.store import scorecard

GAP_S = 60.0
"""Of a recording with a longer pause, nothing is known meanwhile."""


@dataclass(slots=True)
class SteppedClock:
    """A clock that stands still until somebody sleeps, and then is where that one wanted to be."""

    time: float
    speed: float = 1.0

    def now(self) -> float:
        """Plant time (s)."""
        return self.time

    async def sleep_until(self, moment: float, stop: asyncio.Event | None = None) -> None:
        """Be at that moment, after other tasks had their turn."""
        await asyncio.sleep(0)
        self.time = max(self.time, moment)


@dataclass(slots=True)
class ReplayTally:
    """What the gateway did on the way."""

    scans: int = 0
    not_good: Counter[str] = field(default_factory=Counter)
    alarms: list[dict[str, Any]] = field(default_factory=list)
    locations: Counter[str] = field(default_factory=Counter)
    zones: Counter[str] = field(default_factory=Counter)
    valid: int = 0
    blocks: int = 0
    states: dict[str, str] = field(default_factory=dict)

    def take(self, machine: Machine, time: float) -> None:
        """One scan, after the gateway has taken it."""
        self.scans += 1
        if machine.last is not None:
            self.not_good.update(name for name, sample in machine.last.samples.items() if not sample.quality.is_good)
        prediction = machine.model.prediction if machine.model else None
        if prediction is not None:
            self.locations[prediction.location if prediction.known else "not known"] += 1
            self.zones[prediction.zone] += 1
        attempt = machine.writing.blocks[0].attempt if machine.writing else None
        if attempt is not None:
            self.blocks += 1
            self.valid += bool(int(attempt.block.validity) & 1)
        for name, alarm in machine.alarms.alarms.items():
            if self.states.get(name, "normal") != alarm.state.value:
                self.alarms.append({"time": time, "alarm": name, "state": alarm.state.value})
            self.states[name] = alarm.state.value


async def replay_recording(site: Site, config: Config, recording: SiteRecording, progress: Progress) -> CommandResult:
    """Let the gateway take the recording as if it came from the PLC; nothing is read, written or kept.

    Raises ConfigError for a model that cannot be used, ValueError for a recording without any tag of the plant.
    """
    names = [tag.name for tag in config.map.tags]
    missing = [name for name in names if name not in recording.columns]
    if len(missing) == len(names):
        wanted = ", ".join(names[:5])
        raise ValueError(f"{recording.path}: has no column of a tag of {config.map.path}; it needs {wanted}, ...")
    with tempfile.TemporaryDirectory(prefix="decanter-replay-") as folder:
        kept, first = Path(folder) / "historian.sqlite", config.links[0]
        # The configuration with its records elsewhere and nothing to write to; no heartbeat where none was recorded.
        heartbeat = None if first.map.heartbeat in missing else first.map.heartbeat
        shadow = replace(
            config,
            historian=HistorianSection(path=kept, max_mb=config.historian.max_mb),
            writeback=WritebackSection(
                mode="off" if config.map.writeback is None else "shadow",
                horizon=config.writeback.horizon,
                audit=kept.with_name("audit.sqlite"),
            ),
            log=config.log.model_copy(update={"path": kept.with_name("log.jsonl")}),
            links=(replace(first, map=replace(first.map, heartbeat=heartbeat)),),
        )
        seen = await follow_recording(shadow, recording, SteppedClock(recording.times[0]), progress)
        scores = scorecard(kept)
    data = {
        "recording": str(recording.path),
        "rows": len(recording.times),
        "seconds": recording.duration,
        "scans": seen.scans,
        "missing_tags": missing,
        "not_good": {name: count for name, count in seen.not_good.most_common() if name not in missing},
        "events": scores.events,
        "locations": dict(seen.locations.most_common()),
        "zones": dict(seen.zones.most_common()),
        "one_step": asdict(scores.one_step),
        "free_run": asdict(scores.free_run),
        "band90": scores.band90,
        "forecasts": [asdict(forecast) for forecast in scores.forecasts],
        "alarms": seen.alarms,
        "blocks": seen.blocks,
        "blocks_valid": seen.valid,
        "model": str(config.model.path) if config.model.path is not None else None,
    }
    needed = [name for name in missing if name in {*config.watched_temperatures, config.model.temperature}]
    complaint = f"the recording lacks {', '.join(needed)}, which the gateway needs: nothing could be predicted"
    return CommandResult(data, complaint if needed else "")


async def follow_recording(
    config: Config, recording: SiteRecording, clock: SteppedClock, progress: Progress
) -> ReplayTally:
    """Let a gateway of this configuration start, take the recording by this clock, and stop."""
    seen, stop = ReplayTally(), asyncio.Event()
    columns = {
        name: [value if isfinite(value) else None for value in column] for name, column in recording.columns.items()
    }
    settings = {"times": list(recording.times), "columns": columns, "max_gap": GAP_S}
    with open_log(config.log.path, config.log.level) as log:
        driver = open_driver("soft", settings, clock=clock.now)
        # Nothing is written in a replay: any number will do.
        machine = Machine(config, driver=driver, clock=clock, log=log, rng=Random(0))  # noqa: S311
        try:
            await machine.driver.open()
            rules = QualityRules(config.scan.period, config.map.heartbeat, config.device.heartbeat_period)
            derived = config.map.derived
            stream_of = scans(machine.driver, config.map.tags, clock, rules, derived=derived, stop=stop)
            async with aclosing(stream_of) as stream:
                async for scan in stream:
                    await machine.take(scan)
                    # The clock stands still meanwhile: a forecast is done before the next scan, on any machine.
                    if machine.model is not None:
                        await machine.model.outlook.finish()
                    seen.take(machine, scan.time)
                    share = (scan.time - recording.times[0]) / max(recording.duration, 1e-9)
                    progress(f"{seen.scans} scans", min(1.0, share))
                    if scan.time >= recording.times[-1]:
                        stop.set()
        finally:
            if machine.model is not None:
                await machine.model.close()
            await machine.driver.close()
            await asyncio.to_thread(machine.close)
    return seen


def replay(given: SharedOptions, recording: Path) -> None:
    """Carry out `decanter plc replay`; its options and its help are in commission/commands.py."""
    with sentences():
        if given.plant is None:
            raise ValueError("which gateway? Give its plant file (--config FILE)")
        config = load_config(given.plant, machine=given.machine)
        target = Target(
            kind="",
            driver="soft",
            settings={},
            map=config.map,
            config=config,
            files=(given.plant, config.map.path, recording),
        )

    async def work(site: Site) -> CommandResult:
        with progress("replay") as report:
            return await replay_recording(
                site, config, read_recording(recording, machine=target.subject or None), report
            )

    perform(given, "replay", {"recording": str(recording)}, work, _view, target=target)


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    rows = [
        ("recording", f"{data['rows']} rows over {data['seconds']:.6g} s, {data['scans']} scans"),
        ("tags that it lacks", ", ".join(data["missing_tags"]) or "none"),
        ("tags not good", ", ".join(f"{name} {count} x" for name, count in data["not_good"].items()) or "none"),
        ("events", str(data["events"])),
        ("model", data["model"] or "none: nothing is predicted"),
        ("locations (scans)", _counts(data["locations"])),
        ("confidence (scans)", _counts(data["zones"])),
        ("one step ahead", _error(data["one_step"], data["band90"])),
        ("free run", _error(data["free_run"], None)),
        ("blocks", f"{data['blocks']} computed, {data['blocks_valid']} of them valid, none written"),
    ]
    yield Rows("what the gateway made of it", ("what", "found"), rows)
    ahead = [(row["horizon"], row["mae"], row["persistence_mae"], row["count"]) for row in data["forecasts"]]
    if ahead:
        yield Rows("forecasts", ("s ahead", "median off (degC)", "persistence off (degC)", "matured"), ahead)
    alarms = [
        (datetime.fromtimestamp(alarm["time"], UTC).strftime("%Y-%m-%d %H:%M:%S"), alarm["alarm"], alarm["state"])
        for alarm in data["alarms"]
    ]
    if alarms:
        yield Rows(f"{len(alarms)} changes of alarms, the first 20", ("time", "alarm", "state"), alarms[:20])


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in list(counts.items())[:6]) or "none"


def _error(error: Mapping[str, Any], band: float | None) -> str:
    if not error["count"]:
        return "nothing to compare"
    covered = f", {band:.0%} within the 90 % band" if band is not None else ""
    return f"{error['mae']:.3g} degC off on average, root mean square {error['rmse']:.3g} ({error['count']}){covered}"
