"""Reading a recording back: typed rows, in the order in which they happened."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.tag import Value
from sim.plc.program import EmulatorClock, InputError, read_text

_KINDS = ("run", "truth", "request", "block", "frame", "event")


@dataclass(frozen=True, slots=True)
class Run:
    """One process: its clock, and for each tag the rounding (absolute, relative) that its registers may add."""

    clock: EmulatorClock
    device: str
    trace: str | None
    seed: int
    roundings: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class TruthRow:
    """From `time` (plant, s UTC) on, the tag truly was `value`; None: the PLC itself had none."""

    monotonic: float
    time: float
    version: int
    tag: str
    value: Value | None


@dataclass(frozen=True, slots=True)
class RequestRow:
    """One request. `reply` are the bytes that were sent (None: none), `exception` its code if it was one.

    `address` and `count` are None for functions that have none; `version` is the image that it was answered from,
    `delay_s` how long the reply was held back, `faults` those that struck it.
    """

    monotonic: float
    time: float
    peer: str
    transaction: int
    unit: int
    function: int
    address: int | None
    count: int | None
    pdu: bytes
    reply: bytes | None
    exception: int | None
    delay_s: float
    faults: tuple[str, ...]
    version: int


@dataclass(frozen=True, slots=True)
class BlockRow:
    """One write into the write-back area. `fields` are None where length or start was wrong.

    `block` is the suffix of the block that it reached into, "" for the first.
    """

    monotonic: float
    time: float
    peer: str
    address: int
    words: tuple[int, ...]
    fields: Mapping[str, float] | None
    verdict: str
    accepted: bool
    block: str = ""


@dataclass(frozen=True, slots=True)
class FrameRow:
    """One CAN frame, `sent` by the PLC or taken from the gateway; `data` None: a fault kept it from the bus."""

    monotonic: float
    time: float
    face: str
    sent: bool
    id: int
    data: bytes | None


@dataclass(frozen=True, slots=True)
class EventRow:
    """Anything else, with its particulars."""

    monotonic: float
    time: float
    event: str
    detail: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class PlcRecording:
    """What the PLC recorded. `missing` rows were lost before they reached the file, `damaged` lines cannot be read."""

    runs: tuple[Run, ...]
    truth: tuple[TruthRow, ...]
    requests: tuple[RequestRow, ...]
    blocks: tuple[BlockRow, ...]
    events: tuple[EventRow, ...]
    missing: int
    damaged: int
    frames: tuple[FrameRow, ...] = ()


def read_recording(path: Path) -> PlcRecording:
    """The recording in `path`, also one that is still being written or whose writer was killed. Raises InputError."""
    runs: list[Run] = []
    truth: list[TruthRow] = []
    requests: list[RequestRow] = []
    blocks: list[BlockRow] = []
    frames: list[FrameRow] = []
    events: list[EventRow] = []
    counts = {"missing": 0, "damaged": 0}
    expected = 1
    for number, row in _rows(path, counts):
        try:
            kind = row["k"]
            if kind == "run":
                clock = EmulatorClock(row["epoch"], row["monotonic"], row["speed"])
                roundings = {name: (absolute, relative) for name, (absolute, relative) in row["roundings"].items()}
                runs.append(Run(clock, row["device"], row["trace"], row["seed"], roundings))
                expected = 1  # each process numbers its rows from 1
            if not runs:
                raise InputError(f"{path}: line 1: is no start of a run; give a file that the software PLC recorded")
            counts["missing"] += row["n"] - expected
            expected = row["n"] + 1
            time = runs[-1].clock.plant_time(row["t"])
            if kind == "truth":
                truth += [TruthRow(row["t"], time, row["version"], tag, value) for tag, value in row["values"].items()]
            elif kind == "request":
                requests.append(_request(row, time))
            elif kind == "block":
                blocks.append(_block(row, time))
            elif kind == "frame":
                data = None if row["data"] is None else bytes.fromhex(row["data"])
                frames.append(FrameRow(row["t"], time, face=row["face"], sent=row["sent"], id=row["id"], data=data))
            elif kind == "event":
                detail = {key: value for key, value in row.items() if key not in ("k", "n", "t", "event")}
                events.append(EventRow(row["t"], time, row["event"], detail))
        except InputError:
            raise
        except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
            reason = f"{type(error).__name__}: {error}"
            raise InputError(
                f"{path}: line {number}: is no row that the software PLC wrote ({reason}); take it out"
            ) from None
    return PlcRecording(
        runs=tuple(runs),
        truth=tuple(truth),
        requests=tuple(requests),
        blocks=tuple(blocks),
        events=tuple(events),
        missing=counts["missing"],
        damaged=counts["damaged"],
        frames=tuple(frames),
    )


def _rows(path: Path, counts: dict[str, int]) -> Iterator[tuple[int, dict[str, Any]]]:
    for number, line in enumerate(read_text(path, "a recording of the software PLC").split("\n"), start=1):
        if not line:
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            counts["damaged"] += 1  # a killed writer leaves half a line
            continue
        if not (isinstance(row, dict) and isinstance(kind := row.get("k"), str) and kind in _KINDS):
            reason = "is no row of a recording; give a file that the software PLC recorded"
            raise InputError(f"{path}: line {number}: {line[:60]!r} {reason}")
        yield number, row


def _request(row: Mapping[str, Any], time: float) -> RequestRow:
    return RequestRow(
        monotonic=row["t"],
        time=time,
        peer=row["peer"],
        transaction=row["transaction"],
        unit=row["unit"],
        function=row["function"],
        address=row["address"],
        count=row["count"],
        pdu=bytes.fromhex(row["pdu"]),
        reply=None if row["reply"] is None else bytes.fromhex(row["reply"]),
        exception=row["exception"],
        delay_s=row["delay_s"],
        faults=tuple(row["faults"]),
        version=row["version"],
    )


def _block(row: Mapping[str, Any], time: float) -> BlockRow:
    return BlockRow(
        monotonic=row["t"],
        time=time,
        peer=row["peer"],
        address=row["address"],
        words=tuple(row["words"]),
        fields=row["fields"],
        verdict=row["verdict"],
        accepted=row["accepted"],
        block=row.get("block", ""),
    )
