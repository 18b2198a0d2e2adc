"""Recordings of a dozen public repositories, mapped, shown, learned and forecast as by somebody who sees them first.

\b
python -m benchmarks.public_sets FOLDER --out DIR            # each set in processes of its own
python -m benchmarks.public_sets FOLDER --only pv --out DIR  # one of them

FOLDER holds clones of the repositories, each in a folder owner+name; `--sources` prints what to clone. A set that is
not there is left out, with the reason. What is right was read from the raw files, without this program.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import isclose
from pathlib import Path
from typing import Any

import click
import numpy as np

ROOT = Path(__file__).parents[1]
LIMIT_S = 600.0
"""Seconds after which a command is ended."""
MOMENTS = 60
"""Forecasts of a trace at most."""
MIN_HORIZON_S = 60.0
STEPS = (1, 5, 15)
"""Horizons in steps of the recording, of a minute at least."""
LEARNED_SHARE = 2 / 3
"""Of each trace, from its beginning; the rest is held out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublicSet:
    """Files of a public repository at a `commit`, what it records, and what is true of them.

    `answers` are options in the order in which a person would be asked. Of the `temperature`'s readings `readings` are
    numbers, the first at `first` and the last at `last` (UTC, or s of the file's clock), with the mean `mean` (degC),
    over the time where they are stored on change. `loads` may stand for what loads the machine, "" for nothing.
    """

    name: str
    repository: str
    commit: str
    files: str
    what: str
    temperature: str
    readings: int
    first: str | float
    last: str | float
    mean: float
    loads: tuple[str, ...]
    answers: tuple[tuple[str, str], ...] = ()
    on_change: bool = False
    traces: int = 1

    def sources(self, folder: Path) -> list[Path]:
        """Its files, none where the repository is not there."""
        return sorted((folder / self.repository.replace("/", "+")).glob(self.files))


SETS = (
    PublicSet(
        name="heat pump",
        repository="Peccz/nibe_autotuner",
        commit="271c99e457f7e2bc8986eaa8edaf5403ca077c68",
        files="data_input/*_to_2025-11-12_*.csv",
        what="ground source heat pump (Sweden), a file a tag, on change, last row by another clock",
        temperature="Supply line (BT2)",
        readings=1089,
        first="2025-10-31T23:01:15",
        last="2025-11-12T08:23:45",
        mean=28.952,
        loads=("Current compressor frequency",),
        answers=(
            ("--temperature", "Supply line (BT2)"),
            ("--current", "Current compressor frequency"),
            ("--stored", "on change"),
        ),
        on_change=True,
    ),
    PublicSet(
        name="solar module",
        repository="wackypiyush/Solar_Plants",
        commit="751ee1e2e906deff1c146f9db6c0b6e000271b8e",
        files="Plant_1_Weather_Sensor_Data.csv",
        what="photovoltaic plant (India), 15 min, American dates",
        temperature="MODULE_TEMPERATURE",
        readings=3182,
        first="2020-05-15T00:00:00",
        last="2020-06-17T23:45:00",
        mean=31.091,
        loads=("IRRADIATION",),
        answers=(("--temperature", "MODULE_TEMPERATURE"), ("--current", "IRRADIATION")),
    ),
    PublicSet(
        name="office",
        repository="ahmetaydin-aa/room-occupancy-detection",
        commit="7526002dcbf8c2503eb0ebdb7675b4298fbf0695",
        files="datatraining.txt",
        what="heated office (Belgium), a minute",
        temperature="Temperature",
        readings=8143,
        first="2015-02-04T17:51:00",
        last="2015-02-10T09:33:00",
        mean=20.6191,
        loads=("Light", "Occupancy"),
        answers=(("--current", "Light"), ("--running", "Occupancy")),
    ),
    PublicSet(
        name="car",
        repository="yudhi-chen/OBD_viewer",
        commit="85cf2fb5da5e1201d5af89d0dc5e1d357f4c60f6",
        files="trackLog.csv",
        what="engine by a phone's OBD logger, 179 columns, '-' for no reading",
        temperature="Engine Coolant Temperature",
        readings=2650,
        first="2022-02-23T06:34:39.373",
        last="2022-02-23T07:18:48.374",
        mean=87.5728,
        loads=("Engine RPM", "Engine Load", "Engine kW", "Engine kW (At the wheels)"),
        answers=(
            ("--temperature", "Engine Coolant Temperature(°C)"),
            ("--current", "Engine RPM(rpm)"),
            ("--stored", "each row"),
        ),
    ),
    PublicSet(
        name="graphics card",
        repository="MateusRodriguesCosta/AMDdebug",
        commit="2a8a9c470fd6f1b2c9a7050e1552d19288bb94ca",
        files="GPU-Z Sensor Log.txt",
        what="graphics card, 1 s, Latin-1, two sessions, frequencies that are called clocks",
        temperature="GPU Temperature",
        readings=1673,
        first="2020-03-16T17:13:05",
        last="2020-03-18T18:55:58",
        mean=51.5834,
        loads=("GPU Chip Power Draw", "GPU Load"),
        answers=(("--temperature", "GPU Temperature"), ("--current", "GPU Chip Power Draw [W]")),
    ),
    PublicSet(
        name="district heat",
        repository="maltefritz/SWSH",
        commit="4b90fd47c7a75d1dd141f1e95dc33fb07dd55359",
        files="Eingangsdaten/district-heating-network-data-flensburg-2016.csv",
        what="district heating network (Germany), an hour for a year, day first",
        temperature="Feed flow temperature in °C",
        readings=8784,
        first="2016-01-01T00:00:00",
        last="2016-12-31T23:00:00",
        mean=91.1257,
        loads=("Overall heat load in MW",),
    ),
    PublicSet(
        name="chillers",
        repository="AAustinFAN/huarunCOP",
        commit="bbcd48dffa3dec0b03f50f940b973d0b996c08e3",
        files="data/chiller.csv",
        what="four chillers (China), an hour, GB 18030, Chinese months, AM and PM beside 24 hours",
        temperature="HR_SYS/冷机1LDS出水温度",
        readings=4361,
        first="2021-01-01T00:00:00",
        last="2021-07-01T16:00:00",
        mean=18.4845,
        loads=("HR_SYS/冷水机1实际负荷",),
        answers=(
            ("--temperature", "HR_SYS/冷机1LDS出水温度"),
            ("--current", "HR_SYS/冷水机1实际负荷 (%)"),
            ("--stored", "each row"),
        ),
    ),
    PublicSet(
        name="notebook",
        repository="HunterAnnan/hwinfo_plotter",
        commit="218c4a33406b9a9d810fb1962d1894d038e11bfb",
        files="raw_data/DellLatitude_varioustasks.CSV",
        what="a notebook's processor, 2 s, 208 columns, several of one name, Latin-1",
        temperature="Core Temperatures (avg)",
        readings=1748,
        first="2022-09-06T16:14:58.738",
        last="2022-09-06T17:14:40.717",
        mean=63.8833,
        loads=("CPU Package Power", "Core Clocks (avg)", "Total System Power"),
        answers=(("--temperature", "Core Temperatures (avg) [°C]"), ("--current", "CPU Package Power [W]")),
    ),
    PublicSet(
        name="boiler",
        repository="DevYadC/boiler-data-analysis",
        commit="420f725bf9ec3cb8856b8858579f683e47cd3c82",
        files="B2_Cleaned_CEC_Data_2021.csv",
        what="a campus' gas boiler (Canada), an hour for a year, kelvin, gaps",
        temperature="Campus Energy Centre Boiler B-2 Leaving Water Temp",
        readings=7071,
        first="2021-01-01T00:00:00",
        last="2021-12-31T22:00:00",
        mean=87.7196,
        loads=("Campus Energy Centre Boiler B-2 Power", "Campus Energy Centre Boiler B-2 Firing Rate"),
        answers=(
            ("--temperature", "Campus Energy Centre Boiler B-2 Leaving Water Temp (K)"),
            ("--current", "Campus Energy Centre Boiler B-2 Power (MW)"),
            ("--stored", "each row"),
        ),
    ),
    PublicSet(
        name="home boiler",
        repository="konradmakosa/vaillant",
        commit="5d7298e3f40161b29b9d915b252c2b25bd988599",
        files="data/boiler_*.csv",
        what="a home's boiler (Poland), two months in two files, states in words, a column that came later",
        temperature="circuit_flow_temp_c",
        readings=733,
        first="2026-02-13T11:29:31",
        last="2026-03-07T21:34:05",
        mean=43.2879,
        loads=("",),
        answers=(
            ("--temperature", "circuit_flow_temp_c"),
            ("--running", "circuit_state"),
            ("--on", "HEATING"),
            ("--current", "none"),
            ("--stored", "each row"),
        ),
    ),
    PublicSet(
        name="processor module",
        repository="daspronoy/zetascope-codes",
        commit="7fe535fae733218c0ba722e0ff083664096eafe7",
        files="gpu_stats.csv",
        what="a Jetson Orin at full load, a minute, dates month first with dashes",
        temperature="temperature.gpu",
        readings=590,
        first="2026-03-11T15:13:16",
        last="2026-03-12T01:02:18",
        mean=48.6476,
        loads=("",),
    ),
    PublicSet(
        name="battery cell",
        repository="ImperialCollegeLondon/PyProBE",
        commit="b6302b79c34a2748c2aee90e217457b0977339cb",
        files="tests/sample_data/LGM50/*.parquet",
        what="a cell on a cycler (Britain), Parquet, uneven steps",
        temperature="Temperature",
        readings=81661,
        first=0.0,
        last=108211.109,
        mean=26.1569,
        loads=("Current",),
        answers=(("--stored", "each row"),),
    ),
)


@dataclass(frozen=True, slots=True)
class Spent:
    """What a command said (JSON), its error, processor seconds and memory at its most (MB)."""

    said: dict[str, Any]
    error: str
    seconds: float
    peak_mb: float


def run_command(words: Sequence[str]) -> Spent:
    """A command of this program in a process of its own, with its processor time and memory."""
    process = subprocess.Popen(
        [sys.executable, *words], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stderr is not None
    with process.stdout as out, process.stderr as errors:
        text, error = out.read(), errors.read()
    _, _, used = os.wait4(process.pid, 0)
    said = json.loads(text) if text.startswith("{") else {}
    return Spent(said, error.strip(), used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def decanter(*words: str | Path) -> Spent:
    """`decanter` with these words, and --json."""
    return run_command(["-m", "decanter_gateway", *map(str, words), "--json"])


def ask_map(each: PublicSet, source: Path, out: Path) -> tuple[Spent, list[str], str]:
    """The drafted map, the options that were asked for, and what stood in the way at last."""
    given: list[str] = []
    left = list(each.answers)
    while True:
        done = decanter("trace", "map", source, "-o", out, "--overwrite", *given)
        if done.said.get("ok"):
            return done, given[::2], ""
        known = next((answer for answer in left if f"give {answer[0]}" in done.error), None)
        if known is None:
            return done, given[::2], done.error
        left.remove(known)
        given += known


def find_faults(each: PublicSet, column_map: Path, source: Path) -> list[str]:
    """What the map reads otherwise than a person does."""
    from sim.lab.recordings import load_map, load_traces

    read = load_map(column_map)
    traces, _ = load_traces(source, read)
    wanted = each.temperature.replace(" ", "_")
    faults = [] if read.temperature == wanted else [f"temperature {read.temperature}"]
    values = np.concatenate([trace.signals[read.temperature] for trace in traces])
    times = np.concatenate([trace.times for trace in traces])[np.isfinite(values)]
    values = values[np.isfinite(values)]
    if not each.on_change and values.size != each.readings:
        faults.append(f"{values.size} readings of {each.readings}")
    for what, moment, true in (("first", times[0], each.first), ("last", times[-1], each.last)):
        at = true if isinstance(true, float) else datetime.fromisoformat(true).replace(tzinfo=UTC).timestamp()
        if abs(moment - at) > (60.0 if each.on_change else 0.01):
            faults.append(f"{what} reading at {moment:.3f}, not {at:.3f}")
    # Held values stand also in the rows of other tags: time counts.
    weights = np.diff(times, append=times[-1]) if each.on_change else np.ones(times.size)
    mean = float(np.average(values, weights=weights))
    if not isclose(mean, each.mean, rel_tol=2e-3 if each.on_change else 1e-4):
        faults.append(f"mean {mean:.4f}, not {each.mean:.4f}")
    text = column_map.read_text(encoding="utf-8")
    loads = [line.split("signal = ")[1].split('"')[1] for line in text.splitlines() if 'kind = "bins"' in line]
    if (loads or [""])[0] not in {load.replace(" ", "_") for load in each.loads}:
        faults.append(f"loaded by {', '.join(loads) or 'nothing'}")
    if ('stored = "on change"' in text) != each.on_change:
        faults.append("stored otherwise")
    if len(traces) != each.traces:
        faults.append(f"{len(traces)} traces")
    return faults


def judge(column_map: Path, source: Path) -> dict[str, Any]:
    """A model of the first part of each trace, and its forecasts of the rest beside persistence, in this process."""
    import decanter_gateway as door

    whole = door.read(source, column_map)
    past, rest = (_part(whole, first=first) for first in (True, False))
    step = float(np.median(np.concatenate([np.diff(trace.times) for trace in whole.traces])))
    horizons = [count * max(step, MIN_HORIZON_S) for count in STEPS]
    model = door.learn(past)
    judged = door.judge(
        model, rest, horizons=horizons, period=horizons[0], moments=MOMENTS, scan=min(max(step, 1.0), horizons[0])
    )
    rows = json.loads(judged.by_horizon.to_json(orient="records"))
    return {"ok": True, "horizons": horizons, "rows": rows, "verdict": model.verdict, "said": [*judged.sentences]}


def _part(whole: Any, *, first: bool) -> Any:
    """The first part of each trace of a recording, or the rest."""
    from sim.sha import encode

    traces = []
    for trace in whole.traces:
        until = trace.times[0] + LEARNED_SHARE * (trace.times[-1] - trace.times[0])
        own = trace.between(-np.inf, until) if first else trace.between(until, np.inf)
        traces.append(replace(own, events=encode(own, whole.column_map.alphabet)))
    return replace(whole, traces=tuple(trace for trace in traces if trace.times.size > 1))


def try_set(each: PublicSet, folder: Path, out: Path, *, forecast: bool) -> dict[str, Any]:
    """All that a newcomer does with a set: a row of the table as JSON's own types."""
    out.mkdir(parents=True, exist_ok=True)
    files = each.sources(folder)
    source = files[0]
    if len(files) > 1:
        source = out / "files"
        shutil.rmtree(source, ignore_errors=True)
        source.mkdir()
        for file in files:
            shutil.copy(file, source)
    column_map = out / "map.toml"
    mapped, asked, error = ask_map(each, source, column_map)
    row: dict[str, Any] = {"set": each.name, "asked": asked, "map": [mapped.seconds, mapped.peak_mb], "refused": error}
    if error:
        return row
    row["rows"] = [mapped.said["rows"], mapped.said["of"]]
    row["faults"] = find_faults(each, column_map, source)
    shown = decanter("trace", "show", source, "--map", column_map)
    row["show"] = [shown.seconds, shown.peak_mb]
    if not forecast:
        return row
    own = ("-m", "benchmarks.public_sets", str(folder), "--judge", str(column_map), str(source))
    judged = run_command(own)
    row["judge"] = [judged.seconds, judged.peak_mb]
    row["forecast"] = judged.said or {"error": judged.error.splitlines()[-1:]}
    return row


COLUMNS = (
    "set", "rows used", "asked", "right", "horizons (s)", "CRPS, ours / persistence (degC)", "coverage",
    "map (s, MB)", "show (s, MB)", "learn and judge (s, MB)",
)  # fmt: skip


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as one markdown table, and what each set is."""
    lines = [COLUMNS, tuple("-" * 3 for _ in COLUMNS), *(_cells(row) for row in rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    asked = ", ".join(row["asked"]) or "nothing"
    cost = ["{:.0f}, {:.0f}".format(*row[each]) if each in row else "" for each in COSTS]
    if row["refused"]:
        return row["set"], "", asked, f"refused: {row['refused']}", "", "", "", cost[0], "", ""
    used, every = row["rows"]
    right = "; ".join(row["faults"]) or "yes"
    forecast = row.get("forecast", {"error": ""})
    if "error" in forecast:
        return row["set"], f"{used} of {every}", asked, right, "", f"{forecast['error']}", "", *cost
    found = forecast["rows"]
    own, still = ([each for each in found if (each["method"] == PERSISTENCE) == flag] for flag in (False, True))
    crps = "; ".join(f"{a['crps']:.3g} / {b['crps']:.3g}" for a, b in zip(own, still, strict=True))
    cover = "; ".join(f"{a['coverage']:.2f}" for a in own)
    horizons = "; ".join(f"{each['horizon']:g}" for each in own)
    return row["set"], f"{used} of {every}", asked, right, horizons, crps, cover, *cost


COSTS = ("map", "show", "judge")
PERSISTENCE = "persistence"


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--only", type=click.Choice([each.name for each in SETS]), multiple=True, help="This set.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Where maps and results go.")
@click.option("--maps", is_flag=True, help="Without learning and forecasts, which take most of the time.")
@click.option("--sources", is_flag=True, help="Print what each set is and where it comes from, and end.")
@click.option("--judge", "judged", nargs=2, type=click.Path(path_type=Path), hidden=True)
def main(
    folder: Path, only: Sequence[str], out: Path | None, maps: bool, sources: bool, judged: tuple[Path, Path] | None
) -> None:
    """The command."""
    if judged is not None:
        click.echo(json.dumps(judge(*judged)))
        return
    if sources:
        for each in SETS:
            click.echo(f"| {each.name} | {each.what} | {each.repository}@{each.commit[:8]} | `{each.files}` |")
        return
    if out is None:
        raise click.UsageError("give --out, where maps and results go")
    rows = []
    for each in SETS:
        if only and each.name not in only:
            continue
        if not each.sources(folder):
            click.echo(f"{each.name}: left out, {folder} has no {each.repository.replace('/', '+')}", err=True)
            continue
        rows.append(try_set(each, folder, out / each.name.replace(" ", "_"), forecast=not maps))
        text = json.dumps(rows[-1], indent=1) + "\n"
        (out / f"{each.name.replace(' ', '_')}.json").write_text(text, encoding="utf-8")
    click.echo(table(rows))


if __name__ == "__main__":
    main()
