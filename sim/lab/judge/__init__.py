"""One judge of models: figures of a model along recordings, paired verdicts on them, and the views on both."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.lab.judge.campaign import CampaignPlan, Progress, conduct, outcomes_by_model, run_here, run_there, unread
    from sim.lab.judge.comparison import NEW, PRESENT, HorizonComparison, compared, verdict_on
    from sim.lab.judge.differences import LEAST_FOR_INTERVAL, Paired, paired, unit_differences
    from sim.lab.judge.fitness import (
        Facts,
        FitnessLimits,
        facts_of,
        findings_of,
        fitness_of,
        judge,
        limits_of,
        model_facts,
    )
    from sim.lab.judge.free_run import TROUBLE, HeldOutFold, TraceJob, TraceRunSettings, held_out, run_job
    from sim.lab.judge.model_judge import judge_learned
    from sim.lab.judge.output_folder import LEARNED, check_folder, claim_folder, held, read_results, recorded_facts
    from sim.lab.judge.past import Past, PastForecaster, persist, trained
    from sim.lab.judge.ranking import Ranking, Weights, entrants, rank
    from sim.lab.judge.ranking_page import as_plain, draw_ranking, write_page
    from sim.lab.judge.report import CampaignSummary, natural
    from sim.lab.judge.results import TraceResult
    from sim.lab.judge.rows import (
        NOMINAL,
        STRETCHES,
        Skill,
        SkillRow,
        common,
        figures,
        grouped,
        machine_of,
        means,
        skill,
        stretch,
    )
    from sim.lab.judge.skill_picture import draw_skill
    from sim.lab.judge.stages import Prepared, Wanted, load_stage, prepare, relabelled
    from sim.lab.judge.verdicts import gain, summaries, verdict
    from sim.lab.judge.worth import AHEAD, ForecastSkill, forecast_skill, tables
else:
    __getattr__ = opened_at_use(__name__)
