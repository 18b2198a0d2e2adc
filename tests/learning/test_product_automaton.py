"""The product automaton: names, walks, and what an unseen location borrows."""

import pytest

from sim.lab.learning.structure import (
    bare_sha,
    contexts,
    distance,
    edges,
    labels,
    middle,
    nearest,
    reference,
    shared_name,
)
from sim.sha.automaton import nondeterminism, transitions
from sim.sha.events import DECANTER, Alphabet, Bins, Switch, alphabet_symbols
from sim.sha.trace import UNKNOWN

PUMP = Alphabet(
    (Switch("Run", "ON", "OFF"), Switch("Valve", "OPEN", "SHUT"), Bins("Flow", (-5.0, 2.5), ("F_0", "F_1", "F_2")))
)


def test_locations_are_named_by_the_house_words() -> None:
    names = list(contexts(DECANTER))
    assert names[0] == "?"
    assert {"ON/0-100", "ON/200-300", "ON/300+", "OFF/0-100", "ON/?", "?/100-200"} < set(names)
    assert len(names) == 3 * 5
    assert {"ON/OFF/-5-2.5", "?/ON/<-5", "ON/?/2.5+"} < set(contexts(PUMP))


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ([(1, 2)], "ON/200-300"),
        ([(1, 1), (1, 2)], "ON/100-300"),
        ([(0, 0), (0, 1), (0, 2)], "OFF/0-300"),
        ([(1, 2), (1, 3)], "ON/200+"),
        ([(1, 0), (1, 2)], "ON/0-100|200-300"),
        ([(1, 0), (1, 1), (1, 2), (1, 3)], "ON"),
        ([(1, None)], "ON/?"),
        ([(None, None)], "?"),
    ],
)
def test_what_several_contexts_share_is_their_name(values: list[tuple[int | None, ...]], name: str) -> None:
    assert shared_name(values, DECANTER) == name


def test_levels_that_may_be_anything_have_a_name_too() -> None:
    level = Alphabet((Bins("Flow", (-5.0, 2.5), ("F_0", "F_1", "F_2")),))
    assert shared_name([(0,), (1,)], level) == "<2.5"
    assert shared_name([(0,), (1,), (2,)], level) == "any"


@pytest.mark.parametrize("alphabet", [DECANTER, PUMP])
def test_deterministic_and_input_enabled_and_unknown_leads_back(alphabet: Alphabet) -> None:
    sha = bare_sha(alphabet)
    assert nondeterminism(sha) == []
    moves = transitions(sha)
    symbols = {*alphabet_symbols(alphabet), UNKNOWN}
    assert set(moves) == {(name, symbol) for name in contexts(alphabet) for symbol in symbols}
    assert {target for (_, symbol), target in moves.items() if symbol == UNKNOWN} == {sha.initial}


@pytest.mark.parametrize(
    ("word", "end"),
    [
        (("W_ON", "A_1"), "ON/100-200"),
        (("A_1", "W_ON"), "ON/100-200"),
        (("W_ON",), "ON/?"),
        (("A_3",), "?/300+"),
        (("W_ON", "A_2", UNKNOWN, "W_ON"), "ON/?"),
        (("W_ON", "A_2", "W_OFF", "A_0"), "OFF/0-100"),
    ],
)
def test_announcements_walk_through_partial_knowledge(word: tuple[str, ...], end: str) -> None:
    moves = transitions(bare_sha(DECANTER))
    here = "?"
    for symbol in word:
        here = moves[here, symbol]
    assert here == end


def test_the_middle_of_an_open_bin_is_taken_from_its_neighbour() -> None:
    bins = DECANTER.channels[1]
    assert isinstance(bins, Bins)
    assert [middle(bins, value) for value in range(4)] == [50.0, 150.0, 250.0, 350.0]
    assert middle(Bins("x", (-4.0, 2.0), ("a", "b", "c")), 0) == -7.0
    assert middle(Bins("x", (), ("a",)), 0) == 0.0
    assert reference((1, 2), DECANTER, "Assorbimento") == 250.0
    assert reference((1, None), DECANTER, "Assorbimento") == 0.0


def test_the_nearest_location_is_a_bin_away_rather_than_a_switch_away() -> None:
    assert nearest((1, 3), [(0, 3), (1, 1)], DECANTER) == (1, 1)
    assert nearest((1, 1), [(1, 2), (1, 0)], DECANTER) == (1, 0)
    assert distance((1, 0), (0, 2), DECANTER) == 12


def test_a_level_without_thresholds_has_one_value() -> None:
    assert labels(Bins("x", (), ("a",))) == ("any",)
    assert len(edges(Alphabet((Bins("x", (), ("a",)),)))) == 4
