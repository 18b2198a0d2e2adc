"""What the symbols of the ways to a location say of switches and levels there."""

from sim.sha import SHA, Bins, Edge, Flow, Location, level_of_locations
from sim.sha.trace import UNKNOWN


def test_a_locations_level_is_that_of_the_last_word_on_each_way_to_it() -> None:
    places = tuple(Location(name, Flow("constant", {"noise": 0.0}), entry="none") for name in ("?", "a", "b", "c", "d"))
    edges = [
        ("?", "low", "a"),
        ("a", "high", "b"),
        ("a", "stop", "c"),
        ("b", "stop", "c"),
        ("c", UNKNOWN, "d"),
    ]
    sha = SHA("x", places, tuple(Edge(*edge) for edge in edges), initial="?")
    levels = level_of_locations(sha, Bins("load", (100.0,), ("low", "high")))
    # Nothing is said of where it begins; c is reached with either word, d with none that holds.
    assert levels == {"a": 0.0, "b": 1.0, "c": 0.5}
