"""`decanter diagnose --if-drifting --propose`: it waits for drift, and its finding waits for a person."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.lab.models.propose import RecordedDrift, propose, recorded_drift
from gateway.store import reading
from sim.artefacts import (
    FINDING_FILE,
    current,
    load,
    promote,
    read_finding,
    version_directory,
    versions,
)
from sim.files import ArtefactError
from sim.lab.formats import find_model, save
from sim.plant.scenarios import scenario
from sim.sha import Alphabet, Switch
from tests.cli.support import decanter, misused, only_object, refused
from tests.cli.test_diagnose import kept
from tests.discrepancy_report.made_diagnoses import of
from tests.gateway.support import one_machine, two_modes


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A store with one version, which runs."""
    folder = tmp_path / "store"
    promote(folder, save(folder, two_modes(), created=1.0))
    return folder


def test_a_candidate_has_its_finding_beside_it_and_is_promoted_by_nobody(store: Path) -> None:
    first, model = current(store), two_modes()
    adopted = replace(model, sha=replace(model.sha, name="adopted"))
    name, fresh = propose(store, adopted, of("named"), created=2.0)
    assert fresh and current(store) == first and versions(store) == (first, name)
    finding = read_finding(version_directory(store, name))
    assert finding is not None and finding.diagnosed == first
    assert [(each.name, each.experiment) for each in finding.effects] == [
        ("pump-cooling", "run for half an hour at one load with the pump on, then off")
    ]
    assert (finding.before, finding.after, finding.floor, finding.unit) == (0.63, 0.225, 0.2, "degC")
    assert load(store, name).sha.name == "adopted", "its hashes hold with the finding among its files"
    assert read_finding(version_directory(store, first)) is None


def test_what_waits_for_a_decision_is_not_proposed_every_night(store: Path) -> None:
    model = two_modes()
    name, _ = propose(store, model, of("named"), created=2.0)
    assert propose(store, model, of("named"), created=3.0) == (name, False)
    other, fresh = propose(store, model, of("class"), created=4.0)
    assert (other, fresh) == (name, False), "the same effect, of which the data say less"
    promote(store, name)
    again, fresh = propose(store, model, of("named"), created=5.0)
    assert fresh and again != name, "what is missing in the version that runs now is another finding"
    with pytest.raises(ValueError, match="names nothing"):
        propose(store, model, of("agree"), created=6.0)


def test_a_finding_that_was_damaged_is_refused_by_its_name(store: Path) -> None:
    name, _ = propose(store, two_modes(), of("named"), created=2.0)
    file = version_directory(store, name) / FINDING_FILE
    whole = json.loads(file.read_text(encoding="utf-8"))
    for bad in ("{", "[]", json.dumps({**whole, "version": 9}), json.dumps({**whole, "effects": [{}]}), '{"a": 1}'):
        file.write_text(bad, encoding="utf-8")
        with pytest.raises(ArtefactError, match=rf"{FINDING_FILE}.*cannot be used as a finding"):
            read_finding(file.parent)


def guarded(path: Path, cycles: int, **more: float | None) -> Path:
    """A historian of a short run, after which the model's free run was beyond its limit on so many cycles."""
    trace = scenario("cd1")
    kept(path, trace)
    store, _ = one_machine(path)
    guards = json.dumps({"drift": {"cycles": cycles, "error": 2.0, "limit": 1.0, **more}})
    store.view("decanter", temperature="TCuscinettiRiduttore").put("guards", [(float(trace.times[-1]), guards)])
    assert store.close()
    return path


def test_a_drift_that_nobody_looked_at_is_not_called_none(model: Path, tmp_path: Path) -> None:
    never, fresh = tmp_path / "never.sqlite", guarded(tmp_path / "fresh.sqlite", 0, error=None, limit=None)
    trace = scenario("cd1")
    kept(never, trace)
    records, _ = one_machine(never)
    long_ago = float(trace.times[0]) - 7200.0
    records.view("decanter", temperature="TCuscinettiRiduttore").put("guards", [(long_ago, "{}")])
    assert records.close()
    store = tmp_path / "store"
    promote(store, save(store, find_model(str(model)).runnable(), created=1.0))
    for historian, reason in (
        (never, f"the newest hour of {never} has nothing of a model of TCuscinettiRiduttore"),
        (fresh, "no whole cycle has been judged"),
    ):
        said = decanter(
            "diagnose", "--model", store, "--if-drifting", "--out", tmp_path / "o", "--historian", historian
        )
        assert said.exit_code == 0, said.stderr
        assert f"not due: drift was not looked at: {reason}" in said.stdout
    short = guarded(tmp_path / "short.sqlite", 0, error=None, limit=None)
    with reading(short) as connection:
        known = two_modes()
        levels = tuple(channel for channel in known.alphabet.channels if not isinstance(channel, Switch))
        mute = replace(known, alphabet=Alphabet(levels, gap=150.0))
        said_of = recorded_drift(connection, short, machine=None, model=mute)
        assert said_of.not_looked_at.endswith("has no switch, so nothing says when a cycle begins")
        assert "with 20 readings or more" in recorded_drift(connection, short, machine=None, model=known).why_not_due()
    plain = only_object(
        decanter(
            "diagnose", "--model", store, "--if-drifting", "--out", tmp_path / "o", "--historian", never, "--json"
        ).stdout
    )
    assert (plain["due"], plain["drifting"]) == (False, None)
    assert plain["drift_not_looked_at"].startswith("the newest hour of")


def test_a_schedule_diagnoses_only_while_the_drift_alarm_stands(model: Path, tmp_path: Path) -> None:
    calm, drifting = guarded(tmp_path / "calm.sqlite", 2), guarded(tmp_path / "drifting.sqlite", 3)
    with reading(drifting) as connection:
        said_of = recorded_drift(connection, drifting, machine=None, model=two_modes())
        assert said_of == RecordedDrift(3, 3), "a former release does not say from how many on"
    store = tmp_path / "store"
    promote(store, save(store, find_model(str(model)).runnable(), created=1.0))
    given = ("diagnose", "--model", store, "--if-drifting", "--propose", "--out", tmp_path / "out", "--historian")
    said = decanter(*given, calm)
    assert said.exit_code == 0, said.stderr
    assert "not due: the free run was beyond its limit on 2 cycles running" in said.stdout
    assert only_object(decanter(*given, calm, "--json").stdout) == {"ok": True, "due": False, "drifting": 2}
    assert not (tmp_path / "out").exists()
    data = only_object(decanter(*given, drifting, "--json").stdout)
    assert (data["verdict"], data["proposed"], data["new"]) == ("too-little-data", None, False)
    assert len(versions(store)) == 1


def test_a_plant_whose_alarm_counts_other_cycles_has_its_diagnosis_with_that_alarm(model: Path, tmp_path: Path) -> None:
    patient = guarded(tmp_path / "patient.sqlite", 4, alarm_cycles=5)
    given = ("diagnose", "--model", model, "--if-drifting", "--out", tmp_path / "out", "--historian")
    assert "on 4 cycles running, fewer than 5" in decanter(*given, patient).stdout
    hasty = guarded(tmp_path / "hasty.sqlite", 1, alarm_cycles=1)
    assert only_object(decanter(*given, hasty, "--json").stdout)["verdict"] == "too-little-data"


def test_a_candidate_needs_a_store_and_drift_a_historian(model: Path, traces: Path, tmp_path: Path) -> None:
    given = ("diagnose", "--model", model, "--traces", traces / "cd1.csv", "--out", tmp_path / "out")
    refused(decanter(*given, "--propose"), 2, "is none; give --model the store")
    misused(decanter(*given, "--if-drifting"), "--if-drifting belongs to --historian")
