"""The hyper-parameters of L*_SHA, each with what it means and the range in which it makes sense."""

from dataclasses import dataclass
from math import isfinite
from typing import Literal

Memory = Literal["context", "direction", "previous", "word"]
"""What of a word is remembered where its own evidence does not suffice: see `words`."""

MEMORIES: tuple[Memory, ...] = ("context", "direction", "previous", "word")
FLOW_KINDS = ("constant", "linear", "logarithmic", "exponential", "driven", "transient")
"""The flow library. `constant` and `transient` come with `resample` entry: a level that is jumped to."""
DELTAS = (0.0, 0.05, 0.15, 0.4)
"""The merge tolerances that are tried where none is given."""


@dataclass(frozen=True, slots=True)
class LshaSettings:
    """What the learner may be told; what is None is chosen by the held-out likelihood.

    `delta`: two locations whose parameters differ by no more than this count as one, as a share of the standard
    deviation of all segments' parameters. `default_flow`: one of FLOW_KINDS, from which the
    model-identification queries start. `memory`: what words share that have too little evidence of their own.
    `n_min`: segments below which a row of the table says nothing by itself. `alpha`: the family-wise error rate of the
    hypothesis-test queries, the probability that any two words of one location are kept apart. `split`: the parts
    into which the traces are split at least; each is held out once. `complete`: what was never seen gets default edges.

    Raises ValueError, naming the setting and what would be right.
    """

    delta: float | None = None
    default_flow: str | None = None
    memory: Memory | None = None
    n_min: int = 5
    alpha: float = 0.05
    split: int = 5
    complete: bool = True

    def __post_init__(self) -> None:
        if self.delta is not None and not (isfinite(self.delta) and self.delta >= 0):
            raise ValueError(f"delta is {self.delta}; it must be 0 or more, a share of the parameters' spread")
        if self.default_flow is not None and self.default_flow not in FLOW_KINDS:
            raise ValueError(f"the default flow {self.default_flow!r} is unknown; known are {', '.join(FLOW_KINDS)}")
        if self.memory is not None and self.memory not in MEMORIES:
            raise ValueError(f"the memory {self.memory!r} is unknown; known are {', '.join(MEMORIES)}")
        if self.n_min < 2:
            raise ValueError(f"n_min is {self.n_min}; two segments are the least that show any scatter")
        if not 0 < self.alpha < 1:
            raise ValueError(f"alpha is {self.alpha}; it must lie between 0 and 1")
        if self.split < 2:
            raise ValueError(f"split is {self.split}; the traces must be split into two parts at least")
