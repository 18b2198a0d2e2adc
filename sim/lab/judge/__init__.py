"""One judge of models: figures of a model along recordings, paired verdicts on them, and the views on both."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.lab.judge.campaign import (
        CampaignPlan,
        Progress,
        cluster_runner,
        conduct,
        local_runner,
        outcomes_by_model,
        unread_traces,
    )
    from sim.lab.judge.comparison import NEW, PRESENT, HorizonComparison, compare_horizons, propose_verdict
    from sim.lab.judge.differences import MIN_INTERVAL_DIFFERENCES, Paired, compare_pairs, unit_differences
    from sim.lab.judge.fitness import (
        Facts,
        FitnessLimits,
        fitness_verdict,
        judge,
        judge_semantics,
        model_facts,
        model_facts_by_semantics,
        parse_limits,
    )
    from sim.lab.judge.free_run import RUN_ERRORS, HeldOutFold, TraceJob, TraceRunSettings, run_job, score_fold
    from sim.lab.judge.model_judge import judge_learning
    from sim.lab.judge.output_folder import (
        LEARNED_FOLDER,
        check_folder,
        claim_folder,
        hold_folder,
        read_results,
        recorded_facts,
    )
    from sim.lab.judge.past import Past, PastForecaster, persist, train_rival
    from sim.lab.judge.ranking import Ranking, Weights, entrants, rank
    from sim.lab.judge.ranking_page import as_plain, draw_ranking, write_page
    from sim.lab.judge.report import CampaignSummary, natural
    from sim.lab.judge.results import TraceResult
    from sim.lab.judge.rows import (
        NOMINAL_COVERAGE,
        TRACE_PARTS_S,
        Skill,
        SkillRow,
        common,
        figures,
        group_rows,
        means,
        skill,
        stretch,
        trace_machine,
    )
    from sim.lab.judge.skill_picture import draw_skill
    from sim.lab.judge.stages import Prepared, Wanted, distinct_labels, load_stage, prepare
    from sim.lab.judge.verdicts import gain, summaries, verdict
    from sim.lab.judge.worth import MAX_CRPS_RATIO, NOTHING_READ, ForecastSkill, forecast_skill, tables
else:
    __getattr__ = lazy_getattr(__name__)
