"""No sentence of one command names an option of another: `trace map` has every option that its messages name."""

import ast
import inspect
import re
import textwrap
from importlib.util import find_spec
from pathlib import Path

import click
import pytest

import sim.lab.recordings
import sim.lab.recordings.mapping
from gateway.entry import FirstWordCommand
from gateway.lab.traces.commands import map_command
from tests.cli.support import command_paths, find_command

OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]+)")
FIELDS = re.compile(r"[a-z][a-z-]+")
MAPPING = Path(sim.lab.recordings.mapping.__file__).parent
READING = Path(sim.lab.recordings.__file__).parent


def texts(file: Path) -> list[str]:
    """All texts of a module that are not docstrings."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    said = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in said]
    return [node.value for node in nodes if isinstance(node.value, str)]


def options() -> set[str]:
    return {
        name.removeprefix("--") for each in map_command.params if isinstance(each, click.Option) for name in each.opts
    }


@pytest.mark.parametrize("file", sorted(MAPPING.glob("*.py")), ids=lambda file: file.stem)
def test_every_option_that_trace_map_names_is_its_own(file: Path) -> None:
    named = {option for text in texts(file) for option in OPTION.findall(text)}
    assert named <= options()


@pytest.mark.parametrize("file", sorted(READING.glob("*.py")), ids=lambda file: file.stem)
def test_reading_which_any_command_does_names_keys_of_the_map_and_no_option(file: Path) -> None:
    assert not [option for text in texts(file) for option in OPTION.findall(text)]


def test_every_question_has_the_option_that_answers_it() -> None:
    """The third argument of an Undecided, and the part that `_best` and `_named` ask for, are options."""
    fields = set()
    for file in MAPPING.glob("*.py"):
        for call in (
            node for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)
        ):
            name = getattr(call.func, "id", "")
            place = {"Undecided": 2, "_best": 1, "_named": 1}.get(name)
            if place is not None and isinstance(field := call.args[place], ast.Constant):
                fields.add(field.value)
    assert {"temperature", "current", "running", "on", "unit", "stored", "duplicates", "clock-back"} <= fields
    assert fields <= options()


def named_options(command: click.Command) -> set[str]:
    given = (
        name for each in command.params if isinstance(each, click.Option) for name in each.opts + each.secondary_opts
    )
    return {name.removeprefix("--") for name in given} | {"help", "version"}


def own_files(command: click.Command) -> set[str]:
    """The file of a command, and those of the modules that it loads when it is asked to work."""
    assert command.callback is not None
    work = inspect.unwrap(command.callback)
    tree = ast.parse(textwrap.dedent(inspect.getsource(work)))
    loaded = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    found = [inspect.getsourcefile(work), *(find_spec(name).origin for name in loaded)]  # type: ignore[union-attr]
    return {file for file in found if file is not None}


def whole_texts(file: Path) -> list[str]:
    """The texts of a module that are not docstrings, those with values in them whole."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    aside = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    joined = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
    aside |= {id(part) for each in joined for part in each.values}
    whole = ["".join(part.value if isinstance(part, ast.Constant) else "" for part in each.values) for each in joined]
    return whole + [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in aside
    ]


def test_an_option_in_a_message_of_a_command_is_its_own_or_the_command_that_has_it_is_named() -> None:
    every = {" ".join(words): find_command(words) for words, _ in command_paths()}
    for name, command in [*every.items()]:
        if isinstance(command, FirstWordCommand):  # its options without a word are those of its usual work
            every.pop(name)
            every |= {name: command.get_command(click.Context(command), command.usual)} if command.usual else {}
    by_file: dict[str, set[str]] = {}
    for command in every.values():
        for file in own_files(command):
            by_file[file] = by_file.get(file, set()) | named_options(command)
    assert len(by_file) > 40
    strange = [
        (Path(file).name, text)
        for file, own in by_file.items()
        for text in whole_texts(Path(file))
        if "systemctl" not in text
        for option in OPTION.findall(text)
        if option not in own
        and not any(option in named_options(each) and f"decanter {name} " in text for name, each in every.items())
    ]
    assert not strange
