"""Steps of a check, each with its own sentence: what was looked at, how it went, and with which exit code it fails."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click

from gateway.console import CommandResult
from gateway.entry import Exit, exit_code


@dataclass(frozen=True, slots=True)
class CheckStep:
    """One thing looked at; `state` is "ok", "warning", "failed" or "skipped"."""

    name: str
    state: str
    sentence: str
    code: int = Exit.OK

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {"step": self.name, "state": self.state, "sentence": self.sentence}


def ok(name: str, sentence: str) -> CheckStep:
    """It is as it should be."""
    return CheckStep(name, "ok", sentence)


def warning(name: str, sentence: str) -> CheckStep:
    """It works, and is worth a look."""
    return CheckStep(name, "warning", sentence)


def failed_step(name: str, sentence: str, error: Exception | None = None) -> CheckStep:
    """It does not work; the error's kind gives the exit code, else it is that of a failed check."""
    return CheckStep(name, "failed", sentence, Exit.CHECK_FAILED if error is None else exit_code(error))


def conclude_steps(steps: Sequence[CheckStep], **facts: Any) -> CommandResult:
    """The steps and facts as a command's result; the first step that failed gives its sentence and exit code."""
    data = {"steps": [step.plain() for step in steps], **facts}
    first = next((step for step in steps if step.state == "failed"), None)
    return CommandResult(data) if first is None else CommandResult(data, first.sentence, first.code)


def step_lines(data: Mapping[str, Any]) -> Iterator[str]:
    """One line a step."""
    colours = {"ok": "green", "warning": "yellow", "failed": "red"}
    for step in data["steps"]:
        state = click.style(f"{step['state']:8}", fg=colours.get(step["state"]))
        yield f"{state} {step['step']:12} {step['sentence']}"
