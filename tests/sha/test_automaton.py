"""The automaton as a description: what it refuses, and what counts as deterministic and executable."""

from math import nan

import pytest

from sim.effects.check import check_sha
from sim.sha.automaton import SHA, Distribution, Edge, Entry, Flow, Location, nondeterminism, transitions
from sim.sha.entry import mode_parameter

STILL = Flow("constant", {"noise": 0.1})
LAW = Distribution("normal", {"mu": 30.0, "sigma": 2.0})
TWO = (Location("q0", STILL), Location("q1", STILL))


def test_names_must_be_unique() -> None:
    with pytest.raises(ValueError, match="'q0' is defined 2 times"):
        SHA("m", (Location("q0", STILL), Location("q0", STILL)), (), "q0")


def test_the_initial_location_must_exist() -> None:
    with pytest.raises(ValueError, match="initial location 'q9'"):
        SHA("m", TWO, (), "q9")


@pytest.mark.parametrize("edge", [Edge("q9", "a", "q0"), Edge("q0", "a", "q9")])
def test_an_edge_must_join_known_locations(edge: Edge) -> None:
    with pytest.raises(ValueError, match="names the location 'q9'"):
        SHA("m", TWO, (edge,), "q0")


@pytest.mark.parametrize("limits", [{"max_rate": 0.0}, {"max_rate": nan}, {"low": 5.0, "high": 5.0}, {"high": nan}])
def test_limits_must_make_sense(limits: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="max_rate must be positive and low below high"):
        SHA("m", TWO, (), "q0", **limits)


def test_two_targets_are_non_determinism_and_a_doubled_edge_is_not() -> None:
    same = SHA("m", TWO, (Edge("q0", "a", "q1"), Edge("q0", "a", "q1")), "q0")
    assert nondeterminism(same) == []
    assert transitions(same) == {("q0", "a"): "q1"}
    both = SHA("m", TWO, (Edge("q0", "a", "q1"), Edge("q0", "a", "q0")), "q0")
    assert nondeterminism(both) == ["location 'q0' has 2 targets on 'a': q0, q1"]
    with pytest.raises(ValueError, match="not deterministic"):
        transitions(both)


def test_a_guard_is_not_silently_ignored() -> None:
    with pytest.raises(ValueError, match="guards are kept but not executed"):
        transitions(SHA("m", TWO, (Edge("q0", "a", "q1", guard="x > 3"),), "q0"))


HEATING = Flow("exponential", {"k": 0.1, "noise": 0.0})
FIXED_DRIFT = Flow("linear", {"noise": 0.0, "m": 0.05})


@pytest.mark.parametrize(
    ("location", "expected"),
    [
        (Location("drawn", HEATING, LAW), (30.0, 4.0)),
        (Location("resampled around its target", HEATING, LAW, "resample"), (30.0, 0.0)),
        (Location("resampled, drift known", FIXED_DRIFT, LAW, "resample"), (0.05, 0.0)),
        (Location("resampled, no drift", Flow("linear", {"noise": 0.0}), LAW, "resample"), (0.0, 0.0)),
        (Location("the law's mean", HEATING, LAW, "none"), (30.0, 0.0)),
        (Location("fixed", FIXED_DRIFT), (0.05, 0.0)),
        (Location("nothing known", STILL), (0.0, 0.0)),
    ],
    ids=lambda value: value.name if isinstance(value, Location) else "",
)
def test_where_the_mode_parameter_comes_from(location: Location, expected: tuple[float, float]) -> None:
    check_sha(SHA("m", (location,), (), location.name))
    assert mode_parameter(location) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("flow", "law", "entry", "said"),
    [
        (FIXED_DRIFT, LAW, "parameter", "fixes m and the entry draws it"),
        (HEATING, None, "resample", "needs a distribution"),
        (HEATING, LAW, "sample", "unknown entry mode 'sample'"),
        (Flow("exponential", {"k": -1.0, "noise": 0.0}), LAW, "parameter", "k must be positive and finite"),
        (HEATING, Distribution("normal", {"mu": 1.0}), "parameter", "takes mu, sigma"),
    ],
)
def test_an_executable_model_is_checked_location_by_location(
    flow: Flow, law: Distribution | None, entry: Entry, said: str
) -> None:
    with pytest.raises(ValueError, match=f"location 'q1': .*{said}"):
        check_sha(SHA("m", (TWO[0], Location("q1", flow, law, entry)), (), "q0"))
