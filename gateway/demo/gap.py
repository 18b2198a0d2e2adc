"""`decanter demo --discrepancy`: a plant that changes unseen; the hidden effect found, named, added to the model."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gateway.console import CommandResult, Part, conclude, make_folder, progress, shipped_file
from gateway.demo.folder import hold_folder
from gateway.entry import sentences
from gateway.lab.gap.diagnose import DiagnosisRequest, run, signal_roles
from gateway.lab.learning.learn import learn_traces, write
from sim.lab.discrepancy import MIN_LISTED_SHARE
from sim.lab.discrepancy.output import check_folder, document
from sim.lab.recordings import load_map, write_trace
from sim.plant import CooledPlant, cooled_days
from sim.sha import Alphabet, Trace, encode

HIDDEN = "pump-cooling"
COOLING_PER_S = 7e-5
"""1/s: what the hidden cooling takes from the bearing, an eighth of its own loss."""
DAYS_BEFORE, DAYS_AFTER, DAYS_BETWEEN = 3, 4, 30
"""Days that the model is learned from, days that are diagnosed, and days that lie between their beginnings."""
SAMPLE_PERIOD_S = 20.0

Report = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Days:
    """The encoded traces before the change and after it."""

    before: list[Trace]
    after: list[Trace]


def days(seed: int, alphabet: Alphabet) -> Days:
    """Days of one plant, without the cooling and, a month later, with it; no seed is shared."""
    before = cooled_days(DAYS_BEFORE, seed=seed, period=SAMPLE_PERIOD_S)
    after = cooled_days(
        DAYS_AFTER, seed=seed, first_day=DAYS_BETWEEN, period=SAMPLE_PERIOD_S, plant=CooledPlant(cooling=COOLING_PER_S)
    )
    return Days(*([replace(trace, events=encode(trace, alphabet)) for trace in part] for part in (before, after)))


def figures(document: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """What was found, as one object: `right` where the hidden effect (or its class) was named and nothing else."""
    named = [name for effect in document["effects"] for name in effect["class"]]
    first = document["effects"][0]["class"] if document["effects"] else []
    return {
        "synthetic": True,
        "hidden": HIDDEN,
        "verdict": document["verdict"],
        "sentence": document["sentence"],
        "named": named,
        "right": HIDDEN in first and len(document["effects"]) == 1,
        "wrong": bool(named) and HIDDEN not in named,
        "shrinking_shown": all(effect["shrinking_shown"] for effect in document["effects"]),
        "held_out": document["held_out"],
        "localisation": document["localisation"],
        "model_before": document["model_before"],
        "model_after": document["model_after"],
        "report": str(folder / "report.html"),
        "picture": str(folder / "diagnosis.png"),
    }


def summary_lines(data: Mapping[str, Any]) -> list[str]:
    """What the figures say."""
    held = data["held_out"]
    lines = [f"hidden in the plant: {data['hidden']}; the model was learned before it", f"found: {data['sentence']}"]
    if data["localisation"]:
        place = data["localisation"][0]
        where = f"{place['location']}, {place['share']:.0%}, {place['cycles']} cycles"
        lines.append(
            f"where most of the heat was: {where if place['share'] >= MIN_LISTED_SHARE else 'no particular place'}"
        )
    if held and data["named"]:
        shrinks = "the gap shrinks" if data["shrinking_shown"] else "that the gap shrinks is not shown"
        lines.append(f"{shrinks} on cycles that were never fitted: {held['sentence']}")
    if data["right"]:
        lines.append("the hidden effect was found, and nothing else was named")
    else:
        lines.append("THE WRONG EFFECT WAS NAMED" if data["wrong"] else "the hidden effect was not clearly named")
    return lines


MAX_NAMED_EFFECTS = 3
"""Effects that may be named."""


def demonstrate(seed: int, out: Path, *, as_json: bool) -> None:
    """Run it in `out` and say what came out; leaves with code 1 when a wrong effect was named."""
    with sentences(), hold_folder(out):
        data = perform(seed, out)
    complaint = "an effect was named that is not the hidden one" if data["wrong"] else ""
    conclude(CommandResult(data, complaint), lambda _: show(data), as_json=as_json)


def perform(seed: int, out: Path) -> dict[str, Any]:
    """Learn the model before the change and diagnose it after; the figures. Raises ValueError or OSError."""
    column_map, folder, before = load_map(shipped_file("traces", "decanter")), out / "diagnosis", out / "model_before"
    check_folder(folder, before)
    plant = days(seed, column_map.alphabet)
    for name, traces in (("before", plant.before), ("after", plant.after)):
        make_folder(out / name)
        for trace in traces:
            write_trace(trace, out / name / f"{trace.name}.csv")
    with progress("learning before the change") as report:
        # Without bands, for which the model would be fitted three times more: a diagnosis does not look at them.
        learned = learn_traces(plant.before, column_map, name="bearing", seed=seed, report=report, bands=False)
    write(before, learned)
    request = DiagnosisRequest(
        where=str(before), out=folder, source=str(out / "after"), seed=seed, most=MAX_NAMED_EFFECTS, created=time.time()
    )
    with progress("diagnosing after it") as report:
        result = run(request, learned.model, plant.after, signal_roles(column_map, learned.model), report)
    return figures(document(result.diagnosis), folder)


def show(data: dict[str, Any]) -> Iterator[Part]:
    """Print the summary."""
    yield "decanter demo: a hidden effect (SYNTHETIC data, not measured on a plant)"
    for sentence in summary_lines(data):
        yield f"  {sentence}"
    if data["model_after"]:
        yield f"new model: {data['model_after']}"
    yield f"picture: {data['picture']}"
    yield f"report: {data['report']}"
