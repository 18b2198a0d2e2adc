"""The gap workflow: from traces to a diagnosis, and the model with what was missing."""

from sim.discrepancy.advice import experiment_lines, in_words, law_sentence, look_at, overlap_sentence
from sim.discrepancy.augment import augmented
from sim.discrepancy.diagnosis import (
    Beginning,
    CandidateLaw,
    Diagnosis,
    DiagnosisCourse,
    HeatPlace,
    HeldOutProof,
    NamedEffect,
    ProposedExperiment,
    TriedEffect,
)
from sim.discrepancy.experiment import propose_experiment
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
    "ProposedExperiment",
    "TriedEffect",
    "augmented",
    "diagnose",
    "experiment_lines",
    "heat_map",
    "in_words",
    "law_sentence",
    "look_at",
    "overlap_sentence",
    "propose_experiment",
    "span",
]
