"""The gap workflow: from traces to a diagnosis, and the model with what was missing."""

from sim.discrepancy.advice import in_words, law_sentence, look_at, overlap_sentence
from sim.discrepancy.augment import augmented
from sim.discrepancy.diagnosis import (
    Beginning,
    CandidateLaw,
    Diagnosis,
    DiagnosisCourse,
    HeatPlace,
    HeldOutProof,
    NamedEffect,
    TriedEffect,
)
from sim.discrepancy.heat_maps import LONGEST, HeatMap, heat_map, span
from sim.discrepancy.workflow import DiagnosisOutcome, diagnose

__all__ = [
    "LONGEST",
    "Beginning",
    "CandidateLaw",
    "Diagnosis",
    "DiagnosisCourse",
    "DiagnosisOutcome",
    "HeatMap",
    "HeatPlace",
    "HeldOutProof",
    "NamedEffect",
    "TriedEffect",
    "augmented",
    "diagnose",
    "heat_map",
    "in_words",
    "law_sentence",
    "look_at",
    "overlap_sentence",
    "span",
]
