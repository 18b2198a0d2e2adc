"""The same effect on the same record has the same course in every engine: there is one physics, that of the table."""

import pytest

from sim.effects.kinds import EFFECTS
from tests.effects.engines import LEARNERS, check_one_course
from tests.sha.effect_reference import EFFECTS as EXAMPLES
from tests.sha.effect_reference import RANDOM


def test_every_kind_has_an_example() -> None:
    assert {effect.kind for effects in EXAMPLES.values() for effect in effects} | set(RANDOM) == set(EFFECTS)


def test_every_optional_role_is_present_in_one_example_and_absent_in_another() -> None:
    for kind in EFFECTS.values():
        filled = [
            set(effect.signals) for effects in EXAMPLES.values() for effect in effects if effect.kind == kind.name
        ]
        for role in kind.optional:
            assert any(role in each for each in filled) and any(role not in each for each in filled), (kind.name, role)


CASES = [
    pytest.param(name, learner, first, id=f"{name}-{learner}{'-read late' if first else ''}")
    for number, (name, (example,)) in enumerate(EXAMPLES.items())
    for learner in LEARNERS
    for first in ((0.0, 250.0) if example.signals and learner == LEARNERS[number % len(LEARNERS)] else (0.0,))
]
"""What is read late is so whatever a learner calls its locations: of each effect with one of them."""


@pytest.mark.parametrize(("name", "learner", "first"), CASES)
def test_all_engines_have_one_course(name: str, learner: str, first: float) -> None:
    check_one_course(name, learner, first)
