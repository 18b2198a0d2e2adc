"""Column maps drafted from files that nobody has described: `decanter trace map`."""

from sim.lab.recordings.mapping.answers import BLANK_IS_GOOD, CHOICES, NO_COLUMN, Answers, Undecided
from sim.lab.recordings.mapping.clocks import is_time
from sim.lab.recordings.mapping.draft import RUNNING_SIGNAL, DraftedMap, draft_map
from sim.lab.recordings.mapping.words import current_score, load_score, named_otherwise, running_score, split_unit
