"""A case diagnosed, its proposed experiment made, and diagnosed again; what became of the class."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.discrepancy.experiment.cases import TwinCase, folder_of, write_experiment
from benchmarks.discrepancy.experiment.over_plc import over_plc
from benchmarks.discrepancy.judging import answer
from benchmarks.discrepancy.runner import Outcome, by_call
from benchmarks.discrepancy.runner import case as case_of

LIMIT_S = 240.0
"""Seconds that a diagnosis may take."""
SET_POINTS, RECORDED = "set_points.csv", "experiment.csv"


@dataclass(frozen=True, slots=True, kw_only=True)
class Closed:
    """A case's way: the `kind` of its class, what acts, the two outcomes (`second` None: no experiment was made)."""

    kind: str
    case: str
    acts: str
    ratio: float
    first: Outcome
    second: Outcome | None = None

    @property
    def proposed(self) -> Mapping[str, Any] | None:
        """The experiment of the first diagnosis."""
        found = self.first.diagnosis.get("experiment")
        return found if isinstance(found, dict) else None

    @property
    def rivals(self) -> frozenset[str]:
        """Those that the experiment is to tell apart."""
        return frozenset(name for pair in (self.proposed or {}).get("nats", ()) for name in pair["pair"])

    @property
    def is_class(self) -> bool:
        """Whether the first diagnosis ended in a class of two or more, and not in a name withheld between rivals."""
        return bool(answer(self.first).classes)

    @property
    def missing(self) -> bool:
        """Whether the first diagnosis said that something is missing; where it agrees, nothing is to be resolved."""
        return answer(self.first).verdict in ("named", "class", "unexplained")

    def pairs(self) -> list[dict[str, Any]]:
        """The pairs of what acts and a rival, as the experiment has them."""
        return [pair for pair in (self.proposed or {}).get("nats", ()) if self.acts in pair["pair"]]

    @property
    def expected(self) -> float:
        """The least nats that are expected between what acts and a rival."""
        return min((float(pair["expected"]) for pair in self.pairs()), default=float("nan"))

    @property
    def inseparable(self) -> bool:
        """Whether the experiment said that nothing tells what acts from one of its rivals."""
        least = float((self.proposed or {}).get("least_nats", 0.0))
        return any(float(pair["at_most"]) < least for pair in self.pairs())

    @property
    def enough(self) -> bool:
        """Whether the experiment was said to be enough for what acts and each of its rivals."""
        return self.expected >= float((self.proposed or {}).get("needed_nats", 0.0))

    @property
    def gained(self) -> float:
        """Nats by which what acts has drawn ahead of the nearest of its rivals, of those weighed both times."""
        if self.second is None:
            return float("nan")
        before, after = _gains(self.first), _gains(self.second)
        both = before.keys() & after.keys()
        others = [name for name in self.rivals - {self.acts} if name in both]
        if self.acts not in both or not others:
            return float("nan")
        return min((after[self.acts] - after[one]) - (before[self.acts] - before[one]) for one in others)

    @property
    def fate(self) -> str:
        """What became of it: `right`, `wrong`, `class`, `withheld` or `error`; "" where nothing was to be resolved."""
        if self.second is None:
            return ""
        if self.second.status != "done":
            return "error"
        said = answer(self.second)
        if any(name != self.acts for name in said.names) or any(self.acts not in one for one in said.classes):
            return "wrong"
        if said.names:
            return "right"
        return "class" if said.classes else "withheld"


def _gains(outcome: Outcome) -> dict[str, float]:
    """nats by name, of the first step of a diagnosis."""
    tried: Sequence[dict[str, Any]] = outcome.diagnosis.get("candidates") or ()
    return {each["name"]: float(each["gain_nats"]) for each in tried if each["step"] == 1}


def close_circle(one: TwinCase, ratio: float, out: Path, *, plc: bool = False) -> Closed:
    """Diagnose a case, have the machine obey what is proposed, diagnose again. What lies there is not done again.

    `plc`: the machine reads its set-points off the software PLC, and what it does is read off a software PLC, too.
    """
    folder = folder_of(one.spec, out)
    given = case_of(out, one.spec.identifier)
    set_points, recorded = folder / SET_POINTS, folder / RECORDED
    first = _kept(folder / "first.json")
    if first is None:
        first = by_call(given.with_options("--experiment-trace", str(set_points)), LIMIT_S)
        _keep(folder / "first.json", first)
    way = Closed(kind=one.spec.stratum, case=given.name, acts=one.spec.acts[0], ratio=ratio, first=first)
    if way.proposed is None or way.acts not in way.rivals:
        return way
    again = folder / ("second_over_plc.json" if plc else "second.json")
    second = _kept(again)
    if second is None:
        if plc:
            set_points, recorded = _over_plc(set_points), recorded.with_stem("experiment_to_plc")
        write_experiment(one, set_points, recorded)
        given = given.with_options("--with-experiment", str(_over_plc(recorded) if plc else recorded))
        second = by_call(given, LIMIT_S)
        _keep(again, second)
    return Closed(kind=way.kind, case=way.case, acts=way.acts, ratio=ratio, first=first, second=second)


def _over_plc(trace: Path) -> Path:
    read = trace.with_stem(f"{trace.stem}_over_plc")
    over_plc(trace, read)
    return read


def _kept(path: Path) -> Outcome | None:
    return Outcome(**json.loads(path.read_text(encoding="utf-8"))) if path.exists() else None


def _keep(path: Path, outcome: Outcome) -> None:
    path.write_text(json.dumps(asdict(outcome)) + "\n", encoding="utf-8")
