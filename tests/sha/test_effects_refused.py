"""What does not do effects says so in one sentence, before any result."""

import numpy as np
import pytest

from sim.checking.bounds import find_bounds
from sim.checking.verify import DEFAULT, verify
from sim.checking.word import parse_word, replay
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from sim.uppaal.export import ExportError, export
from tests.sha.effect_reference import EFFECTS, plant

MODEL = Model(plant("exponential", EFFECTS["wear-drift"]), Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1)
TRACE = Trace("t", np.array([0.0, 10.0, 20.0]), {"T": np.array([21.0, 21.0, 22.0])}, (Event(5.0, "W_ON"),))


def test_the_proof_of_bounds_declines() -> None:
    with pytest.raises(ValueError, match="the proof of bounds does not do effects yet, and model 'augmented' has wear"):
        find_bounds(MODEL, 0.0, 150.0, DEFAULT)


def test_verification_decides_no_temperature() -> None:
    checks = {check.name: check for check in verify(MODEL).checks}
    assert checks["growth"].verdict == "not decided"
    assert "does not do effects yet" in checks["growth"].evidence


def test_the_replay_of_a_word_declines() -> None:
    with pytest.raises(ValueError, match="the replay of a word does not do effects yet"):
        replay(MODEL, parse_word("W_ON@0 @600"), start=20.0)


def test_the_uppaal_export_declines() -> None:
    with pytest.raises(ExportError, match="the UPPAAL export does not do effects yet"):
        export(MODEL, TRACE)
