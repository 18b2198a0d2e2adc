"""`decanter diagnose` on measured data, beside what is known of them and what a grey box of one's own says.

\b
python -m benchmarks.discrepancy.measured --out DIR              # each record in a process of its own
python -m benchmarks.discrepancy.measured --only car --out DIR   # one of them, in this one

The data are looked for at ../shared/data; a record that is not there is left out, with the reason.
"""

import csv
import json
import resource
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from pathlib import Path
from time import perf_counter
from typing import Any

import click

from benchmarks.discrepancy.grey_box import Part, compare, stretches_of

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
MAPS = Path(__file__).parent / "maps"
LIMIT_S = 600.0
"""Seconds after which the process of a record is ended."""
KNOWN_TRIPS = ("drive12", "idle1", "idle4", "live1", "live17")
"""Trips of the car that its model is learned from; three more are only diagnosed."""
HEALTHY_S = 87_840
"""Seconds from which on the rig's cooler works at 100 %."""

Sources = tuple[list[Path], list[Path]]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredRecord:
    """A measured record: `lay_out` gives (what the model is learned from, what is diagnosed), `known` what is known.

    `drives` are the signals of the grey box, `pieces` into how many stretches it cuts each trace, `parts` what it
    tries.
    """

    name: str
    folder: str
    column_map: str
    lay_out: Callable[[Path, Path], Sources]
    known: str
    drives: Sequence[str] = ()
    pieces: int = 1
    parts: Sequence[Part] = ("second mass",)


def _files(learned: Sequence[str], diagnosed: Sequence[str]) -> Callable[[Path, Path], Sources]:
    """Files of the record's folder as they are."""
    return lambda data, _out: ([data / name for name in learned], [data / name for name in diagnosed])


def _car(data: Path, _out: Path) -> Sources:
    return [data / f"{name}.csv" for name in KNOWN_TRIPS], sorted(data.glob("*.csv"))


def _rig(data: Path, out: Path, break_s: int = 0) -> Sources:
    """Learned from the first half of the sound cooler's time; diagnosed: the other half, then the failing cooler.

    The record has the failing cooler first; here the rows of the sound one come first, as at a machine that wears.
    Between the parts nothing is read for `break_s` seconds.
    """
    with (data / "rig_5s.csv").open(encoding="utf-8") as stream:
        head, *rows = csv.reader(stream)
    sound = [row for row in rows if float(row[0]) >= HEALTHY_S]
    failing = {share: [row for row in rows if row[head.index("cooler")] == share] for share in ("20.00", "3.00")}
    half = len(sound) // 2
    learned = _written(out / "sound.csv", head, sound[:half])
    parts = [sound[half:], failing["20.00"], failing["3.00"]]
    return [learned], [
        _written(out / "failing.csv", head, [row for part in parts for row in part], _ends(parts, break_s))
    ]


def _transformer(data: Path, out: Path) -> Sources:
    """Learned from the first year, diagnosed on the second."""
    with (data / "ETTh1.csv").open(encoding="utf-8") as stream:
        head, *rows = csv.reader(stream)
    half = len(rows) // 2
    return [_written(out / "first.csv", head, rows[:half])], [_written(out / "second.csv", head, rows[half:])]


def _ends(parts: Sequence[Sequence[Sequence[str]]], break_s: int) -> dict[int, int]:
    """The numbers of the rows with which the parts after the first begin, and the seconds of the break before each."""
    return {sum(len(part) for part in parts[:number]): break_s for number in range(1, len(parts))}


def _written(
    path: Path, head: Sequence[str], rows: Sequence[Sequence[str]], breaks: Mapping[int, int] | None = None
) -> Path:
    """The rows as a file, one time step apart where the first column is in seconds, and `breaks` more (s) before those
    of such numbers."""
    seconds = head[0] == "time"
    behind = list(accumulate((breaks or {}).get(number, 0) for number in range(len(rows))))
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(head)
        writer.writerows([str(5 * n + behind[n]), *row[1:]] if seconds else row for n, row in enumerate(rows))
    return path


RECORDS = (
    MeasuredRecord(
        name="car",
        folder="carobd",
        column_map="carobd",
        lay_out=_car,
        known="a thermostat opens near 90 degC, gradually; the load heats; speed and intake air are decoys",
        drives=("Load",),
        parts=("second mass", "thermostat"),
    ),
    MeasuredRecord(
        name="car by CAN",
        folder="can_obd2",
        column_map="can_obd2",
        lay_out=_files(["tripA164_decoded_long.csv"], ["tripA164_decoded_long.csv"]),
        known="one cold start: too little",
        drives=("Load",),
        pieces=4,
        parts=("second mass", "thermostat"),
    ),
    MeasuredRecord(
        name="rig",
        folder="hydraulic_rig",
        column_map=str(MAPS / "hydraulic_rig.toml"),
        lay_out=_rig,
        known="the cooler goes from 100 % to 20 % at 22,230 s and to 3 % at 66,150 s; TS2 and TS4 follow TS1",
        pieces=40,
    ),
    MeasuredRecord(
        name="rig, logged with breaks",
        folder="hydraulic_rig",
        column_map=str(MAPS / "hydraulic_rig.toml"),
        lay_out=partial(_rig, break_s=3600),
        known="the same, with an hour in which nothing is read before each change of the cooler shows",
        pieces=40,
    ),
    MeasuredRecord(
        name="machine, two days",
        folder="nab_machine_temp",
        column_map=str(MAPS / "nab_machine_temp.toml"),
        lay_out=_files(["train.csv"], ["part_600.csv"]),
        known="one temperature; nothing is known of these two days",
        pieces=8,
    ),
    MeasuredRecord(
        name="machine, 16 days",
        folder="nab_machine_temp",
        column_map=str(MAPS / "nab_machine_temp.toml"),
        lay_out=_files(["train.csv"], ["test.csv"]),
        known="one temperature; a failure on 2014-02-08, whose cause is not known",
        pieces=30,
    ),
    MeasuredRecord(
        name="transformer",
        folder="transformer_oil",
        column_map=str(MAPS / "transformer_oil.toml"),
        lay_out=_transformer,
        known="room and season act and are not measured; nothing simple beats persistence",
        drives=("HighLoad", "MiddleLoad"),
        pieces=50,
    ),
    MeasuredRecord(
        name="pump",
        folder="skab",
        column_map="skab",
        lay_out=_files(["anomaly-free.csv"], ["anomaly-free.csv"]),
        known="one run of 2.6 h without a fault: too little",
        drives=("Assorbimento",),
        pieces=6,
    ),
    MeasuredRecord(
        name="bearing to its failure",
        folder="femto_bearing",
        column_map="femto",
        lay_out=_files(["Bearing2_4_temp.csv"], ["Bearing2_5_temp.csv"]),
        known="another bearing of the type, without a stop, that fails at the end",
        pieces=12,
    ),
)


def diagnose(record: MeasuredRecord, out: Path) -> dict[str, Any]:
    """Learn, diagnose and fit the grey box in this process: one row of the table as JSON's own types."""
    from gateway.cli.main import main as decanter
    from gateway.lab.traces.load import load

    out.mkdir(parents=True, exist_ok=True)
    learned, diagnosed = record.lay_out(DATA / record.folder, out)
    row: dict[str, Any] = {"record": record.name, "known": record.known}

    def call(*words: object) -> float:
        began = perf_counter()
        code = decanter([str(word) for word in words], standalone_mode=False)
        if code:
            raise click.ClickException(f"{record.name}: `decanter {words[0]}` ended with {code}")
        return perf_counter() - began

    def given(files: Sequence[Path]) -> list[str | Path]:
        return [word for path in files for word in ("--traces", path)] + ["--map", record.column_map]

    row["learning_s"] = call("model", "learn", *given(learned), "--out", out / "model", "--json")
    found = out / "found"
    where = ("--model", out / "model", "--out", found, "--no-report", "--json")
    row["diagnosis_s"] = call("diagnose", *where, *given(diagnosed))
    row["processor_s"] = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    row["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    row["diagnosis"] = json.loads((found / "diagnosis.json").read_text(encoding="utf-8"))
    traces, column_map = load([str(path) for path in diagnosed], record.column_map)
    stretches = stretches_of(traces, column_map.temperature, record.drives, record.pieces)
    row["grey_box"] = dict(compare(stretches, record.parts))
    return row


def in_own_process(record: MeasuredRecord, out: Path) -> dict[str, Any]:
    """The row of a record, made by a process of its own, so that its memory is its own."""
    command = [sys.executable, "-m", "benchmarks.discrepancy.measured", "--only", record.name, "--out", str(out)]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return {"record": record.name, "known": record.known, "failed": f"over {LIMIT_S:g} s"}
    if done.returncode:
        return {"record": record.name, "known": record.known, "failed": (done.stderr.strip() or "?").splitlines()[-1]}
    return dict(json.loads(row_file(out, record).read_text(encoding="utf-8")))


def row_file(out: Path, record: MeasuredRecord) -> Path:
    """Where the row of a record is kept."""
    return out / f"{record.name.replace(' ', '_').replace(',', '')}.json"


COLUMNS = (
    "record", "said", "names", "error before -> after", "floor", "began", "known", "own grey box, rms",
    "learning, diagnosis, processor (s)", "peak (MB)",
)  # fmt: skip


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as one markdown table."""
    lines = [COLUMNS, tuple("-" * 3 for _ in COLUMNS), *(_cells(row) for row in rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if "failed" in row:
        return (row["record"], f"**{row['failed']}**", *[""] * 4, row["known"], *[""] * 3)
    found = row["diagnosis"]
    held, floor, began = found["held_out"], found["floor"], found.get("began")
    error = limits = date = ""
    if held is not None:
        error = f"{held['rmse_before']:.3g} -> {held['rmse_after']:.3g} (given: {held['given']:.3g})"
    if floor is not None:
        error_of_floor, (low, high) = floor["value"], floor["interval"]
        limits = f"{error_of_floor:.3g} ({low:.3g} to {high:.3g})"
    if began is not None:
        date = f"{began['time']:.0f} s, {began['moves']:+.2g}"
    names = "; ".join(f"{'/'.join(each['class'])} {each['confidence']:.2f}" for each in found["effects"])
    grey = ", ".join(f"{words} {rms:.3g}" for words, rms in row["grey_box"].items())
    seconds = f"{row['learning_s']:.0f}, {row['diagnosis_s']:.0f}, {row['processor_s']:.0f}"
    said = f"**{found['verdict']}**: {found['sentence']}"
    return row["record"], said, names, error, limits, date, row["known"], grey, seconds, f"{row['peak_mb']:.0f}"


@click.command(help=__doc__)
@click.option("--only", type=click.Choice([record.name for record in RECORDS]), help="This record, in this process.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Where results go.")
def main(only: str | None, out: Path) -> None:
    """The command."""
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for record in RECORDS:
        if only not in (None, record.name):
            continue
        if not (DATA / record.folder).is_dir():
            click.echo(f"{record.name}: left out, the data are not at {DATA / record.folder}", err=True)
            continue
        if only is None:
            row = in_own_process(record, out)
        else:
            row = diagnose(record, out / row_file(out, record).stem)
            row_file(out, record).write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
        rows.append(row)
    click.echo(table(rows))


if __name__ == "__main__":
    main()
