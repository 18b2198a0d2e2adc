"""What the gateway's tests share: a small known model, configurations, a clock that jumps, readings in memory."""

import asyncio
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.driver import BeforeSending, Driver, anyhow, open_driver
from drivers.tag import Quality, Sample, Tag, Value
from gateway.machine.reading.scan import Scan
from gateway.settings.config import Config, load_config
from gateway.store import Historian, HistorianView, open_historian
from sim.artefacts.model_json import model_text
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import DECANTER, Alphabet
from sim.sha.model import Model, Stay

ROOT = Path(__file__).parents[2]
MAP = ROOT / "config/devices/decanter_plc.toml"
TEMPERATURE, CURRENT, RUNNING = "TCuscinettiRiduttore", "Assorbimento", "MarciaDecanter"
EPOCH = 1_700_000_000.0


@dataclass
class JumpClock:
    """A clock that stands still until somebody sleeps, and then jumps."""

    time: float = EPOCH
    speed: float = 1.0

    def now(self) -> float:
        return self.time

    async def sleep_until(self, moment: float, stop: asyncio.Event | None = None) -> None:
        await asyncio.sleep(0)
        self.time = max(self.time, moment)


@dataclass
class PacedClock(JumpClock):
    """Leaves `pause_s` of real time before each jump, for what takes real time meanwhile: a thread of a store or of a
    forecast, and a person at the gateway's socket, who would find the arming over on a busy machine."""

    pause_s: float = 0.02

    async def sleep_until(self, moment: float, stop: asyncio.Event | None = None) -> None:
        await asyncio.sleep(self.pause_s)
        await super().sleep_until(moment, stop)


def one_machine(path: Path, tags: Iterable[Tag] = (), **options: Any) -> tuple[Historian, HistorianView]:
    """The historian of a gateway with one machine: what is opened and closed, and the machine's view of it."""
    store = open_historian(path, **options)
    return store, store.view("decanter", tags)


def two_modes(gap: float = 30.0) -> Model:
    """Off cools to 20 degC, on warms to 50 degC at every current; `start` is where nothing is known."""

    def location(name: str, target: float, k: float) -> Location:
        law = Distribution("normal", {"mu": target, "sigma": 1.0})
        return Location(name, Flow("exponential", {"k": k, "noise": 0.01}), law)

    locations = (location("start", 30.0, 0.001), location("off", 20.0, 0.002), location("on", 50.0, 0.01))
    stay = ("A_0", "A_1", "A_2", "A_3")
    edges = [Edge(name, "W_ON", "on") for name in ("start", "off", "on")]
    edges += [Edge(name, "W_OFF", "off") for name in ("start", "off", "on")]
    edges += [Edge(name, symbol, name) for name in ("start", "off", "on") for symbol in stay]
    stays = {
        "off": Stay(Distribution("exponential", {"mean": 300.0}), {"on": 1.0}),
        "on": Stay(Distribution("exponential", {"mean": 600.0}), {"off": 1.0}),
    }
    return Model(
        sha=SHA("two modes", locations, tuple(edges), "start"),
        alphabet=Alphabet(DECANTER.channels, gap=gap, uppaal=DECANTER.uppaal),
        temperature=TEMPERATURE,
        sensor_sigma=0.05,
        initial=Distribution("normal", {"mu": 25.0, "sigma": 5.0}),
        semi_markov=stays,
    )


def plant_file(folder: Path, text: str = "", *, model: Model | None = None, device: Path = MAP) -> Path:
    """A plant.toml in `folder`; `text` is put after [device], so it may begin with keys of that table."""
    lines = [f'[device]\nfile = "{device}"\n{text}']
    if model is not None:
        (folder / "model.json").write_text(model_text(model), encoding="utf-8")
        lines.append('[model]\npath = "model.json"')
    if "[historian]" not in text:
        lines.append('[historian]\npath = "history.sqlite"')
    if "[log]" not in text:
        lines.append('[log]\npath = "gateway.jsonl"\nlevel = "debug"')
    path = folder / "plant.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def config_in(folder: Path, text: str = "", *, model: Model | None = None, **overrides: Any) -> Config:
    """The checked configuration of `plant_file`; overrides are written section__key."""
    given = {key.replace("__", ".", 1): value for key, value in overrides.items()}
    return load_config(plant_file(folder, text, model=model), given)


def at_rest(config: Config) -> dict[str, Value]:
    """A value for every tag of the map: a decanter at rest at 25 degC, writes permitted."""
    values: dict[str, Value] = {tag.name: False if tag.bit is not None else 0 for tag in config.map.tags}
    values |= {
        TEMPERATURE: 25.0,
        "TCuscinettiAlimentazione": 25.0,
        "PlcHeartbeat": 1,
        "WritePermit": True,
        "Challenge": 1,
    }
    return values


@dataclass
class Bench:
    """A soft device whose heartbeat moves at each read, as a living PLC's does, unless `frozen`."""

    config: Config
    clock: JumpClock
    armed: bool = False
    frozen: bool = False
    reads: int = 0
    plan: dict[int, Mapping[str, Value | None]] = field(default_factory=dict)
    stop_after: int | None = None
    stop: asyncio.Event = field(default_factory=asyncio.Event)
    written: list[dict[str, Value]] = field(default_factory=list)

    def __post_init__(self) -> None:
        words = self.config.map.block_words if self.armed else ()
        self.soft: Any = open_driver("soft", {"values": at_rest(self.config)}, clock=self.clock.now, write_map=words)

    async def open(self) -> None:
        await self.soft.open()

    async def close(self) -> None:
        await self.soft.close()

    async def read(self, tags: Any) -> list[Sample]:
        for name, value in self.plan.get(self.reads, {}).items():
            if name == "fault":
                self.soft.fail(value)
            else:
                self.soft.put(name, value, Quality.GOOD if value is not None else Quality.SENSOR_FAILURE)
        self.reads += 1
        if self.stop_after is not None and self.reads >= self.stop_after:
            self.stop.set()
        if not self.frozen:
            self.soft.put("PlcHeartbeat", self.reads % 0xFFFF + 1)
        read: list[Sample] = await self.soft.read(tags)
        return read

    async def write(self, values: Any, *, before_sending: BeforeSending = anyhow) -> None:
        await self.soft.write(values, before_sending=before_sending)
        self.written.append({tag.name.removeprefix("Writeback."): value for tag, value in values})

    @property
    def connected(self) -> bool:
        return bool(self.soft.connected)

    def statistics(self) -> Mapping[str, float]:
        return dict(self.soft.statistics())


def as_driver(bench: Bench) -> Driver:
    """mypy's proof that the bench is a driver."""
    return bench


def scan_of(values: Mapping[str, Value | None], time: float, quality: Quality = Quality.GOOD) -> Scan:
    """A scan of these readings; None is a reading that failed."""
    samples = {
        name: Sample(name, value, quality if value is not None else Quality.TIMEOUT, time, time)
        for name, value in values.items()
    }
    return Scan(0, time, samples, 0, 0.0)


def logged(folder: Path) -> list[dict[str, Any]]:
    """The lines of the log."""
    return [json.loads(line) for line in (folder / "gateway.jsonl").read_text(encoding="utf-8").splitlines()]
