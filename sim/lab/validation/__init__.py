"""The nine stages of validation, their campaign and their report."""

from sim.lab.validation.campaign import Progress, outcomes_by_model, run_here, run_there, unread
from sim.lab.validation.campaign_run import CampaignPlan, conduct
from sim.lab.validation.fitness import (
    Facts,
    Finding,
    Fitness,
    FitnessLimits,
    findings_of,
    fitness_of,
    fitness_sentence,
    judge,
    limits_of,
    why,
)
from sim.lab.validation.metrics import QUANTILES
from sim.lab.validation.output_folder import CAMPAIGN, LEARNED, check_folder, claim_folder, held, read_results
from sim.lab.validation.plots import MEASURED, Curve, Picture, draw
from sim.lab.validation.report import CampaignSummary, natural
from sim.lab.validation.results import TraceResult
from sim.lab.validation.seen import TRAINED_ON, Seen
from sim.lab.validation.stage_records import load_stage
from sim.lab.validation.stages import Prepared, Wanted, prepare, relabelled
from sim.lab.validation.trace_run import TROUBLE, TraceJob, TraceRunSettings, run_job
from sim.lab.validation.verdicts import gain, summaries, verdict

__all__ = [
    "CAMPAIGN",
    "LEARNED",
    "MEASURED",
    "QUANTILES",
    "TRAINED_ON",
    "TROUBLE",
    "CampaignPlan",
    "CampaignSummary",
    "Curve",
    "Facts",
    "Finding",
    "Fitness",
    "FitnessLimits",
    "Picture",
    "Prepared",
    "Progress",
    "Seen",
    "TraceJob",
    "TraceResult",
    "TraceRunSettings",
    "Wanted",
    "check_folder",
    "claim_folder",
    "conduct",
    "draw",
    "findings_of",
    "fitness_of",
    "fitness_sentence",
    "gain",
    "held",
    "judge",
    "limits_of",
    "load_stage",
    "natural",
    "outcomes_by_model",
    "prepare",
    "read_results",
    "relabelled",
    "run_here",
    "run_job",
    "run_there",
    "summaries",
    "unread",
    "verdict",
    "why",
]
