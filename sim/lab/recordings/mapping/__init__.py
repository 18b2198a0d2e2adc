"""Column maps drafted from files that nobody has described: `decanter trace map`."""

from sim.lab.recordings.mapping.answers import BLANK, CHOICES, NONE, Answers, Undecided
from sim.lab.recordings.mapping.draft import RUNNING, DraftedMap, draft_map
