"""The one door for models: whatever form a model has, a command that takes one finds it or says what is there."""

from pathlib import Path

import pytest

from sim.artefacts.model_directory import MODEL_FILE
from sim.artefacts.store import Force, promote
from sim.files import ArtefactError
from sim.lab.formats.find import find_model
from sim.lab.formats.foreign.bundle import write_artefacts
from sim.lab.formats.foreign.from_model import to_artefacts
from sim.lab.formats.write_model import save, write_model_directory
from tests.artefacts.models import decanter_model
from tests.artefacts.real import REAL, SETS, real_data

MODEL = decanter_model()


def test_a_model_directory_its_file_and_a_store_are_the_same_model(tmp_path: Path) -> None:
    write_model_directory(tmp_path / "plain", MODEL)
    first = save(tmp_path / "store", MODEL, created=1.0)
    promote(tmp_path / "store", first, Force("tests", "it has every flow kind, and some grow without bound", 0.0))
    for where in ("plain", f"plain/{MODEL_FILE}", "store", f"store@{first}"):
        found = find_model(tmp_path / where)
        assert found.runnable() == MODEL, where
        assert found.structure == MODEL.sha


def test_a_version_that_a_store_does_not_have_is_named_with_those_it_has(tmp_path: Path) -> None:
    first = save(tmp_path / "store", MODEL, created=1.0)
    with pytest.raises(ArtefactError, match=f"there is no version '0009-00000000'; there are: {first}"):
        find_model(f"{tmp_path / 'store'}@0009-00000000")


@pytest.mark.parametrize("where", ["set/cd", "set", "set/cd_source.txt"])
def test_artefacts_are_found_by_their_base_name_their_directory_or_their_source(tmp_path: Path, where: str) -> None:
    write_artefacts(tmp_path / "set", to_artefacts(MODEL))
    found = find_model(tmp_path / where, alphabet=MODEL.alphabet, temperature=MODEL.temperature)
    assert found.runnable().sha == MODEL.sha
    assert found.runnable().alphabet == MODEL.alphabet
    assert found.artefacts is not None


def test_a_directory_with_two_sets_asks_which_one(tmp_path: Path) -> None:
    write_artefacts(tmp_path, to_artefacts(decanter_model("one")))
    write_artefacts(tmp_path, to_artefacts(decanter_model("two")))
    with pytest.raises(ArtefactError, match=r"holds 2 sets of artefacts; say which, as .*one \(one, two\)"):
        find_model(tmp_path)


def test_a_base_name_in_the_wrong_case_is_told_with_the_right_one(tmp_path: Path) -> None:
    write_artefacts(tmp_path, to_artefacts(decanter_model("Plant")))
    with pytest.raises(ArtefactError, match="upper and lower case count"):
        find_model(tmp_path / "plant")


def test_a_name_that_is_nothing_says_so_and_lists_the_sets_beside_it(tmp_path: Path) -> None:
    write_artefacts(tmp_path, to_artefacts(decanter_model("Plant")))
    with pytest.raises(ArtefactError, match=r"no model directory, store, file or set .* are Plant"):
        find_model(tmp_path / "other")
    with pytest.raises(ArtefactError, match="no model directory, store, file or set of artefacts of this name"):
        find_model(tmp_path / "nowhere" / "other")


class TestRealArtefacts:
    """The public learner's sets: all have a structure; what cannot be run says why."""

    pytestmark = real_data

    @pytest.mark.parametrize("name", SETS)
    def test_every_real_set_is_runnable_or_refused_with_its_place_and_reason(self, name: str) -> None:
        found = find_model(SETS[name] / name)
        assert found.structure.locations
        if found.model is None:
            assert found.refusal.startswith(f"{SETS[name] / name}: ")
            with pytest.raises(ArtefactError, match=r"location|flow|distribution"):
                found.runnable()
        else:
            assert name == "HRI_SIM_3b"

    def test_the_folder_with_five_sets_asks_which(self) -> None:
        with pytest.raises(ArtefactError, match="holds 5 sets"):
            find_model(REAL)
