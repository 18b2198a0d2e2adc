"""A plant of two machines, and slips in its plant file: what the judge of a plant file says of each.

The plant is that of `tests.rig.broken_starts`, which is in order. Each slip is one value, or two, that nobody can mean.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any

import tomlkit

from drivers.settings import ConfigError
from gateway.plant import check_plant
from gateway.settings import load_plant

HEAT, SWITCH, OTHER = "TCuscinettiRiduttore", "MarciaDecanter", "TCuscinettiTamburo"
ARMED = {"mode": "armed", "armed_by": "Ada", "reason": "test", "minutes": 10.0}
INFLUX = {"name": "plant", "url": "http://127.0.0.1:1/", "organization": "o", "bucket": "b"}
RECORDS = ("records/history.sqlite", "records/audit.sqlite", "records/audit.heads.jsonl", "records/audit.key")
OTHERS = (
    "plant.toml",
    "secrets.toml",
    "northbound.toml",
    "model/model.json",
    "model/manifest.json",
    "records",
    "model",
)
VALUES: dict[str, tuple[Any, ...]] = {
    "alarms.limit": (nan, inf, -inf, "80", True, [80], 1e6, -300.0),
    "alarms.deadband": (nan, inf, -1.0, 500.0),
    "alarms.on_delay": (nan, inf, -1.0, 1e9),
    "alarms.off_delay": (nan, inf, -1.0, 1e9),
    "alarms.p_limit": (0, 1.5, nan),
    "alarms.anomaly": (0, inf, 1e9),
    "alarms.unfamiliar": (0, 1e9),
    "alarms.drift": (0, inf, nan),
    "alarms.drift_cycles": (0, 1.5),
    "alarms.trend": (True, inf, 0),
    "alarms.tags": (["Nix"], [SWITCH], [HEAT, HEAT], HEAT),
    "alarms.twins": (["Nix", HEAT], [HEAT, HEAT], [HEAT], [HEAT, SWITCH]),
    "alarms.acknowledge": ("Nix", HEAT, ""),
    "alarms.disk_mb": (-1, inf),
    "alarms.limt": (80.0,),
    "scan.period": (0, 60, 3600, nan, "1"),
    "forecast.horizons": ([], [1e9], [60, 60], [inf], [900, 60], [-60], 60),
    "forecast.period": (0, inf, 1e9),
    "forecast.runs": (19, 1e3, True),
    "historian.path": (*OTHERS, *RECORDS[1:], "gateway.jsonl", "", "/dev/null"),
    "historian.retention_days": (0, 1e-6, inf),
    "historian.max_mb": (0, inf),
    "historian.max_interval": (0, inf, 1e9),
    "log.path": (*OTHERS, *RECORDS, *(f"{RECORDS[0]}{end}" for end in ("-wal", "-shm", ".lock")), "/dev/full"),
    "log.level": ("loud",),
    "control.path": (*OTHERS, *RECORDS, "x" * 200),
    "writeback.audit": (*OTHERS, RECORDS[0], "gateway.jsonl"),
    "writeback.audit_key": (*OTHERS, *RECORDS[:3]),
    "writeback.audit_heads": ("plant.toml", RECORDS[0], RECORDS[1], RECORDS[3], "model/manifest.json"),
    "writeback.horizon": (60.0, 0),
    "writeback.most_per_second": (0.1, 1e9),
    "writeback.max_age": (60, 0),
    "writeback.mode": ("on",),
    "clock.speed": (0, inf),
    "clock.tag": ("Nix", HEAT, SWITCH),
    "serve.port": (0, 99_999, 15_999),
    "page.port": (-1, 99_999),
    "page.host": ("0.0.0.0", ""),
    "page.users": ("plant.toml", RECORDS[0]),
    "page.certificates": ("nix",),
    "page.labels": ({"Nix": "x"}, {HEAT: 3}),
    "virtual_sensor.width": (0, 1e-9, inf),
    "virtual_sensor.minutes": (0, inf),
    "ensemble.members": (["model"], ["nix"], ["plant.toml"]),
    "ensemble.weights": ([0.5, 0.5], "best"),
    "ensemble.half_life": (0, 1e-9, inf),
    "model.temperature": ("Nix", SWITCH),
    "model.correction": ("nix",),
    "notify.secrets": ("nix.toml", "plant.toml", RECORDS[0]),
    "northbound.secrets": ("nix.toml", "secrets.toml"),
    "device.host": ("", "a b"),
    "device.unit": (300, -1),
    "device.timeout": (0, nan, inf, 1e9),
    "device.file": ("plant.toml", "nix.toml", "model/model.json", "records"),
    "machine.0.device.port": (0, 70_000, "502", 15_022),
    "machine.0.model.path": ("records", "store/current", "nix"),
    "machine.0.alarms": ({"limit": 8.0}, {"limit": 800.0}),
    "machine.0.historian": ({"path": "a.sqlite"},),
    "machine.0.writeback.minutes": (0, 1e9),
    "machine.0.writeback.armed_by": ("",),
    "machine.0.temperature": ([{"tag": HEAT}, {"tag": HEAT}], [{"tag": HEAT, "model": "model"}]),
    "machine.1.name": ("first", "a b", "page", ""),
    "alarm": ([{"kind": "nix"}], [{"name": "nix"}]),
    "northbound.influx.0.url": ("nix",),
    "northbound.influx": ([INFLUX, INFLUX],),
    "notify.to.0.webhook": ("http://x",),
    "sacn.period": (1,),
}
"""Values that cannot be meant, by the key at which they stand."""


@dataclass(frozen=True, slots=True)
class Slip:
    """A value at a key of the plant file."""

    key: str
    value: Any

    def __str__(self) -> str:
        text = repr(self.value)
        return f"{self.key} = {text if len(text) <= 40 else f'{text[:37]}...'}"

    def text(self, plant: str) -> str:
        """The plant file with it."""
        document = tomlkit.parse(plant)
        table: Any = document
        *heads, last = self.key.split(".")
        for head in heads:
            table = table[int(head)] if head.isdigit() else table.setdefault(head, tomlkit.table())
        table[last] = self.value
        return tomlkit.dumps(document)


def slips() -> Iterator[Slip]:
    """All of them."""
    return (Slip(key, value) for key, values in VALUES.items() for value in values)


@dataclass(frozen=True, slots=True)
class Judgement:
    """What is said of a plant file: `refused` by whoever loads it, or with `sentences` by the judge."""

    refused: bool
    sentences: tuple[str, ...]


def judge_plant(plant: Path) -> Judgement:
    """What every command that reads the plant file says of it."""
    try:
        configs = load_plant(plant)
    except ConfigError as error:
        return Judgement(True, tuple(error.problems))
    return Judgement(False, tuple(finding.sentence for finding in check_plant(configs)))
