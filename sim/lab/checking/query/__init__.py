"""A query as a tree, the names that it speaks of, and what decides one over the locations alone."""

from sim.lab.checking.query.names import (
    FUNCTIONS,
    KEYWORDS,
    PROCESS,
    QUANTITIES,
    RESERVED_WORDS,
    QuantityKind,
    identifiers,
)
from sim.lab.checking.query.symbolic import decide
from sim.lab.checking.query.tree import (
    Always,
    Arithmetic,
    At,
    Both,
    BoundedResponse,
    Compare,
    Comparison,
    Constant,
    Deadlock,
    Either,
    Eventually,
    Expression,
    Formula,
    Hypothesis,
    Indicator,
    Not,
    Number,
    Operation,
    Path,
    Probability,
    Quantity,
    Simulation,
    Symbolic,
    Until,
)
