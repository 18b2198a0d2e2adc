"""The fault matrix, measured: for each fault of the PLC when it was noticed, when all was well again, what was wrong.

The gateway and the software PLC run as two processes; the PLC's own recording is the judge. `python -m
benchmarks.fault_matrix [--json] [FAULT ...]` prints one row a fault (real seconds). `detected`: from the fault's
beginning to the first reading that was not good or block that was not confirmed; a dash where the fault did no harm.
`recovered`: from its end to the first scan in which all readings were good again; a dash where none had been lost.
"""

import json
import struct
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import inf, isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click

from drivers.tag import Quality, Sample
from gateway.machine.reading.quality import STALE_PERIODS
from gateway.store.read_back import reading, samples, stored_rows
from sim.plc.program.faults import FAULTS as KINDS
from sim.plc.program.faults import face_shows
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import PlcRecording, RequestRow, read_recording
from tests.rig.pair import MAP, PATIENCE_S, TEMPERATURE, Gateway, Plc, Rig, brief, make_rig, restless_trace

PERIOD = 0.1
TOLERANCE_S = STALE_PERIODS * PERIOD
"""A good value may be as old as the gateway's stated rule says, and no older."""
PAUSE_S = 0.6
AGAIN_S = 1.0
"""So long a fault without a duration is looked for before it is ordered again."""
WRITES = (5, 6, 15, 16, 22, 23)
BLOCK = range(400, 426)

OUTAGES = ("refuse", "silent", "restart")
"""The PLC goes away and comes back: good readings must return within one second."""

_ROWS: Mapping[str, Mapping[str, Any]] = {
    "refuse": {"kind": "refuse", "duration": 1.5},
    "silent": {"kind": "silent", "duration": 2.5},
    "half_open": {"kind": "half_open", "duration": 0.1},
    "restart": {"kind": "restart", "down_s": 0.7, "zeros_s": 0.7},
    "frozen image": {"kind": "frozen", "duration": 1.6},
    "words swapped in mid-run": {"kind": "swapped_words", "duration": 1.0},
    "reset in mid-frame": {"kind": "reset", "duration": 1.0},
    "late reply": {"kind": "late", "delay_s": 0.9, "duration": 1.5},
    "late reply, now and then": {"kind": "late", "delay_s": 0.3, "duration": 1.5, "probability": 0.3},
    "wrong unit": {"kind": "wrong_unit", "duration": 1.0},
    "wrong function": {"kind": "wrong_function", "duration": 1.0},
    "too few registers": {"kind": "wrong_count", "duration": 1.0},
    "too many registers": {"kind": "wrong_count", "delta": 1, "duration": 1.0},
    "wrong byte count": {"kind": "wrong_count", "honest": False, "duration": 1.0},
    "wrong transaction": {"kind": "wrong_transaction", "duration": 1.0},
    "exception 4": {"kind": "exception", "code": 4, "duration": 1.0},
    "exception 6 (busy)": {"kind": "exception", "code": 6, "duration": 1.0},
    "illegal register": {"kind": "illegal_register", "registers": ["holding:104"], "duration": 1.5},
    "garbage": {"kind": "garbage", "duration": 1.0},
    "reply cut short": {"kind": "cut_short", "missing": 2, "probability": 0.3, "duration": 1.0},
    "split reply": {"kind": "split", "duration": 1.0},
    "duplicate reply": {"kind": "duplicate", "duration": 1.0},
    "write ignored": {"kind": "write_ignored", "duration": 1.0},
}
SERVER_BUSY = 6
"""The exception (Modbus V1.1b3, section 7) of a request of which nothing was done."""
_NAMED = {row["kind"] for row in _ROWS.values()}
FAULTS: Mapping[str, Mapping[str, Any]] = {
    **_ROWS,
    **{kind: {"kind": kind, "duration": 1.0} for kind in KINDS if kind not in _NAMED and face_shows(kind, "tcp")},
}
"""What is ordered from the PLC, by the row's name: each of its faults that any face can show, at its defaults unless
it has a row above. One frozen register behind a living heartbeat is not among them: nothing but a tag's own
`frozen_after` can tell it (decision 0005)."""
TOLERATED = ("split reply", "duplicate reply")
"""No reading and no block may be lost to these."""
PUNCTUAL = (*TOLERATED, "write ignored", "illegal register", "words swapped in mid-run")
"""Under these every reply comes in its time: a scan that is late is late by the computer."""


Seen = Callable[[dict[str, Any]], bool]
"""True for a status of the gateway that shows a fault."""


@dataclass(frozen=True, slots=True)
class Row:
    """One fault: real seconds (None: nothing was lost), readings that were judged, and how many were wrong.

    `began` and `ended` are plant seconds; `not_good` counts the readings, by tag, that were not good from the beginning
    until all was well again; `unconfirmed` the blocks that were not confirmed in that time.
    """

    fault: str
    began: float
    ended: float
    detected_s: float | None
    recovered_s: float | None
    not_good: Mapping[str, int]
    unconfirmed: int
    judged: int
    wrong_good: int


@dataclass(frozen=True, slots=True)
class Matrix:
    """The rows, and what the PLC saw of the gateway in the whole run; `examples` tells of wrong good values.

    `outside` are writes that touched an address outside the write-back block, `repeated` blocks that were on the wire
    more than once and not refused as busy before.
    """

    rows: tuple[Row, ...]
    examples: tuple[str, ...]
    requests: int
    blocks: int
    refusals: Mapping[str, int]
    outside: int
    repeated: int
    missing: int
    failures: int


def measure(
    folder: Path,
    faults: Mapping[str, Mapping[str, Any]],
    device: Path = MAP,
    *,
    pause: float = PAUSE_S,
    held: Mapping[str, Seen] = MappingProxyType({}),
) -> Matrix:
    """Run the faults one after the other against one pair of processes, and judge what was recorded.

    `device` is the register map that the gateway works by; the PLC always has its own. For `pause` and `held` see
    `suffered`.
    """
    rig = make_rig(folder, restless_trace(160.0), period=PERIOD, device=device)
    return suffered(rig, faults, pause=pause, held=held)


def suffered(
    rig: Rig,
    faults: Mapping[str, Mapping[str, Any]],
    options: Sequence[str] = (),
    tolerance: float = TOLERANCE_S,
    *,
    pause: float = PAUSE_S,
    held: Mapping[str, Seen] = MappingProxyType({}),
) -> Matrix:
    """The same on a rig that is there already; `options` are the PLC's own, such as another face.

    `tolerance` (s) is the age that a good value may have by the link's own rules, `pause` (s) is between two faults.
    A fault in `held` lasts beyond its duration until the gateway's status shows it, or is ordered again if it has none:
    a scan may come too late for it, on a machine that is busy with other things above all.
    """
    with rig.plc(*options) as plc, rig.gateway(plc) as gateway:
        gateway.wait_for(_well)
        orders = []
        for name, fault in faults.items():
            time.sleep(pause)
            orders.append(_suffer(name, fault, plc, gateway, held.get(name)))
        status = gateway.status
        code, _ = gateway.stop()
        assert code == 0, gateway.words()
        plc.order("stop")
        plc.wait_for("stopped")
    return _judged(rig, dict(zip(faults, orders, strict=True)), int(status["failures"]), tolerance)


def _well(status: Mapping[str, Any]) -> bool:
    return bool(status["values"]) and not reading_lost(status) and not block_lost(status)


def _read_at(status: Mapping[str, Any]) -> float:
    """When the readings were taken. A status is written while a scan waits for its reply, too: it has the last ones."""
    return float(status["values"][TEMPERATURE]["time"])


def reading_lost(status: Mapping[str, Any]) -> bool:
    """True if a reading is not good."""
    return any(value["quality"] != "GOOD" for value in status["values"].values())


def block_lost(status: Mapping[str, Any]) -> bool:
    """True if the newest block was not confirmed."""
    return bool(status["writeback"].get("last_verdict") != "written")


def block_failed(status: Mapping[str, Any]) -> bool:
    """True if the newest block was sent and not confirmed; one that is held back has met no fault."""
    return bool(status["writeback"].get("last_verdict") == "failed")


def _suffer(name: str, fault: Mapping[str, Any], plc: Plc, gateway: Gateway, seen: Seen | None) -> tuple[int, int]:
    """One fault from its beginning until the gateway says that all is well again; its first and its last number."""
    lasting = {key: value for key, value in fault.items() if seen is None or key != "duration"}
    first = number = int(plc.order("fault", fault=lasting)["number"])
    if seen is not None:
        ordered = time.monotonic()
        deadline = ordered + fault.get("duration", 0.0) + PATIENCE_S
        time.sleep(fault.get("duration", 0.0))
        while not ((status := gateway.status) and seen(status)):
            assert time.monotonic() < deadline, f"the fault {name!r} is not seen: {brief(status)}"
            time.sleep(0.01)
            if "duration" not in fault and time.monotonic() - ordered > AGAIN_S:
                number, ordered = int(plc.order("fault", fault=lasting)["number"]), time.monotonic()
        if "duration" in fault:
            plc.order("clear", number=number)
    while plc.order("status")["faults"]:
        time.sleep(0.02)
    over = float(plc.order("status")["plant_time"])
    try:
        gateway.wait_for(lambda status: _well(status) and _read_at(status) > over + PERIOD)
    except AssertionError as error:
        raise AssertionError(f"after the fault {name!r}: {error}") from None
    return first, number


# ---------------------------------------------------------------- the judgement


def _judged(rig: Rig, orders: Mapping[str, tuple[int, int]], failures: int, tolerance: float) -> Matrix:
    recording, read = read_recording(rig.recording), list(samples(rig.historian))
    wrong = wrong_good(recording, read, tolerance)
    unconfirmed = _unconfirmed(rig.historian)
    # In plant seconds.
    begun = {row.detail["number"]: row.time for row in recording.events if row.event == "fault began"}
    over = {row.detail["number"]: row.time for row in recording.events if row.event == "fault ended"}
    spans = [(begun[first], over[last]) for first, last in orders.values()]
    assert len(begun) == len(over) == max(last for _, last in orders.values()), "every order was carried out once"
    ends = [*(began for began, _ in spans[1:]), inf]
    rows = tuple(
        judged_row(name, span, until, read=read, unconfirmed=unconfirmed, wrong=[one.sample for one in wrong])
        for name, span, until in zip(orders, spans, ends, strict=True)
    )
    return Matrix(
        rows,
        tuple(f"{one.sample.time:.3f}: {one.reason}" for one in wrong[:5]),
        len(recording.requests),
        len(recording.blocks),
        Counter(block.verdict for block in recording.blocks if not block.accepted),
        outside(recording),
        repeated(recording.requests),
        recording.missing + recording.damaged,
        failures,
    )


def judged_row(
    name: str,
    span: tuple[float, float],
    until: float,
    *,
    read: Sequence[Sample],
    unconfirmed: Sequence[float],
    wrong: Sequence[Sample],
) -> Row:
    """The row of a fault that lay in `span` and had the stage to itself until the next began at `until` (plant s).

    The plant's clock runs at real speed here, so its seconds are real ones.
    """
    began, ended = span
    mine = [sample for sample in read if began <= sample.time < until]
    since, struck = _under_way(read, began), _under_way(mine, until)
    late = _late_scans(read) if name in PUNCTUAL else []

    def unproven(moment: float) -> bool:
        return any(abs(moment - scan) < PERIOD / 2 for scan in late)

    bad = [sample for sample in read if since <= sample.time < struck and not sample.quality.is_good]
    bad = [sample for sample in bad if sample.quality is not Quality.LAST_USABLE or not unproven(sample.time)]
    lost = [moment for moment in unconfirmed if since <= moment < struck and not unproven(moment)]
    noticed = min([sample.time for sample in bad] + lost, default=None)
    last = max([sample.time for sample in bad], default=None)
    back = None if last is None else max(0.0, _all_good_after(mine, last) - ended)
    return Row(
        name,
        began,
        ended,
        None if noticed is None else max(0.0, noticed - began),
        back,
        Counter(sample.tag for sample in bad),
        len(lost),
        sum(sample.quality.is_good for sample in mine),
        sum(began <= sample.time < until for sample in wrong),
    )


def _late_scans(read: Iterable[Sample]) -> list[float]:
    """When scans came so late that nothing proves whether the PLC's memory lived in between: what they read is rightly
    not good, and that is the busy computer's part and not the fault's.

    A scan right after a late one is as late: the former count of the heartbeat was read two scans ago.
    """
    times = sorted({sample.time for sample in read if sample.tag == TEMPERATURE})
    one, two = (STALE_PERIODS - 0.5) * PERIOD, STALE_PERIODS * PERIOD
    before = [times[0], *times] if times else []
    return [c for a, b, c in zip(before, times, times[1:], strict=False) if c - b > one or c - a > two]


def _under_way(read: Sequence[Sample], moment: float) -> float:
    """From when on a scan may show a fault that struck at `moment`: what is under way has the time at which it began.

    The scan before may have read all it wanted, and its block be the first to meet the fault.
    """
    if not isfinite(moment):
        return moment
    newest = max((sample.time for sample in read if sample.time < moment), default=moment)
    return min(newest, moment - PERIOD)


def _all_good_after(mine: Iterable[Sample], moment: float) -> float:
    """The first reading of the temperature after the last scan in which anything was not good; inf if there is none."""
    return min((sample.time for sample in mine if sample.tag == TEMPERATURE and sample.time > moment), default=inf)


def _unconfirmed(historian: Path) -> list[float]:
    """When blocks were sent that the PLC was not seen to take, or could not be sent; those held back for rate aside."""
    with reading(historian) as connection:
        rows = stored_rows(connection, "writes", ("time", "verdict"))
    return [float(time) for time, verdict in rows if verdict not in ("written", "held back")]


def outside(recording: PlcRecording) -> int:
    """How many writing requests touched an address outside the write-back block, whatever became of them."""
    return sum(
        not (row.function == 16 and row.address is not None and _inside(row.address, row.count or 0))
        for row in recording.requests
        if row.function in WRITES
    )


def _inside(address: int, count: int) -> bool:
    return count > 0 and address in BLOCK and address + count - 1 in BLOCK


def repeated(requests: Iterable[RequestRow]) -> int:
    """How many writing requests carry a sequence number, or on one connection a transaction, that was there before.

    Within the life of one gateway and fewer than 65,536 blocks. A block that was refused as busy may come again: the
    exception says that nothing was done (Modbus V1.1b3, section 7). Its transaction may not.
    """
    written = [row for row in requests if row.function == 16]
    sequences = Counter(struct.unpack(">H", row.pdu[8:10])[0] for row in written if row.exception != SERVER_BUSY)
    transactions = Counter((row.peer, row.transaction) for row in written)
    return sum(count - 1 for counts in (sequences, transactions) for count in counts.values())


# ---------------------------------------------------------------- the command


def table(matrix: Matrix, tolerance: float = TOLERANCE_S) -> str:
    """The matrix as Markdown."""
    head = "| fault | detected (s) | recovered (s) | readings not good | blocks not confirmed | wrong values GOOD |"
    lines = [head, "|---|---|---|---|---|---|"]
    for row in matrix.rows:
        times = [("–" if value is None else f"{value:.2f}") for value in (row.detected_s, row.recovered_s)]
        counts = f"{sum(row.not_good.values())} | {row.unconfirmed} | {row.wrong_good} of {row.judged}"
        lines.append(f"| {row.fault} | {times[0]} | {times[1]} | {counts} |")
    refused = ", ".join(f"{count} ({why})" for why, count in matrix.refusals.items()) or "0"
    lines.append("")
    lines.append(
        f"Scan period {PERIOD:g} s, a good value may be {tolerance:g} s old. {matrix.requests} requests, "
        f"{matrix.blocks} blocks, refused by the PLC: {refused}; writes outside the block: {matrix.outside}; "
        f"blocks on the wire more than once, refusals as busy aside: {matrix.repeated}; rows that the recording lacks: "
        f"{matrix.missing}."
    )
    return "\n".join([*lines, *matrix.examples])


@click.command()
@click.argument("faults", nargs=-1, type=click.Choice(tuple(FAULTS)), metavar="[FAULT]...")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(faults: tuple[str, ...], as_json: bool) -> None:
    """Measure the fault matrix (all faults unless some are named); exit code 1 if a wrong value was good."""
    with tempfile.TemporaryDirectory() as folder:
        matrix = measure(Path(folder), {name: FAULTS[name] for name in faults or FAULTS})
    click.echo(json.dumps(asdict(matrix)) if as_json else table(matrix))
    raise SystemExit(1 if any(row.wrong_good for row in matrix.rows) else 0)


if __name__ == "__main__":
    main()
