"""What `judge rank` and `judge validation` are asked alike: which models, along which traces, semantics, how."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from gateway.console import shipped_file
from gateway.lab.judging.figures import JudgedForecasts, judged_forecasts
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
