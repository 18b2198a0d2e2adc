"""The gap workflow: from traces to a diagnosis, and the model with what was missing."""

from sim.lab.discrepancy.advice import (
    LEAST_TOLD_SHARE,
    experiment_lines,
    in_words,
    law_sentence,
    look_at,
    overlap_sentence,
    told_places,
)
from sim.lab.discrepancy.augment import augmented
from sim.lab.discrepancy.diagnosis import (
    CandidateLaw,
    Diagnosis,
    DiagnosisCourse,
    GapBeginning,
    HeatPlace,
    HeldOutProof,
    MissingHeat,
    NamedEffect,
    NoiseFloor,
    ProposedExperiment,
    TriedEffect,
)
from sim.lab.discrepancy.experiment import propose_experiment
from sim.lab.discrepancy.heat_maps import LONGEST, HeatMap, heat_map, span
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.discrepancy.story import (
    beginning_sentence,
    floor_sentence,
    held_out_count,
    held_out_sentence,
    shown_time,
)
from sim.lab.discrepancy.workflow import DiagnosisOutcome, diagnose

__all__ = [
    "LEAST_TOLD_SHARE",
    "LONGEST",
    "CandidateLaw",
    "DecisionRules",
    "Diagnosis",
    "DiagnosisCourse",
    "DiagnosisOutcome",
    "GapBeginning",
    "HeatMap",
    "HeatPlace",
    "HeldOutProof",
    "MissingHeat",
    "NamedEffect",
    "NoiseFloor",
    "ProposedExperiment",
    "TriedEffect",
    "augmented",
    "beginning_sentence",
    "diagnose",
    "experiment_lines",
    "floor_sentence",
    "heat_map",
    "held_out_count",
    "held_out_sentence",
    "in_words",
    "law_sentence",
    "look_at",
    "overlap_sentence",
    "propose_experiment",
    "shown_time",
    "span",
    "told_places",
]
