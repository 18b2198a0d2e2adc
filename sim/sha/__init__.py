"""The stochastic hybrid automaton as a description: locations, flows, laws, events, traces. No current state."""

from sim.sha.automaton import SHA, Distribution, Edge, Effect, Entry, Flow, Input, Location, nondeterminism, transitions
from sim.sha.distributions import LAWS, check_distribution, mean, variance
from sim.sha.effect_line import EffectLine, LineActs, LineParameter
from sim.sha.entry import draw_parameter, draw_temperature, mode_parameter
from sim.sha.events import (
    DECANTER,
    Alphabet,
    Bins,
    Encoder,
    EncoderState,
    Switch,
    alphabet_symbols,
    check_alphabet,
    encode,
    encode_trace,
)
from sim.sha.flows import (
    FIXED_PARAMETER,
    FLOWS,
    RELAXING_FLOWS,
    Coefficients,
    check_flow,
    coefficients,
    mean_step,
    offset,
)
from sim.sha.kinds import Indices, OfKind, by_kind
from sim.sha.model import Correction, MachineCorrection, Model, PlainMember, Provenance, Stay, plain_model
from sim.sha.semi_markov import MAX_STAYS, Chain, Paths, compile_chain, draw_paths, input_moments, known_paths
from sim.sha.switches import SwitchLocations, level_of_locations, switch_locations
from sim.sha.trace import (
    EARLY_SHARE,
    UNKNOWN,
    Array,
    Event,
    Mask,
    Trace,
    content_hash,
    holds_roughly,
    joint_hash,
    signal_unit,
)
from sim.units import DEFAULT_UNIT, display_unit
