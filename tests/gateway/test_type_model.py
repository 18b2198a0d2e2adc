"""A model of a type of machine in the gateway: each machine runs it with what is its own, by name or as is said."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.settings import ConfigError
from gateway.machine.model.loading import load_models
from gateway.settings import load_plant
from sim.artefacts.model_json import model_text
from sim.sha import Effect, MachineCorrection, Model
from tests.cli.support import decanter
from tests.gateway.support import MAP, TEMPERATURE, two_modes

MACHINES = {"m1": MachineCorrection(targets=4.0, targets_error=0.5), "m2": MachineCorrection(gain=1.1)}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A plant file's place, beside a model of a type."""
    model = two_modes()
    sha = replace(model.sha, effects=(Effect("machine-offset", {"sigma": 7.5}),))
    text = model_text(replace(model, sha=sha, machines=MACHINES))
    (tmp_path / "type.json").write_text(text, encoding="utf-8")
    return tmp_path / "plant.toml"


def loaded(path: Path, text: str) -> list[Model]:
    path.write_text(f'[device]\nfile = "{MAP}"\n{text}', encoding="utf-8")
    models = [of_one for config in load_plant(path) for of_one, _ in load_models(config)]
    return [one.model for one in models if one is not None]


def spread(model: Model) -> float:
    return model.sha.effects[0].params["sigma"]


THREE = "".join(f'[[machine]]\nname = "m{n}"\n[machine.device]\nhost = "10.0.0.{n}"\n' for n in (1, 2, 3))


def test_each_machine_of_a_plant_has_its_own_by_its_name_and_a_new_one_is_the_type(path: Path) -> None:
    one, two, new = loaded(path, f'[model]\npath = "type.json"\n{THREE}')
    assert one.provenance.settings["machine"] == "m1" and (spread(one), one.correction.gain) == (0.5, 1.0)
    assert two.provenance.settings["machine"] == "m2" and (spread(two), two.correction.gain) == (0.0, 1.1)
    assert "machine" not in new.provenance.settings and spread(new) == 7.5
    assert len({model_text(model) for model in (one, two, new)}) == 3


@pytest.mark.parametrize(
    "keys", ['[model]\npath = "type.json"', f'[[temperature]]\ntag = "{TEMPERATURE}"\nmodel = "type.json"']
)
def test_whose_correction_is_taken_may_be_said(path: Path, keys: str) -> None:
    (same,) = loaded(path, f'{keys}\ncorrection = "m1"\n')
    assert spread(same) == 0.5
    (bare,) = loaded(path, f'{keys}\ncorrection = ""\n')
    assert spread(bare) == 7.5
    with pytest.raises(ConfigError, match=r"correction: the model knows no machine 'm9', only m1, m2; give one of"):
        loaded(path, f'{keys}\ncorrection = "m9"\n')


def test_check_and_show_say_the_type_and_what_is_each_ones_own(path: Path) -> None:
    loaded(path, f'[model]\npath = "type.json"\n{THREE}')
    for machine, words in (("m1", "what it knows of the machine m1"), ("m3", "a new machine of the type of m1, m2")):
        assert words in decanter("plc", "check", "--offline", "--config", path, "--machine", machine).output
    shown = decanter("model", "show", path.parent / "type.json").stdout
    assert "a model of a type of machine" in shown and "+4 ± 0.5" in shown and "1.1" in shown
