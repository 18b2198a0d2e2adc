"""Location names as identifiers: unique, legal in both languages, and stable."""

import re

from hypothesis import given
from hypothesis import strategies as st

from sim.lab.checking.query.names import RESERVED_WORDS, identifiers


def test_the_decanter_s_locations_get_readable_identifiers() -> None:
    chosen = identifiers(["?", "ON/?", "ON/200-300", "ON/300+", "OFF/<-5", "q_3"])
    assert chosen == {
        "?": "unknown",
        "ON/?": "ON_unknown",
        "ON/200-300": "ON_200_300",
        "ON/300+": "ON_300_plus",
        "OFF/<-5": "OFF_below_minus_5",
        "q_3": "q_3",
    }


@given(st.lists(st.text(min_size=1, max_size=8) | st.sampled_from(sorted(RESERVED_WORDS)), unique=True, max_size=12))
def test_any_names_give_as_many_legal_identifiers_that_are_no_words_of_uppaal(names: list[str]) -> None:
    chosen = identifiers(names)
    assert list(chosen) == names
    assert len(set(chosen.values())) == len(names)
    for identifier in chosen.values():
        assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", identifier, re.ASCII)
        assert identifier not in RESERVED_WORDS


def test_a_name_that_is_legal_keeps_it_even_when_another_would_become_the_same() -> None:
    assert identifiers(["ON/1", "ON_1"]) == {"ON/1": "ON_1_2", "ON_1": "ON_1"}
