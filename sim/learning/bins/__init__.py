"""Method `bins`: one location for each combination of channel values."""

from sim.learning.bins.candidates import CANDIDATES
from sim.learning.bins.learn import Learned, learn_bins

__all__ = ["CANDIDATES", "Learned", "learn_bins"]
