"""The redundant link, measured: switch-overs under load, each by a fault of the primary link alone.

The gateway and the software PLC run as two processes over two links, `python -m benchmarks.redundant [--standby FACE]
[--switches N] [--json]`. The machine switches and its current climbs through the bins all the time, and every scan
reads all tags and writes a block. The PLC's own recording is the judge: of the events that its signals truly made each
must be in the gateway's historian once, no value may be wrong and good, no block twice on the wire.
"""

import json
import struct
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.figures import Figure, give, percentile
from gateway.machine.reading.quality import STALE_PERIODS
from gateway.store.read_back import events as recorded_events
from gateway.store.read_back import reading, samples
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import PlcRecording, read_recording
from sim.sha.events import DECANTER, encode
from sim.sha.trace import Array, Event, Trace
from tests.rig.pair import CURRENT, MAP, PATIENCE_S, RUNNING, TEMPERATURE, Gateway, Plc, Rig, make_rig, restless_trace
from tests.rig.stalls import longest_hold_up, longest_pause

PERIOD = 0.2
"""A scan's (s). A block that meets the fault costs TIMEOUT_S, the rest of a period and SWITCH_AFTER_S. It must be less
than the STALE_PERIODS for which readings are good: otherwise all events are told again, after an unknown one."""
SWITCH_AFTER_S = 0.1
RETURN_AFTER_S = 0.5
TIMEOUT_S = 0.3
LATEST_S = 1.0
"""An event that comes later than this after its cause counts as lost."""
AGAIN_S = 3.0
"""So long after a fault without a switch-over it was a block that met it (s)."""
EDGE_S = 1.0
"""Events so near to the beginning or the end of the gateway's scans are not counted."""
FAULTS: Sequence[Mapping[str, Any]] = (
    {"kind": "refuse", "duration": 0.8},
    {"kind": "silent", "duration": 0.8},
    {"kind": "late", "delay_s": 0.6, "duration": 0.8},
    {"kind": "reset", "duration": 0.8},
    {"kind": "garbage", "duration": 0.8},
    {"kind": "half_open", "duration": 0.1},
    {"kind": "wrong_unit", "duration": 0.8},
)
"""What befalls the primary link, in turns."""
STANDBYS: Mapping[str, Sequence[str]] = {
    "rtu-tcp": ("--rtu-tcp", "0"),
    "serial": ("--serial", "pty", "--baud", "115200"),
}
"""The PLC's options for the standby's face, by its name."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run came to; times in real seconds.

    `switch_s`: from a fault's beginning to the switch-over; `waited_s`: how much longer that scan took than others may;
    `gap_s`: the longest time between two good readings of the temperature. `delays` are the events' (s). `still_s` is
    the longest time in which the PLC did not get to its next row, or by which a scan was late without a fault: far more
    than a row's and the computer stood still.
    """

    standby: str
    switch_overs: int
    returns: int
    switch_s: tuple[float, ...]
    gap_s: float
    still_s: float
    events: int
    lost: tuple[str, ...]
    doubled: tuple[str, ...]
    delays: tuple[float, ...]
    wrong_good: int
    judged: int
    blocks: int
    repeated: int
    refusals: Mapping[str, int]


def busy_trace(seconds: float, step: float = 0.05) -> Trace:
    """The restless trace with the machine switching each 0.9 s, and the current through all bins in 6 s."""
    plain = restless_trace(seconds, step)
    phase: Array = plain.times / 6.0 % 1.0
    signals = dict(plain.signals)
    signals[RUNNING] = np.floor(plain.times / 0.9) % 2
    signals[CURRENT] = 5.0 + 340.0 * (1.0 - np.abs(2.0 * phase - 1.0))
    return Trace("busy", plain.times, signals, origin="made for a test of redundant links", synthetic=True)


def measure(folder: Path, switches: int, standby: str = "rtu-tcp") -> Outcome:
    """Provoke so many switch-overs, each by a fault of the primary link, and judge what was recorded."""
    rig = make_rig(folder, busy_trace(20.0 + 4.0 * switches), period=PERIOD)
    with rig.plc(*STANDBYS[standby]) as plc:
        write_links(rig, plc, standby)
        with rig.gateway(plc) as gateway:
            gateway.wait_for(_both_well)
            for number in range(switches):
                _suffer(FAULTS[number % len(FAULTS)], plc, gateway)
            time.sleep(EDGE_S)
            driver = gateway.status["driver"]
            code, _ = gateway.stop()
            assert code == 0, gateway.words()
        plc.order("stop")
        plc.wait_for("stopped")
    return _judged(rig, standby, int(driver["switch_overs"]), int(driver["returns"]))


def write_links(rig: Rig, plc: Plc, standby: str) -> None:
    """Give the rig's plant file two links to the running PLC: Modbus TCP, and another face."""
    face = plc.ready["faces"][standby]
    if standby == "serial":
        own = {"transport": "rtu", "serial": face["path"], "baud": face["baud"], "parity": face["parity"]}
    else:
        own = {"transport": standby, "host": face["host"], "port": face["port"]}
    links = [
        {
            "name": "primary",
            "file": str(MAP),
            "host": plc.ready["host"],
            "port": plc.ready["port"],
            "timeout": TIMEOUT_S,
        },
        {"name": "standby", "file": str(MAP), **own, "timeout": TIMEOUT_S, "longest_reply": 1.0},
    ]
    rows = [f"[[device.links]]\n{_rows(link)}" for link in links]
    before, _, after = rig.plant.read_text(encoding="utf-8").partition("[scan]")
    kept = [line for line in before.splitlines() if line.startswith("heartbeat_period")]
    head = ["[device]", *kept, f"switch_after = {SWITCH_AFTER_S}", f"return_after = {RETURN_AFTER_S}"]
    rig.plant.write_text("\n".join([*head, *rows]) + "\n[scan]" + after, encoding="utf-8")


def _rows(link: Mapping[str, object]) -> str:
    return "\n".join(f"{key} = {json.dumps(value)}" for key, value in link.items())


def _both_well(status: Mapping[str, Any]) -> bool:
    """The primary is used, both links are well, and blocks are written."""
    links = status["links"]
    well = all(link["well"] for link in links) and len(links) == 2
    return well and links[0]["active"] and status["writeback"].get("last_verdict") == "written"


def _suffer(fault: Mapping[str, Any], plc: Plc, gateway: Gateway) -> None:
    """One fault of the primary link, until the primary is used again.

    It lasts beyond its duration until the links are switched over: a scan may come too late for it. A connection that
    goes deaf is ordered again where a block was what met it: the new one may serve all readings.
    """
    before = gateway.status["driver"]["switch_overs"]
    is_moment = fault["kind"] == "half_open"
    lasting = {key: value for key, value in fault.items() if is_moment or key != "duration"}
    begun = time.monotonic()
    while True:
        number = plc.order("fault", fault={**lasting, "face": "tcp"})["number"]
        try:
            gateway.wait_for(
                lambda status: status["driver"]["switch_overs"] > before, AGAIN_S if is_moment else PATIENCE_S
            )
            break
        except AssertionError:
            if not is_moment or time.monotonic() - begun > PATIENCE_S:
                raise
    if not is_moment:
        time.sleep(max(0.0, begun + fault["duration"] - time.monotonic()))
        plc.order("clear", number=number)
    while plc.order("status")["faults"]:
        time.sleep(0.02)
    gateway.wait_for(_both_well)


# ---------------------------------------------------------------- the judgement


def _judged(rig: Rig, standby: str, switch_overs: int, returns: int) -> Outcome:
    recording, read = read_recording(rig.recording), list(samples(rig.historian))
    good = sorted(sample.time for sample in read if sample.tag == TEMPERATURE and sample.quality.is_good)
    window = (good[0] + EDGE_S, good[-1] - EDGE_S)
    lost, doubled, delays = compare(true_events(recording), recorded_events(rig.historian), window)
    sequences = Counter(
        struct.unpack(">H", row.pdu[8:10])[0] for row in recording.requests if row.function == 16 and len(row.pdu) > 10
    )
    wrong = wrong_good(recording, read, STALE_PERIODS * PERIOD)
    return Outcome(
        standby,
        switch_overs,
        returns,
        switch_times(recording, rig.historian),
        float(np.max(np.diff(good))),
        max(longest_pause(recording), longest_hold_up(rig.historian, recording, PERIOD)),
        len(delays) + len(lost),
        lost,
        doubled,
        delays,
        len(wrong),
        sum(sample.quality.is_good for sample in read),
        len(recording.blocks),
        sum(count - 1 for count in sequences.values()),
        Counter(block.verdict for block in recording.blocks if not block.accepted),
    )


def true_events(recording: PlcRecording) -> tuple[Event, ...]:
    """The events that the PLC's own signals made, by the same alphabet, from what the PLC recorded as true."""
    names = (RUNNING, CURRENT)
    rows = [row for row in recording.truth if row.tag in names]
    times = sorted({row.time for row in rows})
    place = {moment: index for index, moment in enumerate(times)}
    signals = {name: np.full(len(times), np.nan) for name in names}
    for row in rows:
        signals[row.tag][place[row.time]] = np.nan if row.value is None else float(row.value)
    for column in signals.values():
        known = np.maximum.accumulate(np.where(np.isnan(column), 0, np.arange(len(times))))
        column[:] = column[known]
    return encode(Trace("truth", np.array(times), signals), DECANTER)


def compare(
    truth: Sequence[Event], found: Sequence[Event], window: tuple[float, float]
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[float, ...]]:
    """(lost, doubled, delays): each true event takes the first event of its symbol that follows within LATEST_S.

    What true events do not take is doubled, and a true event that takes none is lost.
    """
    free = list(found)
    lost, delays = [], []
    for event in truth:
        mine = next(
            (one for one in free if one.symbol == event.symbol and 0 <= one.time - event.time <= LATEST_S), None
        )
        if mine is not None:
            free.remove(mine)
        if not window[0] <= event.time <= window[1]:
            continue
        if mine is None:
            lost.append(f"{event.symbol} at {event.time:.3f}")
        else:
            delays.append(mine.time - event.time)
    doubled = [f"{one.symbol} at {one.time:.3f}" for one in free if window[0] <= one.time <= window[1]]
    return tuple(lost), tuple(doubled), tuple(delays)


def switch_times(recording: PlcRecording, historian: Path) -> tuple[float, ...]:
    """From the beginning of each fault to the switch-over that it caused, in real seconds (the clock runs at 1)."""
    began = [row.time for row in recording.events if row.event == "fault began"]
    with reading(historian) as connection:
        rows = connection.execute("SELECT time FROM audit WHERE what = 'link standby' ORDER BY id").fetchall()
    switched = [float(row[0]) for row in rows]
    spans = zip(began, [*began[1:], inf], strict=True)
    caused = ([moment - begin for moment in switched if begin <= moment < end] for begin, end in spans)
    return tuple(min(times) for times in caused if times)


# ---------------------------------------------------------------- the command


def figures(outcome: Outcome) -> list[Figure]:
    """The run as figures; the limits are the ones that docs/links.md states."""
    limit, what = PERIOD + TIMEOUT_S + SWITCH_AFTER_S, "a scan, a write's deadline and switch_after"
    name = f"redundant, TCP to {outcome.standby}"
    return [
        Figure(f"{name}: switch-overs", outcome.switch_overs, "", "events judged", outcome.events),
        Figure(f"{name}: events lost", len(outcome.lost), ""),
        Figure(f"{name}: events doubled", len(outcome.doubled), ""),
        Figure(f"{name}: switched after a fault, p50", percentile(outcome.switch_s, 50), "s", what, limit),
        Figure(f"{name}: switched after a fault, longest", max(outcome.switch_s), "s", what, limit),
        Figure(f"{name}: longest time without a good reading", outcome.gap_s, "s", what, limit),
        Figure(f"{name}: delay of events, p99", percentile(outcome.delays, 99), "s", "scan period", PERIOD),
        Figure(f"{name}: wrong values GOOD", outcome.wrong_good, "", "judged", outcome.judged),
        Figure(f"{name}: blocks twice on the wire", outcome.repeated, "", "blocks", outcome.blocks),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Seven switch-overs instead of twenty.")
@click.option("--switches", type=click.IntRange(1), help="How many switch-overs.  [default: 20]")
@click.option("--standby", type=click.Choice(tuple(STANDBYS)), help="[default: each in turn]")
@click.option("--details", is_flag=True, help="All that was measured, as JSON, instead of figures.")
def main(as_json: bool, quick: bool, switches: int | None, standby: str | None, details: bool) -> None:
    outcomes = []
    for name in [standby] if standby else STANDBYS:
        with tempfile.TemporaryDirectory() as folder:
            outcomes.append(measure(Path(folder), switches or (7 if quick else 20), name))
    if details:
        click.echo(json.dumps([asdict(outcome) for outcome in outcomes], indent=1))
    else:
        found = [figure for outcome in outcomes for figure in figures(outcome)]
        give("redundant link, switch-overs under load", found, as_json=as_json)


if __name__ == "__main__":
    main()
