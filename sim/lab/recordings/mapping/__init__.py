"""Column maps drafted from files that nobody has described: `decanter trace map`."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.lab.recordings.mapping.answer_words import BLANK_IS_GOOD, CHOICES, NO_COLUMN
    from sim.lab.recordings.mapping.answers import Answers, Undecided
    from sim.lab.recordings.mapping.draft import RUNNING_SIGNAL, DraftedMap, draft_map
    from sim.lab.recordings.mapping.words import current_score, load_score, named_otherwise, running_score, split_unit
else:
    __getattr__ = lazy_getattr(__name__)
