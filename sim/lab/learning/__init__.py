"""What both learners use: free runs, their fit, their noise, the held-out judgement."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.lab.learning.calibrate import MOST_WIDENING, Coverage, HeldOutForecasts, independent_forecasts
    from sim.lab.learning.correction import FORMS, corrected_model, learn_correction
    from sim.lab.learning.data import in_order
    from sim.lab.learning.drivers import DriverEvidence, drivers_of
    from sim.lab.learning.fleet import (
        FALSE_FINDING_CHANCE,
        GroupTargets,
        StandsOut,
        grouped_targets,
        outstanding,
        own_targets,
        target_groups,
    )
    from sim.lab.learning.free_run import (
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
    from sim.lab.learning.held_out import (
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
    from sim.lab.learning.machines import (
        MachineSpread,
        believed,
        machine_corrections,
        machine_spread,
        machines_of,
        next_stay,
        spread_of,
    )
    from sim.lab.learning.max_rate import bite, learn_max_rate, with_max_rate
    from sim.lab.learning.noise import Memories, NoiseLevels, drift_noise, fit_noise, memories_told
    from sim.lab.learning.outcomes import outcomes_of
    from sim.lab.learning.plain import PERSISTENCE, learn_plain
    from sim.lab.learning.preparation import (
        LEAST_READINGS,
        LEAST_SHARE,
        check_data,
        initial_law,
        splits,
        with_events,
        with_range,
    )
    from sim.lab.learning.runs import FreeRuns, Indices, first_switch, free_runs, pieces, sampled, thinned
    from sim.lab.learning.semi_markov import fit_stays, with_inputs
    from sim.lab.learning.shape import ParameterNames, Prior, shape_of, with_parameters
    from sim.lab.learning.structure import (
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
