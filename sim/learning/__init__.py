"""What both learners use: free runs, their fit, their noise, the held-out judgement."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.learning.calibrate import Coverage, HeldOutForecasts, Scored, coverage_of, score_forecasts
    from sim.learning.correction import FORMS, LearnedCorrection, corrected_model, learn_correction
    from sim.learning.data import in_order
    from sim.learning.fleet import outstanding, own_targets
    from sim.learning.free_run import (
        RATES,
        FitShape,
        FreeRunFit,
        LinearFit,
        fit_at_rates,
        fit_free_run,
        loads,
        predict,
        steps,
    )
    from sim.learning.held_out import (
        FOLDS,
        LEAST,
        HeldOutErrors,
        choose,
        cross_validate,
        folds,
        huber_scale,
        judged_part,
        training_errors,
    )
    from sim.learning.machines import (
        MachineSpread,
        believed,
        machine_corrections,
        machine_spread,
        machines_of,
        next_stay,
        spread_of,
    )
    from sim.learning.max_rate import Bite, MaxRate, bite, learn_max_rate, with_max_rate
    from sim.learning.noise import Memories, NoiseLevels, drift_noise, fit_noise
    from sim.learning.outcomes import Outcomes, outcomes_of
    from sim.learning.plain import PERSISTENCE, TREND, learn_plain
    from sim.learning.preparation import (
        LEAST_READINGS,
        LEAST_SHARE,
        check_data,
        encoded,
        initial_law,
        splits,
        with_range,
    )
    from sim.learning.runs import FreeRuns, Indices, first_switch, free_runs, pieces, sampled, thinned
    from sim.learning.semi_markov import fit_stays, with_inputs
    from sim.learning.shape import ParameterNames, Prior, shape_of, with_parameters
    from sim.learning.structure import (
        SWITCH_STEPS,
        Context,
        LearningError,
        announcements,
        bare_sha,
        contexts,
        distance,
        labels,
        level_signals,
        name_of,
        nearest,
        product_sha,
        reference,
    )
else:
    __getattr__ = opened_at_use(__name__)

__all__ = [
    "FOLDS",
    "FORMS",
    "LEAST",
    "LEAST_READINGS",
    "LEAST_SHARE",
    "PERSISTENCE",
    "RATES",
    "SWITCH_STEPS",
    "TREND",
    "Bite",
    "Context",
    "Coverage",
    "FitShape",
    "FreeRunFit",
    "FreeRuns",
    "HeldOutErrors",
    "HeldOutForecasts",
    "Indices",
    "LearnedCorrection",
    "LearningError",
    "LinearFit",
    "MachineSpread",
    "MaxRate",
    "Memories",
    "NoiseLevels",
    "Outcomes",
    "ParameterNames",
    "Prior",
    "Scored",
    "announcements",
    "bare_sha",
    "believed",
    "bite",
    "check_data",
    "choose",
    "contexts",
    "corrected_model",
    "coverage_of",
    "cross_validate",
    "distance",
    "drift_noise",
    "encoded",
    "first_switch",
    "fit_at_rates",
    "fit_free_run",
    "fit_noise",
    "fit_stays",
    "folds",
    "free_runs",
    "huber_scale",
    "in_order",
    "initial_law",
    "judged_part",
    "labels",
    "learn_correction",
    "learn_max_rate",
    "learn_plain",
    "level_signals",
    "loads",
    "machine_corrections",
    "machine_spread",
    "machines_of",
    "name_of",
    "nearest",
    "next_stay",
    "outcomes_of",
    "outstanding",
    "own_targets",
    "pieces",
    "predict",
    "product_sha",
    "reference",
    "sampled",
    "score_forecasts",
    "shape_of",
    "splits",
    "spread_of",
    "steps",
    "thinned",
    "training_errors",
    "with_inputs",
    "with_max_rate",
    "with_parameters",
    "with_range",
]
