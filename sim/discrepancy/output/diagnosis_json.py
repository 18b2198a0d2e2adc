"""`diagnosis.json`: what other programs read of a diagnosis, as strict JSON in which an undefined number is null."""

from dataclasses import asdict
from math import isfinite
from typing import Any

import numpy as np

from sim.discrepancy import LONGEST, Diagnosis, DiagnosisCourse, HeatPlace, HeldOutProof, NamedEffect, TriedEffect
from sim.strict_json import json_text, strict

FORMAT, VERSION = "decanter-diagnosis", 1


def document(diagnosis: Diagnosis) -> dict[str, Any]:
    """The diagnosis as JSON's own types. The keys from `verdict` to `model_after` are the stable interface.

    `sentence` and all that follows may gain keys. The course of the pictures is left out.
    """
    one = diagnosis
    held_out = None if one.held_out is None else _held_out(one.held_out)
    content = {
        "verdict": one.verdict,
        "effects": [_effect(effect) for effect in one.effects],
        "parameter_shift": [asdict(shift) for shift in one.shifts],
        "unexplained": [_place(place, one.course) for place in one.unexplained],
        "localisation": [_place(place, one.course) for place in one.places],
        "held_out": held_out,
        "model_before": one.model_before,
        "model_after": one.model_after,
        "format": FORMAT,
        "version": VERSION,
        "sentence": one.sentence,
        "reasons": one.reasons,
        "untested": one.untested,
        "candidates": [_candidate(candidate) for candidate in one.candidates],
        "ceiling": {"before": one.ceiling_before, "after": one.ceiling_after},
        "settings": one.settings,
    }
    return {key: strict(value) for key, value in content.items()}


def document_text(diagnosis: Diagnosis) -> str:
    """The document as indented strict JSON."""
    return json_text(document(diagnosis), indent=2) + "\n"


def _effect(one: NamedEffect) -> dict[str, Any]:
    return {
        "name": one.name,
        "class": one.members,
        "confidence": one.confidence,
        "gain_nats": one.gain,
        "parameters": one.params,
        "needs": list(dict.fromkeys(one.signals.values())),
        "distinguish_by": one.experiment,
        "plain": one.plain,
        "margin_nats": one.margin,
        "standard_errors": one.errors,
        "signals": one.signals,
        "signal_to_noise": one.signal_to_noise,
    }


def _place(one: HeatPlace, course: DiagnosisCourse | None) -> dict[str, Any]:
    """`cycles` as "9/11"; a span without an end goes to the longest time that was seen there."""
    low, high = one.seconds
    if not isfinite(high):
        high = _longest(one.location, course)
    return asdict(one) | {"seconds": [low, max(low, high)], "cycles": f"{one.cycles[0]}/{one.cycles[1]}"}


def _longest(location: str, course: DiagnosisCourse | None) -> float:
    """Seconds since the last start or stop that were seen in a location; 0 where none were."""
    if course is None:
        return 0.0
    since = course.since_event[np.array(course.location) == location]
    since = since[np.isfinite(since) & (since <= LONGEST)]
    return float(since.max()) if since.size else 0.0


def _candidate(one: TriedEffect) -> dict[str, Any]:
    fields = asdict(one)
    fields["gain_nats"] = fields.pop("gain")
    fields["parameters"] = fields.pop("params")
    fields["distinguish_by"] = fields.pop("experiment")
    return fields | {"cycles": f"{one.cycles[0]}/{one.cycles[1]}"}


def _held_out(one: HeldOutProof) -> dict[str, Any]:
    names = ("before", "after", "noise_floor")
    return asdict(one) | {"per_cycle": [dict(zip(names, row, strict=True)) for row in one.per_cycle]}
