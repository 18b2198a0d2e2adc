"""Stated confidence against what was right, with a quarter of the cases outside the catalogue.

\b
python -m benchmarks.discrepancy.confidence run DIR...
python -m benchmarks.discrepancy.confidence table DIR...

Each case is run with the whole catalogue and, where something acts that has a name, without these names too, which are
outside of it then. Clean cases are left out: what is missing is the question, not whether. The table weighs the cases
so that a quarter is outside, and gives the figures that the posterior's constants are taken from; it takes what speaks
for and against the names from the results, so that other constants (`discrepancy.posterior`) need no other runs.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.stats import beta

from benchmarks.discrepancy.runner import Case, case
from benchmarks.discrepancy.seal import Label, labels_of
from benchmarks.discrepancy.table import grid
from gateway.lab.traces.load import load
from sim.lab.discrepancy import diagnose
from sim.lab.discrepancy.posterior import RIGHT_EXCESS_LEFT, RIGHT_HEAT_LEFT, NamesEvidence, posterior, step_gains
from sim.lab.discrepancy.rules import RULES
from sim.lab.formats import find_model

FOLDERS = click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
NAME = click.option("--name", default="confidence", show_default=True, help="Under which name the results are kept.")
RESULTS = "confidence"
MAP = "decanter"
OUTSIDE = 0.25
"""The share of the cases, by weight, that no name of the catalogue stands for."""
EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99 + 1e-9)
"""Stated confidences that are put together; 0.99 is the greatest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """What was said of one case, `outside` the catalogue or not: the names of the path that was judged, `given` or
    withheld; for each its members, the gains of all that was looked for beside it, and the evidence
    against all of them. `truth` are the names that would be right."""

    case: str
    outside: bool
    truth: tuple[str, ...]
    given: bool
    steps: tuple[dict[str, Any], ...]
    evidence: NamesEvidence | None

    @property
    def right(self) -> bool:
        """Whether the first claim holds something that acts."""
        return bool(self.steps) and bool(set(self.steps[0]["members"]) & set(self.truth))

    @property
    def stated(self) -> tuple[float, float]:
        """(the first claim's confidence, the share of none of these), as the present constants make them."""
        if self.evidence is None:
            return float("nan"), float("nan")
        found = [posterior(step["gains"], self.evidence, RULES) for step in self.steps]
        first = found[0].confidence(tuple(self.steps[0]["members"]))
        return first, max(each.none_of_these for each in found)


@click.group(help=__doc__)
def main() -> None:
    """The commands."""


@main.command()
@FOLDERS
@NAME
def run(folders: Sequence[Path], name: str) -> None:
    """Run every case that has no result yet, both ways."""
    for folder, label, outside in _wanted(folders):
        path = _place(folder, name, label.case, outside)
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            claim = claim_of(case(folder, label.case), label, outside)
            path.write_text(json.dumps(asdict(claim)) + "\n", encoding="utf-8")
            names = [step["members"] for step in claim.steps]
            click.echo(f"{label.case}, {'outside' if outside else 'inside'}: {names if claim.given else '-'}", err=True)


@main.command()
@FOLDERS
@NAME
@click.option("--cases", is_flag=True, help="Every case in a line too.")
def table(folders: Sequence[Path], name: str, cases: bool) -> None:
    """Print stated against right, and the figures behind the constants."""
    paths = [_place(folder, name, label.case, outside) for folder, label, outside in _wanted(folders)]
    claims = [_read(path) for path in paths if path.exists()]
    if not claims:
        raise click.ClickException("there are no results; run the cases first")
    click.echo("\n\n".join([reliability(claims), constants(claims), *([lines(claims)] if cases else [])]))


def claim_of(one: Case, label: Label, outside: bool) -> Claim:
    """One case diagnosed; `outside`: without the names of what acts."""
    acts = tuple(sorted(label.truth))
    traces, column_map = load((str(one.traces),), MAP)
    model = find_model(str(one.model), alphabet=column_map.alphabet, temperature=column_map.temperature).runnable()
    found = diagnose(model, traces, seed=one.seed, without=acts if outside else ())
    taken = found.path.accepted_steps if found.path is not None and found.against is not None else ()
    steps = [{"members": step.members, "gains": step_gains(step)} for step in taken]
    return Claim(
        case=label.case,
        outside=outside or not acts,
        truth=() if outside else acts,
        given=bool(found.diagnosis.effects),
        steps=tuple(steps),
        evidence=found.against,
    )


def reliability(claims: Sequence[Claim]) -> str:
    """Stated confidence of what was named against the share that was right, by weight, with binomial intervals."""
    given = [claim for claim in claims if claim.given]
    weight = _weights(claims)
    body = []
    for low, high in pairwise(EDGES):
        some = [claim for claim in given if low <= claim.stated[0] < high]
        if some:
            stated = np.average([claim.stated[0] for claim in some], weights=[weight(claim) for claim in some])
            none = np.average([claim.stated[1] for claim in some], weights=[weight(claim) for claim in some])
            counts = f"{sum(claim.right for claim in some)}/{len(some)}"
            body.append(
                [f"{low:g} to {min(high, 1.0):.2g}", f"{stated:.3f}", f"{none:.3f}", *_share(some, weight), counts]
            )
    inside, outside = ([claim for claim in claims if claim.outside is which] for which in (False, True))
    words = (
        f"{len(inside)} cases inside, {len(outside)} outside the catalogue; "
        f"named {sum(claim.given for claim in inside)} and {sum(claim.given for claim in outside)}"
    )
    return words + "\n\n" + grid(["stated", "mean", "none of these", "right", "95 %", "n"], body)


def constants(claims: Sequence[Claim]) -> str:
    """What right names and others leave, of those that were held against held-out cycles, given or withheld."""
    tried: dict[bool, list[Claim]] = {True: [], False: []}
    for claim in claims:
        if claim.evidence is not None:
            tried[claim.right].append(claim)
    inside = [claim for claim in claims if not claim.outside]
    outside = [claim for claim in claims if claim.outside]
    so_far = [sum(claim.evidence is not None for claim in group) / max(len(group), 1) for group in (inside, outside)]
    figures: dict[str, Callable[[NamesEvidence], float | None]] = {
        "share of the systematic heat that is left": lambda each: each.heat_left,
        "share of the held-out excess that is left": lambda each: each.excess_left,
        "its standard error": lambda each: None if each.excess_left is None else each.excess_error,
    }
    body = []
    for what, figure in figures.items():
        cells = []
        for right in (True, False):
            known = [figure(claim.evidence) for claim in tried[right] if claim.evidence is not None]
            values = [value for value in known if value is not None]
            cells.append(_quartiles(values))
        body.append([what, *cells])
    twins = sum(_is_twin(claim.evidence) for claim in tried[False] if claim.evidence is not None)
    words = (
        f"as far as the held-out cycles: {so_far[0]:.2f} of the cases inside, {so_far[1]:.2f} of those outside; "
        f"{twins} of {len(tried[False])} that are wrong leave no more than right ones do"
    )
    return words + "\n\n" + grid(["mean (quartiles; n)", "right", "wrong"], body)


def lines(claims: Sequence[Claim]) -> str:
    """Every case in a line."""
    body = []
    for claim in claims:
        names = " + ".join("/".join(step["members"]) for step in claim.steps)
        evidence = (
            ""
            if claim.evidence is None
            else ", ".join("-" if value is None else f"{value:.2f}" for value in asdict(claim.evidence).values())
        )
        kind = "outside" if claim.outside else "inside"
        stated = f"{claim.stated[0]:.3f}, {claim.stated[1]:.3f}"
        said = f"{'given' if claim.given else 'withheld'} {names}" if names else "-"
        body.append([claim.case, kind, "right" if claim.right else "", said, stated, evidence])
    return grid(["case", "", "", "names", "confidence, none of these", "heat left, excess left, its error"], body)


def _wanted(folders: Sequence[Path]) -> Iterator[tuple[Path, Label, bool]]:
    for folder in folders:
        for label in sorted(labels_of(folder).values(), key=lambda one: one.case):
            if label.spec["effects"]:
                yield folder, label, False
                if label.truth:
                    yield folder, label, True


def _place(folder: Path, name: str, which: str, outside: bool) -> Path:
    return folder / RESULTS / name / f"{which}-{'outside' if outside else 'whole'}.json"


def _read(path: Path) -> Claim:
    plain = json.loads(path.read_text(encoding="utf-8"))
    evidence = None if plain["evidence"] is None else NamesEvidence(**plain["evidence"])
    return Claim(**{**plain, "truth": tuple(plain["truth"]), "steps": tuple(plain["steps"]), "evidence": evidence})


def _weights(claims: Sequence[Claim]) -> Callable[[Claim], float]:
    """Each case's weight, so that a quarter of all is outside."""
    count = {which: sum(claim.outside is which for claim in claims) for which in (True, False)}
    share = {True: OUTSIDE, False: 1.0 - OUTSIDE}
    return lambda claim: share[claim.outside] / count[claim.outside]


def _share(claims: Sequence[Claim], weight: Callable[[Claim], float]) -> tuple[str, str]:
    """The weighed share that is right, and its 95 % Clopper-Pearson interval at the effective number (Kish 1965)."""
    weights = np.array([weight(claim) for claim in claims])
    right = np.array([claim.right for claim in claims])
    share, number = float(np.average(right, weights=weights)), float(weights.sum() ** 2 / np.sum(weights**2))
    hits = share * number
    low = float(beta.ppf(0.025, hits, number - hits + 1.0)) if hits > 0 else 0.0
    high = float(beta.ppf(0.975, hits + 1.0, number - hits)) if hits < number else 1.0
    return f"{100 * share:.1f} %", f"{100 * low:.1f}-{100 * high:.1f}"


def _is_twin(evidence: NamesEvidence) -> bool:
    """Whether the shares that are known lie where those of right names do, and one is."""
    shares = ((evidence.heat_left, RIGHT_HEAT_LEFT), (evidence.excess_left, RIGHT_EXCESS_LEFT))
    known = [share <= mean for share, mean in shares if share is not None]
    return bool(known) and all(known)


def _quartiles(values: Sequence[float]) -> str:
    if not values:
        return "-"
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return f"{np.mean(values):.3f} ({low:.2f}, {middle:.2f}, {high:.2f}; {len(values)})"


if __name__ == "__main__":
    main()
