"""Mistakes of a first hour: each is answered by one sentence and its exit code, as docs/commissioning.md has it."""

from pathlib import Path

import pytest

from benchmarks.mistakes import MISTAKES, PAGE, answered, prepare, row


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the mistakes are made with."""
    made = tmp_path_factory.mktemp("mistakes")
    prepare(made)
    return made


def test_there_are_seventy_of_them() -> None:
    assert len({words for words, _, _ in MISTAKES}) == len(MISTAKES) >= 70


@pytest.mark.parametrize(("words", "code", "part"), MISTAKES, ids=[words for words, _, _ in MISTAKES])
def test_a_mistake_is_answered_by_one_sentence(words: str, code: int, part: str, folder: Path) -> None:
    before = sorted(path.name for path in folder.iterdir())
    result = answered(words, folder)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == code and "Traceback" not in result.stderr and "Errno" not in result.stderr
    # Learning warns of the readings before it says what went wrong.
    *warnings, sentence = result.stderr.strip().splitlines()
    assert part in sentence or any(part in line for line in warnings)
    made = {path.name for path in folder.iterdir()} - {*before, "out"}
    assert made == set()
    # The page is made of these answers: python -m benchmarks.mistakes --write
    assert row(words, result, folder) in PAGE.read_text(encoding="utf-8").splitlines()
