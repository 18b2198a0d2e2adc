"""Where the audit log of a commissioning command is, and questions to the person at the HMI."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from gateway.commission.options import SharedOptions
from gateway.commission.session.target import Target
from gateway.settings import load_plant

AUDIT = "audit.sqlite"


def audit_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with --audit; it gets `audit`."""
    option = click.option(
        "--audit",
        type=click.Path(path_type=Path),
        help="The audit log.  [default: the plant file's; without one audit.sqlite beside the records]",
    )
    wrapped: Callable[..., Any] = option(command)
    return wrapped


def audit_path(audit: Path | None, given: SharedOptions, target: Target | None = None) -> Path:
    """The audit log: the one that is named, the plant file's, or the one beside the records. Raises ConfigError."""
    if audit is not None:
        return audit
    if target is not None and target.config is not None:
        return target.config.audit
    if target is not None and target.places is not None:
        return target.places.audit
    if target is None and given.plant is not None:
        return load_plant(given.plant)[0].audit
    return given.records.with_name(AUDIT)


def questions(ask: bool) -> Callable[[str], bool] | None:
    """How a person is asked; None where nobody is to be."""
    if not ask:
        return None
    return lambda question: click.confirm(question, default=False, err=True)


def at(moment: float) -> str:
    """A moment (s UTC) for a person."""
    return datetime.fromtimestamp(moment, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
