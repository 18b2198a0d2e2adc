"""`plc bind --block` of a map with two blocks moved the first one, whichever was meant."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from gateway.settings import load_device
from tests.commission.bench import answer, plc
from tests.gateway.support import MAP

FIRST, OTHER = "TCuscinettiRiduttore", "TCuscinettiAlimentazione"


@pytest.fixture
def device(tmp_path: Path) -> Path:
    path = tmp_path / "plc.toml"
    path.write_bytes(MAP.read_bytes())
    return path


def bound(folder: Path, device: Path, *words: object) -> dict[str, Any]:
    return answer(folder, "bind", "--block", "holding:600", *words, "--device", device)


def test_it_asks_which_of_several_is_meant_and_moves_that_one(tmp_path: Path, device: Path) -> None:
    before = device.read_bytes()
    refused = plc(tmp_path, "bind", "--block", "holding:600", "--device", device)
    assert refused.exit_code == 2 and f"say which with --block-of {FIRST} or {OTHER}" in refused.stderr
    assert device.read_bytes() == before
    assert bound(tmp_path, device, "--block-of", OTHER)["ok"]
    assert [layout.words[0].address for layout in load_device(device).writebacks] == ["holding:400", "holding:600"]
    wanted = tomllib.loads(before.decode())
    wanted["writeback"]["blocks"][0]["address"] = "holding:600"
    assert tomllib.loads(device.read_text(encoding="utf-8")) == wanted, "and nothing else"
    assert device.read_text(encoding="utf-8").count("#") == before.decode().count("#")


def test_the_first_one_is_meant_by_its_temperature_too(tmp_path: Path, device: Path) -> None:
    assert bound(tmp_path, device, "--block-of", FIRST)["ok"]
    assert [layout.words[0].address for layout in load_device(device).writebacks] == ["holding:600", "holding:430"]


def test_a_temperature_of_which_no_block_speaks_is_refused(tmp_path: Path, device: Path) -> None:
    refused = plc(tmp_path, "bind", "--block", "holding:600", "--block-of", "TFango", "--device", device)
    assert refused.exit_code == 2 and "no block of the device file speaks of 'TFango'" in refused.stderr
    refused = plc(tmp_path, "bind", "--block-of", OTHER, "--device", device)
    assert refused.exit_code == 2 and "give --block ADDRESS too" in refused.stderr


def test_a_lone_block_needs_no_word_and_takes_one(tmp_path: Path, device: Path) -> None:
    text = device.read_text(encoding="utf-8")
    text = text[: text.index("# The same words once more")]
    device.write_text(text, encoding="utf-8")
    assert bound(tmp_path, device)["ok"]
    assert load_device(device).writebacks[0].words[0].address == "holding:600"
    # Of a file that does not say whose it is, it says so from then on.
    own = f'temperature = "{FIRST}"'
    device.write_text(text.replace(own, "", 1), encoding="utf-8")
    assert load_device(device).writebacks[0].temperature is None
    assert bound(tmp_path, device, "--block-of", OTHER)["ok"]
    assert load_device(device).writebacks[0].temperature == OTHER
