"""What each command says of models of unfit recordings: `python -m benchmarks.unfit_models [KIND ...]`.

A pump of `benchmarks.foreign_plants` is recorded for days; each kind is that recording as something went wrong. It goes
through `trace map`, `model learn`, `judge proof`, `version promote` into a store where a good model runs, and `plc
check` of a plant that names the model, as somebody types them. Where `trace map` asks, it is answered that the file is
right as it is. Printed is what each says, in a few words, and whether the model was promoted without a reason.
"""

import csv
import shlex
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import chdir
from datetime import UTC, datetime, timedelta
from pathlib import Path

import click
import numpy as np
from click.testing import CliRunner, Result

from benchmarks.foreign_plants import PERIOD_S, PUMP, recording
from gateway.cli.main import main as decanter
from sim.artefacts import VERDICT_FILE, read_model, read_verdict
from sim.sha import Array

DAYS = 4
BEGIN = datetime(2026, 3, 1, tzinfo=UTC)
HEADERS = ("Time", *PUMP.headers)
TEMPERATURE = PUMP.headers[2]
Columns = list[Array]
"""running, load, the temperature, another; NaN where there is no row."""


def _with(values: Callable[[Columns, Columns], Array], *, column: int = 2) -> Callable[[Columns, Columns], Columns]:
    return lambda own, other: [*own[:column], values(own, other), *own[column + 1 :]]


def _each(step: int, code: float) -> Callable[[Columns, Columns], Array]:
    return lambda own, _: np.where(np.arange(own[2].size) % step == 0, code, own[2])


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _some(keep: Callable[[Array], Array]) -> Callable[[Columns, Columns], Columns]:
    """The rows of which `keep` (by number) is true."""
    return lambda own, _: [np.where(keep(np.arange(each.size)), each, np.nan) for each in own]


KINDS: Mapping[str, tuple[Callable[[Columns, Columns], Columns], Sequence[str]]] = {
    "a good one": (lambda own, _: own, ("fit",)),
    "every third reading -127": (_with(_each(3, -127.0)), ("fit",)),
    "every third reading 999.9": (_with(_each(3, 999.9)), ("unfit",)),
    "every fifth reading 85": (_with(_each(5, 85.0)), ("unfit",)),
    "the switch inverted": (_with(lambda own, _: 1.0 - own[0], column=0), ("unfit",)),
    "degrees Fahrenheit": (_with(lambda own, _: 1.8 * own[2] + 32.0), ("limited",)),
    "kelvin": (_with(lambda own, _: own[2] + 273.15), ("limited",)),
    "two machines, row by row": (
        lambda own, other: [
            np.where(np.arange(mine.size) % 2, mine, theirs) for mine, theirs in zip(own, other, strict=True)
        ],
        ("unfit", "limited"),
    ),
    "two machines, one after the other": (
        lambda own, other: [
            np.concatenate([mine, 2.0 * theirs + 30.0 if place == 2 else theirs])
            for place, (mine, theirs) in enumerate(zip(own, other, strict=True))
        ],
        ("unfit", "limited"),
    ),
    "one state for everything": (
        lambda own, _: [np.ones_like(own[0]), np.full_like(own[1], 18.0), *own[2:]],
        ("unfit", "limited"),
    ),
    "bursts of five minutes": (_some(lambda row: row % 120 < 10), ("limited", "not known")),
    "an hour": (_some(lambda row: (row >= 760) & (row < 880)), ("limited", "not known")),
    "noise of 8 degC": (_with(lambda own, _: 40.0 + _rng().normal(0.0, 8.0, own[2].size)), ("unfit", "limited")),
    "of nothing that is measured": (
        _with(lambda own, _: 40.0 + np.cumsum(_rng().normal(0.0, 0.3, own[2].size))),
        ("unfit", "limited"),
    ),
}
"""What went wrong with the columns of one machine, or of it and another, and the words that are right of its model."""


def write_export(path: Path, columns: Columns) -> None:
    """The rows that have a running, as a SCADA exports them."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(HEADERS)
        for row, cells in enumerate(zip(*columns, strict=True)):
            if not np.isnan(cells[0]):
                moment = BEGIN + timedelta(seconds=row * PERIOD_S)
                writer.writerow((moment.strftime(PUMP.time_format), *(f"{cell:.1f}" for cell in cells)))


def _columns(seed: int) -> Columns:
    return list(recording(DAYS, seed=seed).values())[:4]


def type_in(folder: Path, line: str) -> Result:
    """One command as it is typed in the folder; a defect is raised."""
    with chdir(folder):
        told = CliRunner(env={"DECANTER_BY": "Ada"}).invoke(decanter, shlex.split(line))
    if told.exception is not None and not isinstance(told.exception, SystemExit):
        raise told.exception
    return told


def _learn(folder: Path) -> str:
    """The answer to what `trace map` asks ("" if nothing), after the model is learned. Raises ClickException."""
    asked = ""
    line = f"trace map export.csv -o columns.toml --temperature '{TEMPERATURE}'"
    told = type_in(folder, line)
    if told.exit_code:
        asked = told.stderr.strip().splitlines()[-1].removeprefix("decanter: export.csv: ")
        for answer in ("--on 1", f"--unit '{TEMPERATURE}=degC'"):
            if (told := type_in(folder, f"{line} {answer}")).exit_code == 0:
                break
    learned = type_in(folder, "model learn --traces export.csv --map columns.toml --out model --name machine")
    if learned.exit_code:
        raise click.ClickException(f"{told.output}\n{learned.output}")
    return asked


def _plant(folder: Path) -> None:
    """A plant file whose device has the model's signals by their names, and its temperature in degC."""
    model = read_model(folder / "model")
    names = [channel.signal for channel in model.alphabet.channels]
    tags = "".join(
        f'[[tags]]\nname = "{name}"\naddress = "holding:{2 * place}"\ndtype = "float32"\n'
        + ('unit = "degC"\n' if name == model.temperature else "")
        for place, name in enumerate(dict.fromkeys((*names, model.temperature)))
    )
    (folder / "plc.toml").write_text(f'[device]\nname = "pump"\ndriver = "modbus"\nunit = 1\n{tags}')
    (folder / "plant.toml").write_text(
        f'[device]\nfile = "plc.toml"\n[model]\npath = "model"\ntemperature = "{model.temperature}"\n'
        '[historian]\npath = "records/h.sqlite"\n'
        f'[alarms]\ntags = ["{model.temperature}"]\n'
    )


def walk(names: Sequence[str], home: Path) -> Iterator[tuple[str, bool, Sequence[tuple[str, str]]]]:
    """(kind, whether all was right, (command, what it said) one after the other)."""
    own, other = _columns(1), _columns(7)
    store = ""
    for name in ("a good one", *(name for name in names if name != "a good one")):
        change, words = KINDS[name]
        folder = home / str(len(list(home.iterdir())))
        folder.mkdir()
        write_export(folder / "export.csv", change(own, other))
        asked = _learn(folder)
        verdict = read_verdict(folder / "model")
        if verdict is None:
            raise click.ClickException(f"{name}: the model has no {VERDICT_FILE}")
        told = {"trace map": asked or "asks nothing", "model learn": verdict.sentence}
        right = verdict.word in words
        proof = type_in(folder, "model judge proof model")
        told["judge proof"] = f"exit {proof.exit_code}"
        store = store or str(folder.absolute() / "store")
        promoted = type_in(folder, f"model version promote {store} --add model")
        told["version promote"] = f"exit {promoted.exit_code}"
        _plant(folder)
        checked = type_in(folder, "plc check --offline --config plant.toml")
        told["plc check"] = f"exit {checked.exit_code}"
        unfit = verdict.word == "unfit"
        said = [" ".join(each.output.split()) for each in (proof, checked)]
        right &= (promoted.exit_code != 0) == unfit and (checked.exit_code != 0) >= unfit
        right &= not unfit or all("unfit" in text for text in said)
        yield name, right, tuple(told.items())


@click.command()
@click.argument("names", nargs=-1, metavar="[KIND]...")
def main(names: Sequence[str]) -> None:
    """Try them; leaves with 1 if a word is not right, or a command says another."""
    if unknown := [name for name in names if name not in KINDS]:
        raise click.UsageError(f"{unknown[0]!r} is no kind; these are: {', '.join(KINDS)}")
    wrong = 0
    with tempfile.TemporaryDirectory(prefix="unfit-") as home:
        for name, right, told in walk(names or tuple(KINDS), Path(home)):
            wrong += not right
            click.echo(f"{name}: {'right' if right else 'WRONG'}")
            for command, said in told:
                click.echo(f"    {command:16} {said}")
    click.echo(f"{wrong} wrong")
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
