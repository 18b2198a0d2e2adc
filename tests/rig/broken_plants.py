"""A plant of two machines, and slips in its plant file: what the judge of a plant file says of each.

The plant is that of `tests.rig.broken_starts`, which is in order. Each slip is one value, or two, that nobody can mean,
or a piece of text as people mistype it, in the plant file or in the device file beside it.
"""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any

import tomlkit

from drivers.settings import ConfigError
from gateway.plant import check_plant
from gateway.settings import load_plant
from tests.gateway.support import MAP
from tests.rig.broken_starts import seed

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
COMMANDS = (
    "plc check --offline",
    "run",
    "reload",
    "top --once",
    "plc bind --machine first --keep log.max_days=30",
    "machine add third --unit 9",
)
"""What reads a plant file and must say the same of it."""
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


_TAG = '[[tags]]\nname = "MarciaDecanter"'


def _tag(keys: str, name: str = "New") -> str:
    return f'[[tags]]\nname = "{name}"\n{keys}\n{_TAG}'


TEXTS: Mapping[str, tuple[tuple[str, str, str], ...]] = {
    "plant.toml": (
        ("", "\ufeff", "save it as UTF-8 without one"),
        ("\n[forecast]", '\n{"forecast": 1}', "this is another format; write [table]"),
        ("\n[forecast]", "\n[forecast", "Expected ']' at the end of a table declaration (at line"),
        ("\n[forecast]", "\n[forcast]", "forcast: there is no such key; did you mean 'forecast'?"),
        ("\n[forecast]", "\n[Forecast]", "Forecast: there is no such key; did you mean 'forecast'?"),
        ("\n[forecast]", "\n[scan]\nperiod = 1,5\n[forecast]", "write a decimal point, and no comma"),
        ("\n[forecast]", "\n[scan]\nperiod = 1s\n[forecast]", "write a number without its unit"),
        ("\n[forecast]", '\n[scan]\nperiod = "1 s"\n[forecast]', "scan.period: must be a number, got '1 s'"),
        ("\n[forecast]", "\n[alarms]\nlimit = 80 °C\n[forecast]", "write a number without its unit"),
        ("\n[forecast]", '\n[alarms]\nlimit = "80 °C"\n[forecast]', "alarms.limit: must be a number, got '80 °C'"),
        ("\n[forecast]", "\n[alarms]\nlimit = 60\ndeadband = 90\n[forecast]", "has a deadband of 90"),
        ("\n[forecast]", f'\n[alarms]\ntags = ["{HEAT[:-1]}"]\n[forecast]', f"did you mean '{HEAT}'?"),
        ("\n[forecast]", f'\n[model]\ntemperature = "{HEAT.upper()}"\n[forecast]', f"did you mean '{HEAT}'?"),
        ("\n[forecast]", '\ntimezone = "Europe/Rome"\n[forecast]', "timezone: there is no such key"),
        ("runs = 20", "runs = 20\nruns = 30", "it is there already; keep one of the two"),
        ("runs = 20", "runs = 20\n[log]", "Cannot declare ('log',) twice"),
        ("runs = 20", "run = 20", "forecast.run: there is no such key; did you mean 'runs'?"),
        ("runs = 20", "runs\u00a0= 20", "a space there is no plain one"),
        ("runs = 20", "runs : 20", "write key = value"),
        ("runs = 20", "runs =", "give the key a value"),
        ("runs = 20", "runs = .5", "write a number with digits on both sides of its point"),
        ("runs = 20", "runs = 10.0.0.1", "write a text in quotes"),
        ('"secrets.toml"', '"secrets.toml', "close the quotes of a text where it ends"),
        ("runs = 20", "runs = None", "leave the key out where there is no value"),
        ("runs = 20", "runs = 020", "write a number without a 0 before it"),
        ("[10.0]", "[10.0", "(at line"),
        ("enabled = true", "enabled = True", "write true or false"),
        ("enabled = true", "enabled = yes", "write true or false"),
        ("enabled = true", 'enabled = "yes"', "page.enabled: must be true or false, got 'yes'"),
        ('"secrets.toml"', "secrets.toml", "write a text in quotes"),
        ('"secrets.toml"', "\u201csecrets.toml\u201d", "write straight quotes around a text"),
        ('"records/history.sqlite"', '"records\\history.sqlite"', "write a path with / between its parts"),
        ('"records/history.sqlite"', '"C:/data/history.sqlite"', "is a path of a shell or of another system"),
        ('"records/history.sqlite"', '"~/history.sqlite"', "historian.path: '~/history.sqlite' is a path of a shell"),
        ('"records/history.sqlite"', '"$HOME/history.sqlite"', "is a path of a shell or of another system"),
        (
            '"records/history.sqlite"',
            '"records/history.sqlite"\nretention_days = 0.05\nmax_interval = 80000',
            "would be deleted before it is stored again",
        ),
        ("port = 15021", 'host = "192.168.1.300"', "device.host: host '192.168.1.300' is no IP address"),
        ("port = 15021", 'host = "192,168,1,30"', "is no IP address; give four numbers"),
        ("port = 15021", 'host = "10.0.1"', "is no IP address; give four numbers"),
        ("port = 15021", 'host = "<PLC>"', "holds what no name or address has"),
        ("port = 0\n", "port = 15021\n", "page.port: 15021 is the port of the device at 127.0.0.1"),
        ('{ path = "model" }', '{ path = "model", }', "close a { table } on its line"),
        ('{ path = "model" }', '{ path = "model/manifest.json" }', "model.path"),
        ('"second"', '"Lüfter"', "machine[1].name: must match pattern"),
        ("[[machine]]", "[[machines]]", "machines: there is no such key"),
        ("port = 15022", "port = 15021", "give each machine a device of its own"),
        ("bucket =", "tokn =", "tokn: there is no such key"),
    ),
    "plc.toml": (
        ("", "\ufeff", "save it as UTF-8 without one"),
        (_TAG, _tag('address = "40901"'), "New: '40901' is a reference number that counts from 1"),
        (_TAG, _tag("address = 901"), "address: must be text, got 901"),
        (_TAG, _tag('address = "holding:65535"\ndtype = "float32"'), "reach beyond the last address"),
        (_TAG, _tag('address = "holding:900"\ndtype = "REAL"'), "dtype: must be"),
        (_TAG, _tag('address = "holding:900"\nscale = "0,1"'), "scale: must be a number, got '0,1'"),
        (_TAG, _tag('address = "holding:900"\nscale = 0'), "scale 0 would make every reading 0"),
        (_TAG, _tag('address = "holding:900"\nlow = 9\nhigh = 1'), "low: 9.0 is not below high 1.0"),
        (_TAG, _tag('address = "holding:900"', "MarciaDecanter"), "'MarciaDecanter' is already used"),
        (_TAG, _tag('address = "holding:100"\ndtype = "float32"'), "and New overlap: holding:100"),
        ('"modbus"', '"profinet"', "'profinet' is no driver; give one of"),
    ),
}
"""(what stands there, what somebody writes, words that are said of it), by the file."""


def _ring(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    path.symlink_to(path.name)


def _link_log(folder: Path) -> None:
    (folder / "gateway.jsonl").unlink(missing_ok=True)
    os.link(folder / "records/history.sqlite", folder / "gateway.jsonl")


PLACES: Mapping[str, tuple[Callable[[Path], object], str]] = {
    "a plant file that is UTF-16": (
        lambda folder: (folder / "plant.toml").write_text("[device]", encoding="utf-16"),
        "byte 0 is not UTF-8; save the file as UTF-8",
    ),
    "an empty plant file": (lambda folder: (folder / "plant.toml").write_text(""), "device: is missing"),
    "a plant file that is a link to itself": (lambda folder: _ring(folder / "plant.toml"), "Too many levels"),
    "a device file that is a link to itself": (lambda folder: _ring(folder / "plc.toml"), "Too many levels"),
    "records in a link to itself": (lambda folder: _ring(folder / "records"), "is a link that leads nowhere"),
    "a log that is another name of the records": (_link_log, "is the file of historian.path too"),
    "a device file that is a pipe": (
        lambda folder: ((folder / "plc.toml").unlink(), os.mkfifo(folder / "plc.toml")),
        "it is a named pipe, not a file",
    ),
    "a model without its file": (lambda folder: (folder / "model/model.json").unlink(), "has neither model.json"),
    "a store of which nothing runs": (lambda folder: (folder / "store/current").unlink(), "no version is promoted"),
}
"""What befalls a file itself, and words that are said of it."""


def seed_with_device(folder: Path) -> None:
    """Make the plant with a device file of its own."""
    seed(folder)
    shutil.copyfile(MAP, folder / "plc.toml")
    plant = folder / "plant.toml"
    plant.write_text(plant.read_text(encoding="utf-8").replace(f'"{MAP}"', '"plc.toml"'), encoding="utf-8")


def spoiled_plants() -> Iterator[tuple[str, Callable[[Path], object], str]]:
    """(what, how a folder is spoiled, words that are said of it) of each mistyped text and each spoiled file."""

    def replaced(file: str, old: str, new: str) -> Callable[[Path], object]:
        def spoil(folder: Path) -> None:
            text = (folder / file).read_text(encoding="utf-8")
            assert old in text, old
            (folder / file).write_text(text.replace(old, new, 1), encoding="utf-8")

        return spoil

    for file, texts in TEXTS.items():
        for old, new, words in texts:
            yield f"{file}: {new!r}", replaced(file, old, new), words
    for what, (spoil, words) in PLACES.items():
        yield what, spoil, words


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
