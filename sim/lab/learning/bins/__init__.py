"""Method `bins`: one location for each combination of channel values."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.lab.learning.bins.candidates import CANDIDATES
    from sim.lab.learning.bins.learn import Learned, learn_bins
else:
    __getattr__ = opened_at_use(__name__)
