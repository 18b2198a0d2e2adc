"""What is certain of a model: structure, bounds of its temperature, words that show what is wrong."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.proof.envelope import DAY, Assumptions, Sojourn
    from sim.proof.verification import Verification, verify
    from sim.proof.word import TimedWord, parse_word, word_text
    from sim.proof.word_replay import replay
else:
    __getattr__ = opened_at_use(__name__)
