"""`diagnosis.json`: what other programs read of a diagnosis, as strict JSON in which an undefined number is null.

The missing heat over time is a table beside it, `missing_heat.csv`, which the document names.
"""

import io
from dataclasses import asdict
from math import isfinite
from typing import Any

import numpy as np

from drivers.csv_rows import write_rows
from sim.artefacts import effect_line_part
from sim.lab.discrepancy import (
    MAX_PHASE_S,
    CandidateLaw,
    Diagnosis,
    DiagnosisCourse,
    GapBeginning,
    HeatPlace,
    MissingHeat,
    NamedEffect,
    ProposedExperiment,
    TriedEffect,
    advice_lines,
    held_out_sentence,
    law_sentence,
)
from sim.strict_json import json_text, strict

FORMAT, VERSION = "decanter-diagnosis", 1
MISSING_HEAT_FILE = "missing_heat.csv"


def document(diagnosis: Diagnosis) -> dict[str, Any]:
    """The diagnosis as JSON's own types. The keys from `verdict` to `model_after` are the stable interface.

    `sentence` and all that follows may gain keys. The course of the pictures is left out.
    """
    held_out, floor = None, diagnosis.floor
    if diagnosis.held_out is not None:
        names = ("before", "after", "noise_floor")
        rows = [dict(zip(names, row, strict=True)) for row in diagnosis.held_out.per_cycle]
        held_out = asdict(diagnosis.held_out) | {"per_cycle": rows}
        held_out |= {"given": held_out.pop("rmse_given"), "refused_refit": held_out.pop("rmse_refit")}
        held_out["sentence"] = held_out_sentence(diagnosis)
    content: dict[str, Any] = {
        "verdict": diagnosis.verdict,
        "effects": [_effect(effect) for effect in diagnosis.effects],
        "parameter_shift": [asdict(shift) for shift in diagnosis.shifts],
        "unexplained": [_place(place, diagnosis.course) for place in diagnosis.unexplained],
        "localisation": [_place(place, diagnosis.course) for place in diagnosis.places],
        "held_out": held_out,
        "model_before": diagnosis.model_before,
        "model_after": diagnosis.model_after,
        "format": FORMAT,
        "version": VERSION,
        "sentence": diagnosis.sentence,
        "reasons": diagnosis.reasons,
        "floor": None if floor is None else {"value": floor.error, "interval": floor.interval, "from": floor.source},
        "material": diagnosis.material,
        "traces": [asdict(trace) for trace in diagnosis.traces],
        "absorbed": None if diagnosis.absorbed is None else asdict(diagnosis.absorbed),
        "untested": diagnosis.untested,
        "candidates": [_candidate(candidate) for candidate in diagnosis.candidates],
        "ceiling": {"before": diagnosis.ceiling_before, "after": diagnosis.ceiling_after},
        "settings": diagnosis.settings,
        "unit": diagnosis.unit,
        "laws": [_law(law) for law in diagnosis.laws],
        "look_at": advice_lines(diagnosis),
        "missing_heat": None if diagnosis.missing_heat is None else MISSING_HEAT_FILE,
    }
    if diagnosis.began is not None:
        content["began"] = _beginning(diagnosis.began)
    if diagnosis.none_of_these is not None:
        content["none_of_these"] = diagnosis.none_of_these
    if diagnosis.experiment is not None:
        content["experiment"] = _experiment(diagnosis.experiment)
    return {key: strict(value) for key, value in content.items()}


def document_text(diagnosis: Diagnosis) -> str:
    """The document as indented strict JSON."""
    return json_text(document(diagnosis), indent=2) + "\n"


def missing_heat_text(heat: MissingHeat) -> str:
    """The missing heat as CSV: `time` in seconds UTC, `mean`, `low` and `high` of its 95 % band in units of the
    temperature an hour, and 1 where the machine was `running` and where the window was `held_out`."""
    columns = [column.tolist() for column in (heat.times, heat.mean, heat.low, heat.high)]
    flags = [column.astype(int).tolist() for column in (heat.running, heat.held_out)]
    text = io.StringIO()
    write_rows(text, [("time", "mean", "low", "high", "running", "held_out")])
    write_rows(
        text,
        (
            (f"{time:.3f}", f"{mean:.6g}", f"{low:.6g}", f"{high:.6g}", running, held_out)
            for time, mean, low, high, running, held_out in zip(*columns, *flags, strict=True)
        ),
    )
    return text.getvalue()


def _beginning(began: GapBeginning) -> dict[str, Any]:
    fields = asdict(began)
    return fields | {"cycles": {"before": fields.pop("before"), "after": fields.pop("after")}}


def _experiment(proposed: ProposedExperiment) -> dict[str, Any]:
    """`steps` are done `repeats` times, which takes `seconds` in all; a step of 0 seconds goes with the next one."""
    return {
        "what": proposed.what,
        "steps": [asdict(step) for step in proposed.steps],
        "repeats": proposed.repeats,
        "seconds": proposed.seconds,
        "nats": [
            {"pair": [pair.one, pair.other], "expected": pair.nats, "at_most": pair.most, "needs_rows_of_s": pair.rows}
            for pair in proposed.pairs
        ],
        "needed_nats": proposed.needed,
        "least_nats": proposed.least,
        "enough": proposed.enough,
    }


def _effect(effect: NamedEffect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "class": effect.members,
        "confidence": effect.confidence,
        "gain_nats": effect.gain,
        "parameters": effect.params,
        "needs": list(dict.fromkeys(effect.signals.values())),
        "distinguish_by": effect.experiment,
        "plain": effect.plain,
        "margin_nats": effect.margin,
        "standard_errors": effect.errors,
        "signals": effect.signals,
        "signal_to_noise": effect.signal_to_noise,
        "shrinking_shown": effect.shrinking_shown,
    }


def _law(law: CandidateLaw) -> dict[str, Any]:
    """`parameters` are those of the expression, `line` the effect that may be adopted, null where no engine has it."""
    return {
        "expression": law.expression,
        "parameters": {"gain": law.strength},
        "running": law.running,
        "share": law.share,
        "cycles": f"{law.cycles[0]}/{law.cycles[1]}",
        "tried": law.tried,
        "gain_nats": law.gain,
        "alike": law.alike,
        "distinguish_by": law.experiment,
        "sentence": law_sentence(law),
        "line": None if law.line is None else effect_line_part(law.line),
    }


def _place(place: HeatPlace, course: DiagnosisCourse | None) -> dict[str, Any]:
    """`cycles` as "9/11"; a span without an end goes to the longest time that was seen there."""
    low, high = place.seconds
    if not isfinite(high):
        since = np.empty(0) if course is None else course.since_event[np.array(course.location) == place.location]
        since = since[np.isfinite(since) & (since <= MAX_PHASE_S)]
        high = float(since.max()) if since.size else 0.0
    return asdict(place) | {"seconds": [low, max(low, high)], "cycles": f"{place.cycles[0]}/{place.cycles[1]}"}


def _candidate(candidate: TriedEffect) -> dict[str, Any]:
    fields = asdict(candidate)
    fields["gain_nats"] = fields.pop("gain")
    fields["parameters"] = fields.pop("params")
    fields["distinguish_by"] = fields.pop("experiment")
    return fields | {"cycles": f"{candidate.cycles[0]}/{candidate.cycles[1]}"}
