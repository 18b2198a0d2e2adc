"""After `decanter run` nothing was seen: no word of what runs, no panel, and nobody said that a number was old."""

import asyncio
import io
import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from random import Random
from typing import Any

import pytest
from click.testing import CliRunner
from rich.console import Console

import gateway.cli.plant.commands
import gateway.cli.plant.top
from gateway.cli.main import main
from gateway.machine import Machine
from gateway.machine.reading import plant_clock
from gateway.outside.panel import follow, panel
from gateway.outside.status import (
    ChangeLines,
    GatewayWatch,
    Health,
    Sighting,
    StatusError,
    findings,
    judge_health,
    read_status,
)
from gateway.plant.app import run
from gateway.plant.log import open_log
from gateway.plant.status import snapshot
from sim.strict_json import strict
from tests.gateway.status_picture import alarm, picture, tag
from tests.gateway.support import (
    CURRENT,
    ROOT,
    RUNNING,
    TEMPERATURE,
    Bench,
    JumpClock,
    as_driver,
    at_rest,
    config_in,
    plant_file,
    scan_of,
    two_modes,
)

KEYS_OF_BEFORE = {
    "time", "phase", "link", "links", "scan", "values", "prediction", "forecast", "model", "guards", "events",
    "recent_events", "alarms", "writeback", "historian", "parts", "clock", "driver", "complaints", "failures",
    "last_failure",
}  # fmt: skip
"""What older clients read of a status; it stays."""


def shown(sighting: Sighting, width: int = 80, **options: Any) -> str:
    console = Console(width=width, file=io.StringIO(), **options)
    with console.capture() as captured:
        console.print(panel(sighting))
    return captured.get()


def sighted(plain: dict[str, Any], age: float) -> Sighting:
    """A sighting of a gateway of one machine."""
    status = read_status(plain)
    return Sighting(status, age, machines={status.machine: status})


def now(**changes: Any) -> Sighting:
    return sighted(picture(**changes), 0.1)


# ------------------------------------------------------------------ a run, and those who look at it


async def test_a_run_says_what_it_is_and_each_change_and_several_may_watch_it(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), scan__period=0.2, alarms__off_delay=0.0, alarms__limit=26.0)
    stop, watched, said = asyncio.Event(), threading.Event(), list[str]()
    bench = Bench(config, JumpClock())
    bench.soft = Bench(config, plant_clock()).soft  # readings by the wall's time
    screens = [Console(file=io.StringIO()) for _ in range(3)]

    def watch(screen: Console) -> None:
        with closing(GatewayWatch(config.control_socket)) as seen:
            follow(seen, screen, seconds=0.1, stop=watched)

    async def heard(*words: str) -> None:
        async with asyncio.timeout(120.0):
            while not all(
                any(word in text for text in lines)
                for word in words
                for lines in (said, *(screen.file.getvalue().splitlines() for screen in screens))  # type: ignore[attr-defined]
            ):
                await asyncio.sleep(0.02)

    def happen(change: dict[str, Any]) -> None:
        """At the next two scans: the first of them may have begun."""
        bench.plan.update({bench.reads + ahead: change for ahead in (1, 2)})

    gateway = asyncio.create_task(run(config, stop=stop, driver=as_driver(bench), say=said.append))
    watchers = [asyncio.create_task(asyncio.to_thread(watch, screen)) for screen in screens]
    try:
        await heard("model    two modes", "PLC      ", "records  ", "link: good readings arrive")
        happen({TEMPERATURE: 26.5})
        await heard(f"alarm raised: over limit {TEMPERATURE}")
        happen({TEMPERATURE: 23.5, CURRENT: None})
        await heard(f"alarm over: over limit {TEMPERATURE}", f"{CURRENT} SENSOR_FAILURE")
        words = ["status", "--config", str(config.path), "--json"]
        async with asyncio.timeout(120.0):
            # A scan that is late on a busy machine is another finding, for a moment.
            while (status := await asyncio.to_thread(CliRunner().invoke, main, words)).exit_code != 1:
                await asyncio.sleep(0.1)
        data = json.loads(status.output)
        assert data["health"] == "attention" and "readings" in data["findings"]
        assert data["status"]["values"][TEMPERATURE]["value"] == 23.5
        happen({"fault": "silent"})
        await heard("link: no good reading")
    finally:
        stop.set()
        await gateway
        await asyncio.sleep(0)
        watched.set()
        await asyncio.gather(*watchers)
    model, plc, records = said[:3]
    assert "of 20" in model and "limit 26 degC" in model, "the model's date and the limit"
    assert "every 0.2 s" in plc and "off" in plc and str(tmp_path / "history.sqlite") in records
    assert len(said) < 25, said


def test_a_run_from_the_command_line_begins_with_three_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def serve(config: Any, *, say: Callable[[str], None], **_: Any) -> dict[str, Any]:
        say("model  x")
        return {"historian": {"failure": "", "dropped": 0, "refused": 0}, "parts": {}}

    monkeypatch.setattr("gateway.plant.serve", serve)
    result = CliRunner().invoke(main, ["run", "--config", str(plant_file(tmp_path))])
    assert result.exit_code == 0 and "model  x" in result.output
    result = CliRunner().invoke(main, ["run", "--watch", "--quiet", "--config", str(plant_file(tmp_path))])
    assert result.exit_code == 2 and "--watch and --quiet" in result.output


# ------------------------------------------------------------------ what is old is never shown as present


async def test_what_was_not_read_any_more_is_no_longer_good_in_the_status(tmp_path: Path) -> None:
    config, clock = config_in(tmp_path, model=two_modes()), JumpClock()
    with open_log(None, "error", io.StringIO()) as log:
        machine = Machine(config, driver=as_driver(Bench(config, clock)), clock=clock, log=log, rng=Random(0))
        try:
            assert judge_health(snapshot(machine)) is Health.NO_READINGS and snapshot(machine).scan.age is None
            await machine.take(scan_of(at_rest(config), clock.now()))
            fresh = snapshot(machine)
            assert set(asdict(fresh)) >= KEYS_OF_BEFORE and {"value", "quality", "time", "reason"} <= set(
                asdict(fresh)["values"][TEMPERATURE]
            )
            assert fresh.values[TEMPERATURE].quality == "GOOD" and not fresh.scan.late
            clock.time += 4.0
            stale = read_status(strict(snapshot(machine)))
            assert stale.values[TEMPERATURE].quality == "LAST_USABLE" and stale.values[TEMPERATURE].age >= 4.0
            assert stale.scan.late and judge_health(stale) is Health.NO_READINGS
            assert "has not been read for 4.0 s" in " ".join(
                shown(Sighting(stale, 0.0, machines={"decanter": stale})).split()
            )
            clock.time += 8.0
            dead = snapshot(machine).values[TEMPERATURE]
            assert dead.value is None and dead.quality == "NO_DATA"
        finally:
            machine.close()


@contextmanager
def answering(path: Path, replies: list[dict[str, Any] | None]) -> Iterator[None]:
    """A gateway that gives these replies to the requests of one client and then falls silent; None hangs up."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()
    clients: list[socket.socket] = []

    def serve() -> None:
        client, _ = listener.accept()
        clients.append(client)
        lines = client.makefile("rb")
        for reply in replies:
            if not lines.readline():
                return
            if reply is None:
                client.shutdown(socket.SHUT_RDWR)
                return
            client.sendall(json.dumps({"ok": True, "statuses": {"decanter": reply}}).encode() + b"\n")

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield
    finally:
        listener.close()
        for client in clients:
            client.close()


def test_a_gateway_that_falls_silent_is_said_to_be_with_the_age_and_without_its_numbers(tmp_path: Path) -> None:
    seconds = [100.0]
    with answering(tmp_path / "s", [picture()]):
        watch = GatewayWatch(tmp_path / "s", lambda: seconds[0])
        assert "45.68 °C GOOD" in " ".join(shown(watch.look(5.0)).split())
        seconds[0] += 1.0
        assert watch.look(0.01).age == 1.0
        seconds[0] += 11.0
        sighting = watch.look(0.01)
        text = shown(sighting)
        assert sighting.silence and not sighting.gone and sighting.age == 12.0
        assert "N O   A N S W E R   F O R   1 2   S" in text and "Nothing is known of now" in " ".join(text.split())
        assert "predicted" not in text and "in 15 min" not in text and "measured" not in text
        watch.close()
    assert watch.look(0.1).gone


def test_a_reply_that_waited_while_the_watcher_was_stopped_is_not_taken_for_a_present_one(tmp_path: Path) -> None:
    seconds, first = [100.0], picture()
    with answering(tmp_path / "s", [first, picture(events=13)]):
        watch = GatewayWatch(tmp_path / "s", lambda: seconds[0])
        assert watch.look(0.0).age < 2.0
        seconds[0] += 3600.0  # stopped for an hour, its request under way or its reply in the socket
        sighting = watch.look(5.0)
        assert not sighting.silence and sighting.age < 2.0
        watch.close()


def test_a_gateway_that_hangs_up_is_gone_and_its_numbers_with_it(tmp_path: Path) -> None:
    with answering(tmp_path / "s", [picture(), None]):
        watch = GatewayWatch(tmp_path / "s")
        assert watch.look(5.0).silence == ""
        sighting = watch.look(5.0)
        assert sighting.gone and "45.68" in shown(sighting) and "measured" not in shown(sighting)


def test_without_a_gateway_one_sentence_and_three_and_a_silent_one_five(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = plant_file(tmp_path)
    for command in ("top", "status"):
        result = CliRunner().invoke(main, [command, "--config", str(path)])
        assert result.exit_code == 3 and len(result.output.splitlines()) == 1, result.output
        assert "no gateway runs" in result.output and f"decanter run --config {path}" in result.output
    data = json.loads(CliRunner().invoke(main, ["top", "--once", "--config", str(path), "--json"]).stdout)
    assert data["health"] == "absent" and not data["ok"]
    monkeypatch.setattr(gateway.cli.plant.top, "ANSWER_S", 0.05)
    with answering(tmp_path / "history.sock", []):
        result = CliRunner().invoke(main, ["top", "--once", "--config", str(path), "--json"])
    assert result.exit_code == 5 and json.loads(result.stdout)["health"] == "silent"


def test_a_gateway_of_another_version_is_one_sentence() -> None:
    older = picture()
    del older["scan"]["late"]
    with pytest.raises(StatusError, match=r"scan.late: .*another version"):
        read_status(older)
    assert read_status(picture() | {"of a later version": 1}).events == 12


# ------------------------------------------------------------------ the panel, the lines, the word


@pytest.mark.parametrize("width", [80, 60, 200])
def test_the_panel_has_all_of_it_within_its_width(width: int) -> None:
    armed = {"mode": "armed", "armed_by": "Ada", "armed_until": picture()["time"] + 600.0, "written": 9}
    text = shown(
        now(
            writeback=armed | {"accepted": 8, "refused": 1, "last_verdict": "written", "last_reason": ""},
            alarm_summary=[alarm("over limit T"), alarm("x" * 100, "returned unacknowledged", active=False)],
            historian__complaint="a disk that is full " * 30,
            link__outage_count=0,
        ),
        width,
    )
    assert max(map(len, text.splitlines())) <= width
    words = " ".join(text.split())
    for expected in (
        "45.68 °C GOOD, 0.2 s old; limit 80 °C", "45.60 °C, 90 % band 45.10 to 46.10", "ON/100-200, confidence green",
        "in 15 min 46.0 °C (45.0 to 47.0)", "to limit 11.2 min (5.0 to beyond 15)", "over limit T (unacknowledged",
        "NOT kept", "ARMED by Ada until", "1000 scans, 3 missed, 0 outages", "two modes 1f2e3d4c of 2023-11-13",
    ):  # fmt: skip
        assert expected in words or width < 80, (expected, words)
    assert width < 80 or len(text.splitlines()) <= 30


def test_texts_of_others_neither_steer_the_terminal_nor_are_read_as_markup(monkeypatch: pytest.MonkeyPatch) -> None:
    evil = "\x1b[2J[red]gone[/red]\r\nx"
    sighting = now(
        temperature=evil, values={evil: tag(1.0, "TIMEOUT", reason=evil)}, link__alive=False, link__reason=evil
    )
    text = shown(sighting)
    assert "\x1b" not in text and "\r" not in text and "[red]gone[/red]" in text
    assert "\x1b[2J" not in "".join(ChangeLines().take(sighting.status, 0.0)) if sighting.status else False
    monkeypatch.setenv("NO_COLOR", "1")
    coloured = shown(now(alarm_summary=[alarm("T")]), force_terminal=True)
    assert not any(f"{code}m" in coloured for code in (31, 32, 33))


def test_a_forecast_or_a_prediction_that_is_over_is_not_drawn() -> None:
    words = " ".join(shown(now(forecast__usable=False, forecast__age=40.0)).split())
    assert "the newest forecast is 40 s old" in words and "P(limit)" not in words and "11.2" not in words
    words = " ".join(shown(now(scan__late=True, scan__age=9.0)).split())
    assert "45.60" not in words and "has not been read for 9.0 s" in words


@pytest.mark.parametrize(
    ("changes", "word", "check"),
    [
        ({}, Health.WELL, ""),
        ({"alarm_summary": [alarm("T")]}, Health.ATTENTION, "alarms"),
        ({"alarm_summary": [alarm("T", "returned unacknowledged", active=False)]}, Health.WELL, ""),
        ({"values": {TEMPERATURE: tag(None, "TIMEOUT")}}, Health.ATTENTION, "readings"),
        ({"prediction__zone": "red"}, Health.ATTENTION, "model"),
        ({"prediction__known": False}, Health.ATTENTION, "model"),
        ({"model__refused": "it does not verify"}, Health.ATTENTION, "model"),
        ({"historian__failure": "disk full"}, Health.ATTENTION, "records"),
        ({"writeback": {"mode": "shadow", "audit": {"complaint": "torn"}}}, Health.ATTENTION, "records"),
        ({"writeback": {"mode": "armed", "last_verdict": "not permitted"}}, Health.ATTENTION, "write-back"),
        ({"clock__complaint": "it jumped"}, Health.ATTENTION, "clock"),
        ({"parts": {"x": {"running": False, "failure": "boom"}}}, Health.ATTENTION, "parts"),
        ({"complaints": ["bus-off"]}, Health.ATTENTION, "device"),
        ({"link__alive": False}, Health.NO_READINGS, "link"),
        ({"scan__late": True}, Health.NO_READINGS, "link"),
        ({"scan__age": None}, Health.NO_READINGS, "link"),
    ],
)
def test_the_word_for_a_gateway_names_what_is_wrong(changes: dict[str, Any], word: Health, check: str) -> None:
    status = read_status(picture(**changes))
    assert judge_health(status) is word and [finding.check for finding in findings(status)] == (
        [check] if check else []
    )


def test_red_confidence_says_that_the_forecast_is_in_doubt_and_when_to_look_at_the_machine() -> None:
    def sentence(**changes: Any) -> str:
        doubted = picture(prediction__zone="red", prediction__anomaly=5.2, **changes)
        return next(finding.sentence for finding in findings(read_status(doubted)) if finding.check == "model")

    assert "red" in sentence() and "anomaly 5.2" in sentence() and "if the alarm comes" in sentence()
    # Where it stands it says itself what to do.
    standing = sentence(alarm_summary=[alarm("anomaly") | {"kind": "anomaly"}])
    assert "anomaly 5.2" in standing and "if the alarm comes" not in standing


def test_the_page_has_the_exit_codes_that_the_command_has() -> None:
    page = (ROOT / "docs/watching.md").read_text(encoding="utf-8")
    for word, (code, when) in gateway.cli.plant.commands.EXITS.items():
        assert f"| {code:d} | {word} | {when} |" in page


def test_each_change_is_one_line_and_what_goes_to_and_fro_does_not_flood() -> None:
    lines = ChangeLines()
    first = lines.take(read_status(picture()), 0.0)
    assert [line.split(" ", 1)[1] for line in first] == [
        "link: good readings arrive",
        "confidence: green (state ON/100-200)",
    ]
    assert lines.take(read_status(picture(prediction__zone="green", events=99)), 10.0) == []
    armed = {"mode": "armed", "armed_by": "Ada", "armed_until": 1_700_000_600.0}
    (line,) = lines.take(read_status(picture(writeback=armed)), 20.0)
    assert "ARMED by Ada until 22:23:20Z" in line
    (line,) = lines.take(read_status(picture()), 30.0)
    assert "write-back: shadow" in line
    # An hour of a reading, an alarm and a link that change four times a second.
    good = read_status(picture())
    bad = read_status(picture(values={RUNNING: tag(None, "TIMEOUT")}, prediction__zone="red"))
    said = [line for step in range(7_200) for line in lines.take((good, bad)[step % 2], 100.0 + step / 2)]
    assert 2 <= len(said) < 60 and any("changed" in line for line in said)
    # And when it is quiet again the present state is what was said last.
    said += [line for step in range(700) for line in lines.take(good, 4000.0 + step)]
    assert "all readings are good" in [line for line in said if "quality:" in line][-1]
