"""How many runs are enough: estimation, the sequential ratio test, paired comparison."""

from sim.lab.checking.smc.rules.estimation import (
    Draw,
    Progress,
    RuleOutcome,
    anytime,
    fixed_run_estimate,
    to_half_width,
    uppaal_interval,
)
