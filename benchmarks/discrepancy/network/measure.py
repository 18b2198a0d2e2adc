"""The whole measurement of a set: its cases in a drawn order, each made, diagnosed and put down before the next.

The order is drawn by the set's seed, so that the first cases of it are a fair sample, wherever a measurement stops.
What has a label is not made again, what has a result is not diagnosed again.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from time import monotonic
from zlib import crc32

import numpy as np

from benchmarks.discrepancy.bearings import family_of
from benchmarks.discrepancy.judging import Judged, answer
from benchmarks.discrepancy.network.cases import SETS, NetworkSpec, make, specs
from benchmarks.discrepancy.runner import RESULTS, Diagnose, Outcome, case
from benchmarks.discrepancy.seal import commit, labels_of, write_labels

COUNTS = {"clean": 200, "singles": 210, "pairs": 50, "outside": 40}
"""200 cases where nothing is missing and 300 in which something acts."""
CHUNK = 60
"""Cases of the order that are made at once: those of one length are integrated side by side."""
NAME = "measure"

Told = Callable[[str], None]


def drawn_order(set_: str) -> list[NetworkSpec]:
    """All cases of the measurement of a set, in the order in which they are looked at."""
    every = [spec for stratum, count in COUNTS.items() for spec in specs(set_, stratum, range(count))]
    rng = np.random.default_rng(np.random.SeedSequence([SETS[set_], crc32(b"order")]))
    return [every[number] for number in rng.permutation(len(every)).tolist()]


def measure(
    order: Sequence[NetworkSpec],
    out: Path,
    diagnose: Diagnose | None,
    *,
    limit: float,
    seconds: float,
    told: Told = lambda _words: None,
    clock: Callable[[], float] = monotonic,
) -> None:
    """Make the cases and diagnose each (`None`: only make them), with `limit` seconds for one.

    After `seconds` by the clock nothing new is begun.
    """
    results = out / RESULTS / NAME
    results.mkdir(parents=True, exist_ok=True)
    until = clock() + seconds
    for at in range(0, len(order), CHUNK):
        chunk = order[at : at + CHUNK]
        left = [spec for spec in chunk if not _result(results, spec).exists()] if diagnose is not None else chunk
        if not left:
            continue
        if clock() >= until:
            return
        _made(order[0].set, at, chunk, out)
        told(f"{min(at + CHUNK, len(order))} of {len(order)} cases are made")
        for spec in left if diagnose is not None else ():
            if clock() >= until:
                return
            outcome = diagnose(case(out, spec.identifier), limit)
            draft = results / f".{spec.identifier}.draft"
            draft.write_text(json.dumps(asdict(outcome)) + "\n", encoding="utf-8")
            draft.replace(_result(results, spec))
            said = outcome.diagnosis.get("verdict", outcome.status)
            told(f"{spec.stratum} {spec.number}: {said} in {outcome.seconds:.0f} s")


def judged(order: Sequence[NetworkSpec], out: Path) -> list[Judged]:
    """The cases that have a result, in the drawn order."""
    labels, results = labels_of(out), out / RESULTS / NAME
    found = []
    for spec in order:
        if (path := _result(results, spec)).exists():
            outcome = Outcome(**json.loads(path.read_text(encoding="utf-8")))
            gainless = max(family_of(case(out, spec.identifier).model).gains) < 0
            found.append(Judged(labels[spec.identifier], outcome, answer(outcome), gainless))
    return found


def _result(results: Path, spec: NetworkSpec) -> Path:
    return results / f"{spec.identifier}.json"


def _made(set_: str, at: int, chunk: Sequence[NetworkSpec], out: Path) -> None:
    there = labels_of(out)
    wanted = [spec for spec in chunk if spec.identifier not in there]
    for days in sorted({spec.days for spec in wanted}):  # cases of one length are integrated side by side
        part = [spec for spec in wanted if spec.days == days]
        write_labels(out, f"{set_}-{at:03d}-{days}d", make(part, out))
    if wanted:
        commit(out)
