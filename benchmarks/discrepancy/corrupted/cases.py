"""Five small records, and each of them as a recorder with a habit would have kept it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np

from benchmarks.discrepancy.corrupted.habits import CORRUPTIONS, FAULTS, FILINGS, Corruption, only
from sim.artefacts.model_json import model_text
from sim.lab.recordings import write_trace
from sim.sha import Model, Trace
from tests.discrepancy.plants import model, plant

TEMPERATURE = "TCuscinettiRiduttore"
"""The column that the usual map takes for the machine's temperature."""
ROW_S = 240.0
USUAL_DROP = 0.02
"""The share of rows that a recorder loses without anybody's notice."""
MOST_HABITS = 3


def lossy(rng: np.random.Generator, trace: Trace) -> Trace:
    """2 % of the rows missing, each by itself."""
    return only(trace, np.flatnonzero(rng.random(trace.times.size) >= USUAL_DROP))


def several(rng: np.random.Generator, trace: Trace) -> Trace:
    """Two or three habits at once."""
    habits = tuple(CORRUPTIONS.values())
    for number in rng.choice(len(habits), size=rng.integers(2, MOST_HABITS + 1), replace=False):
        trace = habits[number](rng, trace)
    return trace


DROPPED = "2 % of the rows dropped"
ROWS_CLASSES: Mapping[str, Corruption] = {DROPPED: lossy, **CORRUPTIONS, "two or three of them": several, **FAULTS}
CLASSES = (*ROWS_CLASSES, *FILINGS)
RECORDS: Mapping[str, Callable[[], Trace]] = {
    "nothing missing": lambda: plant(7, days=3, period=ROW_S),
    "cooled by its pump": lambda: plant(6, days=3, pump=1e-4, period=ROW_S),
    "churning after starts": lambda: plant(10, days=3, churning=3e-3, period=ROW_S),
    "a part exchanged half-way": lambda: plant(8, days=3, exchanged=0.08, period=ROW_S),
    "runs on, cooled by its pump": lambda: plant(4, days=2, pump=1e-4, runs_on=True, period=ROW_S),
}
"""What is said of them differs, and two of them are near the edge of saying it."""


@dataclass(frozen=True, slots=True)
class CorruptedRecord:
    """The `number`-th corruption of a class, of a record; the class "" is the record as it is."""

    record: str
    kind: str = ""
    number: int = 0

    @property
    def name(self) -> str:
        """One word for files."""
        seed = crc32(f"{self.record}/{self.kind}".encode())
        return f"{seed:08x}-{self.number}"

    def trace(self) -> Trace:
        """Its rows."""
        whole = RECORDS[self.record]()
        habit = ROWS_CLASSES.get(self.kind)
        return whole if habit is None else habit(self._generator(), replace(whole, events=()))

    def _generator(self) -> np.random.Generator:
        seed = [crc32(self.record.encode()), crc32(self.kind.encode()), self.number]
        return np.random.default_rng(np.random.SeedSequence(seed))

    def write(self, folder: Path, trace: Trace | None = None) -> None:
        """Its rows, or some of them, as files of the plant's in a folder of their own."""
        folder.mkdir()
        trace = trace or self.trace()
        renamed = {TEMPERATURE if name == "T" else name: column for name, column in trace.signals.items()}
        whole = folder / "rows.csv"
        write_trace(replace(trace, signals=renamed), whole)
        if self.kind in FILINGS:
            lines = whole.read_text(encoding="utf-8").splitlines(keepends=True)
            whole.unlink()
            rows = lines.index(next(line for line in lines if line.startswith("time"))) + 1
            for number, those in enumerate(FILINGS[self.kind](self._generator(), lines[rows:])):
                (folder / f"rows-{number}.csv").write_text("".join([*lines[:rows], *those]), encoding="utf-8")


def type_model() -> Model:
    """The model under which all of them are diagnosed."""
    return replace(model(), temperature=TEMPERATURE)


def write_model(path: Path) -> None:
    """That model as a file."""
    path.write_text(model_text(type_model()), encoding="utf-8")


def corruptions(count: int, dropped: int, first: int = 0) -> Iterator[CorruptedRecord]:
    """`dropped` of the first class and `count` of each other one, from the `first` on, of all records by turns."""
    for number in range(first, first + max(count, dropped)):
        for kind in CLASSES:
            if number - first < (dropped if kind == DROPPED else count):
                yield CorruptedRecord(tuple(RECORDS)[number % len(RECORDS)], kind, number)
