"""The rows of OUT/results.jsonl: what a former command did of a study, checked, as a person may have edited it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from gateway.lab.fleet.machine_task import MachineResult
from gateway.lab.json_rows import RowKeys, append_row, check_row, read_rows
from sim.files import ArtefactError
from sim.lab.learning import GroupTargets

FORMAT = 2
REMEDY = "take that line out, and what it tells of is done again"


class KeptType(RowKeys):
    """The row of the type's model: the key of what taught it (`type`), `between` (degC), who was `left_out`, and why.

    Rows of former versions name nobody: there one machine that could not be read ended the command.
    """

    format: int
    type: str
    between: float = Field(ge=0)
    left_out: dict[str, str] = Field(default_factory=dict)


class KeptTargets(RowKeys):
    """`GroupTargets`."""

    offset: float
    error: float = Field(ge=0)
    runs: int


class KeptMachine(RowKeys):
    """The row of a machine: `key` of its data and of what was asked, and its `MachineResult`.

    Of a held-out error null stands for one that is not known, as JSON has no NaN.
    """

    format: int
    key: str
    machine: str
    failure: str
    unread: list[str] = Field(default_factory=list)
    rows: int
    hours: float
    offset: float
    error: float = Field(ge=0)
    grouped: dict[str, KeptTargets]
    held_out: dict[Literal["type", "corrected", "own"], float | None]
    verdict: str
    effects: list[str]
    cpu_s: float
    peak_mb: float
    own: None


@dataclass(frozen=True, slots=True)
class KeptRows:
    """The last row of a type's model, as one folder is kept, and those of the machines with their FILE:LINE."""

    taught: KeptType | None
    machines: Sequence[tuple[str, KeptMachine]]


def kept_rows(file: Path) -> KeptRows:
    """The rows of this version, none where there is no file.

    Raises ArtefactError, in one sentence with line and key, for one that cannot be used.
    """
    taught, machines = None, []
    for line, row in enumerate(read_rows(file), 1):
        if row.get("format") != FORMAT:
            continue  # of another version: done again
        if "type" in row:
            taught = check_row(file, line, row, KeptType, REMEDY)
        else:
            machines.append((f"{file}:{line}", check_row(file, line, row, KeptMachine, REMEDY)))
    return KeptRows(taught, machines)


def parse_result(place: str, row: KeptMachine, groups: Collection[str]) -> MachineResult:
    """A result as it was kept; `groups` are those of its type's locations. Raises ArtefactError for another one."""
    unknown = [name for name in row.grouped if name not in groups]
    if unknown:
        known = ", ".join(groups)
        raise ArtefactError(
            f"{place}: grouped: {unknown[0]!r} is no group of locations; known are {known}, or {REMEDY}"
        )
    held_out = {name: float("nan") if error is None else error for name, error in row.held_out.items()}
    fields = row.model_dump(exclude={"format", "key"})
    tuples = {"effects": tuple(row.effects), "unread": tuple(row.unread)}
    grouped = {name: GroupTargets(own.offset, own.error, own.runs) for name, own in row.grouped.items()}
    return MachineResult(**{**fields, **tuples, "grouped": grouped, "held_out": held_out})


def keep_result(file: Path, key: str, result: MachineResult) -> None:
    """Add a machine's row, without a model of its own. Raises OSError."""
    append_row(file, {"format": FORMAT, "key": key, **asdict(result)})


def keep_type(file: Path, key: str, between: float, left_out: Mapping[str, str]) -> None:
    """Add the row of the type's model. Raises OSError."""
    row: dict[str, Any] = {"format": FORMAT, "type": key, "between": between, "left_out": dict(left_out)}
    append_row(file, row)
