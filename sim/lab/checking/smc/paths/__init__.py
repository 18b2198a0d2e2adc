"""How runs are laid out and drawn: known events, unknown ones, effects, tilted laws."""

from sim.lab.checking.smc.paths.known_events import Affine, Cuts, known_engine
from sim.lab.checking.smc.paths.plan import MAX_PIECE_S, Engine, Indices, Piece, State, World, with_extremes
from sim.lab.checking.smc.paths.tilting import Tilts, balance, fit_tilts, neutral, tilt_distance
from sim.lab.checking.smc.paths.unknown_events import semi_markov
