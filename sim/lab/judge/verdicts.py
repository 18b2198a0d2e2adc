"""What the figures of a campaign mean: a verdict on each trace with its reasons, and a summary of each model."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from statistics import fmean, stdev
from typing import Literal

from sim.lab.judge.results import Seen, TraceResult
from sim.lab.judge.semantics import CARRIED, RESAMPLED
from sim.sha import DEFAULT_UNIT, display_unit

Word = Literal["good", "review", "failed"]

MAX_BEYOND_SHARE = 0.01
"""Share of readings beyond three sigma above which a trace is to be looked at (a normal law leaves 0.0027 there)."""
MIN_COVERAGE = 0.75
"""Coverage of the 90 % band below which a trace is to be looked at."""


@dataclass(frozen=True, slots=True)
class TraceVerdict:
    """`failed`: no figures. `review`: somebody should look, for the `reasons`. `good`: nothing speaks against it."""

    word: Word
    reasons: tuple[str, ...] = ()


def verdict(result: TraceResult) -> TraceVerdict:
    """What to say of one model on one trace."""
    if result.failure:
        return TraceVerdict("failed", (f"stage {result.stage}: {result.failure}",))
    reasons = []
    if result.rejected:
        reasons.append(result.rejected)
    if result.beyond > MAX_BEYOND_SHARE:
        reasons.append(f"{result.beyond:.1%} of the readings lie beyond three sigma")
    if result.coverage < MIN_COVERAGE:
        reasons.append(f"the 90 % band covers {result.coverage:.0%} of the readings")
    if result.mae.value >= result.persistence:
        reasons.append(
            f"holding the first reading does as well (MAE {result.persistence:.2f} {display_unit(result.unit)})"
        )
    # The flag about events without an edge says once more what the rejection has said already.
    reasons += [flag for flag in result.flags if not (result.rejected and flag.startswith("events:"))]
    return TraceVerdict("review" if reasons else "good", tuple(reasons))


Sample = Literal["unseen", "not known", "in-sample"]
"""Whether figures are of traces of the model's training; "not known" where it does not say which these were."""
SAMPLE_WORDS: Mapping[Seen, Sample] = {
    "no": "unseen",
    "unknown": "not known",
    "content": "in-sample",
    "name": "in-sample",
}


@dataclass(frozen=True, slots=True)
class VerdictSummary:
    """One model under one semantics over its traces of one sample; means over those with figures, each counting once.

    `better` counts the traces with a smaller MAE than persistence; `mae_percent` is the mean of the MAE in per cent of
    each trace's readings. Those that end in `_sigma` are standard deviations over the traces (NaN for fewer than two).
    """

    model: str
    semantics: str
    sample: Sample
    traces: int
    scored: int
    good: int
    review: int
    failed: int
    accepted: int
    mae: float
    rmse: float
    dense: float
    at_events: float
    final: float
    final_percent: float
    max_error: float
    coverage: float
    crps: float
    persistence: float
    better: int
    mae_sigma: float = nan
    mae_percent: float = nan
    mae_percent_sigma: float = nan
    final_sigma: float = nan
    unit: str = DEFAULT_UNIT


def summary(results: Sequence[TraceResult]) -> VerdictSummary:
    """The summary of the results of one model, semantics and sample. Raises ValueError without results."""
    if not results:
        raise ValueError("nothing can be summarised without results")
    done = [result for result in results if not result.failure]
    words = [verdict(result).word for result in results]
    return VerdictSummary(
        model=results[0].model,
        semantics=results[0].semantics,
        sample=SAMPLE_WORDS[results[0].seen],
        traces=len(results),
        scored=len(done),
        good=words.count("good"),
        review=words.count("review"),
        failed=words.count("failed"),
        accepted=sum(result.accepted for result in results),
        mae=mean(result.mae.value for result in done),
        rmse=mean(result.rmse.value for result in done),
        dense=mean(result.dense.mae for result in done),
        at_events=mean(result.at_events.mae for result in done),
        final=mean(abs(result.final_error) for result in done),
        final_percent=mean(result.final_percent for result in done),
        max_error=max((result.max_error for result in done), default=nan),
        coverage=mean(result.coverage for result in done),
        crps=mean(result.crps for result in done),
        persistence=mean(result.persistence for result in done),
        better=sum(result.mae.value < result.persistence for result in done),
        mae_sigma=_spread(result.mae.value for result in done),
        mae_percent=mean(result.percent(result.mae.value) for result in done),
        mae_percent_sigma=_spread(result.percent(result.mae.value) for result in done),
        final_sigma=_spread(abs(result.final_error) for result in done),
        unit=results[0].unit,
    )


def summaries(results: Iterable[TraceResult]) -> list[VerdictSummary]:
    """One summary for each model, semantics and sample: the models in their order, of each the unseen traces first.

    What stands first is what people take for the result, and an error on the traces of the training is none.
    """
    groups: dict[str, dict[tuple[Sample, str], list[TraceResult]]] = {}
    for result in results:
        groups.setdefault(result.model, {}).setdefault((SAMPLE_WORDS[result.seen], result.semantics), []).append(result)
    order = list(dict.fromkeys(SAMPLE_WORDS.values()))
    return [
        summary(group)
        for own in groups.values()
        for _, group in sorted(own.items(), key=lambda item: order.index(item[0][0]))
    ]


@dataclass(frozen=True, slots=True)
class Gain:
    """Carried against resampled temperature on the traces where both have figures; `wins` counts those where carried
    has the smaller MAE. The traces are the unseen ones where there are any."""

    traces: int
    wins: int
    carried: VerdictSummary
    resampled: VerdictSummary

    @property
    def sentence(self) -> str:
        """The gain with its numbers."""
        ratio = f" ({self.resampled.mae / self.carried.mae:.2g} times as much)" if self.carried.mae > 0 else ""
        unit = display_unit(self.carried.unit)
        return (
            f"mean MAE {self.carried.mae:.3f} {unit} with the temperature carried over events, "
            f"{self.resampled.mae:.3f} {unit} with it drawn on entry{ratio}; "
            f"carried is better on {self.wins} of {self.traces} traces ({self.carried.sample}); "
            f"mean CRPS {self.carried.crps:.3f} against {self.resampled.crps:.3f} {unit}, "
            f"coverage of the 90 % band {self.carried.coverage:.0%} against {self.resampled.coverage:.0%}"
        )


def gain(results: Sequence[TraceResult]) -> Gain | None:
    """The two semantics of one model side by side; None unless both have figures on a common trace."""
    carried, resampled = (
        {result.trace: result for result in results if result.semantics == name and not result.failure}
        for name in (CARRIED, RESAMPLED)
    )
    both = [name for name in carried if name in resampled]
    common = [name for name in both if SAMPLE_WORDS[carried[name].seen] == "unseen"] or both
    if not common:
        return None
    wins = sum(carried[name].mae.value < resampled[name].mae.value for name in common)
    one, other = (summary([own[name] for name in common]) for own in (carried, resampled))
    return Gain(len(common), wins, one, other)


def mean(values: Iterable[float]) -> float:
    """The mean of the finite values; NaN without any."""
    finite = [value for value in values if isfinite(value)]
    return fmean(finite) if finite else nan


def _spread(values: Iterable[float]) -> float:
    """The standard deviation of the finite values; NaN for fewer than two."""
    finite = [value for value in values if isfinite(value)]
    return stdev(finite) if len(finite) > 1 else nan
