"""Column maps drafted from files that nobody has described: `decanter trace map`."""

from sim.traces.mapping.decide import NONE, Answers, Undecided
from sim.traces.mapping.draft import RUNNING, DraftedMap, draft_map

__all__ = ["NONE", "RUNNING", "Answers", "DraftedMap", "Undecided", "draft_map"]
