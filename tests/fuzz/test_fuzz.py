"""The short form of `make fuzz`: a hundred inputs of each target, the same ones each time."""

from pathlib import Path

import pytest

from tests.fuzz.campaign import fuzz
from tests.fuzz.targets import TARGETS


@pytest.mark.parametrize("name", TARGETS)
def test_what_is_near_a_valid_input_is_read_or_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    fuzz(name, 100, 0, tmp_path)
