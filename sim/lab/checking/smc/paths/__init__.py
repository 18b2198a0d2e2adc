"""How runs are laid out and drawn: known events, unknown ones, effects, tilted laws."""

from sim.lab.checking.smc.paths.effects import augmented
from sim.lab.checking.smc.paths.known_events import Affine, Cuts, known
from sim.lab.checking.smc.paths.plan import LONGEST, Engine, Indices, Piece, State, World, with_extremes
from sim.lab.checking.smc.paths.tilting import Tilts, balance, fitted, moved, neutral
from sim.lab.checking.smc.paths.unknown_events import semi_markov
