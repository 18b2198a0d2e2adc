"""A switch is asked for by its signal, whatever the locations are called."""

import pytest

from sim.lab.checking.language.parse import QueryError, parse_query
from sim.lab.checking.query import tree as q
from sim.lab.checking.smc import decide_symbolic
from sim.sha.automaton import SHA, Edge, Flow, Location
from sim.sha.events import UNKNOWN, Alphabet, Bins, Switch
from sim.sha.model import Model

ALPHABET = Alphabet(
    (Switch("Marcia", "W_ON", "W_OFF"), Switch("Pompa", "P_ON", "P_OFF"), Bins("Load", (1.0,), ("L_0", "L_1"))),
    gap=60.0,
)
MOVES = (
    ("?", "W_OFF", "cold"),
    ("?", "W_ON", "idle"),
    ("cold", "W_ON", "idle"),
    ("idle", "L_1", "hot"),
    ("idle", "W_OFF", "cold"),
    ("hot", "L_0", "idle"),
    ("hot", "W_OFF", "cold"),
)


def model(*more: tuple[str, str, str]) -> Model:
    names = ("?", "cold", "idle", "hot")
    locations = tuple(Location(name, Flow("constant"), None, "none") for name in names)
    edges = [Edge(*move) for move in (*MOVES, *more)] + [Edge(name, UNKNOWN, "?") for name in names]
    return Model(SHA("plant", locations, tuple(edges), "?"), ALPHABET, "T", 0.1)


def test_a_switch_is_on_in_the_locations_whose_ways_all_say_so_last() -> None:
    query = parse_query("A[] Marcia imply !cold", model())
    assert query == q.Symbolic("A[]", q.Either(q.Not(q.Either(q.At("idle"), q.At("hot"))), q.Not(q.At("cold"))))
    assert parse_query("simulate [<=10; 1] {Marcia}", model()) == parse_query(
        "simulate [<=10; 1] {idle || hot}", model()
    )
    assert decide_symbolic(parse_query("E<> !Marcia", model()), model().sha).verdict is True


@pytest.mark.parametrize(
    ("text", "moves", "sentence"),
    [
        ("E<> Marcia", [("hot", "W_OFF", "idle")], "in location 'idle' Marcia may be on or off"),
        ("E<> Marcia > 0", [], "Marcia is a switch and a number is needed"),
        ("E<> Pompa", [], "'Pompa' is not known"),
        ("E<> marcia", [], "did you mean Marcia?"),
    ],
)
def test_what_a_switch_does_not_say_is_refused(text: str, moves: list[tuple[str, str, str]], sentence: str) -> None:
    kept = tuple(move for move in MOVES if move[:2] not in {one[:2] for one in moves})
    plant = model()
    edges = [edge for edge in plant.sha.edges if edge.symbol == UNKNOWN]
    sha = SHA("plant", plant.sha.locations, (*(Edge(*move) for move in (*kept, *moves)), *edges), "?")
    with pytest.raises(QueryError, match=sentence.replace("?", r"\?")):
        parse_query(text, Model(sha, ALPHABET, "T", 0.1))
