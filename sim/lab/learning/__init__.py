"""What both learners use: free runs, their fit, their noise, the held-out judgement."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.lab.learning.calibrate import HORIZONS_S, MOST_WIDENING, Coverage, HeldOutForecasts, independent_forecasts
    from sim.lab.learning.correction import FORMS, corrected_model, learn_correction
    from sim.lab.learning.data import in_order
    from sim.lab.learning.drivers import DriverEvidence, find_drivers
    from sim.lab.learning.fleet import (
        FALSE_FINDING_CHANCE,
        GroupTargets,
        StandsOut,
        find_outliers,
        grouped_targets,
        own_targets,
        target_groups,
    )
    from sim.lab.learning.free_run import (
        RATE_PARAMETERS,
        FitShape,
        FreeRunFit,
        LinearFit,
        fit_at_rates,
        fit_free_run,
        load,
        loads,
        predict,
        pushed_targets,
        relaxing_rates,
        steps,
        targets,
    )
    from sim.lab.learning.held_out import (
        FOLDS,
        MIN_READINGS,
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
        machine_corrections,
        machine_spread,
        next_stay,
        offset_spread,
        shrink_offset,
        trace_machines,
    )
    from sim.lab.learning.max_rate import bite, learn_max_rate, with_max_rate
    from sim.lab.learning.noise import Memories, NoiseLevels, drift_noise, fit_noise, observable_memories
    from sim.lab.learning.outcomes import clean_readings
    from sim.lab.learning.plain import PERSISTENCE, learn_plain
    from sim.lab.learning.preparation import (
        MIN_READING_SHARE,
        MIN_TRAINING_READINGS,
        check_data,
        initial_law,
        splits,
        with_events,
        with_range,
    )
    from sim.lab.learning.runs import FreeRuns, Indices, first_switch, free_runs, pieces, sample_runs, thin_free_runs
    from sim.lab.learning.semi_markov import fit_stays, with_inputs
    from sim.lab.learning.shape import ParameterNames, Prior, build_shape, with_parameters
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
        location_name,
        nearest,
        product_sha,
        reference,
        shared_name,
    )
else:
    __getattr__ = lazy_getattr(__name__)
