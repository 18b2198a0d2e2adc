"""The main job of `decanter demo`: learn, play, judge what came of it, and show that."""

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from gateway.console import CommandResult, Part, Rows, conclude, config_dir, progress, shipped_file
from gateway.demo.child import DemoError
from gateway.demo.folder import clear, hold_folder
from gateway.demo.heat import alarm_rows, headline
from gateway.demo.lead_time import AHEAD_S
from gateway.demo.links import LINKS
from gateway.demo.play import play
from gateway.demo.prepare import (
    MOST_SPEED,
    PLANT_LIMIT,
    DemoBearing,
    DemoRun,
    choose_limit,
    pace,
    predictable_tags,
    split,
    suits,
    write_device,
)
from gateway.demo.summary import BEARING_COLUMNS, bearing_row, findings, result
from gateway.entry import Exit, fail, sentences
from gateway.lab.learning.learn import learn_traces, write
from gateway.lab.traces.load import load
from sim.lab.learning import LearningError
from sim.lab.recordings import ColumnMap, load_map, write_trace
from sim.plant import heat_history, uncontrolled_heat_day
from sim.sha import Trace, encode

if TYPE_CHECKING:
    from sim.lab.learning.bins import Learned


def demonstrate(
    paths: Sequence[str],
    map_name: str,
    *,
    limit: float | None,
    seconds: float | None,
    seed: int,
    link: str,
    out: Path,
    as_json: bool,
) -> None:
    """Run the demonstration that `decanter demo` describes, with all its files in `out`, and conclude the command."""
    console = Console(stderr=as_json)
    if not console.is_terminal:
        console = Console(stderr=as_json, width=140)
    try:
        with interruptible(), sentences(), hold_folder(out):
            setting = prepare(paths, map_name, limit=limit, seconds=seconds, seed=seed, link=link, out=out)
            data = perform(setting, console, as_json=as_json)
    except KeyboardInterrupt:
        fail(
            f"stopped before the end; PLC and gateway are stopped too, and what there is lies in {out}",
            Exit.INTERRUPTED,
        )
    complaint = f"{data['wrong_good']} wrong values were held for good" if data["wrong_good"] else ""
    conclude(CommandResult(data, complaint), lambda _: show(data), as_json=as_json)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the demonstration as Ctrl-C does: with both processes stopped."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    ours = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def perform(setting: DemoRun, console: Console, *, as_json: bool) -> dict[str, Any]:
    """Play the demonstration, draw it, and give its figures; leaves with code 1 when a process fails."""
    for note in setting.notes:
        console.print(note, style="yellow", markup=False, highlight=False)
    try:
        recording, historian = play(setting, console, quiet=as_json)
        return result(setting, recording, historian, setting.folder / "demo.png")
    except DemoError as error:
        fail(str(error), Exit.CHECK_FAILED)


def prepare(
    paths: Sequence[str], map_name: str, *, limit: float | None, seconds: float | None, seed: int, link: str, out: Path
) -> DemoRun:
    """Learn the model and write all files of the demonstration into `out`. Raises ValueError or OSError."""
    template = config_dir() / "devices" / "decanter_plc.toml"
    notes: list[str] = []
    with progress("demo") as report:
        report("traces", 0.0)
        if paths:
            traces, column_map = load(paths, map_name)
            training, rest = split(traces)
        else:
            column_map = load_map(shipped_file("traces", map_name))
            trip = PLANT_LIMIT if limit is None else limit
            training = [replace(day, events=encode(day, column_map.alphabet)) for day in heat_history(seed, limit=trip)]
            rest = uncontrolled_heat_day(seed, limit=trip)
        # A map that was made for the trace has one block, of the temperature that the column map names.
        fits = suits(template, rest)
        tags = predictable_tags(template, rest, column_map.temperature) if fits else (column_map.temperature,)
        learned, refused = learn_each(tags, training, column_map, seed=seed, report=report)
        notes += refused
    clear(out)
    # The live plant's history reaches the limit and is tripped there: it is no reason for another one.
    bearings = []
    for tag, model in learned.items():
        bound, note = choose_limit(training if paths else [], tag, limit)
        folder = "model" if tag == tags[0] else f"model_{tag}"
        write(out / folder, model)
        bearings.append(DemoBearing(model=model.model, folder=folder, limit=bound))
        notes += [f"{tag}: {note}"] if note else []
    replayed, speed, period = pace(rest, seconds)
    if not paths and replayed.times.size < rest.times.size:
        least = np.ptp(rest.times) / MOST_SPEED
        raise ValueError(f"--seconds {seconds:g}: the bearing needs {least:.0f} s to run hot; give {least:.0f} or more")
    write_trace(replayed, out / "replay.csv")
    device, addresses = template, config_dir() / "devices" / LINKS[link].device if LINKS[link].device else None
    if not fits:
        if addresses is not None:
            raise ValueError(f"--link {link}: {addresses} has not all signals of this trace; give --link modbus for it")
        units = {name: signal.unit for name, signal in column_map.signals.items()}
        device = write_device(replayed, column_map.alphabet, units, template, out / "device.toml")
    # What people read first: that nothing of it was measured, what was learned from, what is replayed and for how long.
    caveat = "SYNTHETIC data, not measured on a plant: " if replayed.synthetic else ""
    cut = f" (of {rest.times.size}: --seconds ends it)" if replayed.times.size < rest.times.size else ""
    learned_from = f"learned from {len(training)} traces with {sum(trace.times.size for trace in training)} rows"
    origin = f"{caveat}{learned_from}, replaying {replayed.times.size} rows{cut} of {replayed.name}"
    if not paths:
        minutes = np.ptp(replayed.times) / 60
        origin = f"{caveat}{learned_from}; {minutes:.0f} min of another day run live, and the plant reacts to the PLC"
    lasts = f"it takes {np.ptp(replayed.times) / speed:.0f} s over {link}"
    return DemoRun(
        folder=out,
        trace=replayed,
        bearings=tuple(bearings),
        device=device,
        plant=out / "plant.toml",
        replay=out / "replay.csv",
        speed=speed,
        period=period,
        notes=(f"{origin}; {lasts}", *notes),
        link=link,
        addresses=addresses,
        live=not paths,
        seed=seed,
    )


def learn_each(
    tags: Sequence[str], training: Sequence[Trace], column_map: ColumnMap, *, seed: int, report: Any
) -> tuple[dict[str, "Learned"], list[str]]:
    """The model of each temperature, and a sentence for each further one that cannot be learned.

    The first is learned here and the others beside it, on the other cores. Raises LearningError for the first.
    """
    learn = partial(learn_traces, training, column_map, name="demo", seed=seed)
    if len(tags) == 1:
        return {tags[0]: learn(report=report)}, []
    # A child of its own, as a thread would share one core with this one. Ctrl-C reaches it too, and is for its parent
    # to act on: leaving the pool ends it.
    with get_context("spawn").Pool(1, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        beside = {tag: pool.apply_async(learn, (), {"temperature": tag}) for tag in tags[1:]}
        learned, refused = {tags[0]: learn(report=report)}, []
        for tag, work in beside.items():
            try:
                learned[tag] = work.get()
            except LearningError as error:
                refused.append(f"{tag} is not predicted: {error}")
    return learned, refused


def show(data: dict[str, Any]) -> Iterator[Part]:
    """Print the summary."""
    written, outage = data["writeback"], data["outage"]
    latency = written["latency_ms"]
    rows = [
        ["events", data["events"]],
        ["samples kept", data["samples"]],
        ["free-run error", _error(data["errors"]["free_run"])],
        ["one-step error", _error(data["errors"]["one_step"])],
        ["scan to confirmed write", f"p50 {latency['p50']:.1f} ms, p99 {latency['p99']:.1f} ms"],
        ["outage noticed", _delay_text(outage["detected_s"], "it began")],
        ["good readings again", _delay_text(outage["recovered_s"], "it ended")],
        ["wrong values held for good", f"{data['wrong_good']} of {data['judged']} judged by the PLC"],
    ]
    caveat = "SYNTHETIC data, " if data["synthetic"] else ""
    if (heat := data["heat"]) is not None:
        yield headline(heat)
        ahead = f"alarm: the limit within {AHEAD_S / 60:.0f} min"
        yield Rows("of the same readings", (ahead, "lead time", "false alarms"), alarm_rows(heat))
    title = f"summary: {caveat}{data['trace']}, {data['rows']} rows, {data['speed']:.0f} times real time"
    yield Rows(title, ("what", "figure"), rows)
    bearings = [bearing_row(bearing) for bearing in data["bearings"]]
    yield Rows("each bearing; blocks that the PLC has accepted/refused", BEARING_COLUMNS, bearings)
    yield from findings(data)
    yield f"picture: {data['picture']}"
    yield f"log: {data['log']}"


def _error(error: dict[str, float]) -> str:
    return f"rmse {error['rmse']:.3f} °C, mean absolute {error['mae']:.3f} °C"


def _delay_text(value: float | None, what: str) -> str:
    return "never" if value is None else f"{value:.2f} s after {what}"
