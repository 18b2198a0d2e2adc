"""One judge of models: figures of a model along recordings, paired verdicts on them, and the views on both."""

from sim.lab.judge.campaign import CampaignPlan, Progress, conduct, outcomes_by_model, run_here, run_there, unread
from sim.lab.judge.differences import Paired, holm, paired
from sim.lab.judge.fitness import (
    Facts,
    FitnessLimits,
    findings_of,
    fitness_of,
    fitness_sentence,
    judge,
    limits_of,
    why,
)
from sim.lab.judge.free_run import TROUBLE, TraceJob, TraceRunSettings, run_job
from sim.lab.judge.output_folder import CAMPAIGN, LEARNED, check_folder, claim_folder, held, read_results
from sim.lab.judge.past import Past, persistence
from sim.lab.judge.pictures import Curve, Picture, draw
from sim.lab.judge.ranking import Ranking, Weights, entrants, rank
from sim.lab.judge.ranking_page import as_plain, draw_ranking, write_page
from sim.lab.judge.report import CampaignSummary, natural
from sim.lab.judge.results import TraceResult
from sim.lab.judge.rows import NOMINAL, Skill, SkillRow, common, grouped, skill
from sim.lab.judge.skill_picture import draw_skill
from sim.lab.judge.stage_records import load_stage
from sim.lab.judge.stages import Prepared, Wanted, prepare, relabelled
from sim.lab.judge.verdicts import gain, summaries, verdict
from sim.lab.judge.worth import AHEAD, ForecastSkill, forecast_skill, tables

__all__ = [
    "AHEAD",
    "CAMPAIGN",
    "LEARNED",
    "NOMINAL",
    "TROUBLE",
    "CampaignPlan",
    "CampaignSummary",
    "Curve",
    "Facts",
    "FitnessLimits",
    "ForecastSkill",
    "Paired",
    "Past",
    "Picture",
    "Prepared",
    "Progress",
    "Ranking",
    "Skill",
    "SkillRow",
    "TraceJob",
    "TraceResult",
    "TraceRunSettings",
    "Wanted",
    "Weights",
    "as_plain",
    "check_folder",
    "claim_folder",
    "common",
    "conduct",
    "draw",
    "draw_ranking",
    "draw_skill",
    "entrants",
    "findings_of",
    "fitness_of",
    "fitness_sentence",
    "forecast_skill",
    "gain",
    "grouped",
    "held",
    "holm",
    "judge",
    "limits_of",
    "load_stage",
    "natural",
    "outcomes_by_model",
    "paired",
    "persistence",
    "prepare",
    "rank",
    "read_results",
    "relabelled",
    "run_here",
    "run_job",
    "run_there",
    "skill",
    "summaries",
    "tables",
    "unread",
    "verdict",
    "why",
    "write_page",
]
