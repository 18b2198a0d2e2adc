"""A reload that overtook a disarming began a machine armed again, and under another file than it had been armed for.

Arming, disarming, expiry, reload, the way back and a promotion are drawn to happen beside one another, on one PLC. Each
block is held against the audit log at the moment when it reaches the wire.
"""

import asyncio
import json
import os
import shutil
import sqlite3
import threading
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from random import Random
from struct import pack
from typing import Any

import pytest

from drivers.driver import BeforeSending, anyhow, open_driver
from gateway.machine.writing.arming import arm_in_log, next_start, sign_arming, uptime
from gateway.plant import fleet as fleets
from gateway.plant.configurations import without_arming
from gateway.plant.fleet import Fleet
from gateway.plant.log import open_log
from gateway.settings import Config, load_plant
from gateway.settings import config as configs
from gateway.store.arming_rows import given_words
from gateway.store.audit import ARMED, EXPIRED, Audit, read
from sim.artefacts.model_json import model_hash
from sim.artefacts.store import promote
from tests.gateway.support import EPOCH, MAP, JumpClock, PacedClock, at_rest, config_in, two_modes
from tests.gateway.test_pickup import other, stocked
from tests.rig.memory import folder_in_memory

DEEDS, SEEDS = 50, 4
MODELS = {int(model_hash(model)[-4:], 16) for model in (two_modes(), other())}
FILES = {
    "a": '[alarms]\nlimit = 80.0\n[writeback]\nmode = "shadow"\n',
    "b": '[alarms]\nlimit = 75.0\n[writeback]\nmode = "shadow"\n',
    "armed": '[alarms]\nlimit = 70.0\n[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "file"\nminutes = 5.0\n',
    "off": '[writeback]\nmode = "off"\n',
}
USELESS = '[alarms]\nlimit = "hot"\n'


@dataclass
class Plc:
    """The one PLC, and what is wrong with what was written to it, as it was written."""

    clock: JumpClock
    audit: Path
    open: list["Link"] = field(default_factory=list)
    reads: int = 0
    usable: int = 0
    others: int = 0
    disarmed: bool = False
    wrong: list[str] = field(default_factory=list)

    def take(self, link: "Link", words: list[int]) -> None:
        if not words[3] & 1 << 15 and not words[3]:
            self.others += 1
            return
        self.usable += 1
        if self.open != [link]:
            self.wrong.append(f"{len(self.open)} have the PLC")
        if self.disarmed:
            self.wrong.append("a block after the reply to disarm")
        if words[link.hash_at] not in MODELS:
            self.wrong.append("a block of no model of the store")
        plain = pack(f">{len(words)}H", *words).hex()
        with closing(sqlite3.connect(f"file:{self.audit}?mode=ro", uri=True)) as connection:
            rows = connection.execute("SELECT detail FROM audit WHERE kind = 'write' ORDER BY id DESC LIMIT 3")
            if plain not in [json.loads(detail)["words"] for (detail,) in rows]:
                self.wrong.append("a block before its row")
        word = given_words(self.audit)[0].entry
        if word.kind != ARMED:
            self.wrong.append(f"a block while the newest word is {word.kind!r}")
        elif word.detail.get("configuration") != link.config.arming_hash:
            self.wrong.append("a block by another configuration than it was armed for")


@dataclass
class Link:
    """One machine's way to the PLC."""

    plc: Plc
    config: Config

    def __post_init__(self) -> None:
        words, values = self.config.map.block_words, at_rest(self.config)
        self.soft: Any = open_driver("soft", {"values": values}, clock=self.plc.clock.now, write_map=words)
        self.hash_at = [word.name.removeprefix("Writeback.") for word in words].index("model_hash")

    async def open(self) -> None:
        await self.soft.open()
        self.plc.open.append(self)

    async def close(self) -> None:
        await self.soft.close()
        if self in self.plc.open:
            self.plc.open.remove(self)

    async def read(self, tags: Any) -> Any:
        self.plc.reads += 1
        self.soft.put("PlcHeartbeat", self.plc.reads % 0xFFFF + 1)
        return await self.soft.read(tags)

    async def write(self, values: Any, *, before_sending: BeforeSending = anyhow) -> None:
        await asyncio.sleep(0)
        await self.soft.write(values, before_sending=before_sending)
        self.plc.take(self, [int(value) for _, value in values])

    @property
    def connected(self) -> bool:
        return bool(self.soft.connected)

    def statistics(self) -> dict[str, float]:
        return dict(self.soft.statistics())


@dataclass
class Running:
    """A gateway of one machine at the PLC, asked as by its control socket."""

    fleet: Fleet
    plc: Plc
    folder: Path
    said: Counter[str] = field(default_factory=Counter)
    arming: int = 0
    filed: int = 0

    @property
    def plant(self) -> Path:
        return self.folder / "plant.toml"

    async def ask(self, command: str, **keys: Any) -> dict[str, Any]:
        reply = await self.fleet.answer(json.dumps({"command": command, **keys}).encode())
        self.said[f"{command} {'ok' if reply['ok'] else 'refused'}"] += 1
        return reply

    async def arm(self, minutes: float) -> None:
        # From now on a block may be of this arming, whatever the replies before.
        self.arming, self.plc.disarmed = self.arming + 1, False
        try:
            await self.ask("arm", by="Ada", reason="test", minutes=minutes)
        finally:
            self.arming -= 1

    async def disarm(self) -> None:
        before = self.said["arm ok"], self.arming, self.filed
        reply = await self.ask("disarm", by="Bea", reason="enough")
        if reply["ok"] and before == (self.said["arm ok"], 0, self.filed) and not self.arming:
            self.plc.disarmed = True

    def save(self, text: str) -> None:
        """Save a plant file: one of the mode "armed" is a word, and later than all disarmings before it."""
        if 'mode = "armed"' in text:
            self.filed, self.plc.disarmed = self.filed + 1, False
        self.plant.write_text(text, encoding="utf-8")

    async def reload(self, text: str) -> None:
        self.save(plant_text(text))
        await self.ask("reload")

    async def refused(self) -> None:
        """A file that is refused: the machine that runs is the same one, and so is what it may."""
        before = self.plant.read_text(encoding="utf-8")
        self.save(f"{before}\n{USELESS}")
        await self.ask("reload")
        if self.useless:
            self.save(before)

    async def go_back(self) -> None:
        """As `config rollback` does it."""
        if not self.useless:
            self.save(without_arming(self.plant.read_bytes()).decode())
        await self.ask("reload")

    @property
    def useless(self) -> bool:
        return self.plant.read_text(encoding="utf-8").endswith(USELESS)


def plant_text(tables: str) -> str:
    """A plant file with these tables."""
    beside = '[model]\npath = "store"\n[scan]\nperiod = 1.0\n[historian]\npath = "history.sqlite"\n'
    return f'[device]\nfile = "plc.toml"\n{tables}{beside}[log]\npath = "gateway.jsonl"\n'


@asynccontextmanager
async def gateway(folder: Path, monkeypatch: pytest.MonkeyPatch, file: str = "a") -> AsyncIterator[Running]:
    shutil.copyfile(MAP, folder / "plc.toml")
    if not (folder / "store").exists():
        stocked(folder, two_modes(), other())
    (folder / "plant.toml").write_text(plant_text(FILES[file]), encoding="utf-8")
    machines = load_plant(folder / "plant.toml")
    clock = PacedClock(EPOCH, pause_s=0.001)
    plc = Plc(clock, machines[0].audit)
    monkeypatch.setattr(fleets, "make_driver", lambda config, *_: Link(plc, config))
    with open_log(folder / "log.jsonl") as log:
        fleet = Fleet(
            machines, clock=clock, log=log, rng=Random(1), read_anew=partial(load_plant, folder / "plant.toml")
        )
        stop = asyncio.Event()
        fleet.start(stop)
        try:
            yield Running(fleet, plc, folder)
        finally:
            stop.set()
            await fleet.stop()


@pytest.fixture
def folder(tmp_path: Path) -> Any:
    with folder_in_memory(tmp_path) as place:
        yield place


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(120.0):
        while not holds():
            await asyncio.sleep(0.002)


@pytest.mark.parametrize("seed", range(SEEDS))
async def test_whatever_happens_beside_it_each_block_is_of_the_newest_word(
    seed: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = Random(seed)
    versions = stocked(folder, two_modes(), other())
    async with gateway(folder, monkeypatch) as here:

        async def promotion() -> None:
            promote(folder / "store", draw.choice(versions))

        async def passing() -> None:
            here.plc.clock.time += draw.choice((1.0, 30.0, 400.0))

        deeds: list[Callable[[], Any]] = [
            *3 * [lambda: here.arm(draw.choice((0.2, 5.0, 60.0)))],
            *3 * [here.disarm],
            *4 * [lambda: here.reload(FILES[draw.choice(list(FILES))])],
            here.refused,
            here.go_back,
            promotion,
            passing,
        ]
        going = set[asyncio.Task[None]]()
        async with asyncio.timeout(240.0):
            for _ in range(DEEDS):
                going.add(asyncio.ensure_future(draw.choice(deeds)()))
                for _ in range(draw.choice((0, 0, 1, 3, 20))):
                    await asyncio.sleep(0)
                if draw.random() < 0.3:
                    await asyncio.gather(*going)
                    going.clear()
                    reads = here.plc.reads
                    await until(lambda reads=reads: here.plc.reads > reads + 3)  # type: ignore[misc]
            await asyncio.gather(*going)
    assert not here.plc.wrong, (Counter(here.plc.wrong), here.said)
    assert here.said["disarm ok"] and here.said["arm ok"] and here.said["reload ok"]


async def test_a_refused_reload_changes_nothing_of_an_armed_machine(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with gateway(folder, monkeypatch) as here:
        await until(lambda: here.plc.reads > 3)
        await here.arm(60.0)
        await until(lambda: here.plc.usable > 2)
        machine = here.fleet.machines["decanter"]
        await here.refused()
        before = here.plc.usable
        await until(lambda: here.plc.usable > before + 2)
        assert here.fleet.machines == {"decanter": machine} and here.said["reload refused"] == 1
    assert not here.plc.wrong


@pytest.mark.parametrize("change", ["plant file", "device file", "both back again"])
async def test_an_arming_ends_with_the_configuration_that_it_is_for(
    folder: Path, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    async with gateway(folder, monkeypatch) as here:
        await until(lambda: here.plc.reads > 3)
        await here.arm(60.0)
        await until(lambda: here.plc.usable > 2)
        text, device = here.plant.read_text(encoding="utf-8"), here.plant.with_name("plc.toml")
        if change == "device file":
            device.write_text(device.read_text(encoding="utf-8").replace("scale = 0.1", "scale = 0.2", 1))
            await here.ask("reload")
        else:
            await here.reload(FILES["b"])
        if change == "both back again":
            here.save(text)
            await here.ask("reload")
        before, reads = here.plc.usable, here.plc.reads
        await until(lambda: here.plc.reads > reads + 5)
        assert here.plc.usable == before
        last = [row.entry for row in read(here.plc.audit) if row.entry.kind == EXPIRED]
        assert last and "for another configuration" in last[0].reason
    assert not here.plc.wrong


async def test_a_disarming_that_the_disk_takes_late_wins_over_the_machine_that_is_begun(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has been replied to after DISARMED_SECONDS, and its row waits; the same configuration is begun anew."""
    write, slow, again = Audit._commit, threading.Event(), threading.Event()

    def late(audit: Audit, claim: Any) -> Any:
        if slow.is_set():
            again.wait(60.0)
        return write(audit, claim)

    monkeypatch.setattr(Audit, "_commit", late)
    async with gateway(folder, monkeypatch) as here:
        await until(lambda: here.plc.reads > 3)
        await here.arm(60.0)
        await until(lambda: here.plc.usable > 2)
        slow.set()
        await here.disarm()
        assert here.plc.disarmed
        asyncio.get_running_loop().call_later(0.3, again.set)
        config = here.fleet.machines["decanter"].config
        await here.fleet.replace_machines(["decanter"], {"decanter": config}, {})
        reads = here.plc.reads
        await until(lambda: here.plc.reads > reads + 5)
    assert not here.plc.wrong


async def test_a_file_that_was_saved_before_a_disarming_arms_nothing_whatever_was_armed_since(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The machine runs in mode 'off': the disarming is on record all the same."""
    async with gateway(folder, monkeypatch, "off") as here:
        await until(lambda: here.plc.reads > 1)
        here.save(plant_text(FILES["armed"]))
        await here.disarm()
        await here.ask("reload")
        reads = here.plc.reads
        await until(lambda: here.plc.reads > reads + 5)
        assert here.plc.usable == 0
        (config,) = load_plant(here.plant)
    arm_in_log(config.audit, sign_arming("Cai", "at once", 5, here.plc.clock.now()), here.plc.clock.now())
    start = next_start(config, config.audit, here.plc.clock.now(), uptime())
    assert start.file is None, "the arming since then is of a person, and the file's words are not"
    assert not here.plc.wrong


def test_a_plant_file_is_of_the_time_before_it_was_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was saved while it was read made an older text as new as itself, and a disarming between them lost."""
    path = config_in(folder).path
    os.utime(path, (EPOCH, EPOCH))
    parse = configs.read_toml

    def saved_meanwhile(file: Path) -> Any:
        data = parse(file)
        os.utime(file, (EPOCH + 60.0, EPOCH + 60.0))
        return data

    monkeypatch.setattr(configs, "read_toml", saved_meanwhile)
    assert load_plant(path)[0].stamp == EPOCH
