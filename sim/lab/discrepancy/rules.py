"""One table of the rules that decide: what is a gap, what is named, what is told beside it.

Numbers of the method (rounds, grids, draws, quantiles of a stated confidence) are no rules and stand where they are
used.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class DecisionRules:
    """The thresholds of a diagnosis, made where it is called and handed down; a naming step keeps those it was made by.

    `least` and `most` are bounds from below and from above; shares are of 1.
    """

    # ---- how much is needed before anything is said
    held_out_share: float = 0.3
    """Of the cycles, the last ones, that are kept for the proof."""
    least_cycles: int = 4
    """Cycles below which nothing is said: three to fit, one to judge by."""
    first_name_least_cycles: int = 6
    """Independent cycles, held-out ones included, without which nothing is named."""
    each_name_least_cycles: int = 4
    """Such cycles for each of several names."""

    # ---- which signals do not say what they should
    turning_least_load_share: float = 0.02
    """Of a load's greatest value, above which the machine turns, where its load is asked in place of its switch."""
    contradicted_least_share: float = 0.1
    """Of all time, that switch and load contradict each other where the switch is asked no more: one that comes a
    little late does less."""
    by_load_most_error_share: float = 0.5
    """Of the given model's error, up to which is left where the load takes the place of a switch that says nothing."""
    still_usual_least_moved_share: float = 0.5
    """Of what the temperature varies by (rms about its mean), that the median run or rest moves it by where one that
    moves it by nothing stands out."""
    still_least_usual: int = 3
    """Runs, or rests, that moved it: of fewer nothing is usual."""
    still_least_lasted_share: float = 0.5
    """Of the time that the median one takes, from which one would have moved it."""
    still_least_way_share: float = 0.3
    """Of what the median one moves it by, that one begins away from where those like it end: what begins nearer, as a
    rest after a start that was broken off, has nowhere to go."""
    still_least_way_steps: int = 3
    """Of the reading's least steps, the same."""

    # ---- which signals are consequences
    follows_least_share: float = 0.6
    """Of the variance of a signal's changes that the temperature's past foresees where it follows. A room that is
    warmed by a tenth of what the machine is warmed by reaches 0.4 to 0.8, one that the machine does not reach below 0.1
    and the oil temperatures of one circuit (measured) 0.97."""
    follows_most_lead_share: float = 0.03
    """By which the temperature's future tells more of a signal than its past where the signal leads: 0.03 to 0.15 for a
    room that heats a mass of 300 to 6000 s, at most 0.02 for oil temperatures of one circuit."""

    # ---- what a name needs of the likelihood
    least_gain_nats: float = 14.0
    """That a name needs. Chance makes so much of one shape in one case of eight million: of a whole catalogue of them
    in less than one case of a hundred, unless it has 80,000 that do not resemble one another (decision 0029)."""
    same_least_cosine: float = 0.9
    """From which two effects are of one class."""
    near_least_cosine: float = 0.6
    """From which two effects are rivals."""
    margin_nats: float = 6.0
    """By which a name must beat every rival outside its class; and by which held-out cycles are foreseen better with
    names whose leavings bound the floor (decision 0031)."""
    margin_share: float = 0.01
    """Of a gain, the margin for one of its class where that is more: by so little a shape that is not quite the plant's
    may win over its twin."""
    named_least_confidence: float = 0.5
    """That a name has, by all that it is stated with: one that is less likely than not is none."""
    strength_least_sigmas: float = 2.0
    """Standard errors, beside all other names and parameters, from which the strength of a name is no chance. What the
    likelihood asks of one alone is more than five; less is left where a fit is far from what its linear problem says,
    or where a later name does the same."""
    told_apart_times: float = 2.0
    """Of the margin, up to which an effect that lies behind on the fitted cycles is held against the best on the
    held-out ones too."""
    once_least_share: float = 0.95
    """Of what a signal varies by while the machine runs, that one step takes, from which it has moved once: a ramp's
    best step takes three quarters."""
    invisible_most_share: float = 0.05
    """Of an effect's size that the model's parameters leave, up to which it is not visible in the data."""

    # ---- what a name needs of the cycles and of the names before it
    robust_least_z: float = 1.0
    """The z by cycles that a name needs where its information is spread, unless its gain overwhelms."""
    spread_least_cycles: float = 3.0
    """Over which information is spread: of fewer, single cycles cannot be asked to agree."""
    overwhelming_nats: float = 20.0
    """From which cycles are not asked, and from which a name that a rival stands too near to is taken for the time
    being."""
    further_nats: float = 5.0
    """That a further name needs beyond the threshold of the first one."""
    leftover_share: float = 0.02
    """Of its gain that an effect whose shape is not quite right leaves behind: at the lesser end, for a further name
    whose shape does not look like it (`near_least_cosine`)."""
    leftover_of_rival_share: float = 0.3
    """The same at the greater end, where both shapes are the same."""
    further_least_size_share: float = 0.2
    """Of the greatest amplitude before it that a further name must have, unless its gain is clear. What a thermostat's
    shape leaves of 619 nats is as good as a housing of 35 nats that is a ninth as large."""
    further_clear_nats: float = 40.0
    """From which the gain of a further name is clear."""
    most_heat_times: float = 10.0
    """The fastest movement that a record shows (both in degC/s) up to which a heat or a cooling is believed: those of
    plants make 0.3 to 0.9 times, what was named of a measured box without being there thousands."""

    # ---- what matters
    material_sigmas: float = 0.5
    """Of the sensor (rms) from which something matters: an effect, by what it does beyond what the model's parameters
    imitate, and a gap, by what the held-out free run errs by beyond the floor. Less than half of what one reading errs
    by can be felt by nobody, however certain many readings make it."""
    gap_itself_least_share: float = 0.5
    """Of the held-out excess that an effect beyond chance which was refused on the fitted cycles, as too small, as a
    leftover or as contradicted, must remove to be what the gap is made of."""

    # ---- what held-out cycles and the free learner say against a name
    removed_least_share: float = 0.1
    """Of a held-out excess that matters which names remove at least: what leaves more is not what is missing."""
    beyond_doubt_nats: float = 60.0
    """Of the fitted cycles' gain of all names, or of what held-out ones are foreseen better by, from which names need
    not bring the error within the model's own noise."""
    covered_most_times: float = 1.2
    """The model's own spread, or the floor, up to which an error counts as covered by it."""
    ceiling_most_p: float = 0.01
    """Of the heat that trees predict, up to which it is systematic."""
    ceiling_least_share: float = 0.08
    """Of the heat that trees predict, from which it is systematic."""
    ceiling_left_most_share: float = 0.35
    """Of the systematic heat found that names may leave."""
    ceiling_alone_most_p: float = 0.002
    """Of such heat up to which it is a gap by itself, where no candidate stands for it."""

    # ---- what is a gap by the model's own noise (decision 0031)
    wide_median_times: float = 1.5
    """That the median cycle is as far off as the model's own noise allows where there is a gap."""
    wide_low_times: float = 1.2
    """That all cycles but the share below are at least as far off."""
    wide_low_share: float = 0.2
    """Of the cycles that need not be so far off."""

    # ---- the floor
    floor_interval_share: float = 0.99
    """Of the errors that chance makes, what the floor's interval holds: of 200 clean machines one is beyond it."""
    left_by_names_log_sd: float = 0.18
    """By which what right names leave of held-out cycles differs, in logarithms, from what an ideal judge's fit leaves
    of them: of 54 the middle half lies between 0.83 and 1.06 times of it."""
    stated_noise_log_sd: float = 0.35
    """By which the noise of a machine differs from what its model states, in logarithms: machines of one type differ
    by a factor of 1.4 in what is rough about them."""
    stated_noise_most_times: float = 2.5
    """What the model states that the noise is at most: no machine of its type is rougher. Of 50 clean ones whose noise
    was drawn apart from their models' the roughest was 2.2 times as far off as stated."""
    floor_parameters_most_times: float = 2.0**0.5
    """The noise alone that it is with what the fit's parameters took from it: as much again in the mean square."""
    equal_least_cycles: int = 4
    """That a cell needs in order to compare them."""
    comparable_least_share: float = 0.7
    """Of all windows that must lie in such cells."""
    floor_blind_from_share: float = 0.5
    """Of what the temperature varies by (rms about its mean), from which the upper end of the floor's interval says
    nothing: a model that explains no more than three quarters of the variance would agree."""

    # ---- where a gap begins
    beginning_least_cycles: int = 3
    """Before a beginning and after it, each."""
    beginning_most_p: float = 0.001
    """Of a beginning among draws of as many normal errors: it is looked for at all cycles and in two phases.
    Permutations would do without the normal law, but of fifteen cycles there are too few ways to take the last four."""
    beginning_carried_share: float = 0.5
    """Of its gain that an effect which begins must keep where each cycle's strength is that of the others: of the
    half-way gaps of a plant 0.7 to 1, of what one cycle or a neighbour made up at most 0.25."""
    beginning_wanders_from: float = 0.5
    """The correlation of neighbouring cycles, once the step is taken out, from which the error wanders."""

    # ---- what is told beside: places, moved parameters, absorbed laws
    place_most_p: float = 0.05
    """Of the greatest z among all cells, up to which heat in one is no chance."""
    place_least_share: float = 0.02
    """Of the unexplained heat that a place has."""
    place_least_correlation: float = 0.3
    """By rank, from which the heat in a place goes with a signal."""
    moved_least_sigmas: float = 4.0
    """Standard errors from which a parameter has moved."""
    moved_least_share: float = 0.01
    """Of a parameter from which its move is told."""
    absorbed_least_p: float = 0.01
    """From which constants differ from a law by chance."""
    absorbed_least_saved: int = 2
    """Constants that a law must save to be worth a word."""

    # ---- laws to look at
    law_least_nats: float = 9.2
    """After all laws that were tried are paid for: 1 in 10 000, as one more look costs nothing."""
    law_fitted_least_nats: float = 6.0
    """On the fitted cycles, from which the held-out ones are asked about a law."""
    law_least_share: float = 0.25
    """Of what is left that a law must take on held-out cycles."""
    law_least_cycles_share: float = 0.6
    """Of the held-out cycles that must be better foreseen with it."""
    law_same_least_cosine: float = 0.9
    """From which two laws are one to these data."""
    law_term_nats: float = 2.0
    """That one more term must be worth."""
    law_further_least_share: float = 0.7
    """Of the surest law's gain that a further one must have."""


RULES = DecisionRules()
"""The rules as they stand."""
