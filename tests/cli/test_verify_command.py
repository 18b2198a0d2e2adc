"""`decanter model judge proof`, its counterexamples in `model simulate --word`, promotion, and the gateway's gate."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.settings import ConfigError
from gateway.machine.model.loading import load_model
from sim.artefacts import NO_VERDICT_TEXT
from sim.artefacts.store import Force, current, find_force, load, promote
from sim.files import ArtefactError
from sim.lab.formats.write_model import save, write_model_directory
from sim.sha.model import Model
from tests.checking.verify_models import thesis
from tests.cli.artefact_set import files, written
from tests.cli.support import decanter, misused, only_object, refused
from tests.gateway.support import TEMPERATURE, config_in, two_modes

HOT = replace(thesis(), temperature=TEMPERATURE)
ARMED = {
    "writeback__mode": "armed",
    "writeback__armed_by": "test",
    "writeback__reason": "test",
    "writeback__minutes": 5.0,
}


def directory(folder: Path, model: Model) -> Path:
    write_model_directory(folder, model)
    return folder


def test_a_learned_model_is_deployable_and_accepts_the_trace_that_it_was_learned_from(
    model: Path, traces: Path
) -> None:
    result = decanter("model", "judge", "proof", model, "--traces", traces / "cd17.csv", "--json")
    data = only_object(result.stdout)
    assert result.exit_code == 0 and data["deployable"] is True and data["reasons"] == []
    verdicts = {row["check"]: row["verdict"] for row in data["checks"]}
    assert verdicts["acceptance"] == verdicts["determinism"] == verdicts["growth"] == "proven"
    assert set(data["intervals"]) == {
        f"{a}/{b}" if (a, b) != ("?", "?") else "?"
        for a in ("ON", "OFF", "?")
        for b in ("0-100", "100-200", "200-300", "300+", "?")
    }
    text = decanter("model", "judge", "proof", model).stdout
    assert "proven: every check that decides" in text and "unfit" not in text and len(text.splitlines()) < 40


def test_a_model_that_diverges_leaves_with_1_and_the_printed_word_really_leaves(tmp_path: Path) -> None:
    hot = directory(tmp_path / "hot", HOT)
    word = tmp_path / "word.txt"
    result = decanter("model", "judge", "proof", hot, "--word", word)
    assert result.exit_code == 1
    assert "unfit: not proven: growth" in result.stdout and "without bound" in result.stdout
    data = only_object(decanter("model", "simulate", hot, "--word", word, "--json").stdout)
    assert data["leaves"] is True and data["highest"] > 150.0
    text = word.read_text(encoding="utf-8").strip()
    assert only_object(decanter("model", "simulate", hot, "--word", text, "--json").stdout) == data
    shown = decanter("model", "simulate", hot, "--word", text).stdout
    assert "it is left in 'run'" in shown


def test_a_model_that_grows_is_told_how_to_learn_one_that_cannot_and_the_deciding_word_comes_first(
    tmp_path: Path,
) -> None:
    shown = decanter("model", "judge", "proof", directory(tmp_path / "hot", HOT)).stdout
    assert "the flow of 'run' is linear, which has no target" in shown
    assert "--method lsha --default-flow exponential" in shown
    assert "counterexample to growth: decanter model simulate" in shown
    fine = decanter("model", "judge", "proof", directory(tmp_path / "m", two_modes())).stdout
    assert "--default-flow" not in fine and "counterexample" not in fine


def test_artefacts_take_the_alphabet_of_a_map_that_is_named_also_without_a_trace(tmp_path: Path) -> None:
    where = written(tmp_path, files())
    bare = only_object(decanter("model", "judge", "proof", where, "--json").stdout)
    assert any(reason.startswith("alphabet refuted: no plant could run it") for reason in bare["reasons"])
    mapped = only_object(decanter("model", "judge", "proof", where, "--map", "decanter", "--json").stdout)
    assert not any("has no channel" in reason for reason in mapped["reasons"])


def test_a_claimed_range_must_be_proven(tmp_path: Path) -> None:
    cold = directory(tmp_path / "m", two_modes())
    assert decanter("model", "judge", "proof", cold, "--bounds", 0, 60).exit_code == 0
    result = decanter("model", "judge", "proof", cold, "--bounds", 0, 45, "--json")
    assert result.exit_code == 1
    assert "T can leave [0, 45] degC: above 45 in 'on'" in only_object(result.stdout)["reasons"][0]
    short = decanter("model", "judge", "proof", directory(tmp_path / "h", HOT), "--sojourn", "0..60", "--json")
    assert any("0 to 60 s" in one for one in only_object(short.stdout)["assumptions"])


def test_verify_refuses_wrong_arguments_in_one_sentence(tmp_path: Path) -> None:
    m = directory(tmp_path / "m", two_modes())
    refused(decanter("model", "judge", "proof", tmp_path / "none"), 2, "none")
    refused(decanter("model", "judge", "proof", m, "--bounds", 5, 5), 2, "no temperature lies within 5 to 5")
    refused(decanter("model", "judge", "proof", m, "--sojourn", "9..2"), 2, "stays of 9 to 2 s are none")
    refused(decanter("model", "judge", "proof", m, "--inputs", "Load=0..5"), 2, "none is driven by any signal")
    refused(decanter("model", "judge", "proof", m, "--map", "nowhere"), 2, "nowhere")
    misused(decanter("model", "judge", "proof", m, "--sojourn", "often"), "is no range")
    misused(decanter("model", "judge", "proof", m, "--inputs", "Load"), "SIGNAL=LOW..HIGH")
    misused(decanter("model", "judge", "proof", m, "--z", "nan"), "no finite number")
    refused(decanter("model", "simulate", m, "--word", "W_ON"), 2, "W_ON")
    refused(decanter("model", "simulate", m, "--word", "W_ON@x"), 2, "no finite number")
    misused(decanter("model", "simulate", m), "--trace or --word")
    misused(decanter("model", "simulate", m, "--word", "W_ON@0", "--trace", "x.csv"), "--trace or --word")


# ------------------------------------------------------------------ the gate


def test_promotion_refuses_what_does_not_verify_and_keeps_the_current_version(tmp_path: Path) -> None:
    shelf = tmp_path / "store"
    good = directory(tmp_path / "good", two_modes())
    first = only_object(decanter("model", "version", "promote", shelf, "--add", good, "--json").stdout)["current"]
    bad = save(shelf, HOT, created=1.0)
    refused(
        decanter("model", "version", "promote", shelf, bad),
        2,
        bad,
        "is not promoted, as it does not verify",
        "without bound",
    )
    assert current(shelf) == first
    said = decanter("model", "version", "promote", shelf, first).stdout
    assert said == f"{first}: {NO_VERDICT_TEXT}\n{shelf}: {first} is current\n"


def test_a_forced_promotion_is_recorded_with_name_and_reason(tmp_path: Path) -> None:
    bad = save(tmp_path, HOT, created=1.0)
    result = decanter(
        "model", "version", "promote", tmp_path, bad, "--force", "rest is over in an hour", "--by", "Anna"
    )
    assert "forced by Anna: rest is over in an hour" in result.stdout
    force = find_force(tmp_path)
    assert force is not None and (force.by, force.reason) == ("Anna", "rest is over in an hour")
    assert load(tmp_path) == HOT
    good = save(tmp_path, two_modes(), created=2.0)
    promote(tmp_path, good, Force("Anna", "habit", 3.0))
    assert find_force(tmp_path) is None, "a model that verifies is not forced"
    promote(tmp_path, bad, Force("Bert", "again", 4.0))
    assert find_force(tmp_path) == Force("Bert", "again", 4.0)


def test_what_cannot_be_run_cannot_be_forced(tmp_path: Path) -> None:
    sha = HOT.sha
    split = replace(HOT, sha=replace(sha, edges=(*sha.edges, replace(sha.edges[0], target="rest"))))
    version = save(tmp_path, split, created=1.0)
    with pytest.raises(ArtefactError, match=r"cannot be run at all: determinism refuted: 1 conflicts"):
        promote(tmp_path, version, Force("Anna", "please", 2.0))


def test_promote_is_called_with_one_model_and_a_whole_signature(tmp_path: Path) -> None:
    misused(decanter("model", "version", "promote", tmp_path), "name a VERSION of the store, or --add a model")
    misused(
        decanter("model", "version", "promote", tmp_path, "x", "--force", "why"), "--force REASON and --by NAME belong"
    )
    misused(decanter("model", "version", "promote", tmp_path, "x", "--force", " ", "--by", "Anna"), "neither is empty")
    refused(decanter("model", "version", "promote", tmp_path, "x"), 2, "is no model store")


def test_the_gateway_does_not_start_on_a_model_that_does_not_verify(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"model\.path: the model at .* is not run, as it does not verify: growth"):
        load_model(config_in(tmp_path, model=HOT))
    result = decanter("plc", "check", "--offline", "--config", config_in(tmp_path, model=HOT).path)
    assert (
        result.exit_code == 1 and "does not verify" in result.stderr and "decanter model judge proof" in result.stderr
    )


def test_the_gateway_runs_a_forced_model_with_a_warning_and_never_armed(tmp_path: Path) -> None:
    version = save(tmp_path / "store", HOT, created=1.0)
    promote(tmp_path / "store", version, Force("Anna", "for a look", 2.0))
    config = config_in(tmp_path, '[model]\npath = "store"\n')
    loaded = load_model(config)
    assert loaded is not None and "Anna promoted it by force: for a look" in loaded.warning
    with pytest.raises(ConfigError, match=r"writeback\.mode: is 'armed'.*set it to 'shadow'"):
        load_model(config_in(tmp_path, '[model]\npath = "store"\n', **ARMED))


def test_the_gateway_runs_a_model_that_verifies_without_a_word(tmp_path: Path) -> None:
    loaded = load_model(config_in(tmp_path, model=two_modes(), **ARMED))
    assert loaded is not None and loaded.warning == ""
