"""What is certain of a model: structure, bounds of its temperature, words that show what is wrong."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from sim.proof.envelope import DAY_S, Assumptions, Sojourn
    from sim.proof.verification import Verification, verify
    from sim.proof.word import TimedWord, parse_word, word_text
    from sim.proof.word_replay import replay
else:
    __getattr__ = lazy_getattr(__name__)
