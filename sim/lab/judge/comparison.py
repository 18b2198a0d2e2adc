"""Two models on the same recordings: what a paired test says at each horizon, and whether the new one is proposed."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import accumulate
from typing import Any, Literal

import numpy as np

from sim.lab.judge.differences import Paired, compare_families, unit_differences
from sim.lab.judge.rows import group_rows
from sim.lab.learning import PERSISTENCE
from sim.sha import Array, display_unit

PRESENT, NEW = "present", "new"
METHODS = (PRESENT, NEW, PERSISTENCE)
ERROR_CHANCE = 0.05
"""The chance at most that any horizon of a set is called better or worse where both models are alike."""
WORSE_CRPS_RATIO = 1.05
"""A CRPS so many times the present model's is worse even where the cycles are too few to tell it apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HorizonComparison:
    """The new model against the present one at a `horizon` (s) on a `subject`: a set of cycles.

    `crps` and `coverage` are means over the cycles by method; `difference` is that of the CRPS (degC), new minus
    present, cycle by cycle (or day by day, see `compare_horizons`). Its two-sided p-value is corrected for the set's
    horizons: `p` by Holm, by which the new model is worse at any of them; `sequence` by taking them one after the other
    from the longest, by which it is better (a fixed sequence: the largest p-value so far, 1 from the first horizon on
    at which it is not the better one). What protects a bearing is the longest horizon, and few cycles that show a large
    gain there must not fail for the minute ahead, at which nothing changes (record 0146).
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
    def outcome(self) -> Literal["better", "worse", ""]:
        """What the test says of the new model; "" where it tells nothing."""
        if not self.shown_p < ERROR_CHANCE:
            return ""
        return "better" if self.difference.mean < 0 else "worse"

    @property
    def refuses(self) -> bool:
        """Whether this is a reason not to take the new model."""
        return self.outcome == "worse" or self.crps[NEW] > WORSE_CRPS_RATIO * self.crps[PRESENT]

    def sentence(self, unit: str) -> str:
        """The figures in words."""
        d = self.difference
        spread = f" ({d.low:+.3g} to {d.high:+.3g})" if d.interval else ""
        word = {"better": "the new model is better", "worse": "the new model is worse", "": "not told apart"}
        said = word[self.outcome]
        if self.refuses and not self.outcome:
            said += f", but the new one's CRPS is more than {WORSE_CRPS_RATIO:g} times the present one's"
        return (
            f"{self.subject}, {self.horizon:g} s: CRPS {self.crps[NEW]:.3g} {display_unit(unit)} new, "
            f"{self.crps[PRESENT]:.3g} present, difference {d.mean:+.3g}{spread} "
            f"over {d.n} cycles, p {self.shown_p:.2g}: {said}"
        )

    def cells(self) -> list[object]:
        """A row of a table: horizon (s), cycles, CRPS of the new and the present model, difference, p, told apart."""
        d, word = self.difference, self.outcome or "no"
        return [self.horizon, d.n, self.crps[NEW], self.crps[PRESENT], d.mean, self.shown_p, word]

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values."""
        told = {"shown_p": self.shown_p, "told_apart": self.outcome, "refuses": self.refuses}
        return {**asdict(self), **told}


def compare_horizons(
    subject: str, scores: Sequence[Mapping[str, Any]], *, seed: int, unit: str = "trace"
) -> list[HorizonComparison]:
    """The comparisons of a set of cycles, a horizon each; horizons without a cycle are left out.

    `unit` is the key of the rows by which they are independent of one another: rows that share it are one, their mean.
    """
    found: list[tuple[float, list[dict[str, float]], Array]] = []
    for horizon, own in sorted(group_rows(scores, lambda row: row["horizon"]).items()):
        by_unit = group_rows(own, lambda row: (row["method"], row[unit]))
        crps, coverage = (
            {
                method: {
                    name: float(np.mean([row[figure] for row in rows]))
                    for (whose, name), rows in by_unit.items()
                    if whose == method
                }
                for method in METHODS
            }
            for figure in ("crps", "coverage")
        )
        differences = unit_differences(crps[NEW], crps[PRESENT])
        if differences.size:
            means = [
                {method: float(np.mean(list(by_name.values()))) for method, by_name in figure.items() if by_name}
                for figure in (crps, coverage)
            ]
            found.append((horizon, means, differences))
    tests = compare_families([differences for *_, differences in found], np.random.default_rng(seed))
    better = [difference.p if difference.mean < 0 else 1.0 for difference, _ in tests]
    in_sequence = list(accumulate(reversed(better), max))[::-1]
    return [
        HorizonComparison(
            subject=subject,
            horizon=horizon,
            crps=means[0],
            coverage=means[1],
            difference=difference,
            p=p,
            sequence=sequence,
        )
        for (horizon, means, _), (difference, p), sequence in zip(found, tests, in_sequence, strict=True)
    ]


def propose_verdict(
    comparisons: Sequence[HorizonComparison], refusals: Sequence[str], subject: str, unjudged: Sequence[str] = ()
) -> tuple[bool, str]:
    """(whether the new model is to be proposed, the sentence why or why not).

    It must be better somewhere on `subject`, which it has not seen, and worse nowhere; nothing may speak against it by
    itself (`refusals`), and no trace that it must not be worse on may be `unjudged`.
    """
    if refusals:
        return False, f"not proposed: {'; and '.join(refusals)}"
    worse = [f"at {each.horizon:g} s on the {each.subject}" for each in comparisons if each.refuses]
    if worse:
        return False, f"not proposed: it is worse than the present model {', '.join(worse)}"
    if unjudged:
        return False, f"not proposed: {unjudged[0]} judges nothing, as no forecast along it comes due"
    own = [each for each in comparisons if each.subject == subject]
    better = [f"{each.horizon:g} s" for each in own if each.outcome == "better"]
    if better:
        return True, f"proposed: better than the present model at {', '.join(better)} on the {subject}, worse nowhere"
    if not own:
        return False, f"not proposed: no forecast on the {subject} came due"
    n = max(each.difference.n for each in own)
    few = f"; {n} cycles could not show more" if 2.0 ** (1 - n) >= ERROR_CHANCE else ""
    return False, f"not proposed: nowhere better than the present model on the {subject}{few}"
