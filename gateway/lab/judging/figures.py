"""What models forecast along recordings as the running gateway does, beside rivals, and what is known of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import click

from gateway.entry import sentence
from gateway.lab.judging.skill import PastForecaster, fitted_rivals, lacking, persist, skill_rows
from gateway.settings import ForecastSection
from sim.lab.judge import Facts, ForecastSkill, Prepared, SkillRow, forecast_skill
from sim.lab.learning import PERSISTENCE
from sim.proof import verify
from sim.sha import DEGREES, Model, Trace

SCAN = 1.0
"""s: the scan period of a gateway along a trace."""
LEAST_PERIOD, MOST_FORECASTS = 60.0, 200
"""s between two forecasts, and how many of them a trace gets at most: a forecast takes about 40 ms."""
MOST_QUESTIONS = 40
"""Forecasts of a rival along a trace at most: some are fitted anew for each."""


@dataclass(frozen=True, slots=True)
class JudgedForecasts:
    """The forecasts of several models along the same traces, and sentences about what could not be made.

    `methods` are the names of a model's variants by its label; `unit` is that of the first model.
    """

    rows: Sequence[SkillRow]
    notes: Sequence[str]
    methods: Mapping[str, Sequence[str]]
    unit: str = DEGREES

    def skill(self, label: str | None = None, *, seed: int = 0) -> ForecastSkill:
        """Of all models at the moments that all share; of the one of this `label` beside what is no model."""
        every = [name for names in self.methods.values() for name in names]
        ours = every if label is None else list(self.methods[label])
        rows = [row for row in self.rows if row.method in ours or row.method not in every]
        return forecast_skill(rows, ours, seed=seed, notes=self.notes, unit=self.unit)


def judged_forecasts(
    prepared: Sequence[Prepared],
    traces: Sequence[Trace],
    *,
    training: Sequence[Trace] | None,
    seed: int,
    report: Callable[[str, float], None],
) -> JudgedForecasts:
    """What every variant of the models forecasts along the traces, beside persistence and the rivals.

    Rivals are fitted to the traces of `training`; None asks for none. What a model or a rival cannot do becomes a note.
    Raises ValueError where the rivals cannot be loaded.
    """
    models: dict[str, Model] = {}
    methods: dict[str, list[str]] = {}
    for each in prepared:
        # As the ranking calls them: a model of several semantics is one entrant for each.
        named = {
            f"{each.label} ({semantics})" if len(each.variants) > 1 else each.label: model
            for semantics, model in each.variants.items()
        }
        models |= named
        methods[each.label] = list(named)
    if not models:
        return JudgedForecasts([], ["no model can be run, so there are no forecasts"], methods)
    first = next(iter(models.values()))
    horizons = ForecastSection().horizons
    others: dict[str, PastForecaster] = {PERSISTENCE: partial(persist, horizons=horizons)}
    notes: list[str] = []
    if training is not None:
        fitted, notes = fitted_rivals(
            training, first.temperature, first.alphabet, horizons=horizons, scan=SCAN, seed=seed
        )
        others |= fitted
    rows: list[SkillRow] = []
    for trace in traces:
        lasts = float(trace.times[-1] - trace.times[0]) if trace.times.size else 0.0
        section = ForecastSection(horizons=horizons, period=max(LEAST_PERIOD, lasts / MOST_FORECASTS), seed=seed)
        asked: Mapping[str, PastForecaster] = others
        own: list[SkillRow] = []
        followed = False
        for name, model in models.items():
            try:
                if (model.temperature, model.unit) != (first.temperature, first.unit) or name in others:
                    raise ValueError("it forecasts another signal than the first model, or is called as one beside it")
                made = skill_rows(
                    trace,
                    first.temperature,
                    model.alphabet,
                    models={name: [model]},
                    others=asked,
                    forecasts=section,
                    scan_period=SCAN,
                    report=report,
                    ask_period=lasts / MOST_QUESTIONS if training is not None else 0.0,
                )
            except ValueError as error:
                notes.append(f"{name} has no forecast along {trace.name}: {sentence(error)}")
                continue
            # The others are asked once, at the moments of the first model that forecasts.
            asked = {} if made else asked
            own += made
            followed = True
        rows += own
        notes += lacking(trace, own, horizons) if followed else []
    return JudgedForecasts(rows, notes, methods, first.unit)


def skill_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options by which a command is asked for forecasts too."""
    forecasts = click.option(
        "--skill/--no-skill",
        default=False,
        show_default=True,
        help="Also score forecasts 60, 300 and 900 s ahead, made as the running gateway does (seconds a trace).",
    )
    rivals = click.option(
        "--rivals", is_flag=True, help="Statistical methods beside them, fitted to --training; implies --skill."
    )
    return forecasts(rivals(command))


def gate_of(model: Model) -> tuple[bool, str]:
    """Whether verification lets the model be deployed, and the sentence that says so."""
    verification = verify(model)
    if verification.deployable:
        return (
            True,
            f"verified: {len([check for check in verification.checks if check.blocking])} blocking checks are proven",
        )
    return False, "; ".join(verification.reasons)


def facts_of(prepared: Prepared) -> dict[str, Facts]:
    """What a model at hand says of itself, by semantics; a model that cannot be run fails the gate."""
    facts = {"": Facts(verified=False, gate="; ".join(prepared.refusals.values()))}
    for semantics, model in prepared.variants.items():
        verified, gate = gate_of(model)
        facts[semantics] = replace(origin_of(model), verified=verified, gate=gate)
    return facts


def origin_of(model: Model) -> Facts:
    """Artefacts and models by hand do not say what they were learned from."""
    known = bool(model.provenance.data_hash or model.provenance.traces)
    return Facts(synthetic=model.provenance.synthetic if known else None)
