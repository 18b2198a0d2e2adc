"""What persons, the PLC and the plant file do with alarms: at a whole machine, by its socket, by the commands."""

import asyncio
import json
import sqlite3
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from pathlib import Path
from random import Random
from threading import Thread
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivers.settings import ConfigError
from drivers.tag import Value
from gateway.cli.main import main
from gateway.machine.alarms import make_conditions
from gateway.machine.pipeline import Machine
from gateway.plant.control import ControlScope, answer
from gateway.plant.log import open_log
from gateway.plant.status import snapshot
from gateway.settings.config import Config, load_plant
from gateway.store import read
from gateway.store.audit import verify
from tests.gateway.support import EPOCH, MAP, TEMPERATURE, Bench, JumpClock, PacedClock, config_in, scan_of
from tests.gateway.test_app import go
from tests.gateway.test_notify import until

OTHER = "TCuscinettiAlimentazione"
HOT = f"over limit {TEMPERATURE}"
QUICK = f'[alarms]\noff_delay = 0\nsensors = false\ntrend = false\ntags = ["{TEMPERATURE}", "{OTHER}"]\n'


class Stand:
    """A machine whose scans are made by hand, one second apart, and asked as by its control socket."""

    def __init__(self, machine: Machine, clock: JumpClock) -> None:
        self.machine, self.clock = machine, clock
        self.values: dict[str, Value | None] = {TEMPERATURE: 25.0, OTHER: 25.0, "AcknowledgeBits": 0}

    async def scan(self, seconds: float = 1.0, **values: Value | None) -> None:
        self.values |= values
        self.clock.time += seconds
        await self.machine.take(scan_of(self.values, self.clock.time))

    async def ask(self, command: str, **keys: Any) -> dict[str, Any]:
        scope = ControlScope({self.machine.config.machine: self.machine}, snapshot)
        reply: dict[str, Any] = await answer(scope, json.dumps({"command": command, **keys}).encode())
        return reply

    def state(self, name: str = HOT) -> str:
        return self.machine.alarms.alarms[name].state.value


@asynccontextmanager
async def standing(config: Config, at: float = 0.0, *, kept: bool = True) -> AsyncIterator[Stand]:
    clock = JumpClock(EPOCH + at)
    with open_log(config.log.path, config.log.level) as log:
        machine = Machine(config, driver=Bench(config, clock), clock=clock, log=log, rng=Random(0))
        try:
            yield Stand(machine, clock)
            await machine.finish()
        finally:
            assert machine.close() == kept


SIGNED = {"by": "A. Rossi", "reason": "cable is being changed"}


async def test_a_person_acknowledges_shelves_and_returns_alarms_and_all_of_it_is_on_record(tmp_path: Path) -> None:
    config = config_in(tmp_path, QUICK)
    async with standing(config) as stand:
        await stand.scan()
        await stand.scan(**{TEMPERATURE: 90.0})
        assert stand.state() == "unacknowledged"
        reply = await stand.ask("acknowledge", alarm=HOT, by="A. Rossi")
        assert reply["ok"] and (reply["alarm"], reply["state"]) == (HOT, "acknowledged")
        refused = await stand.ask("acknowledge", alarm=HOT, by="A. Rossi")
        assert not refused["ok"] and "what can be done: shelve, remove from service" in refused["reason"]
        assert (await stand.ask("shelve", alarms=[HOT], minutes=1.0, **SIGNED))["ok"]
        assert stand.state() == "shelved" and stand.machine.alarms.word(TEMPERATURE) & 1 == 0
        await stand.scan(59.0)
        assert stand.state() == "shelved"
        await stand.scan(1.0)
        assert stand.state() == "unacknowledged", "its time is over, and it stands"
        assert (await stand.ask("remove from service", alarms=[HOT], **SIGNED))["ok"]
        await stand.scan(**{TEMPERATURE: 20.0})
        assert (await stand.ask("return to service", alarms=[HOT], **SIGNED))["alarms"] == {
            HOT: "returned unacknowledged"
        }
        (listed,) = [row for row in (await stand.ask("alarms"))["alarms"] if row.name == HOT]
        assert listed.by == "A. Rossi" and "acknowledge" in listed.possible and listed.consequence
        await stand.ask("acknowledge", by="PLC room")
        assert stand.state() == "normal"
    kinds = [row.entry.kind for row in read(config.audit) if row.entry.kind.startswith("alarm ")]
    assert kinds == [
        "alarm acknowledged",
        "alarm shelved",
        "alarm removed from service",
        "alarm returned to service",
        "alarm acknowledged",
    ]
    assert not verify(config.audit).problem
    with closing(sqlite3.connect(config.historian.path)) as connection:
        rows = connection.execute("SELECT state, acknowledged_by FROM alarms ORDER BY id").fetchall()
    assert rows == [
        ("unacknowledged", ""),
        ("acknowledged", "A. Rossi"),
        ("shelved", "A. Rossi"),
        ("unacknowledged", "the gateway"),
        ("out of service", "A. Rossi"),
        ("out of service", "A. Rossi"),
        ("returned unacknowledged", "A. Rossi"),
        ("normal", "PLC room"),
    ]


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("acknowledge", {"alarm": HOT}, "by: is missing"),
    ("acknowledge", {"alarm": HOT, "by": "  "}, "give a name"),
    ("acknowledge", {"alarm": HOT, "by": "a\nb"}, "give a name"),
    ("acknowledge", {"alarm": "over limt TCuscinettiRiduttore", "by": "A"}, "did you mean"),
    ("acknowledge", {"alarm": 5, "by": "A"}, "alarm: must be text"),
    ("shelve", {"alarm": HOT, "by": "A", "minutes": 5.0}, "give a reason"),
    ("shelve", {"alarm": HOT, **SIGNED}, "a shelving ends"),
    ("shelve", {"alarm": HOT, "minutes": 481.0, **SIGNED}, "at most 480"),
    ("shelve", {"alarm": HOT, "minutes": -1.0, **SIGNED}, "more than 0"),
    ("shelve", {"minutes": 5.0, **SIGNED}, "which alarm?"),
    ("unshelve", {"alarm": HOT, **SIGNED}, "there is nothing to unshelve"),
    ("reset", {"alarm": HOT, **SIGNED}, "there is nothing to reset"),
    ("suppress", {"alarm": HOT, **SIGNED}, "there is no command"),
    ("alarms", {"machine": "m9"}, "there is no machine"),
]


async def test_what_cannot_be_done_is_said_in_one_sentence(shared: Stand) -> None:
    for command, keys, sentence in REFUSED:
        reply = await shared.ask(command, **keys)
        assert not reply["ok"] and sentence in reply["reason"] and "\n" not in reply["reason"], reply


@pytest.fixture
async def shared(tmp_path: Path) -> AsyncIterator[Stand]:
    async with standing(config_in(tmp_path, QUICK)) as stand:
        yield stand


async def test_of_several_alarms_all_are_changed_or_none(shared: Stand) -> None:
    reply = await shared.ask("shelve", alarms=["link", "nothing"], minutes=5.0, **SIGNED)
    assert not reply["ok"] and shared.state("link") == "normal"
    reply = await shared.ask("shelve", alarms=["link", "disk"], minutes=5.0, **SIGNED)
    assert reply["alarms"] == {"link": "shelved", "disk": "shelved"}


async def test_what_hides_an_alarm_must_be_on_record_and_an_acknowledgement_need_not(tmp_path: Path) -> None:
    config = config_in(tmp_path, QUICK)
    config.audit.mkdir()
    async with standing(config, kept=False) as stand:
        await stand.scan()
        await stand.scan(**{TEMPERATURE: 90.0})
        reply = await stand.ask("shelve", alarm=HOT, minutes=5.0, **SIGNED)
        assert not reply["ok"] and "audit" in reply["reason"] and stand.state() == "unacknowledged"
        assert (await stand.ask("acknowledge", alarm=HOT, by="Ada"))["ok"]
        assert stand.state() == "acknowledged"


@pytest.mark.parametrize("jump", [5.0, 90.0, -1e7, 1e7])
async def test_a_restart_keeps_what_persons_did_and_no_clock_prolongs_a_shelving(jump: float, tmp_path: Path) -> None:
    config = config_in(tmp_path, QUICK.replace("]", ', "TFango"]').replace('[alarms, "TFango"]', "[alarms]"))
    names = [f"over limit {tag}" for tag in (TEMPERATURE, OTHER, "TFango")]
    async with standing(config) as stand:
        await stand.scan(TFango=25.0)
        await stand.scan(**{TEMPERATURE: 90.0, OTHER: 90.0, "TFango": 90.0})
        await stand.ask("acknowledge", alarm=names[0], by="Ada")
        await stand.ask("shelve", alarm=names[1], minutes=1.0, **SIGNED)
        await stand.ask("remove from service", alarm=names[2], **SIGNED)
        await stand.scan(10.0)
    async with standing(config, at=13.0 + jump) as stand:
        assert [stand.state(name) for name in names] == ["acknowledged", "shelved", "out of service"]
        stand.values["TFango"] = 25.0
        left = stand.machine.alarms.alarms[names[1]].until
        assert left is not None and left - stand.clock.now() <= 50.0
        await stand.scan(51.0, **{TEMPERATURE: 90.0, OTHER: 90.0, "TFango": 90.0})
        assert [stand.state(name) for name in names] == ["acknowledged", "unacknowledged", "out of service"]


async def test_the_plc_acknowledges_all_by_the_rise_of_a_tag(tmp_path: Path) -> None:
    config = config_in(tmp_path, QUICK + 'acknowledge = "PresenzaAllarme"\n')
    async with standing(config) as stand:
        assert "PresenzaAllarme" in stand.machine.urgent()
        await stand.scan(PresenzaAllarme=True)
        await stand.scan(**{TEMPERATURE: 90.0, OTHER: 90.0})
        await stand.scan()
        assert stand.state() == "unacknowledged", "a level that stands is nobody's word"
        await stand.scan(PresenzaAllarme=None)
        await stand.scan(PresenzaAllarme=True)
        assert stand.state() == "unacknowledged", "what could not be read leaves no edge"
        await stand.scan(PresenzaAllarme=False)
        await stand.scan(PresenzaAllarme=True)
        assert stand.state() == stand.state(f"over limit {OTHER}") == "acknowledged"


async def test_of_alarms_that_come_together_the_first_is_marked_until_all_are_over(tmp_path: Path) -> None:
    config = config_in(tmp_path, QUICK)
    first = lambda stand: [name for name, alarm in stand.machine.alarms.alarms.items() if alarm.first_up]  # noqa: E731
    async with standing(config) as stand:
        await stand.scan()
        await stand.scan(**{OTHER: 90.0})
        await stand.scan(**{TEMPERATURE: 90.0})
        assert first(stand) == [f"over limit {OTHER}"]
        await stand.scan(**{OTHER: 20.0, TEMPERATURE: 20.0})
        await stand.ask("acknowledge", by="Ada")
        await stand.scan(**{TEMPERATURE: 90.0})
        await stand.scan(**{OTHER: 90.0})
        assert HOT in first(stand) and f"over limit {OTHER}" not in first(stand)


ROWS = """
[alarms]
off_delay = 3
tags = ["TCuscinettiRiduttore", "TCuscinettiAlimentazione"]
[[alarm]]
name = "over limit"
priority = 2
latch = true
response = "stop {it}"
[[alarm]]
name = "over limit"
tag = "TCuscinettiAlimentazione"
on_delay = 7
suppressed_by = "MarciaDecanter=0"
[[alarm]]
name = "sensor noisy"
enabled = false
"""


async def test_the_plant_file_says_what_is_other_by_kind_and_by_tag(tmp_path: Path) -> None:
    config = config_in(tmp_path, ROWS)
    conditions = make_conditions(config, config.watched_temperatures)
    one, other = conditions[HOT], conditions[f"over limit {OTHER}"]
    assert (one.priority, one.latches, one.response, one.on_delay, one.off_delay) == (2, True, "stop {it}", 0.0, 3.0)
    assert (other.priority, other.latches, other.on_delay) == (2, True, 7.0)
    assert other.suppressed_by == ("MarciaDecanter", 0.0) and one.suppressed_by is None
    assert not any(name.startswith("sensor noisy") for name in conditions)
    assert f"sensor drifting {TEMPERATURE}" in conditions and f"sensor drifting {OTHER}" not in conditions
    async with standing(config) as stand:
        assert "MarciaDecanter" in stand.machine.urgent()
        await stand.scan(MarciaDecanter=False)
        await stand.scan(9.0, **{TEMPERATURE: 90.0, OTHER: 90.0})
        await stand.scan(9.0)
        assert (stand.state(), stand.state(other.name)) == ("unacknowledged", "suppressed by design")
        await stand.scan(MarciaDecanter=None)
        assert stand.state(other.name) == "unacknowledged", "of a tag that is not known nothing is suppressed"
        await stand.ask("acknowledge", by="Ada")
        await stand.scan(9.0, **{TEMPERATURE: 20.0, OTHER: 20.0})
        await stand.scan(9.0)
        assert stand.state() == "latched acknowledged" and stand.machine.alarms.word(TEMPERATURE) & 1
        await stand.ask("reset", alarm=HOT, **SIGNED)
        assert stand.state() == "normal"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            '[[alarm]]\nname = "over limits"\n',
            "alarm[0].name: there is no alarm 'over limits'; did you mean 'over limit'?",
        ),
        ("[[alarm]]\npriority = 2\n", "alarm[0].name: is missing"),
        (
            '[[alarm]]\nname = "link"\npriority = 5\n',
            "priority: must be at most 4, got 5; give a priority from 1",
        ),
        ('[[alarm]]\nname = "link"\non_delay = -1\n', "alarm[0].on_delay: must be at least 0"),
        ('[[alarm]]\nname = "link"\ntag = "TFango"\n', "alarm[0].tag: there is no alarm 'link' of 'TFango'; leave"),
        ('[[alarm]]\nname = "over limit"\ntag = "TFango"\n', f"of 'TFango'; give one of {TEMPERATURE}"),
        ('[[alarm]]\nname = "link"\nsuppressed_by = "Nothing=1"\n', "'Nothing' is not a tag of"),
        ('[[alarm]]\nname = "link"\nsuppressed_by = "MarciaDecanter=2"\n', "neither 'TAG', 'TAG=1' nor 'TAG=0'"),
        ('[[alarm]]\nname = "link"\ndelay = 2\n', "alarm[0].delay: there is no such key; did you mean 'on_delay'?"),
        ('[alarms]\nacknowledge = "Nothing"\n', "alarms.acknowledge: 'Nothing' is not a tag of"),
        ('[alarms]\ntwins = ["TFango"]\n', "alarms.twins: ['TFango'] are not two tags"),
        ("[alarms]\nlongest_shelving = 0\n", "alarms.longest_shelving: must be more than 0"),
    ],
)
def test_rows_that_cannot_be_are_refused_in_one_sentence(text: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as refused:
        config_in(tmp_path, text)
    (problem,) = refused.value.problems
    assert sentence in problem


def test_a_machines_own_rows_go_over_those_that_all_have(tmp_path: Path) -> None:
    (tmp_path / "plant.toml").write_text(
        f'[device]\nfile = "{MAP}"\n[[alarm]]\nname = "link"\npriority = 2\non_delay = 20\n'
        '[[machine]]\nname = "one"\ndevice = { unit = 1 }\n'
        '[[machine]]\nname = "two"\ndevice = { unit = 2 }\n[[machine.alarm]]\nname = "link"\npriority = 3\n'
    )
    one, two = (
        make_conditions(config, config.watched_temperatures)["link"] for config in load_plant(tmp_path / "plant.toml")
    )
    assert (one.priority, one.on_delay, two.priority, two.on_delay) == (2, 20.0, 3, 20.0)


async def test_a_reload_keeps_what_a_person_did_a_moment_ago(tmp_path: Path) -> None:
    config = config_in(tmp_path, QUICK)
    other = config_in(tmp_path, QUICK + "deadband = 3.0\n")
    bench = Bench(config, PacedClock())
    for read_ in range(10, 30):
        bench.plan[read_] = {TEMPERATURE: min(25.0 + 4.0 * (read_ - 9), 85.0)}
    running = asyncio.create_task(go(config, bench, 1_000_000, read_anew=lambda: [other]))
    while bench.reads < 40 or not config.control_socket.exists():
        await asyncio.sleep(0.005)

    async def asked(command: str, **keys: Any) -> dict[str, Any]:
        reader, writer = await asyncio.open_unix_connection(config.control_socket)
        writer.write(json.dumps({"command": command, **keys}).encode() + b"\n")
        reply: dict[str, Any] = json.loads(await reader.readline())
        writer.close()
        return reply

    assert (await asked("shelve", alarm=HOT, minutes=5.0, **SIGNED))["ok"]
    assert (await asked("reload"))["changes"] == {"decanter": ["alarms.deadband: 2.0 -> 3.0"]}
    (row,) = [row for row in (await asked("alarms"))["alarms"] if row["name"] == HOT]
    assert (row["state"], row["by"], row["reason"]) == ("shelved", SIGNED["by"], SIGNED["reason"])
    bench.stop.set()
    await running


# ---------------------------------------------------------------- the commands


def test_the_commands_speak_to_the_running_gateway_and_to_its_records(tmp_path: Path) -> None:
    config = config_in(tmp_path, QUICK)
    bench = Bench(config, PacedClock())
    for read_ in range(10, 30):
        bench.plan[read_] = {TEMPERATURE: min(25.0 + 4.0 * (read_ - 9), 85.0)}
    # In a thread, as the commands take signals, which only the main thread may.
    running = Thread(target=lambda: asyncio.run(go(config, bench, 1_000_000)))
    running.start()
    try:
        until(lambda: bench.reads > 40 and config.control_socket.exists())
        _speak_to_the_gateway(config)
    finally:
        bench.stop_after = bench.reads
        running.join(60.0)
    _read_its_records(config)


def called(config: Config, *words: str) -> Result:
    return CliRunner().invoke(main, ["alarm", *words, "--config", str(config.path)], env={"COLUMNS": "200"})


def _speak_to_the_gateway(config: Config) -> None:
    listed = called(config, "list", "--json")
    assert listed.exit_code == 1 and [row["name"] for row in json.loads(listed.output)["alarms"]] == [HOT]
    shown = called(config, "show", HOT)
    assert "B unacknowledged: the condition stands" in shown.output and "otherwise:" in shown.output
    done = called(config, "acknowledge", "--by", "Ada")
    assert done.output == f"{HOT}: acknowledged, now acknowledged\n" and done.exit_code == 0
    again = called(config, "acknowledge", HOT, "--by", "Ada")
    assert again.exit_code == 1 and "there is nothing to acknowledge" in again.output
    done = called(config, "remove-from-service", HOT, "--by", "Ada", "--reason", "sensor is changed", "--json")
    assert json.loads(done.output) == {"ok": True, "alarms": {HOT: "out of service"}}
    assert (called(config, "list")).exit_code == 0
    assert (called(config, "return", HOT, "--by", "Ada", "--reason", "sensor is changed")).exit_code == 0
    unknown = called(config, "show", "nothing")
    assert unknown.exit_code == 2 and HOT in unknown.output


def _read_its_records(config: Config) -> None:
    journal = json.loads((called(config, "journal", "--json")).output)["journal"]
    assert [(row["state"], row["by"], row["reason"]) for row in journal] == [
        ("unacknowledged", "", ""),
        ("acknowledged", "Ada", ""),
        ("out of service", "Ada", "sensor is changed"),
        ("unacknowledged", "Ada", "sensor is changed"),
    ]
    rates = json.loads((called(config, "rates", "--since", "1h", "--json")).output)
    assert rates["announced"] == 2 and rates["peak"] == 2 and HOT in rates["standing"]
    assert "alarms against EEMUA 191" in (called(config, "rates")).output
    assert (called(config, "list")).exit_code == 3, "no gateway runs"
