"""`model learn correction`: a calibration correction of a model, learned from traces that it was not fitted to."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from gateway.console import CommandResult, Part, Rows, conclude, progress
from gateway.entry import sentences
from gateway.lab.traces.load import load
from sim.artefacts import STORE_FILE, VERDICT_FILE, model_hash
from sim.lab.formats import find_model, save, write_model_directory
from sim.lab.learning import (
    FORMS,
    bite,
    corrected_model,
    learn_correction,
    learn_max_rate,
    with_max_rate,
)
from sim.sha import display_unit, encode_trace, joint_hash, signal_unit


def correct(
    name: str, paths: Sequence[str], map_name: str, out: Path, form: str, limit_rate: bool, as_json: bool
) -> None:
    """Carry out `decanter model learn correction`; its options and its help are in learning/commands.py."""
    with sentences(), progress("correcting") as report:
        traces, column_map = load(paths, map_name)
        found = find_model(name, alphabet=column_map.alphabet, temperature=column_map.temperature)
        model = found.runnable()
        parent = model_hash(model)
        # Artefacts of the public learner know no unit: then that of the traces is the model's.
        model = replace(model, unit=signal_unit(traces, model.temperature, model.unit))
        traces = [encode_trace(trace, model.alphabet) for trace in traces]
        wanted = [candidate for candidate in FORMS if form in ("best", candidate)]
        learned = learn_correction(model, traces, forms=wanted, progress=report)
        rate = bites = None
        if limit_rate:
            rate = learn_max_rate(traces, model.temperature)
            bites = bite(with_max_rate(replace(model, correction=learned.correction), rate), traces)
        accepted = learned.chosen is not None or (bites is not None and bites.accepted)
        written = None
        if accepted:
            new = corrected_model(model, learned, traces, parent)
            if rate is not None and bites is not None and bites.accepted:
                new = with_max_rate(new, rate)
            is_store = (out / STORE_FILE).is_file()
            # A correction mends the sensor's scale: what was judged of the model stays so.
            more = {} if found.verdict is None else {VERDICT_FILE: found.verdict.text()}
            written = (
                save(out, new, created=time.time(), more=more)
                if is_store
                else str(write_model_directory(out, new, more=more))
            )
    fits = []
    for fit in learned.fits:
        row = asdict(fit)
        fits.append({"form": fit.form, **row.pop("correction"), **{k: v for k, v in row.items() if k != "form"}})
    data = {
        "chosen": learned.chosen,
        "correction": asdict(learned.correction),
        "fits": fits,
        "unit": model.unit,
        "skipped": list(learned.skipped),
        "max_rate": None if rate is None or bites is None else asdict(rate) | asdict(bites),
        # Of the very traces that the model was learned from, the held-out error is none.
        "training traces": model.provenance.data_hash == joint_hash(traces),
        "written": written,
        "out": str(out) if written else None,
    }
    complaint = "" if accepted else f"nothing was accepted, so nothing was written: {learned.best.reason}"
    conclude(CommandResult(data, complaint), lambda _: _show(data), as_json=as_json)


def _show(data: dict[str, Any]) -> Iterator[Part]:
    unit = display_unit(data["unit"])
    columns = ("form", "gain", "gain_error", "offset", "offset_error", "before", "after", "improvement_error", "runs")
    yield Rows(
        f"T' = gain T + offset; mean absolute error of held-out runs ({unit})",
        columns,
        [[fit[key] for key in columns] for fit in data["fits"]],
    )
    for fit in data["fits"]:
        yield f"{fit['form']}: {'accepted' if fit['accepted'] else 'not accepted'}, {fit['reason']}"
    if data["max_rate"] is not None:
        limit = data["max_rate"]
        verdict = "accepted" if limit["accepted"] else "not accepted, as it makes the model worse"
        yield (
            f"max rate: {limit['rate']:.3g} {unit}/s, {limit['margin']:g} times what was seen; {limit['limited']} "
            f"steps meet it, error {limit['before']:.3g} without and {limit['after']:.3g} {unit} with it: {verdict}"
        )
    if data["training traces"]:
        yield "these are the traces that the model was learned from: held out here, but not for the model"
    if data["skipped"]:
        yield f"left out, with too few readings: {', '.join(data['skipped'])}"
    if data["written"]:
        yield f"written: {data['written']}"
