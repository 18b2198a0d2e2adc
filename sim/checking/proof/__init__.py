"""What is certain of a model: structure, bounds of its temperature, words that show what is wrong."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from sim.checking.proof.envelope import DAY, Assumptions, Sojourn
    from sim.checking.proof.symbolic import decide
    from sim.checking.proof.verification import Verification, verify
    from sim.checking.proof.word import TimedWord, parse_word, word_text
    from sim.checking.proof.word_replay import WordReplay, replay
else:
    __getattr__ = opened_at_use(__name__)

__all__ = [
    "DAY",
    "Assumptions",
    "Sojourn",
    "TimedWord",
    "Verification",
    "WordReplay",
    "decide",
    "parse_word",
    "replay",
    "verify",
    "word_text",
]
