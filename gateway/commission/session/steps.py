"""Steps of a check, each with its own sentence: what was looked at, how it went, and with which exit code it fails."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click

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


def failed(name: str, sentence: str, error: Exception | None = None) -> CheckStep:
    """It does not work; the error's kind gives the exit code, else it is that of a failed check."""
    return CheckStep(name, "failed", sentence, Exit.CHECK_FAILED if error is None else exit_code(error))


def verdict(steps: Sequence[CheckStep]) -> tuple[int, str]:
    """The exit code and the sentence of the first step that failed; 0 and "" where none did."""
    first = next((step for step in steps if step.state == "failed"), None)
    return (0, "") if first is None else (first.code, first.sentence)


def show_steps(data: Mapping[str, Any]) -> None:
    """One line a step."""
    colours = {"ok": "green", "warning": "yellow", "failed": "red"}
    for step in data["steps"]:
        state = click.style(f"{step['state']:8}", fg=colours.get(step["state"]))
        click.echo(f"{state} {step['step']:12} {step['sentence']}")
