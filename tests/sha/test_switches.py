"""What the symbols of the ways to a location say of switches and levels there."""

from sim.sha import SHA, Alphabet, Bins, Edge, Flow, Location, Switch, level_of_locations, switch_locations
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


def test_a_location_without_a_word_on_a_switch_is_neither_on_nor_off() -> None:
    names = ("?", "on", "off", "both", "lost")
    places = tuple(Location(name, Flow("constant", {"noise": 0.0}), entry="none") for name in names)
    edges = [
        ("?", "start", "on"),
        ("on", "stop", "off"),
        ("off", "start", "on"),
        ("on", "high", "both"),
        ("off", "high", "both"),
        ("on", UNKNOWN, "lost"),
    ]
    sha = SHA("x", places, tuple(Edge(*edge) for edge in edges), initial="?")
    where = switch_locations(sha, Alphabet((Switch("run", "start", "stop"),)))["run"]
    assert (where.on, where.either, where.off) == (("on",), ("both",), ("off",))
