"""Chooses the rivals' settings on development cases: share named exactly minus share of clean cases named."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from benchmarks.discrepancy.rivals import METHODS, Settings, problem
from benchmarks.discrepancy.runner import case
from benchmarks.discrepancy.seal import committed, index, opened

BLOCKS, MARGINS, THRESHOLDS = (120.0, 300.0, 600.0), (1.0, 4.0, 8.0, 16.0, 32.0), (0.05, 0.1, 0.2, 0.3, 0.4)
GRID: Mapping[str, tuple[Settings, ...]] = {
    "one-step-bic": tuple(Settings(block=block, margin=one) for block, one in product(BLOCKS, MARGINS)),
    "sindy-stlsq": tuple(Settings(block=block, threshold=one) for block, one in product(BLOCKS, THRESHOLDS)),
    "sindy-ensemble": tuple(Settings(block=block, threshold=one) for block, one in product(BLOCKS, THRESHOLDS[1:])),
}


@dataclass(frozen=True, slots=True)
class Tried:
    """Settings of a method on the development cases: exact of those with an effect, named of those without."""

    method: str
    settings: Settings
    exact: int = 0
    acting: int = 0
    named: int = 0
    clean: int = 0

    @property
    def score(self) -> float:
        """Share named exactly minus share of clean cases named."""
        return self.exact / max(self.acting, 1) - self.named / max(self.clean, 1)


def tune(folder: Path, jobs: int) -> list[Tried]:
    """The best settings of each method. Raises ValueError for cases of another set than development."""
    from joblib import Parallel, delayed

    labels = opened(folder, committed(folder))
    if any(label.spec["set"] != "development" for label in labels.values()):
        raise ValueError(f"{folder}: the rivals are tuned on the development set only")
    truths = [(name, labels[name].truth) for name in index(folder) if not labels[name].outside]
    found = Parallel(n_jobs=jobs)(delayed(_answers)(folder, name) for name, _ in truths)
    answers = list(zip(found, (truth for _, truth in truths), strict=True))
    tried = [_tried(method, settings, answers) for method, grid in GRID.items() for settings in grid]
    return [max((one for one in tried if one.method == method), key=lambda one: one.score) for method in GRID]


Answers = Mapping[tuple[str, Settings], frozenset[str]]


def _tried(method: str, settings: Settings, answers: Sequence[tuple[Answers, frozenset[str]]]) -> Tried:
    acting = [(said[method, settings], truth) for said, truth in answers if truth]
    clean = [said[method, settings] for said, truth in answers if not truth]
    exact = sum(names == truth for names, truth in acting)
    return Tried(method, settings, exact, len(acting), sum(map(bool, clean)), len(clean))


def _answers(folder: Path, name: str) -> Answers:
    """What each method says of a case under each of its settings."""
    from threadpoolctl import threadpool_limits

    said = {}
    with threadpool_limits(1):
        for block in BLOCKS:
            given = problem(case(folder, name), Settings(block=block))
            for method, grid in GRID.items():
                for settings in grid:
                    if settings.block == block:
                        said[method, settings] = frozenset(one for one, _ in METHODS[method](given, settings))
    return said
