"""Symbolic queries: known answers, shortest paths, and the same answers as trying out all paths of small automata."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.query import tree as q
from sim.lab.checking.query.symbolic import SymbolicVerdict, decide
from sim.sha.automaton import SHA, Edge, Flow, Location, nondeterminism


def automaton(edges: str, initial: str = "a") -> SHA:
    """`ax>b` is an edge from a to b on x; the places in alphabetic order."""
    parts = [(text[0], text[1], text[3]) for text in edges.split()]
    names = sorted({initial} | {name for source, _, target in parts for name in (source, target)})
    locations = tuple(Location(name, Flow("constant"), None, "none") for name in names)
    return SHA("small", locations, tuple(Edge(*part) for part in parts), initial)


def verdict(text: str, sha: SHA) -> SymbolicVerdict:
    query = parse_query(text, sha)
    assert isinstance(query, q.Symbolic)
    return decide(query, sha)


RING = automaton("ax>b by>c cz>a")
"""a, b, c, and round again."""
TRAP = automaton("ax>b by>a bz>c cu>d")
"""Between a and b for ever, or by c into d, which nothing leaves."""


@pytest.mark.parametrize(
    ("text", "sha", "holds", "word", "loop"),
    [
        ("E<> c", RING, True, "xy", ""),
        ("E<> deadlock", RING, False, "", ""),
        ("A[] not deadlock", RING, True, "", ""),
        ("A<> c", RING, True, "", ""),
        ("a --> c", RING, True, "", ""),
        ("E[] a or b", RING, False, "", ""),
        ("E[] true", RING, True, "", "xyz"),
        ("E<> deadlock", TRAP, True, "xzu", ""),
        ("A[] not d", TRAP, False, "xzu", ""),
        ("A<> d", TRAP, False, "", "xy"),
        ("A<> a", TRAP, True, "", ""),
        ("E[] not d", TRAP, True, "", "xy"),
        ("E[] a or b or c", TRAP, True, "", "xy"),
        ("c --> d", TRAP, True, "", ""),
        ("c --> a", TRAP, False, "xzu", ""),
        ("b --> d", TRAP, False, "x", "yx"),
        ("E[] not a", TRAP, False, "", ""),
        ("A[] 1 < 2 and 2 * 3 - 1 == 5 / 1", TRAP, True, "", ""),
        ("E<> false", TRAP, False, "", ""),
        ("a and b --> d", TRAP, True, "", ""),
    ],
)
def test_known_answers_with_their_shortest_path(text: str, sha: SHA, holds: bool, word: str, loop: str) -> None:
    found = verdict(text, sha)
    assert (found.holds, "".join(found.word), "".join(found.loop)) == (holds, word, loop)


def test_a_verdict_says_what_its_path_is_and_how_much_was_looked_at() -> None:
    found = verdict("A<> d", TRAP)
    assert (found.shows, found.path, found.loop_path, found.explored) == ("counterexample", ("a",), ("b", "a"), 4)
    assert verdict("E<> d", TRAP).shows == "witness"
    assert verdict("A[] true", TRAP).shows == ""


def test_what_cannot_be_reached_is_not_looked_at() -> None:
    island = automaton("ax>a by>c")
    assert verdict("E<> b", island) == SymbolicVerdict(holds=False, explored=1)
    assert verdict("b --> a", island).holds


def test_an_automaton_with_several_targets_for_one_event_is_decided() -> None:
    sha = automaton("ax>b ax>c by>b")
    assert nondeterminism(sha)
    found = verdict("A<> b", sha)
    assert (found.holds, found.word, found.path, found.loop) == (False, ("x",), ("a", "c"), ())


def test_guards_count_as_open_and_the_verdict_says_so() -> None:
    sha = automaton("ax>b")
    guarded = SHA(sha.name, sha.locations, (Edge("a", "x", "b", "T<20"),), "a")
    found = verdict("E<> b", guarded)
    assert found.holds
    assert found.notes == ("edges with guards count as open: 1 of them, such as a -x-> b [T<20]",)


def test_the_shortest_of_all_lassos_is_shown_not_the_nearest_cycle() -> None:
    sha = automaton("ap>b bq>c cr>d ds>b dt>e eu>e")
    assert verdict("E[] true", sha).word == ("p",)
    assert verdict("E[] true", sha).loop == ("q", "r", "s")
    far = automaton("ap>b bq>c cr>d ds>f ft>g gu>b cv>h hw>h")
    assert (verdict("E[] true", far).word, verdict("E[] true", far).loop) == (("p", "q", "v"), ("w",))


def test_what_changes_in_time_and_unknown_locations_are_refused() -> None:
    hot = q.Compare(">", q.Quantity("temperature"), q.Number(80.0))
    with pytest.raises(ValueError, match="temperature changes continuously"):
        decide(q.Symbolic("A[]", hot), RING)
    with pytest.raises(ValueError, match="no location 'z'"):
        decide(q.Symbolic("E<>", q.At("z")), RING)
    with pytest.raises(ValueError, match="divides by zero"):
        zero = q.Operation("/", q.Number(1.0), q.Operation("-", q.Number(1.0), q.Number(1.0)))
        decide(q.Symbolic("E<>", q.Compare("<", zero, q.Number(1.0))), RING)


def simple_paths(sha: SHA, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], tuple[str, ...] | None]]:
    """All paths without repetition from here: (path, None), and (path, the way back into it) where one closes.

    A path that ends in a deadlock has the way back ().
    """
    targets = sorted({edge.target for edge in sha.edges if edge.source == path[-1]})
    yield path, None if targets else ()
    for target in targets:
        if target in path:
            begin = path.index(target)
            yield path[: begin + 1], (*path[begin + 1 :], target)
        else:
            yield from simple_paths(sha, (*path, target))


def brute(query: q.Symbolic, sha: SHA, holds_in: dict[q.Formula, set[str]]) -> tuple[bool, int | None]:
    """Whether the query holds, and how many events its shortest path takes, by trying all paths."""
    inner = holds_in[query.inner]
    everywhere = {location.name for location in sha.locations}
    paths = list(simple_paths(sha, (sha.initial,)))
    if query.kind in ("E<>", "A[]"):
        wanted = inner if query.kind == "E<>" else everywhere - inner
        lengths = [len(path) - 1 for path, _ in paths if path[-1] in wanted]
    elif query.kind in ("E[]", "A<>"):
        keep = inner if query.kind == "E[]" else everywhere - inner
        lengths = [len(path) - 1 + len(back) for path, back in paths if back is not None and {*path, *back} <= keep]
    else:
        assert query.then is not None
        keep = everywhere - holds_in[query.then]
        prefixes = {path for path, _ in paths if path[-1] in inner & keep}
        lengths = [
            len(prefix) - 1 + len(path) - 1 + len(back)
            for prefix in prefixes
            for path, back in simple_paths(sha, prefix[-1:])
            if back is not None and {*path, *back} <= keep
        ]
    exists = query.kind.startswith("E")
    return bool(lengths) == exists, min(lengths, default=None)


def check_path(found: SymbolicVerdict, sha: SHA) -> None:
    """The word leads along the path, and the loop back to its end, or the path has come to where nothing leads on."""
    edges = {(edge.source, edge.symbol, edge.target) for edge in sha.edges}
    assert found.path[0] == sha.initial
    round_again = (found.path[-1], *found.loop_path)
    for way, word in ((found.path, found.word), (round_again, found.loop)):
        assert len(word) == len(way) - 1
        assert all((here, symbol, there) in edges for (here, there), symbol in zip(pairwise(way), word, strict=True))
    assert round_again[-1] == found.path[-1]


def random_automaton(rng: np.random.Generator) -> SHA:
    names = "abcdef"[: rng.integers(1, 7)]
    share = rng.choice([0.15, 0.3, 0.5])
    edges = [
        Edge(source, symbol, target)
        for source in names
        for target in names
        for symbol in "xy"
        if rng.random() < share / 2
    ]
    return SHA(
        "random", tuple(Location(name, Flow("constant"), None, "none") for name in names), tuple(edges), names[0]
    )


@pytest.mark.parametrize("kind", ["E<>", "A[]", "E[]", "A<>", "-->"])
def test_every_verdict_and_the_length_of_its_path_are_those_of_trying_all_paths(kind: str) -> None:
    rng = np.random.default_rng(7)
    seen = set()
    for _ in range(300):
        sha = random_automaton(rng)
        names = [location.name for location in sha.locations]
        sets = [{name for name in names if rng.random() < 0.6} for _ in range(2)]
        formulas = [f"(false or {' or '.join(sorted(places)) or 'false'})" for places in sets]
        text = f"{formulas[0]} --> {formulas[1]}" if kind == "-->" else f"{kind} {formulas[0]}"
        query = parse_query(text, sha)
        assert isinstance(query, q.Symbolic)
        by_formula = {query.inner: sets[0]} | ({query.then: sets[1]} if query.then is not None else {})
        found = decide(query, sha)
        holds, shortest = brute(query, sha, by_formula)
        assert found.holds == holds, (sha.edges, text)
        assert (len(found.word) + len(found.loop) if found.shows else None) == shortest, (sha.edges, text, found)
        if found.shows:
            check_path(found, sha)
            deadlocked = not any(edge.source == found.path[-1] for edge in sha.edges)
            assert bool(found.loop) != deadlocked or kind in ("E<>", "A[]")
        seen.add((holds, bool(found.loop)))
    assert len(seen) >= 2


def test_the_dual_queries_are_each_others_contrary() -> None:
    rng = np.random.default_rng(8)
    for _ in range(100):
        sha = random_automaton(rng)
        assert verdict("A[] a or deadlock", sha).holds != verdict("E<> !(a or deadlock)", sha).holds
        assert verdict("A<> deadlock", sha).holds != verdict("E[] !deadlock", sha).holds
        assert verdict("true --> deadlock", sha).holds == verdict("A<> deadlock", sha).holds
