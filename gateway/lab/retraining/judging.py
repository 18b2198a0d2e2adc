"""Two models on the same cycles, forecast as the gateway forecasts, and what a paired test says at each horizon."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import accumulate
from math import inf
from typing import Any, Literal

import numpy as np

from gateway.lab.judging.skill import persist, skill_rows
from gateway.settings import ForecastSection
from sim.lab.learning import PERSISTENCE
from sim.lab.paired import Paired, holm, paired
from sim.lab.skill import common, grouped, skill
from sim.sha import Model, Trace, shown_unit

PRESENT, NEW = "present", "new"
LEVEL = 0.05
"""The chance at most that any horizon of a set is called better or worse where both models are alike."""
WORSE = 1.05
"""A CRPS so many times the present model's is worse even where the cycles are too few to tell it apart."""
HORIZONS = ForecastSection().horizons
LONGEST_HORIZON = max(HORIZONS)
"""s: the outcome of a cycle's last forecast comes so long after it."""
LEAST_PERIOD, MOST_FORECASTS = 60.0, 40
"""s between two forecasts, and how many of them a cycle gets at most."""


def scores_along(
    trace: Trace,
    present: Model,
    new: Model | None,
    *,
    seed: int,
    report: Callable[[str, float], None],
    most: int = MOST_FORECASTS,
    until: float = inf,
) -> list[dict[str, Any]]:
    """A row for each horizon (s) and method along a trace: how many forecasts, CRPS and MAE (degC), coverage.

    The forecasts are those that are made `until` then (s), `most` at most; what comes after it is their outcome. They
    lie evenly, from a moment on that is drawn: where each cycle began with one, some part of a cycle, such as its last
    minutes, would never be judged.

    Without a `new` model the present one is alone beside persistence. Methods are compared at the moments at which all
    of them have a forecast. Raises ValueError for a trace that a model cannot follow.
    """
    begin = float(trace.times[0])
    lasts = min(float(trace.times[-1]), until) - begin
    period = max(LEAST_PERIOD, lasts / most)
    first = begin + period * np.random.default_rng((seed, abs(int(begin)))).random()
    rows = common(
        skill_rows(
            trace,
            present.temperature,
            present.alphabet,
            models={PRESENT: [present]} | ({} if new is None else {NEW: [new]}),
            others={PERSISTENCE: partial(persist, horizons=HORIZONS)},
            forecasts=ForecastSection(horizons=HORIZONS, period=period, seed=seed),
            since=first,
            report=report,
        )
    )
    rows = [row for row in rows if row.origin <= lasts]
    return [
        {"trace": trace.name, "horizon": horizon, "method": method, **asdict(skill(own))}
        for (horizon, method), own in sorted(grouped(rows, lambda row: (row.horizon, row.method)).items())
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class HorizonComparison:
    """The new model against the present one at a `horizon` (s) on a `subject`: a set of cycles.

    `crps` and `coverage` are means over the cycles by method; `difference` is that of the CRPS (degC), new minus
    present, cycle by cycle (or day by day, see `compared`). Its two-sided p-value is corrected for the set's horizons:
    `p` by Holm, by which the new model is worse at any of them; `sequence` by taking them one after the other from the
    longest, by which it is better (a fixed sequence: the largest p-value so far, 1 from the first horizon on at which
    it is not the better one). What protects a bearing is the longest horizon, and few cycles that show a large gain
    there must not fail for the minute ahead, at which nothing changes (record 0146).
    """

    subject: str
    horizon: float
    crps: Mapping[str, float]
    coverage: Mapping[str, float]
    difference: Paired
    p: float
    sequence: float

    @property
    def shown_p(self) -> float:
        """The p-value that decides: which of the two, the sign of the difference says."""
        return self.sequence if self.difference.mean < 0 else self.p

    @property
    def told_apart(self) -> Literal["better", "worse", ""]:
        """What the test says of the new model; "" where it tells nothing."""
        if not self.shown_p < LEVEL:
            return ""
        return "better" if self.difference.mean < 0 else "worse"

    @property
    def refuses(self) -> bool:
        """Whether this is a reason not to take the new model."""
        return self.told_apart == "worse" or self.crps[NEW] > WORSE * self.crps[PRESENT]

    def sentence(self, unit: str) -> str:
        """The figures in words."""
        d = self.difference
        spread = f" ({d.low:+.3g} to {d.high:+.3g})" if d.interval else ""
        word = {"better": "the new model is better", "worse": "the new model is worse", "": "not told apart"}
        said = word[self.told_apart]
        if self.refuses and not self.told_apart:
            said += f", but the new one's CRPS is more than {WORSE:g} times the present one's"
        return (
            f"{self.subject}, {self.horizon:g} s: CRPS {self.crps[NEW]:.3g} {shown_unit(unit)} new, "
            f"{self.crps[PRESENT]:.3g} present, difference {d.mean:+.3g}{spread} "
            f"over {d.n} cycles, p {self.shown_p:.2g}: {said}"
        )

    def cells(self) -> list[object]:
        """A row of a table: horizon (s), cycles, CRPS of the new and the present model, difference, p, told apart."""
        d, word = self.difference, self.told_apart or "no"
        return [self.horizon, d.n, self.crps[NEW], self.crps[PRESENT], d.mean, self.shown_p, word]

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values."""
        told = {"shown_p": self.shown_p, "told_apart": self.told_apart, "refuses": self.refuses}
        return {**asdict(self), **told}


def compared(
    subject: str, scores: Sequence[Mapping[str, Any]], *, seed: int, unit: str = "trace"
) -> list[HorizonComparison]:
    """The comparisons of a set of cycles, a horizon each; horizons without a cycle are left out.

    `unit` is the key of the rows by which they are independent of one another: rows that share it are one, their mean.
    """
    rng = np.random.default_rng(seed)
    found: list[tuple[float, dict[str, float], dict[str, float], Paired]] = []
    for horizon in sorted({row["horizon"] for row in scores}):
        own = [row for row in scores if row["horizon"] == horizon]
        by_method: dict[str, dict[Any, dict[str, float]]] = {method: {} for method in (PRESENT, NEW, PERSISTENCE)}
        for (method, name), rows in grouped(own, lambda row: (row["method"], row[unit])).items():
            by_method[method][name] = {
                figure: float(np.mean([row[figure] for row in rows])) for figure in ("crps", "coverage")
            }
        both = [name for name in by_method[PRESENT] if name in by_method[NEW]]
        if not both:
            continue
        differences = [by_method[NEW][name]["crps"] - by_method[PRESENT][name]["crps"] for name in both]
        means = {
            figure: {
                method: float(np.mean([mean[figure] for mean in own_means.values()]))
                for method, own_means in by_method.items()
                if own_means
            }
            for figure in ("crps", "coverage")
        }
        found.append((horizon, means["crps"], means["coverage"], paired(differences, rng)))
    alone = [difference.p for *_, difference in found]
    better = [difference.p if difference.mean < 0 else 1.0 for *_, difference in found]
    in_sequence = list(accumulate(reversed(better), max))[::-1]
    return [
        HorizonComparison(
            subject=subject, horizon=horizon, crps=crps, coverage=cover, difference=difference, p=p, sequence=sequence
        )
        for (horizon, crps, cover, difference), p, sequence in zip(found, holm(alone), in_sequence, strict=True)
    ]


def verdict_on(
    comparisons: Sequence[HorizonComparison], refusals: Sequence[str], subject: str, unjudged: Sequence[str] = ()
) -> tuple[bool, str]:
    """(whether the new model is to be proposed, the sentence why or why not).

    It must be better somewhere on `subject`, which it has not seen, worse nowhere, and verified (no `refusals`); and no
    trace that it must not be worse on may be `unjudged`.
    """
    if refusals:
        return False, f"not proposed: it does not verify: {'; '.join(refusals)}"
    worse = [f"at {each.horizon:g} s on the {each.subject}" for each in comparisons if each.refuses]
    if worse:
        return False, f"not proposed: it is worse than the present model {', '.join(worse)}"
    if unjudged:
        return False, f"not proposed: {unjudged[0]} judges nothing, as no forecast along it comes due"
    own = [each for each in comparisons if each.subject == subject]
    better = [f"{each.horizon:g} s" for each in own if each.told_apart == "better"]
    if better:
        return True, f"proposed: better than the present model at {', '.join(better)} on the {subject}, worse nowhere"
    if not own:
        return False, f"not proposed: no forecast on the {subject} came due"
    n = max(each.difference.n for each in own)
    few = f"; {n} cycles could not show more" if 2.0 ** (1 - n) >= LEVEL else ""
    return False, f"not proposed: nowhere better than the present model on the {subject}{few}"
