"""How long the PLC waits: from a change in one of its registers until the prediction made of it lies in its registers.

Three processes, in real time, over a socket on loopback: the software PLC, which records everything on one monotonic
clock; the gateway as `decanter run` starts it, with a learned model, historian, log and alarms, armed, a forecast every
ten scans; and this one, which forces a register to a new value at random moments of the scan period, by turns the
bearing temperature (a small step) and the current (across the boundary of a bin, so that an event and a new location
follow). All moments are the PLC's own:

    change     the PLC's program puts the new value into the register (a `truth` row, with the image's version)
    read       the gateway's first request for that register that the PLC answers from this version or a later one
    block      the next write-back block on the same connection, accepted by the PLC

    change to block = change to read (waiting for the next scan, half a scan period on average) + read to block

The gateway has one scan in flight and writes one block a scan, so the block is the one computed from that reading. It
is not taken on trust: the bytes of the reply must hold the new value, and for the current the block's location must
differ from that of the block before. A change that is overwritten before it is read, or that fails this proof, is
counted, and the benchmark fails. The block holds the one-step prediction for the moment of the reading, which inputs
and events of the same scan enter; a temperature enters its anomaly score, zone and alarms, and the predicted
temperature of the blocks after it.

The yardstick, measured in the same run between the changes, against the same PLC process: two bare round trips of
pymodbus's asynchronous client (20 registers read, 24 written with function 16, outside the block, so that the PLC need
not check them), at moments like the gateway's, after pauses; and `at once`, a second pair right after the first, when
nothing has gone to sleep. Read to block is no round trip of its own: it has the way of a reply, the gateway's work, and
the way of a request. Reading the block back, which the gateway does afterwards, is not in it.
"""

import asyncio
import random
import tempfile
import time
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import click

from benchmarks.bare import connect, pair
from benchmarks.figures import Figure, give, percentile, shares
from benchmarks.processes import (
    CURRENT,
    MAP,
    TEMPERATURE,
    BenchmarkError,
    Plc,
    gateway,
    learned_model,
    software_plc,
    until_usable,
)
from sim.plc.program.encoding import encode
from sim.plc.program.registers import RegisterMap, read_map
from sim.plc.record.recording import BlockRow, PlcRecording, RequestRow, TruthRow, read_recording

CURRENTS = (150.0, 250.0)
STEP, STEPS = 0.02, 10
"""The temperature goes up by STEP degC at each of its changes and back after STEPS: no faster than the tag may."""
SHORTEST, LONGEST = 0.6, 1.2
"""Half the pause between two changes, in scan periods: longer than one period in all, and spread over more than one."""


@dataclass(frozen=True, slots=True)
class Scan:
    """A read of all tags, and the block that came of it."""

    read: RequestRow
    block: BlockRow


@dataclass(frozen=True, slots=True)
class Followed:
    """Seconds from a change to its read and to its block, of the proven ones; how many were `lost` or `unproven`."""

    waited: list[float]
    total: list[float]
    lost: int
    unproven: int


@dataclass(frozen=True, slots=True)
class Pairs:
    """Seconds of two bare round trips: after a pause like the gateway's, and at once after that."""

    paced: list[float]
    at_once: list[float]


def settle(plc: Plc, period: float) -> float:
    """Hold both tags where they are, the current in its upper bin, for some scans; gives the temperature (degC)."""
    first = float(plc.order("values")["values"][TEMPERATURE])
    plc.order("force", tag=TEMPERATURE, value=first)
    plc.order("force", tag=CURRENT, value=CURRENTS[1])
    time.sleep(3.0 * period)
    return first


async def provoke(plc: Plc, first: float, changes: int, period: float, rng: random.Random) -> Pairs:
    """Force `changes` values at random moments, from the temperature `first` on, and two bare pairs before each."""
    pairs = Pairs([], [])
    client = await connect(plc.port)
    try:
        for number in range(changes):
            await asyncio.sleep(period * rng.uniform(SHORTEST, LONGEST))
            pairs.paced.append(await pair(client, number))
            pairs.at_once.append(await pair(client, number))
            await asyncio.sleep(period * rng.uniform(SHORTEST, LONGEST))
            turn = number // 2
            if number % 2:
                plc.order("force", tag=CURRENT, value=CURRENTS[turn % 2])
            else:
                plc.order("force", tag=TEMPERATURE, value=round(first + STEP * (1 + turn % STEPS), 3))
        await asyncio.sleep(3.0 * period)
    finally:
        client.close()
    return pairs


def scans_in(recording: PlcRecording, registers: RegisterMap) -> list[Scan]:
    """Every read of the two forced tags that a block followed before the next read, on the gateway's connection.

    Raises BenchmarkError when there is none or more than one connection wrote blocks.
    """
    peers = {block.peer for block in recording.blocks}
    if len(peers) != 1:
        raise BenchmarkError(f"blocks came over {len(peers)} connections; one was expected")
    reads = [row for row in recording.requests if row.peer in peers and _reads_both(row, registers)]
    moments = [block.monotonic for block in recording.blocks]
    found = []
    for read, following in pairwise(reads):
        at = bisect_left(moments, read.monotonic)
        if at < len(moments) and moments[at] < following.monotonic and recording.blocks[at].accepted:
            found.append(Scan(read, recording.blocks[at]))
    return found


def _reads_both(row: RequestRow, registers: RegisterMap) -> bool:
    if row.function != 3 or row.address is None or row.count is None:
        return False
    asked = range(row.address, row.address + row.count)
    return all(set(registers.places[tag].addresses()) <= set(asked) for tag in (TEMPERATURE, CURRENT))


def changes_in(recording: PlcRecording, since: float, until: float) -> list[TruthRow]:
    """The changes of the two tags after `since` and before `until` (monotonic s)."""
    return [row for row in recording.truth if row.tag in (TEMPERATURE, CURRENT) and since < row.monotonic < until]


def follow(changes: Sequence[TruthRow], scans: Sequence[Scan], registers: RegisterMap) -> Followed:
    """Find the block of each change, and prove that it is."""
    versions = [scan.read.version for scan in scans]
    waited, total, lost, unproven = [], [], 0, 0
    for number, change in enumerate(changes):
        at = bisect_left(versions, change.version)
        if at == len(scans) or _overtaken(change, changes[number + 1 :], versions[at]):
            lost += 1
        elif not _proven(change, scans[at], scans[at - 1] if at else None, registers):
            unproven += 1
        else:
            waited.append(scans[at].read.monotonic - change.monotonic)
            total.append(scans[at].block.monotonic - change.monotonic)
    return Followed(waited, total, lost, unproven)


def _overtaken(change: TruthRow, later: Sequence[TruthRow], version: int) -> bool:
    following = next((row for row in later if row.tag == change.tag), None)
    return following is not None and following.version <= version


def _proven(change: TruthRow, scan: Scan, before: Scan | None, registers: RegisterMap) -> bool:
    """The reply holds the value as the PLC encodes it; a current in another bin has moved the block's location."""
    place, reply = registers.places[change.tag], scan.read.reply
    if reply is None or change.value is None or scan.read.address is None:
        return False
    begin = 9 + 2 * (place.address - scan.read.address)
    words = b"".join(word.to_bytes(2, "big") for word in encode(registers.tags[change.tag], change.value))
    if reply[begin : begin + len(words)] != words:
        return False
    if change.tag != CURRENT:
        return True
    own, earlier = scan.block.fields, before.block.fields if before else None
    return own is not None and earlier is not None and own["location"] != earlier["location"]


def measure(changes: int, period: float, seed: int, model_folder: Path | None = None) -> list[Figure]:
    """Run the three processes. Raises BenchmarkError when a change cannot be followed to its block."""
    with tempfile.TemporaryDirectory(prefix="decanter-latency-") as name:
        folder = Path(name)
        model = learned_model(model_folder or folder)
        with software_plc(folder) as plc, gateway(folder, plc, model, period) as process:
            until_usable(plc, process)
            first, since = settle(plc, period), time.monotonic()
            pairs = asyncio.run(provoke(plc, first, changes, period, random.Random(seed)))
            until = time.monotonic()
        recording = read_recording(plc.recording)
    registers = read_map(MAP)
    scans = scans_in(recording, registers)
    followed = follow(changes_in(recording, since, until), scans, registers)
    if len(followed.total) != changes:
        raise BenchmarkError(
            f"of {changes} changes {len(followed.total)} were followed to their block, {followed.lost} were never "
            f"read or overtaken, {followed.unproven} had a reply or a block that does not hold them"
        )
    during = scans[bisect_right([s.read.monotonic for s in scans], since) : -1]
    return _figures(followed, [scan for scan in during if scan.read.monotonic < until], pairs, period)


def _figures(followed: Followed, scans: Sequence[Scan], pairs: Pairs, period: float) -> list[Figure]:
    milli = 1e3
    total = [milli * seconds for seconds in followed.total]
    work = [milli * (scan.block.monotonic - scan.read.monotonic) for scan in scans]
    paced, at_once = ([milli * seconds for seconds in some] for some in (pairs.paced, pairs.at_once))
    waited = milli * sum(followed.waited) / len(followed.waited)
    bare = "two bare round trips"
    return [
        *shares("register change to its block", "ms", total, bare, paced),
        Figure("  of it waiting for the scan, mean", waited, "ms", "half the scan period", milli * period / 2),
        *shares("register read to its block", "ms", work, bare, paced),
        Figure("register read to its block, worst", max(work), "ms", f"{bare}, worst", max(paced)),
        Figure(
            "two bare round trips at once, p50", percentile(at_once, 50), "ms", "after a pause", percentile(paced, 50)
        ),
        Figure("changes followed and proven", len(followed.total), "", "scans in that time", len(scans)),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="50 changes instead of 400.")
@click.option("--changes", type=click.IntRange(2), help="How many registers are changed.")
@click.option("--period", type=click.FloatRange(0.02), default=0.05, show_default=True, help="Scan period (s).")
@click.option("--seed", default=1, show_default=True, help="Seed of the moments.")
@click.option("--model-folder", type=click.Path(path_type=Path), help="Where the learned model is kept.")
def main(as_json: bool, quick: bool, changes: int | None, period: float, seed: int, model_folder: Path | None) -> None:
    figures = measure(changes or (50 if quick else 400), period, seed, model_folder)
    give(f"latency, scan period {1e3 * period:g} ms", figures, as_json=as_json)


if __name__ == "__main__":
    main()
