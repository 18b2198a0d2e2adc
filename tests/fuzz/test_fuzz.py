"""The short form of `make fuzz`: some inputs of each target, the same ones each time, and all that once failed."""

from pathlib import Path

import pytest

from tests.fuzz.campaign import bounded, corpus, fuzz
from tests.fuzz.targets import TARGETS

INPUTS = 48


@pytest.mark.parametrize("name", TARGETS)
def test_what_is_near_a_valid_input_is_read_or_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    target = TARGETS[name]
    if missing := target.missing():
        pytest.skip(missing)
    with target.bench(tmp_path) as run:
        for example in target.examples():
            assert target.take(run, example), "an example is valid"
        for data in corpus(name):
            with bounded():
                target.take(run, data)
        fuzz(target, run, target.examples(), min(INPUTS, target.most // 50), 0)
