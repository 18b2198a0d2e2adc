"""What `rank` and `validate` are asked alike: which models, along which traces, under which semantics, how."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import click

from gateway.console import map_option, seed_option, shipped_file
from gateway.lab.judging.figures import JudgedForecasts, judged_forecasts
from gateway.lab.options import jobs_option
from sim.lab.judge import Prepared, TraceRunSettings, Wanted, prepare
from sim.lab.recordings import ColumnMap
from sim.sha import Trace


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgingRequest:
    """What is judged: `models` along the traces of `paths`, under the `wanted` semantics.

    `training` are traces for laws of entry and rivals; `skill` asks for forecasts, `rivals` for others beside them.
    """

    models: Sequence[str]
    paths: Sequence[str]
    map_name: str
    wanted: Wanted
    training: Sequence[str]
    settings: TraceRunSettings
    jobs: int | None
    skill: bool
    rivals: bool

    @property
    def map_file(self) -> Path:
        """The column map. Raises ValueError where none has the name."""
        return shipped_file("traces", self.map_name)

    @property
    def workers(self) -> int:
        """How many processes work."""
        return self.jobs or len(os.sched_getaffinity(0))

    def check_training(self) -> None:
        """Raises UsageError where rivals have no traces that they could be fitted to."""
        if self.rivals and not self.training:
            raise click.UsageError("--rivals are fitted to traces: name them with --training")

    def prepare_model(self, where: str, column_map: ColumnMap, training: Sequence[Trace] | None) -> Prepared:
        """A model after its first four stages. Raises ArtefactError as `prepare`."""
        alphabet, temperature, seed = column_map.alphabet, column_map.temperature, self.settings.seed
        return prepare(where, alphabet, temperature, wanted=self.wanted, training=training, seed=seed)

    def forecasts(
        self,
        prepared: Sequence[Prepared],
        traces: Sequence[Trace],
        training: Sequence[Trace] | None,
        report: Callable[[str, float], None],
    ) -> JudgedForecasts | None:
        """The forecasts along the traces, None where nobody asks for them. Raises ValueError as `judged_forecasts`."""
        if not self.skill:
            return None
        fitted = training if self.rivals else None
        return judged_forecasts(prepared, traces, training=fitted, seed=self.settings.seed, report=report)


def judging_options(*, semantics: str, training: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The options of a JudgingRequest, which the command gets as its first argument; the two help texts are its own.

    MODEL and --traces are the command's to declare, and --policy where it has one.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def call(**given: Any) -> Any:
            settings = TraceRunSettings(given.pop("runs"), given.pop("policy", "resync"), given.pop("seed"))
            names = ("models", "paths", "map_name", "wanted", "training", "jobs", "skill", "rivals")
            asked = {name: given.pop(name) for name in names}
            asked["skill"] = asked["skill"] or asked["rivals"]
            return command(JudgingRequest(settings=settings, **asked), **given)

        kinds = click.Choice(["written", "carried", "resampled", "both"])
        carried = f"The temperature is carried over events or resampled on entry (the thesis); {semantics}."
        ahead = "Also score forecasts 60, 300 and 900 s ahead, made as the running gateway does (seconds a trace)."
        beside = "Statistical methods beside them, fitted to --training; implies --skill."
        for option in (
            seed_option,
            jobs_option,
            click.option(
                "--runs", type=click.IntRange(100, 100_000), default=1000, show_default=True, help="Runs a trace."
            ),
            click.option("--rivals", is_flag=True, help=beside),
            click.option("--skill/--no-skill", default=False, show_default=True, help=ahead),
            click.option("--training", multiple=True, help=training),
            click.option("--semantics", "wanted", type=kinds, default="written", show_default=True, help=carried),
            map_option,
        ):
            call = option(call)
        return call

    return decorate
