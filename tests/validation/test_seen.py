"""Which traces a model has seen in training: by their content, whatever their files are called."""

from dataclasses import replace

from sim.lab.judge.results import seen_traces
from sim.plant.scenarios import scenario
from sim.sha.automaton import SHA, Flow, Location
from sim.sha.events import Alphabet
from sim.sha.model import Model, Provenance
from sim.sha.trace import content_hash, joint_hash

CD1, CD2, CD3 = (scenario(name) for name in ("cd1", "cd2", "cd3"))


def learned_from(*names: str, data_hash: str = "", contents: tuple[str, ...] = ()) -> Model:
    sha = SHA("m", (Location("q", Flow("constant", {"noise": 0.1})),), (), "q")
    origin = Provenance("bins", data_hash, names, contents=contents)
    return Model(sha, Alphabet(()), "T", 0.1, provenance=origin)


def test_a_trace_is_known_by_its_content_under_any_name() -> None:
    both = learned_from("cd1", "cd2", data_hash="of both", contents=(content_hash(CD1), content_hash(CD2)))
    renamed, other = replace(CD1, name="new run"), replace(CD3, name="cd2")
    assert seen_traces(both, [renamed, CD3]) == {"new run": "content", "cd3": "no"}
    assert seen_traces(both, [CD2]) == {"cd2": "content"}
    assert seen_traces(both, [other]) == {"cd2": "name"}


def test_a_model_of_a_former_release_knows_its_traces_together() -> None:
    both = joint_hash([CD1, CD2])
    assert seen_traces(learned_from("cd1", "cd2", data_hash=both), [CD3, CD2, CD1]) == {
        "cd1": "content",
        "cd2": "content",
        "cd3": "no",
    }
    assert seen_traces(learned_from("cd1", "cd2", data_hash=both), [CD1, CD3]) == {"cd1": "name", "cd3": "no"}
    assert seen_traces(learned_from("cd1", "cd2", data_hash=both), [scenario("cd1", 5), CD2]) == {
        "cd1": "name",
        "cd2": "name",
    }
    renamed = replace(CD1, name="other")
    found = seen_traces(learned_from("cd1", data_hash=joint_hash([CD1])), [CD3, renamed])
    assert found == {"cd3": "no", "other": "content"}


def test_a_model_that_does_not_say_what_it_was_learned_from_is_not_taken_at_its_best() -> None:
    assert seen_traces(learned_from(), [CD1]) == {"cd1": "unknown"}
