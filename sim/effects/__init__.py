"""What may act on top of the flows: kinds of effects as one table, and what every engine needs of them."""

from sim.effects.check import check_effect, check_effects, check_sha
from sim.effects.correction import apply_correction, in_sensor_scale, of_machine, with_targets
from sim.effects.exchange import ABSOLUTE_ZERO, in_scale_of_x, is_gradual, linear_radiation, radiation_tangent
from sim.effects.expressed import SINCE, TEMPERATURE, cells, enclosure, steepest_loss
from sim.effects.expression import Expression, compile_expression, parse
from sim.effects.expression import names as names_in
from sim.effects.kind import (
    ABSOLUTE_SECONDS,
    FEATURES,
    EffectCandidate,
    EffectKind,
    EffectRefusal,
    ExpressedBound,
    Feature,
    HeldLaw,
    LatePart,
    LossBound,
    MachineLog,
    RecordedLaw,
    RecordView,
    Structural,
    TextLaw,
    VaryingBound,
    VaryingLaw,
    unknown,
)
from sim.effects.kinds import (
    EFFECTS,
    RIVALS,
    ROLES,
    affects_location,
    dead_time,
    delay_of,
    drop_features,
    effect_kind,
    effect_signals,
    effect_summary,
    growth_starts,
    heat_lag,
    of_feature,
    offset_times,
    own_kind,
    parameter,
    parameter_words,
    refuse,
    sensor_offset,
    sensor_offsets,
    usual_roles,
)
from sim.effects.late import SETTLED_LAGS, late_jumps, late_mean, late_source, remaining_share
from sim.effects.lines import LineError
from sim.effects.random import DisturbanceStep, disturbance_step
from sim.effects.rivals import (
    CHANGES_AT_A_MOMENT,
    DRIFTING_SURROUNDINGS,
    SECOND_MOMENT,
    UNMEASURED_NEIGHBOUR,
    moment_words,
)
from sim.effects.roles import SETTABLE
