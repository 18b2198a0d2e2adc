"""A plant that has run for a while, and starts of its gateway after one of its files was damaged.

Two machines in one process: one whose model is a directory, one whose model is a store; historian, audit log with its
heads and key, log, accounts, secrets, the history of the configuration. Each trial copies all of it, damages one file,
and starts the gateway with both machines over their limit.
"""

import asyncio
import random
import shutil
from collections.abc import Awaitable, Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from gateway.outside.web.access import AccountRole
from gateway.outside.web.access.accounts import add_account
from gateway.plant.app import run
from gateway.settings import Config, load_plant
from sim.artefacts.store import promote, versions
from sim.lab.formats.write_model import save, write_model_directory
from tests.gateway.support import MAP, TEMPERATURE, Bench, JumpClock, two_modes

PLANT = f"""
[device]
file = "{MAP}"
[forecast]
horizons = [10.0]
runs = 20
[historian]
path = "records/history.sqlite"
[log]
path = "gateway.jsonl"
[page]
enabled = true
port = 0
[notify]
secrets = "secrets.toml"
[[notify.to]]
name = "shift"
webhook = "secret"
[northbound]
secrets = "northbound.toml"
[[northbound.influx]]
name = "plant"
url = "http://127.0.0.1:1/"
organization = "o"
bucket = "b"
[[machine]]
name = "first"
device = {{ port = 15021 }}
model = {{ path = "model" }}
writeback = {{ mode = "armed", armed_by = "Ada", reason = "test", minutes = 480.0 }}
[[machine]]
name = "second"
device = {{ port = 15022 }}
model = {{ path = "store" }}
"""
MODELS = {"first": ("model/",), "second": ("store/",)}
"""What is a machine's alone, by how its files begin."""
MAY_REFUSE = ("plant.toml",)
SCANS, BEFORE = 6, 40


@dataclass(frozen=True, slots=True)
class Damage:
    """What is done to a file: `data` in place of the bytes from `begin` to `end`."""

    file: str
    begin: int
    end: int
    data: bytes

    def __str__(self) -> str:
        return f"{self.file}: bytes {self.begin} to {self.end} become {self.data[:16]!r}{'...' * (len(self.data) > 16)}"

    def to(self, folder: Path) -> None:
        """Do it."""
        path = folder / self.file
        before = path.read_bytes()
        path.write_bytes(before[: self.begin] + self.data + before[self.end :])


def damages(file: str, content: bytes, places: int, rng: random.Random) -> Iterator[Damage]:
    """What may befall a file: emptied, cut, a bit flipped, a range of zeros, of ones, of a text; at `places` each."""
    size = len(content)
    yield Damage(file, 0, size, b"")
    yield Damage(file, size, size, b"\n")
    spots = sorted({rng.randrange(size) for _ in range(places)}) if size > places else list(range(size))
    for at in spots:
        end = min(size, at + rng.choice((1, 4, 16, 100, 1024)))
        yield Damage(file, at, at + 1, bytes([content[at] ^ 1 << rng.randrange(8)]))
        yield Damage(file, at, size, b"")
        yield Damage(file, at, end, bytes(end - at))
        yield Damage(file, at, end, b"\xff" * (end - at))
        yield Damage(file, at, at, b"\n[x]")


async def nothing() -> None:
    """What is done meanwhile by default."""


async def started(
    folder: Path, scans: int, temperature: float = 95.0, meanwhile: Callable[[], Awaitable[None]] = nothing
) -> dict[str, Any]:
    """The last status of the gateway of this folder after some scans of both machines, over their limit."""
    configs = load_plant(folder / "plant.toml")
    clock, benches = JumpClock(1_700_000_000.0 + scans), dict[str, Bench]()
    stop = asyncio.Event()

    def make_bench(config: Config, *_: object) -> Bench:
        bench = Bench(config, clock, armed=config.writeback.mode == "armed")
        bench.plan[0] = {TEMPERATURE: temperature}
        benches[config.machine] = bench
        return bench

    async def watched() -> None:
        while not benches or any(bench.reads < scans for bench in benches.values()):
            await asyncio.sleep(0.005)
        try:
            await meanwhile()
        finally:
            stop.set()

    with mock.patch("gateway.plant.fleet.make_driver", make_bench):
        running = asyncio.create_task(run(*configs, clock=clock, stop=stop))
        watching = asyncio.create_task(watched())
        try:
            status = await asyncio.wait_for(running, 120.0)
            await watching
            return status
        finally:
            watching.cancel()


def seed(folder: Path) -> None:
    """Make the plant, and have it run for a while."""
    folder.mkdir(parents=True)
    (folder / "plant.toml").write_text(PLANT)
    secrets = {"secrets": '[webhooks]\nshift = "https://127.0.0.1:1/"', "northbound": '[tokens]\nplant = "t"'}
    for name, lines in secrets.items():
        (folder / f"{name}.toml").write_text(lines + "\n")
        (folder / f"{name}.toml").chmod(0o600)
    write_model_directory(folder / "model", two_modes())
    save(folder / "store", two_modes(gap=20.0), created=0.0)
    promote(folder / "store", versions(folder / "store")[0])
    add_account(folder / "records/users.json", "ada", AccountRole.ENGINEER, "a long enough word")
    for temperature in (95.0, 25.0):
        asyncio.run(started(folder, BEFORE, temperature))


def files_of(folder: Path) -> list[str]:
    """Every file of the plant."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def problems(folder: Path, status: dict[str, Any], damage: Damage) -> list[str]:
    """What is missing of what a start has to do whatever is damaged; none: all is well."""
    if damage.file in MAY_REFUSE:
        return []  # it is another plant then
    found = []
    for name, machine in status["machines"].items():
        if machine["alarms"].get(f"over limit {TEMPERATURE}") not in ("unacknowledged", "acknowledged"):
            found.append(f"{name}: the alarm at the limit does not stand")
        if machine["scan"]["count"] < SCANS - 1:
            found.append(f"{name}: {machine['scan']['count']} scans")
        damaged = damage.file.startswith(MODELS[name])
        if not damaged and machine["model"] is None:
            found.append(f"{name}: runs without a model")
        if damaged and machine["model"] is None and machine["alarms"]["parts"] != "unacknowledged":
            found.append(f"{name}: runs without a model, and no alarm says so")
        if machine["failures"]:
            found.append(f"{name}: {machine['last_failure']}")
        found += [f"{name}: {part}: {how['failure']}" for part, how in machine["parts"].items() if how["restarts"]]
    if set(status["machines"]) != {"first", "second"}:
        found.append(f"only {list(status['machines'])}")
    return found


def tried(plant: Path, place: Path, damage: Damage) -> list[str]:
    """What is wrong with a start after a damage, at a `place` that is not there yet."""
    shutil.copytree(plant, place)
    try:
        damage.to(place)
        try:
            return problems(place, asyncio.run(started(place, SCANS)), damage)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is what is looked for
            if isinstance(error, ValueError) and damage.file in MAY_REFUSE and str(place / damage.file) in str(error):
                return []
            return [f"no start: {type(error).__name__}: {error}"]
    finally:
        shutil.rmtree(place)


def drawn(plant: Path, places: int, rng: random.Random, only: Sequence[str] = ()) -> list[Damage]:
    """Damages of every file of the plant, or `only` of some."""
    return [
        damage
        for file in files_of(plant)
        if not only or file in only
        for damage in damages(file, (plant / file).read_bytes(), places, rng)
    ]
