"""What a fuzz target is, and what all of them have to keep."""

import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

Run = Callable[[bytes], object]
"""Takes one input: refuses it with an error of the target's, or gives a result that it has checked itself."""
LONGEST_SENTENCE = 2000


@dataclass(frozen=True, slots=True)
class FuzzTarget:
    """What is fuzzed: valid `examples`, and `bench`, which makes ready in a folder and gives what takes an input.

    `errors` are the refusals, each of whose sentences begins as `place` (a pattern) says: the file, and the line or key
    where there is one. `most` inputs are run at most, where each needs real time. `missing` says why it cannot run.
    """

    examples: Callable[[], Sequence[bytes]]
    bench: Callable[[Path], AbstractContextManager[Run]]
    errors: tuple[type[Exception], ...] = ()
    place: str = ""
    most: int = 1_000_000_000
    missing: Callable[[], str] = lambda: ""

    def take(self, run: Run, data: bytes) -> bool:
        """Run one input; False if it was refused. Raises AssertionError for a refusal that says too little."""
        try:
            run(data)
        except self.errors as error:
            for sentence in getattr(error, "problems", (str(error),)):
                check_sentence(sentence)
                assert re.match(self.place, sentence), f"says no place: {sentence!r}"
            return False
        return True


def check_sentence(sentence: str) -> None:
    """Raises AssertionError unless it is one line of printable characters and of a length that somebody reads."""
    assert sentence.strip(), "refused without a sentence"
    assert sentence.isprintable(), f"not one line of printable characters: {sentence!r}"
    assert len(sentence) <= LONGEST_SENTENCE, f"{len(sentence)} characters: {sentence[:200]!r}"


def plain(run: Run) -> Callable[[Path], AbstractContextManager[Run]]:
    """The bench of a target that needs none."""
    return lambda _: nullcontext(run)


def of_text(read: Callable[[str], object]) -> Callable[[Path], AbstractContextManager[Run]]:
    """The bench of a parser that takes text."""
    return plain(lambda data: read(data.decode(errors="replace")))


def of_file(name: str, read: Callable[[Path], object]) -> Callable[[Path], AbstractContextManager[Run]]:
    """The bench of a parser that takes a path."""

    def bench(folder: Path) -> AbstractContextManager[Run]:
        path = folder / name

        def run(data: bytes) -> object:
            path.write_bytes(data)
            return read(path)

        return nullcontext(run)

    return bench
