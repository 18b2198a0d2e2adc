"""Exports drawn from dialects, clocks, layouts, machines, storage and defects: read right, asked, refused, or wrong.

\b
python -m benchmarks.drawn_exports [--count 200] [--seed 0] [--keep DIR]

What is right is the table that was written. A question is answered as the one who wrote it would; an export that says
too little to be read must be refused, or asked.
"""

import gzip
import random
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from openpyxl import Workbook

from sim.lab.recordings import TraceError, load_traces, parse_map
from sim.lab.recordings.mapping import Answers, Undecided, draft_map
from sim.sha import Trace
from tests.traces.exports import Recording, recording

MAX_QUESTIONS = 3
DEADBAND = 0.5
"""degC by which a temperature moves before it is stored anew."""
BAD_CODE = -127.0
MONTHS = {"de": ["Jan", "Feb", "Mrz", "Apr", "Mai", "Jun"], "fr": ["janv.", "févr.", "mars", "avr.", "mai", "juin"]}
WORDS = {
    "en": ("Time", "Bearing temperature", "Motor current", "Running", "Machine", "Value", "Name", ("on", "off")),
    "de": ("Zeit", "Lagertemperatur", "Motorstrom", "Motor Ein", "Maschine", "Wert", "Name", ("Ein", "Aus")),
    "it": ("Ora", "Temperatura cuscinetto", "Corrente motore", "Marcia", "Macchina", "Valore", "Nome", ("Si", "No")),
    "fr": ("Heure", "Température palier", "Courant moteur", "Marche", "Machine", "Valeur", "Nom", ("oui", "non")),
    "es": ("Hora", "Temperatura rodamiento", "Corriente motor", "Marcha", "Equipo", "Valor", "Nombre", ("si", "no")),
}
"""Names by language: clock, temperature, current, switch, machine, value, name, words of the switch."""
DIALECTS = (("en", ",", "."), ("de", ";", ","), ("it", ";", ","), ("fr", ";", ","), ("es", "\t", ","), ("en", "|", "."))
EPOCH = datetime(1970, 1, 1)
READ_AT = 1.72e9
"""s since 1970, some weeks after the last drawn row: nothing drawn depends on the day of the run."""
CLOCKS: dict[str, Callable[[datetime], str]] = {
    "iso": lambda t: f"{t:%Y-%m-%d %H:%M:%S}",
    "zulu": lambda t: f"{t:%Y-%m-%dT%H:%M:%S}.000Z",
    "dotted": lambda t: f"{t:%d.%m.%Y %H:%M:%S}",
    "half days": lambda t: f"{t:%m/%d/%Y %I:%M:%S %p}",
    "epoch": lambda t: f"{(t - EPOCH).total_seconds():.0f}",
    "milliseconds": lambda t: f"{(t - EPOCH).total_seconds() * 1000:.0f}",
    "days": lambda t: f"{(t - datetime(1899, 12, 30)) / timedelta(days=1):.8f}",
    "german month": lambda t: f"{t.day}. {MONTHS['de'][t.month - 1]} {t:%Y %H:%M:%S}",
    "french month": lambda t: f"{t.day} {MONTHS['fr'][t.month - 1]} {t:%Y %H:%M:%S}",
    "two columns": lambda t: f"{t:%d/%m/%Y}\x00{t:%H:%M:%S}",
}
LAYOUTS = ("wide", "titled", "units", "newest first", "long", "tag files", "parts", "packed", "sheet")
MACHINES = ("one", "two in turn", "two in a row")
STORAGE = ("each row", "on change")
DEFECTS = ("none", "code", "header again", "narrow row", "row twice", "blank lines", "words", "kelvin", "beside")


@dataclass(frozen=True, slots=True)
class Drawn:
    """One combination."""

    language: str
    mark: str
    decimal: str
    clock: str
    layout: str
    machines: str
    storage: str
    defect: str

    def __str__(self) -> str:
        return " x ".join((self.language, self.clock, self.layout, self.machines, self.storage, self.defect))


def draw(rng: random.Random) -> Drawn:
    """A combination that a program could have written."""
    while True:
        language, mark, decimal = rng.choice(DIALECTS)
        one = Drawn(
            language, mark, decimal, rng.choice(list(CLOCKS)), rng.choice(LAYOUTS), rng.choice(MACHINES),
            rng.choice(STORAGE), rng.choice(DEFECTS),
        )  # fmt: skip
        by_tag = one.layout in ("long", "tag files")
        if one.machines != "one" and (by_tag or one.layout in ("parts", "newest first") or one.storage == "on change"):
            continue
        if by_tag and one.defect in ("header again", "narrow row", "beside", "kelvin"):
            continue
        if one.layout == "sheet" and one.defect in ("narrow row", "blank lines"):
            continue
        return one


@dataclass(frozen=True, slots=True)
class Written:
    """The export, and of each machine the plant behind it and the rows that stand in it."""

    path: Path
    plants: dict[str, Recording]
    lost: frozenset[int]


def write(one: Drawn, folder: Path, seed: int) -> Written:
    """The export of a combination."""
    plants = {"A1": recording(seed, times=2)}
    if one.machines != "one":
        plants["B2"] = recording(seed + 1, times=2, ambient=33.0)
    rows = [
        (place, machine, moment, [plant.heat[place], plant.current[place], float(plant.running[place])])
        for machine, plant in plants.items()
        for place, moment in enumerate(plant.moments)
    ]
    if one.machines == "two in turn":
        rows.sort(key=lambda row: (row[2], row[1]))
    lost = frozenset({15, 90, 91, 200}) if one.defect in ("code", "words", "narrow row") else frozenset[int]()
    names = WORDS[one.language]
    lines = _tables(one, rows, lost, names)
    path = _put(one, folder, lines)
    return Written(path, plants, lost)


def _tables(
    one: Drawn, rows: Sequence[tuple[int, str, datetime, list[float]]], lost: frozenset[int], names: Sequence[object]
) -> dict[str, list[list[str]]]:
    """The rows of each file as cells, header first; a wide export has one file, by the name of the export."""
    clock, heat, current, running, machine, value, name, (on, off) = names  # type: ignore[misc]
    kelvin = 273.15 if one.defect == "kelvin" else 0.0
    titles = [f"{heat} [K]" if kelvin else str(heat), str(current), str(running)]
    clocks = [str(clock)] if one.clock != "two columns" else ["Date", str(clock)]
    last: dict[int, float] = {}

    def number(amount: float) -> str:
        return f"{amount:.2f}".replace(".", one.decimal)

    wide: list[list[str]] = []
    tags: dict[str, list[list[str]]] = {title: [] for title in titles}
    for place, whose, moment, values in rows:
        at = CLOCKS[one.clock](moment).split("\x00")
        if one.clock == "days":
            at = [at[0].replace(".", one.decimal)]
        cells = [number(values[0] + kelvin), number(values[1]), str(on if values[2] else off)]
        if place in lost and one.defect in ("code", "words"):
            cells[0] = number(BAD_CODE) if one.defect == "code" else "Bad"
        if one.storage == "on change":
            for column, (now, band) in enumerate(zip(values, (DEADBAND, 4.0, 0.5), strict=True)):
                same = place and place not in lost and abs(now - last[column]) < band
                cells[column] = "" if same else cells[column]
                last[column] = last[column] if same or place in lost else now
        if not any(cells):
            continue
        beside = ["7", "constant"] if one.defect == "beside" else []
        wide.append([*at, *([whose] if one.machines != "one" else []), *cells, *beside])
        if one.defect == "narrow row" and place in lost:
            wide[-1] = wide[-1][: len(at)]
        for title, cell in zip(titles, cells, strict=True):
            if cell:
                tags[title].append([*at, cell])
    header = [*clocks, *([str(machine)] if one.machines != "one" else []), *titles]
    header += ["Setting", "Remark"] if one.defect == "beside" else []
    if one.layout == "tag files":
        return {title: [[*clocks, str(value)], *own] for title, own in tags.items()}
    if one.layout == "long":
        every = [[*row[:-1], title, row[-1]] for title, own in tags.items() for row in own]
        return {"export": [[*clocks, str(name), str(value)], *every]}
    if one.layout == "newest first":
        wide.reverse()
    if one.defect == "header again":
        wide.insert(len(wide) // 2, header)
    if one.defect == "row twice":
        wide.insert(60, wide[60])
    if one.layout == "parts":
        third = len(wide) // 3
        return {f"2024-03-{13 + part}": [header, *wide[part * third : (part + 1) * third if part < 2 else None]]
                for part in range(3)}  # fmt: skip
    if one.layout == "units":
        unit = {titles[0]: "K" if kelvin else "°C", titles[1]: "A"}
        wide.insert(0, [unit.get(each, "") for each in header])
    if one.layout == "titled":
        wide = [header, *wide]
        return {"export": [["Report of the plant"], ["Query", "all"], *wide]}
    return {"export": [header, *wide]}


def _put(one: Drawn, folder: Path, files: dict[str, list[list[str]]]) -> Path:
    """The files on the disk; the folder where they are several."""
    for name, rows in files.items():
        if one.layout == "sheet":
            book = Workbook()
            for row in rows:
                book.active.append(row)  # type: ignore[union-attr]
            book.save(folder / f"{name}.xlsx")
            return folder / f"{name}.xlsx"
        lines = [one.mark.join(row) for row in rows]
        if one.defect == "blank lines":
            lines[50:50] = ["", ""]
        text = "\n".join(lines) + "\n"
        if one.layout == "packed":
            (folder / f"{name}.csv.gz").write_bytes(gzip.compress(text.encode()))
            return folder / f"{name}.csv.gz"
        encoding = "cp1252" if one.mark == ";" else "utf-8"
        (folder / f"{name}.csv").write_text(text, encoding=encoding)
    return folder if len(files) > 1 else folder / f"{next(iter(files))}.csv"


def answer(one: Drawn, question: Undecided) -> str:
    """What the one who wrote it says; "" where none of the choices is true."""
    names = WORDS[one.language]
    true = {
        "temperature": str(names[1]), "current": str(names[2]), "running": str(names[3]), "machine": str(names[4]),
        "stored": one.storage, "dates": "month" if one.clock == "half days" else "day", "on": str(names[7][0]),
        "session": "none", "time": str(names[0]), "clock-back": "refuse",
    }  # fmt: skip
    wanted = true.get(question.field, "")
    return next((choice for choice in question.choices if wanted and wanted in choice), "")


def judge(one: Drawn, written: Written) -> tuple[str, str]:
    """(right, asked, refused or wrong; what was said or how it differs)."""
    answers = Answers()
    asked: list[str] = []
    while True:
        try:
            drafted = draft_map(written.path, answers, now=READ_AT)
            break
        except Undecided as question:
            own = answer(one, question)
            if not own or len(asked) == MAX_QUESTIONS:
                return "no answer", str(question)
            asked.append(question.field)
            answers = answers.with_answer(question.field, own)
        except TraceError as error:
            return "refused", str(error)
    traces, _ = load_traces(written.path, column_map := parse_map(drafted.text, "drawn"))
    faults = _faults(one, written, traces, column_map.temperature)
    return ("wrong", "; ".join(faults)) if faults else ("asked" if asked else "right", ", ".join(asked))


def _faults(one: Drawn, written: Written, traces: Sequence[Trace], temperature: str) -> list[str]:
    if len(traces) != len(written.plants):
        return [f"{len(traces)} traces of {len(written.plants)} machines"]
    faults: list[str] = []
    for trace, plant in zip(traces, written.plants.values(), strict=True):
        begin = (plant.moments[0] - EPOCH).total_seconds()
        values = trace.signals[temperature]
        at = np.round((trace.times - begin) / 10.0).astype(int)
        if one.storage == "on change":
            inside = (at >= 0) & (at < plant.heat.size) & np.isfinite(values)
            off = np.abs(values[inside] - plant.heat[at[inside]])
            # What is lost holds the value before it.
            if np.quantile(off, 0.97) > 1.5 * DEADBAND:
                faults.append(f"held values are off by {np.quantile(off, 0.97):.2f}")
            if inside.sum() < 0.9 * plant.heat.size:
                faults.append(f"{inside.sum()} held values of {plant.heat.size}")
            continue
        if not np.allclose(trace.times, begin + 10.0 * at, atol=0.01):
            faults.append("times")
            continue
        read = dict(zip(at.tolist(), values.tolist(), strict=True))
        left = [place for place in range(plant.heat.size) if place not in written.lost]
        wrong = [place for place in left if abs(read.get(place, np.nan) - plant.heat[place]) > 0.011]
        wrong += [place for place in left if not np.isfinite(read.get(place, np.nan))]
        wrong += [place for place in written.lost if np.isfinite(read.get(place, np.nan))]
        if wrong:
            faults.append(f"{len(wrong)} of {plant.heat.size} readings, first {wrong[0]}")
        starts = int((np.diff(plant.running) == 1).sum())
        if sum(event.symbol == "W_ON" for event in trace.events) not in (starts, starts + 1):
            faults.append("starts")
    return faults


@click.command(help=__doc__)
@click.option("--count", default=200, show_default=True, help="Exports.")
@click.option("--seed", default=0, show_default=True, help="Of the drawing.")
@click.option("--keep", type=click.Path(path_type=Path, file_okay=False), help="Where exports stay that are not right.")
def main(count: int, seed: int, keep: Path | None) -> None:
    """The command."""
    rng, tally = random.Random(seed), Counter[str]()
    for number in range(count):
        one = draw(rng)
        with TemporaryDirectory() as folder:
            written = write(one, Path(folder), number)
            found, said = judge(one, written)
            tally[found] += 1
            if found not in ("right", "asked"):
                click.echo(f"{number}: {one}: {found}: {said.replace(folder, '')}")
                if keep is not None:
                    Path(folder).rename(keep / str(number))
                    Path(folder).mkdir()
    click.echo(", ".join(f"{found} {tally[found]}" for found in ("right", "asked", "no answer", "refused", "wrong")))


if __name__ == "__main__":
    main()
