"""A scripted day of three machines, sixty times as fast: what came of it against what must, wherever it is shown.

    python -m benchmarks.day [--hours 24] [--speed 60] [--seed 1] [--keep FOLDER]

Starts and loads in cycles; one bearing overheats, one sensor freezes, one link is lost, the broker is out of reach for
ten minutes, one machine wears, and all bearings of all machines heat at once. An operator acknowledges and shelves at
the page, by an account. Four hours hold all of it (`--hours 4 --speed 90`: about three minutes).
It ends with 1 where anything is missing, comes twice, out of order, or is shown that is not so.
"""

import json
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion
from sparkplub_b_packets.core.sparkplug_b_pb2 import Payload

from benchmarks.day.judge import Change, Journal, Message, copies, lives, looks, marks, told
from benchmarks.day.plant import FLAGS, Day, write_files
from benchmarks.day.script import (
    COOL,
    CURRENT,
    HOT,
    MACHINES,
    MOVES,
    ROW,
    RUNNING,
    SHORTEST_HOURS,
    STEP,
    Plan,
    expected,
    plan,
    traces,
)
from benchmarks.figures import Figure, show
from gateway.machine.alarms import read_journal
from gateway.store import reading, samples, stored_rows
from sim.sha.trace import Trace
from tests.rig.servers import Line, free_port, program, running

LATE_SECONDS, RETRY_SECONDS = 2.0, 20.0
"""Real seconds: how late a reading may be seen on a busy computer, and until a broker that is back is found again."""
PLC_SECONDS = 0.25
"""Real seconds for which the program of a software PLC may stand still on a busy computer."""
SESSION_SECONDS = 5.0
"""Real seconds after a session's beginning in which rows may be history."""
MOST_SHOWN = 40
SAME = 0.06
"""By how much a reading may differ from its row: registers hold tenths of an ampere, and floats of four bytes."""
MESSAGES = "messages.txt"


@contextmanager
def taken_down(folder: Path, port: int) -> Iterator[None]:
    """Every message, as a line of topic and hexadecimal digits in `messages.txt`."""
    with (folder / MESSAGES).open("w", encoding="ascii") as file:

        def heard(_client: Client, _data: Any, message: MQTTMessage) -> None:
            file.write(f"{message.topic} {message.payload.hex()}\n")

        client = Client(CallbackAPIVersion.VERSION2)
        client.on_message = heard
        client.connect("127.0.0.1", port)
        client.subscribe("#", qos=1)
        client.loop_start()
        try:
            yield
        finally:
            client.disconnect()
            client.loop_stop()


def lived(day: Day, script: Plan, actions: Any, line: Line) -> dict[str, float]:
    """Let the day pass: what happens to the plant, and what the operator does, each at its time."""
    moments: dict[str, float] = {}

    def cut() -> None:
        moments["cut"] = day.now()
        line.cut()

    def mend() -> None:
        line.mend()
        moments["mended"] = day.now()

    happenings: list[tuple[float, Any]] = [
        (script.freeze[0], lambda: day.strike("south", "frozen", tags=[COOL])),
        (script.freeze[1], lambda: day.mend("south")),
        (script.outage[0], cut),
        (script.outage[1], mend),
        (script.link[0], lambda: day.strike("west", "refuse")),
        (script.link[1], lambda: day.mend("west")),
        *((action.time, lambda action=action: day.act(action)) for action in actions),
    ]
    late = 0.0
    for moment, happen in sorted(happenings, key=lambda one: one[0]):
        time.sleep(max((moment - day.now()) / day.speed, 0.0))
        happen()
        late = max(late, day.now() - moment)
    time.sleep(max((script.length - day.now()) / day.speed, 0.0))
    moments["latest"] = late
    return moments


def of_json(path: Path, begin: float) -> list[Message]:
    """The messages of the sink of JSON."""
    found = []
    for text in path.read_text(encoding="ascii").splitlines():
        topic, _, digits = text.rpartition(" ")
        group, *rest = topic.split("/")
        if group != "day" or len(rest) < 3:
            continue
        row = json.loads(bytes.fromhex(digits))
        signal, content = _named(rest[2], row)
        found.append(Message(rest[1], signal, row["time"] - begin, content, row["historical"]))
    return found


def of_sparkplug(path: Path, begin: float) -> list[Message]:
    """The data of the sink of Sparkplug B, by the definition of Eclipse Tahu; times are in milliseconds."""
    names: dict[tuple[str, int], str] = {}
    found = []
    for text in path.read_text(encoding="ascii").splitlines():
        topic, _, digits = text.rpartition(" ")
        levels = topic.split("/")
        if levels[0] != "spBv1.0" or levels[2] not in ("DBIRTH", "DDATA"):
            continue
        for metric in Payload.FromString(bytes.fromhex(digits)).metrics:
            if levels[2] == "DBIRTH":
                names[levels[4], metric.alias] = metric.name
                continue
            kind, _, signal = names[levels[4], metric.alias].partition("/")
            value = None if metric.is_null else getattr(metric, metric.WhichOneof("value"))
            if isinstance(value, bool):
                value = float(value)
            at = metric.timestamp / 1000.0 - begin
            found.append(Message(levels[4], f"{kind} {signal}", at, value, metric.is_historical))
    return found


def _named(table: str, row: Mapping[str, Any]) -> tuple[str, Any]:
    if table == "samples":
        return f"Measured {row['tag']}", (row["value"], row["quality"])
    return f"Alarm {row['condition']}", row["state"]


def on_record(path: Path, begin: float) -> list[Message]:
    """Samples and alarms of all machines as the historian has them."""
    found = []
    with reading(path) as connection:
        for machine in MACHINES:
            for tag in (RUNNING, CURRENT, HOT, COOL):
                for one in samples(path, tag, begin, machine=machine):
                    content = (one.value, one.quality.name)
                    found.append(Message(machine, f"Measured {tag}", one.time - begin, content))
            for time_, alarm, state in stored_rows(
                connection, "alarms", ("time", "condition", "state"), machine=machine
            ):
                found.append(Message(machine, f"Alarm {alarm}", time_ - begin, state))
    return found


def as_sparkplug(record: list[Message], begin: float) -> list[Message]:
    """What of the record Sparkplug's metrics say: no names of qualities, and times in milliseconds."""
    return [
        replace(
            one,
            time=round(1000.0 * (one.time + begin)) / 1000.0 - begin,
            content=one.content[0] if isinstance(one.content, tuple) else one.content,
        )
        for one in record
    ]


def readings(
    path: Path, script: Plan, played: Mapping[str, Trace], begin: float, late: float, standing: float
) -> Iterator[str]:
    """The good samples on record against what the PLCs showed between question and answer; a lost link has none.

    `standing` (s) is how old what a PLC shows may be.
    """
    quiet = (script.link[0] + late, script.link[1] - STEP)
    for machine, trace in played.items():
        for one in samples(path, start=begin, end=begin + script.length, machine=machine):
            if one.tag not in trace.signals or not one.quality.is_good or not isinstance(one.value, int | float):
                continue
            time_, asked = one.time - begin, (one.time if one.sent is None else one.sent) - begin
            if machine == "west" and quiet[0] <= time_ <= quiet[1]:
                yield f"record: west, {one.tag}: a good reading of {time_:.1f} s, when there was no link"
            if (machine, one.tag) == ("south", COOL) and any(abs(time_ - edge) < late for edge in script.freeze):
                continue  # the command that freezes it comes by another clock
            begun, ended = asked - standing, time_
            if (machine, one.tag) == ("south", COOL) and script.freeze[0] < time_ < script.freeze[1]:
                # It stands at what it was when the command came.
                begun, ended = script.freeze[0] - standing, script.freeze[0] + late
            rows = slice(max(int(begun // ROW), 0), max(int(ended // ROW), 0) + 2)
            if not np.any(np.abs(trace.signals[one.tag][rows] - one.value) < SAME):
                yield f"record: {machine}, {one.tag}: {one.value:g} of {time_:.1f} s is not what the PLC showed"


def judged(
    folder: Path, day: Day, script: Plan, played: Mapping[str, Trace], moments: Mapping[str, float]
) -> tuple[list[str], dict[str, float]]:
    """What is wrong with the day, in sentences; and its figures."""
    late, retry = LATE_SECONDS * day.speed + 2 * STEP, RETRY_SECONDS * day.speed
    must = expected(script, played, late=late, retry=retry)
    historian = folder / "records/h.sqlite"
    journal = [
        Change(row.time - day.begin, row.machine, row.alarm, row.state, row.by) for row in read_journal(historian)
    ]
    record = on_record(historian, day.begin)

    def within(rows: list[Any]) -> list[Any]:
        """What came before the day began, or after its end, is not judged."""
        return [row for row in rows if 0.0 <= row.time <= script.length]

    journal, record = within(journal), within(record)
    messages = {"json": of_json(folder / MESSAGES, day.begin)}
    messages["sparkplug"] = of_sparkplug(folder / MESSAGES, day.begin)
    messages = {name: within(own) for name, own in messages.items()}
    second = day.speed
    outage = (moments["cut"] + second, moments["mended"] - second)
    settled = (
        (SESSION_SECONDS * second, moments["cut"] - SESSION_SECONDS * second),
        (moments["mended"] + retry, script.length),
    )
    seen, book = day.witnesses, Journal(journal)
    plain = {state: state for state in {"normal", *MOVES.values()}}
    findings = [f"page: refused: {what}" for what in day.refused]
    findings += lives(must, journal)
    for name, own in (("json", record), ("sparkplug", as_sparkplug(record, day.begin))):
        findings += copies(name, own, messages[name], outage)
        findings += marks(name, messages[name], settled)
    findings += readings(historian, script, played, day.begin, late, PLC_SECONDS * day.speed)
    findings += looks("page", book, seen.page, lag=STEP, words=plain)
    findings += looks("metrics", book, seen.metrics, lag=late, words=FLAGS)
    end = max((look.end for look in seen.page), default=0.0)
    findings += told("opcua", journal, within(seen.notes), least=late, end=end - late)
    for machine in MACHINES:
        findings += _listed(folder, day, machine, journal, script.length)
    floods = json.loads((folder / "rates.json").read_text())["rates"]["floods"]
    if len(floods) != 1 or not script.flood <= floods[0]["start"] - day.begin <= script.flood + 900.0 + late:
        findings.append(f"page: rates: the flood at {script.flood:.0f} s is shown as {floods}")
    with reading(historian) as connection:
        scans = [
            rows
            for machine in MACHINES
            for rows in stored_rows(connection, "scans", ("time", "missed"), machine=machine)
        ]
    figures = {
        "alarms that had to come": sum(step.state == "unacknowledged" for own in must.lives.values() for step in own),
        "rows of the journal": len(journal),
        "rows that had to be there": sum(len(own) for own in must.lives.values()),
        "samples on record": sum(one.signal.startswith("Measured") for one in record),
        "messages, JSON": len(messages["json"]),
        "values, Sparkplug B": len(messages["sparkplug"]),
        "marked as historical, JSON": sum(one.historical for one in messages["json"]),
        "looks at the page": len(seen.page),
        "looks at metrics": len(seen.metrics),
        "looks not answered": sum(seen.failures.values()),
        "notifications, OPC UA": len(seen.notes),
        "scans": len(scans),
        "scans left out": sum(missed for _, missed in scans),
        "latest happening (s)": round(moments["latest"], 1),
        "findings": len(findings),
    }
    return findings, figures


def _listed(folder: Path, day: Day, machine: str, journal: list[Change], length: float) -> Iterator[str]:
    """The page's own list of an alarm's changes, the newest first, against the journal."""
    rows = json.loads((folder / f"alarms_{machine}.json").read_text())["rows"]
    rows = [row for row in rows if 0.0 <= row["time"] - day.begin <= length]
    got = [(round(row["time"] - day.begin, 3), row["condition"], row["state"], row["acknowledged_by"]) for row in rows]
    own = [(round(row.time, 3), row.alarm, row.state, row.by) for row in journal if row.machine == machine]
    asked = [row for row in own if not got or row[0] <= got[0][0]]
    if sorted(got) != sorted(asked) or [row[0] for row in got] != sorted((row[0] for row in got), reverse=True):
        yield f"page: {machine}: its list of {len(got)} changes is not the journal's {len(asked)}"


def passed(folder: Path, hours: float, speed: float, seed: int) -> tuple[list[str], dict[str, float]]:
    """One day in a folder, from beginning to end."""
    script = plan(hours)
    played = traces(script, seed)
    write_files(folder, played)
    plain = free_port()
    conf = f"user root\nlistener {plain} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n"
    (folder / "mosquitto.conf").write_text(conf, encoding="utf-8")
    day = Day(folder, speed)
    late = LATE_SECONDS * speed + 2 * STEP
    actions = expected(script, played, late=late, retry=RETRY_SECONDS * speed).actions
    with running([str(program("mosquitto")), "-c", str(folder / "mosquitto.conf")], plain):
        line = Line(plain)
        with taken_down(folder, plain):
            with day.running(line, seed):
                moments = lived(day, script, actions, line)
                for machine in MACHINES:
                    rows = day.asked("GET", f"/api/alarms?machine={machine}&most=1000")
                    (folder / f"alarms_{machine}.json").write_text(json.dumps(rows), encoding="utf-8")
                rates = day.asked("GET", "/api/rates?days=2")
                (folder / "rates.json").write_text(json.dumps(rates), encoding="utf-8")
                time.sleep(4.0)  # the feeds look for new rows once a second
            time.sleep(1.0)
        line.cut()
    seen = {**asdict(day.witnesses), "begin": day.begin, "moments": moments, "refused": day.refused}
    (folder / "witnesses.json").write_text(json.dumps(seen), encoding="utf-8")
    return judged(folder, day, script, played, moments)


@click.command()
@click.option("--hours", default=24.0, show_default=True, help=f"How long the day is, {SHORTEST_HOURS:g} at least.")
@click.option("--speed", default=60.0, show_default=True, help="Plant seconds a second.")
@click.option("--seed", default=1, show_default=True, help="Of the traces, and of what the PLCs draw.")
@click.option("--keep", type=click.Path(path_type=Path), help="A new folder for what is left of the day.")
def main(hours: float, speed: float, seed: int, keep: Path | None) -> None:
    """Let a scripted day pass and judge it."""
    if program("mosquitto") is None:
        raise click.ClickException("needs mosquitto (apt-get install mosquitto)")
    try:
        plan(hours)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--hours") from None
    if keep is not None:
        try:
            keep.mkdir(parents=True)
        except FileExistsError:
            raise click.BadParameter(f"{keep} is there already; name a new folder", param_hint="--keep") from None
    with tempfile.TemporaryDirectory() if keep is None else nullcontext(str(keep)) as folder:
        findings, figures = passed(Path(folder), hours, speed, seed)
    for finding in findings[:MOST_SHOWN]:
        click.echo(finding)
    if len(findings) > MOST_SHOWN:
        click.echo(f"... and {len(findings) - MOST_SHOWN} more")
    if findings and figures["scans left out"]:
        click.echo(
            f"{figures['scans left out']:g} scans were left out: a computer that is too busy for {speed:g} times the "
            "speed raises alarms of its own, of readings that come late; have less run beside it, or lower --speed"
        )
    show("a day", [Figure(name, value, "") for name, value in figures.items()])
    sys.exit(1 if findings else 0)


if __name__ == "__main__":
    main()
