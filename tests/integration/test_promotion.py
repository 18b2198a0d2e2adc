"""A promotion by the command line reaches a running, armed gateway: over real processes and a real socket."""

from dataclasses import replace
from pathlib import Path

from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.store.read_back import reading
from sim.artefacts.store import CURRENT_LINK
from sim.lab.formats.write_model import save, write_model_directory
from sim.plc.record.recording import read_recording
from sim.sha.automaton import Distribution, Effect, Flow
from sim.sha.model import Model, Stay
from tests.rig.pair import TARGETS, Gateway, Rig, known_model, make_rig, restless_trace

PERIOD = 0.1
FULL = 2 | 4 | 8 | 16
"""Inputs, location, forecast, model. The restless trace follows no model: its zone is red, and bit 0 stays clear."""


def named(name: str) -> Model:
    """The known model under another name, so another version."""
    model = known_model()
    return replace(model, sha=replace(model.sha, name=name))


def diverging() -> Model:
    """The known model, whose hardest work warms by 0.05 degC/s for as long as it lasts."""
    model = named("diverging")
    slope = Distribution("normal", {"mu": 0.05, "sigma": 0.0})
    places = tuple(
        replace(place, flow=Flow("linear", {"noise": 0.0}), distribution=slope, entry="parameter")
        if place.name == "ON/300+"
        else place
        for place in model.sha.locations
    )
    return replace(model, sha=replace(model.sha, locations=places))


def augmented() -> Model:
    """The known model with what a diagnosis may add: heat of the current, a pump, a housing, a slow sensor."""
    model = named("augmented")
    running = tuple(name for name in TARGETS if name.startswith("ON/"))
    effects = (
        Effect("current-heating", {"gain": 1e-5, "reference": 150.0}, {"current": "Assorbimento"}, running),
        Effect("pump-cooling", {"loss": 2e-6, "sink": 20.0}, {"pump": "VelocitaPompa"}),
        Effect("housing-thermal-mass", {"coupling": 1e-3, "tau": 1200.0}),
        Effect("sensor-lag", {"tau": 5.0, "order": 2.0}),
        Effect("dead-time", {"delay": 0.3}),
    )
    stay = Stay(Distribution("exponential", {"mean": 60.0}), {"OFF/0-100": 1.0}, {"VelocitaPompa": (50.0, 15.0)})
    return replace(model, sha=replace(model.sha, effects=effects), semi_markov={running[0]: stay})


def decanter(*arguments: object) -> Result:
    """The command in this process: the gateway that it speaks to is another one all the same."""
    return CliRunner().invoke(main, list(map(str, arguments)))


def promoted(store: Path, folder: Path, model: Model) -> str:
    """Promote a model as an operator would; the version's name."""
    write_model_directory(folder / model.sha.name, model)
    done = decanter("model", "version", "promote", store, "--add", folder / model.sha.name)
    assert done.exit_code == 0, done.stderr
    return (store / CURRENT_LINK).read_text(encoding="utf-8").strip()


def on_a_store(folder: Path) -> tuple[Rig, Path]:
    """The rig with its model in a store."""
    rig = make_rig(folder, restless_trace(90.0), period=PERIOD)
    text = rig.plant.read_text(encoding="utf-8")
    rig.plant.write_text(text.replace('path = "model.json"', 'path = "store"'), encoding="utf-8")
    return rig, folder / "store"


def go_on(gateway: Gateway, blocks: int) -> None:
    """Wait until the PLC has accepted so many blocks more, the last one usable in full."""
    before = gateway.status["writeback"]["accepted"]
    gateway.wait_for(
        lambda status: (
            status["writeback"].get("accepted", 0) > before + blocks
            and status["writeback"]["last_validity"] & FULL == FULL
        )
    )


def test_promoted_versions_run_without_a_restart_one_with_effects_too_and_one_that_diverges_changes_nothing(
    tmp_path: Path,
) -> None:
    rig, store = on_a_store(tmp_path)
    first = promoted(store, tmp_path, named("first"))
    with rig.plc() as plc, rig.gateway(plc) as gateway:
        gateway.wait_for(lambda status: bool(status["writeback"].get("accepted")))
        assert gateway.status["model"]["version"] == first
        go_on(gateway, 10)
        second = promoted(store, tmp_path, named("second"))
        gateway.wait_for(lambda status: status["model"]["version"] == second)
        go_on(gateway, 10)
        third = promoted(store, tmp_path, augmented())
        gateway.wait_for(lambda status: status["model"]["version"] == third)
        go_on(gateway, 20)

        bad = save(store, diverging(), created=1.0)
        refused = decanter("model", "version", "promote", store, bad)
        assert refused.exit_code == 2 and "is not promoted, as it does not verify: growth" in refused.stderr
        (store / CURRENT_LINK).write_text(bad + "\n", encoding="utf-8")  # past the command, which refused it
        said = gateway.wait_for(lambda status: bool(status["model"]["refused"]))
        assert said["model"]["version"] == third and "growth refuted" in said["model"]["refused"]
        go_on(gateway, 10)
        last = gateway.status
        assert (last["failures"], last["model"]["version"]) == (0, third)
        assert gateway.stop()[0] == 0
    blocks = [block.fields for block in read_recording(rig.recording).blocks if block.fields is not None]
    hashes = [fields["model_hash"] for fields in blocks if int(fields["validity"]) & 16]
    assert len(set(hashes)) == 3 and hashes == sorted(hashes, key=hashes.index), "two changes, and never back"
    with reading(rig.historian) as connection:
        told = connection.execute("SELECT what FROM audit WHERE what LIKE '%model%' ORDER BY id").fetchall()
        unknown = connection.execute("SELECT count(*) FROM predictions WHERE NOT known").fetchone()[0]
    assert told == [(f"model {second} runs",), (f"model {third} runs",), ("promoted model refused",)]
    assert unknown <= 3, "the location is unknown at the very start alone"
