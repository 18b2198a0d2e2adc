"""`decanter demo`: the main job end to end on this machine."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.cli.model import learn_from, load, write
from gateway.cli.output import Exit, emit, fail, progress, sentences, table
from gateway.cli.places import config_dir, shipped

if TYPE_CHECKING:
    from gateway.demo.prepare import Setting
    from sim.sha.trace import Trace
    from sim.validation.column_map import ColumnMap


@click.command()
@click.option(
    "--trace",
    "paths",
    multiple=True,
    help="A recorded trace instead of the embedded synthetic ones; a file, folder or glob.",
)
@click.option(
    "--map",
    "map_name",
    default="decanter",
    show_default=True,
    help="Its column map: a TOML file, or a name in config/traces.",
)
@click.option("--limit", type=float, help="Alarm limit in °C.  [default: 80, or above what was learned from]")
@click.option(
    "--seconds",
    type=click.FloatRange(5, 3600),
    default=38.0,
    show_default=True,
    help="Real time for the replay, at most 100 times faster than it was.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/demo"), show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Only one JSON object at the end.")
def demo(
    paths: Sequence[str], map_name: str, limit: float | None, seconds: float, seed: int, out: Path, as_json: bool
) -> None:
    """Run the main job end to end: PLC over Modbus TCP, events, prediction, registers written back.

    A software PLC replays a trace and the gateway reads it over a real socket, as two processes. The model is learned
    before: from three synthetic days for the first hour of another one, or from the first 60 % of a trace of yours for
    the rest. Half way the PLC refuses its connections for two seconds.
    """
    from rich.console import Console

    from gateway.demo.play import play
    from gateway.demo.processes import DemoError
    from gateway.demo.summary import draw_result, result
    from gateway.demo.summary import sentences as said

    console = Console(stderr=as_json)
    if not console.is_terminal:
        console = Console(stderr=as_json, width=140)
    with sentences():
        setting = prepare(paths, map_name, limit, seconds, seed, out)
    for note in setting.notes:
        console.print(note, style="yellow")
    try:
        recording, historian = play(setting, console, quiet=as_json)
        picture = draw_result(setting, historian, out / "demo.png")
        data = result(setting, recording, historian, picture)
    except DemoError as error:
        fail(str(error), Exit.CHECK_FAILED)
    emit(data, lambda: show(data, said(data)), as_json_line=as_json)
    if data["wrong_good"]:
        fail(f"{data['wrong_good']} wrong values were held for good", Exit.CHECK_FAILED)


def prepare(
    paths: Sequence[str], map_name: str, limit: float | None, seconds: float, seed: int, out: Path
) -> "Setting":
    """Learn the model and write all files of the demonstration into `out`. Raises ValueError or OSError."""
    from gateway.demo.prepare import Setting, limit_for, pace, split, write_device, write_plant
    from sim.validation.trace_file import write_trace

    template = config_dir() / "devices" / "decanter_plc.toml"
    out.mkdir(parents=True, exist_ok=True)
    with progress("demo") as report:
        report("traces", 0.0)
        if paths:
            given, column_map = load(paths, map_name)
            training, replayed = split(given)
        else:
            training, replayed, column_map = _embedded(map_name, seed)
        learned = learn_from(training, column_map, name="demo", seed=seed, report=report)
        write(out / "model", learned)
    bound, note = limit_for(training, column_map.temperature, limit)
    speed, period = pace(replayed, seconds)
    write_trace(replayed, out / "replay.csv")
    units = {name: signal.unit for name, signal in column_map.signals.items()}
    foreign = bool(paths) and set(replayed.signals) - set(_mapped_tags(template))
    device = write_device(replayed, column_map.alphabet, units, template, out / "device.toml") if foreign else template
    plant = write_plant(out, device, column_map.temperature, bound, period)
    notes = tuple(filter(None, (_origin(replayed.synthetic, training, replayed), note)))
    return Setting(out, replayed, learned.model, device, plant, out / "replay.csv", bound, speed, period, notes)


def _origin(synthetic: bool, training: "Sequence[Trace]", replayed: "Trace") -> str:
    rows = sum(trace.times.size for trace in training)
    made = "SYNTHETIC data, not measured on a plant: " if synthetic else ""
    learned = f"learned from {len(training)} traces with {rows} rows"
    return f"{made}{learned}, replaying {replayed.times.size} rows of {replayed.name}"


def _embedded(map_name: str, seed: int) -> "tuple[list[Trace], Trace, ColumnMap]":
    """The synthetic history and the new day, encoded."""
    from dataclasses import replace

    from sim.plant.scenarios import history_and_day
    from sim.sha.events import encode
    from sim.validation.column_map import load_map

    column_map = load_map(shipped("traces", map_name))
    history, day = history_and_day(seed)
    encoded = [replace(trace, events=encode(trace, column_map.alphabet)) for trace in (*history, day)]
    return encoded[:-1], encoded[-1], column_map


def _mapped_tags(device: Path) -> list[str]:
    from gateway.devices import load_device

    return [tag.name for tag in load_device(device).tags]


def show(data: dict[str, Any], said: Sequence[str]) -> None:
    """Print the summary."""
    errors, written, outage = data["errors"], data["writeback"], data["outage"]
    latency = written["latency_ms"]
    rows = [
        ["events", data["events"]],
        ["samples kept", data["samples"]],
        [
            "free-run error (°C)",
            f"rmse {errors['free_run']['rmse']:.3f}, mean absolute {errors['free_run']['mae']:.3f}",
        ],
        [
            "one-step error (°C)",
            f"rmse {errors['one_step']['rmse']:.3f}, mean absolute {errors['one_step']['mae']:.3f}",
        ],
        ["blocks by the PLC's account", f"{written['accepted']} accepted, {written['refused']} refused"],
        ["scan to confirmed write (ms)", f"p50 {latency['p50']:.1f}, p99 {latency['p99']:.1f}"],
        ["outage", f"noticed after {_s(outage['detected_s'])}, good again {_s(outage['recovered_s'])} after its end"],
        ["wrong values held for good", f"{data['wrong_good']} of {data['judged']} judged by the PLC's recording"],
    ]
    made = "SYNTHETIC data, " if data["synthetic"] else ""
    table(
        f"summary: {made}{data['trace']}, {data['rows']} rows, {data['speed']:.0f} times real time",
        ("what", "figure"),
        rows,
    )
    for sentence in said:
        click.echo(sentence)
    click.echo(f"picture: {data['picture']}")
    click.echo(f"log: {data['log']}")


def _s(value: float | None) -> str:
    return "never" if value is None else f"{value:.2f} s"
