"""The gap workflow: from traces to a diagnosis, and the model with what was missing."""

from sim.lab.discrepancy.advice import (
    MIN_LISTED_SHARE,
    advice_lines,
    experiment_lines,
    law_sentence,
    overlap_sentence,
    told_places,
)
from sim.lab.discrepancy.augment import augment_model
from sim.lab.discrepancy.diagnosis import (
    CandidateLaw,
    Diagnosis,
    DiagnosisCourse,
    GapBeginning,
    HeatPlace,
    HeldOutProof,
    MissingHeat,
    NamedEffect,
    ProposedExperiment,
    TriedEffect,
)
from sim.lab.discrepancy.experiment import propose_experiment
from sim.lab.discrepancy.heat_maps import MAX_PHASE_S, HeatMap, heat_map, span
from sim.lab.discrepancy.story import (
    beginning_sentence,
    floor_sentence,
    held_out_count,
    held_out_sentence,
)
from sim.lab.discrepancy.workflow import DiagnosisOutcome, diagnose
