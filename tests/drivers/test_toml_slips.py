"""What is said of a text that is no TOML: what would be right where that is certain, and nothing else."""

import tomllib

import pytest

from drivers.toml_slips import toml_remedy

COMMA, LINES, UNIT, QUOTES = (
    "no comma at the end of a line",
    "each key on a line",
    "without its unit",
    "a text in quotes",
)
TABLE, ZERO, NOTHING = "close a { table } on its line", "without a 0 before it", "correct that place"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('host = "10.0.0.5",', COMMA),
        ("period = 0.5,", COMMA),
        ("x = false,", COMMA),
        ("x = { a = 1 }, # a comment", COMMA),
        ("x = { a = 1, }", TABLE),
        ("x = { a = { b = 1 }, }", TABLE),
        ("x = [1,\n2 3,\n]", NOTHING),
        ("x=1 y=2", LINES),
        ("[a] x = 1", LINES),
        ("x = { a = 1 b = 2 }", NOTHING),
        ("time = 06:00", QUOTES),
        ("x = 010.0.0.5", QUOTES),
        ("x = 05", ZERO),
        ("x = 1/10", NOTHING),
        ("x = 1/10/2026", QUOTES),
        ("x = 1e", NOTHING),
        ("x = 0x", NOTHING),
        ("x = 5 eV", UNIT),
        ("x = 90 degC", UNIT),
    ],
)
def test_a_remedy_is_said_where_it_is_certain(text: str, words: str) -> None:
    with pytest.raises(tomllib.TOMLDecodeError) as caught:
        tomllib.loads(text)
    assert words in toml_remedy(text, str(caught.value))
