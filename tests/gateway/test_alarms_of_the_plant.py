"""Alarms that a plant has once: its first machine looks after them, and nothing of the others is left standing."""

import asyncio
import json
from dataclasses import asdict, replace
from pathlib import Path
from random import Random

import pytest
from click.testing import CliRunner, Result

from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from gateway.cli.main import main
from gateway.machine.alarms import alarm_rates, make_conditions, read_journal
from gateway.machine.reading import plant_clock
from gateway.outside.notify import Notifier, attach_machine
from gateway.outside.notify.messages import AlarmMessage, subject_line
from gateway.outside.status import read_status
from gateway.outside.texts import all_words
from gateway.outside.web import machine_view
from gateway.plant.app import run
from gateway.plant.fleet import Fleet
from gateway.plant.log import open_log
from gateway.settings import OF_PLANT, Config, changed_machines, load_plant
from tests.gateway.status_picture import picture
from tests.gateway.support import EPOCH, MAP, TEMPERATURE
from tests.gateway.test_alarm_desk import Stand, standing
from tests.rig.servers import free_port

TOP = """
[alarms]
off_delay = 0
sensors = false
trend = false
[[northbound.mqtt]]
name = "it"
host = "127.0.0.1"
tls = false
[[alarm]]
name = "northbound"
on_delay = 0
[notify]
[[notify.to]]
name = "shift"
webhook = "https://example.com/x"
"""


def plant_of(folder: Path, *names: str, own: str = "", top: str = TOP) -> tuple[Config, ...]:
    """A plant of machines of these names; `own` is what the table of the last one has beside its place."""
    rows = [f'[[machine]]\nname = "{name}"\ndevice = {{ port = {1500 + place} }}' for place, name in enumerate(names)]
    path = folder / "plant.toml"
    common = f'[device]\nfile = "{MAP}"\n[historian]\npath = "h.sqlite"\n[log]\npath = "log.jsonl"\n{top}'
    path.write_text("\n".join([common, *rows, own]) + "\n", encoding="utf-8")
    return load_plant(path)


async def out_of_reach(stand: Stand, why: str = "it cannot be reached") -> None:
    stand.machine.common.unreached = lambda: why
    await stand.scan()


def test_the_first_machine_has_them_and_they_name_the_plant(tmp_path: Path) -> None:
    first, second = (make_conditions(config, config.watched_temperatures) for config in plant_of(tmp_path, "a", "b"))
    assert {name for name in first if name in OF_PLANT} == OF_PLANT and not OF_PLANT & set(second)
    assert {first[name].tag for name in OF_PLANT} == {"plant"}
    assert set(first) - OF_PLANT == set(second)


def test_a_machine_says_nothing_of_its_own_about_them(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"machine 'b': alarm: 'disk' is the plant's.*at the top of the file"):
        plant_of(tmp_path, "a", "b", own='[[machine.alarm]]\nname = "disk"\npriority = 1')
    with pytest.raises(ConfigError, match=r"alarm\[1\].tag: there is no alarm 'disk' of 'x'.*it is the plant's"):
        plant_of(tmp_path, "a", top=TOP + '[[alarm]]\nname = "disk"\ntag = "x"\n')


def test_a_reload_that_brings_another_first_machine_says_so(tmp_path: Path) -> None:
    before = {config.machine: config for config in plant_of(tmp_path, "a", "b")}
    after = {name: replace(before[name], leads=name == "b") for name in ("b", "a")}
    changed = changed_machines(before, after)
    assert changed == {
        "b": ("the alarms of the plant: looks after them",),
        "a": ("the alarms of the plant: no longer looks after them",),
    }


async def test_what_each_machine_had_is_put_to_an_end_on_record_and_no_message_follows(tmp_path: Path) -> None:
    """The records of a release that raised it for every machine: of the second one nothing is left standing."""
    _, second = plant_of(tmp_path, "a", "b")
    async with standing(replace(second, leads=True, several=False)) as former:
        await out_of_reach(former)
        assert former.state("northbound") == "unacknowledged"
        message = {
            "message": {
                "machine": "b", "alarm": "northbound", "tag": "b", "priority": 3, "state": "unacknowledged",
                "raised": EPOCH, "first_up": False, "response": "", "consequence": "",
            },
            "recipient": "shift", "left": 600.0,
        }  # fmt: skip
        former.machine.historian.save("messages", EPOCH, {"waiting": [message], "known": [message]})
    rows = read_journal(second.historian.path)
    assert list(alarm_rates(rows, EPOCH - 1, EPOCH + 90_000).stale) == ["northbound"]

    async with standing(second, at=60.0) as now:
        assert "northbound" not in now.machine.alarms.alarms
        notifier = _attached(now)
        assert notifier.waiting == 0
        notifier.close()
        await now.scan()
    rows = read_journal(second.historian.path)
    assert [(row.alarm, row.state, row.by) for row in rows][1:] == [("northbound", "normal", "the gateway")]
    assert not alarm_rates(rows, EPOCH - 1, EPOCH + 90_000).standing
    async with standing(second, at=120.0) as again:
        await again.scan()
    assert len(read_journal(second.historian.path)) == len(rows), "once, and not at every start"


def _attached(stand: Stand) -> Notifier:
    """A notifier that hears of the machine's alarms, and may have nothing to say."""
    machine = stand.machine
    rows = machine.config.notify.to
    notifier = Notifier(
        rows,
        {row.name: lambda messages, now: pytest.fail(f"sent {messages}") for row in rows},
        now=stand.clock.now,
        supervisor=Supervisor(),
        log=machine.log,
    )
    attach_machine(notifier, machine)
    return notifier


async def test_what_stands_of_the_plant_takes_from_no_machine_that_its_alarm_was_the_first(tmp_path: Path) -> None:
    first, _ = plant_of(tmp_path, "a", "b")
    async with standing(first) as stand:
        await out_of_reach(stand)
        await stand.scan(**{TEMPERATURE: 90.0})
        alarms = stand.machine.alarms.alarms
        assert alarms["northbound"].first_up and alarms[f"over limit {TEMPERATURE}"].first_up


async def test_it_is_the_plants_in_journal_messages_and_on_the_page(tmp_path: Path) -> None:
    first, _ = plant_of(tmp_path, "a", "b")
    async with standing(first) as stand:
        await out_of_reach(stand)
        alarm = next(asdict(one) for one in (await stand.ask("alarms"))["alarms"] if one.name == "northbound")
        assert (alarm["tag"], alarm["state"]) == ("plant", "unacknowledged")
    (row,) = [row for row in read_journal(first.historian.path) if row.alarm == "northbound"]
    assert (row.subject, row.machine) == ("plant", "a")
    told = AlarmMessage(
        machine="a", alarm="northbound", tag="plant", priority=3, state="unacknowledged", raised=EPOCH,
        first_up=False, response="", consequence="",
    )  # fmt: skip
    assert subject_line([told]) == "alarm, priority 3: northbound (plant)"
    assert subject_line([replace(told, tag="a")]) == "alarm, priority 3: northbound (a)"
    for language, word in (("en", "Plant"), ("it", "Impianto"), ("de", "Anlage")):
        plain = picture(alarm_summary=[{**alarm, "since": EPOCH}])
        shown = machine_view(all_words()[language], {}, read_status(plain))
        assert (shown["alarms"][0]["of"], shown["alarms"][0]["of_plant"]) == (word, True)
        (found,) = [each["sentence"] for each in shown["findings"] if each["check"] == "alarms"]
        assert found.startswith(f"{word}: ")
        without = machine_view(all_words()[language], {}, read_status(picture()))
        assert shown["level"] == without["level"], "it says nothing of the machine"


async def test_one_broker_out_of_reach_is_one_alarm_listed_and_acknowledged_without_naming_a_machine(
    tmp_path: Path,
) -> None:
    pytest.importorskip("paho.mqtt")
    top = TOP.replace('host = "127.0.0.1"\n', f'host = "127.0.0.1"\nport = {free_port()}\n').split("[notify]")[0]
    plant = plant_of(tmp_path, "a", "b", top=f"[scan]\nperiod = 0.2\n{top}")
    stop = asyncio.Event()
    work = asyncio.create_task(run(*plant, stop=stop))

    async def asked(*words: str) -> Result:
        command = ["alarm", *words, "--config", str(plant[0].path)]
        return await asyncio.to_thread(CliRunner().invoke, main, command)

    try:
        async with asyncio.timeout(120.0):
            while "northbound" not in (listed := await asked("list", "--json")).output:
                assert not work.done(), await work
                await asyncio.sleep(0.1)
            rows = [row for row in json.loads(listed.stdout)["alarms"] if row["name"] == "northbound"]
            assert [(row["machine"], row["tag"]) for row in rows] == [("a", "plant")]
            line = next(line for line in (await asked("list")).output.splitlines() if "northbound" in line)
            assert line.split()[1] == "plant"
            done = await asked("acknowledge", "northbound", "--by", "A. Rossi")
            assert (done.exit_code, done.output) == (0, "northbound: acknowledged, now acknowledged\n")
            # Of another machine there is no such alarm, and one of a machine needs its name.
            assert "there is no alarm" in (await asked("acknowledge", "disk", "--machine", "b", "--by", "x")).output
            assert (await asked("acknowledge", "link", "--by", "x")).exit_code != 0
    finally:
        stop.set()
        await work
    told = [row for row in read_journal(plant[0].historian.path) if row.alarm == "northbound"]
    assert [(row.subject, row.state) for row in told] == [("plant", "unacknowledged"), ("plant", "acknowledged")]


async def test_after_a_reload_with_another_first_machine_that_one_has_the_alarm_and_the_former_none(
    tmp_path: Path,
) -> None:
    first, second = plant_of(tmp_path, "a", "b", top=f"[scan]\nperiod = 0.1\n{TOP.split('[notify]')[0]}")
    swapped = replace(second, leads=True), replace(first, leads=False)
    stop = asyncio.Event()
    with open_log(first.log.path) as log:
        fleet = Fleet((first, second), clock=plant_clock(), log=log, rng=Random(0), read_anew=lambda: swapped)
        fleet.records.unreached = lambda: "it cannot be reached"

        def whose() -> list[str]:
            boards = {name: machine.alarms.alarms for name, machine in fleet.machines.items()}
            return [name for name, own in boards.items() if "northbound" in own and own["northbound"].active]

        try:
            fleet.start(stop)
            async with asyncio.timeout(60.0):
                while whose() != ["a"]:
                    await asyncio.sleep(0.02)
                changes = (await fleet.reload())["changes"]
                assert changes["a"] == ["the alarms of the plant: no longer looks after them"]
                while whose() != ["b"]:
                    await asyncio.sleep(0.02)
        finally:
            stop.set()
            await fleet.stop()
    told = [(row.machine, row.state) for row in read_journal(first.historian.path) if row.alarm == "northbound"]
    assert sorted(told) == [("a", "normal"), ("a", "unacknowledged"), ("b", "unacknowledged")]
