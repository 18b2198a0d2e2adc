"""How many runs are enough: estimation, the sequential ratio test, paired comparison."""

from sim.lab.checking.smc.rules.estimation import (
    Draw,
    Progress,
    RuleOutcome,
    anytime,
    fixed,
    one_or_two_sided,
    to_half_width,
)
