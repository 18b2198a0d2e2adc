"""Steps of a check, each with its own sentence: what was looked at, how it went, and with which exit code it fails."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from gateway.console.output import Exit, exit_code


@dataclass(frozen=True, slots=True)
class Step:
    """One thing looked at; `state` is "ok", "warning", "failed" or "skipped"."""

    name: str
    state: str
    sentence: str
    code: int = Exit.OK

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {"step": self.name, "state": self.state, "sentence": self.sentence}


def ok(name: str, sentence: str) -> Step:
    """It is as it should be."""
    return Step(name, "ok", sentence)


def warning(name: str, sentence: str) -> Step:
    """It works, and is worth a look."""
    return Step(name, "warning", sentence)


def failed(name: str, sentence: str, error: Exception | None = None) -> Step:
    """It does not work; the error's kind gives the exit code, else it is that of a failed check."""
    return Step(name, "failed", sentence, Exit.CHECK_FAILED if error is None else exit_code(error))


def verdict(steps: Sequence[Step]) -> tuple[int, str]:
    """The exit code and the sentence of the first step that failed; 0 and "" where none did."""
    first = next((step for step in steps if step.state == "failed"), None)
    return (0, "") if first is None else (first.code, first.sentence)
