"""Method `bins`: one location for each combination of channel values."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.lab.learning.bins.candidates import CANDIDATES
    from sim.lab.learning.bins.learn import Learned, learn_bins
else:
    __getattr__ = lazy_getattr(__name__)
