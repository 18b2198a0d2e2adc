"""The one formatter of sentences about settings: the key as the file has it, the reason, and what would be right."""

from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from drivers.errors import DriverError
from drivers.settings import ConfigError, Section, check_settings, validate_section


class Cold(Section):
    kind: Literal["cold"]
    depth: float = Field(1.0, gt=0, description="metres, above 0")


class Hot(Section):
    kind: Literal["hot"]
    power: int = Field(1, ge=1, le=9, description="kilowatts, 1 to 9")


class Rooms(Section):
    name: str = Field(min_length=1, description="a name")
    rooms: list[Annotated[Cold | Hot, Field(discriminator="kind")]] = Field(
        default_factory=list, description="a list of rooms"
    )
    by_name: dict[str, Cold] = Field(default_factory=dict, description="a table of cold rooms")
    size: float | None = Field(None, description="square metres")


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({}, "f: name: is missing; give a name"),
        ({"name": ""}, "f: name: must not be empty, got ''; give a name"),
        ({"name": 3}, "f: name: must be text, got 3; give a name"),
        ({"name": "n", "size": "wide"}, "f: size: must be a number, got 'wide'; give square metres"),
        ({"name": "n", "size": float("inf")}, "f: size: must be a finite number, got inf; give square metres"),
        ({"name": "n", "siz": 1}, "f: siz: there is no such key; did you mean 'size'?"),
        ({"name": "n", "qq": 1}, "f: qq: there is no such key; known are name, rooms, by_name, size"),
        ({"name": "n", "rooms": 1}, "f: rooms: must be a list, got 1; give a list of rooms"),
        (
            {"name": "n", "rooms": [{"kind": "hot", "power": 10}]},
            "f: rooms[0].power: must be at most 9, got 10; give kilowatts, 1 to 9",
        ),
        (
            {"name": "n", "rooms": [{"kind": "cold"}, {"kind": "cold", "depht": 1}]},
            "f: rooms[1].depht: there is no such key; did you mean 'depth'?",
        ),
        (
            {"name": "n", "rooms": [{"kind": "cold", "power": 1}]},
            "f: rooms[0].power: there is no such key; known are kind, depth",
        ),
        (
            {"name": "n", "by_name": {"name": {"kind": "cold", "depth": 0}}},
            "f: by_name.name.depth: must be more than 0, got 0; give metres, above 0",
        ),
    ],
)
def test_a_sentence_has_place_key_reason_and_remedy(given: dict[str, object], sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        validate_section(Rooms, given, Path("f"))
    assert caught.value.problems == (sentence,)
    with pytest.raises(DriverError) as refused:
        check_settings("f", Rooms, given)
    assert str(refused.value) == sentence


def test_what_is_none_is_not_given() -> None:
    assert check_settings("f", Rooms, {"name": "n", "rooms": None}).rooms == []
