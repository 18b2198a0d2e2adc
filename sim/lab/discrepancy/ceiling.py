"""How much could be explained at best: boosted trees on the heat that is left, judged on cycles they have not seen.

Whatever is systematic in the heat and follows anything that is measured (signals, temperature, time since start or
stop, time of day, the calendar), trees find some of it. What they cannot predict on other cycles is the plant's own
roughness.
"""

import numpy as np

from sim.lab.discrepancy.diagnosis import Ceiling
from sim.lab.discrepancy.fitting import Fitted
from sim.lab.discrepancy.heat import Blocks, flips, heat_blocks
from sim.lab.learning import Indices
from sim.lab.tree_regressor import one_thread, tree_regressor
from sim.sha import Array

FOLDS, DRAWS = 5, 4000
LEAST_CYCLES, LEAST_BLOCKS = 4, 60
DAY_S = 86400.0


def ceiling(fitted: Fitted, seed: int, first_made: float = np.inf) -> Ceiling | None:
    """The share of the heat left by a fit that trees predict on unseen cycles; None with too few cycles or blocks.

    Not asked are those of an experiment, from the piece of evidence `first_made` on: they repeat the same set-points,
    and what a model is off by at these one of them tells of the others. That is no more than that they are repeated.
    """
    blocks = heat_blocks(fitted)
    blocks = blocks.select(blocks.cycle < first_made)
    cycles = np.unique(blocks.cycle)
    if cycles.size < LEAST_CYCLES or blocks.heat.size < LEAST_BLOCKS:
        return None
    record = fitted.frame.record
    names = (*record.signals, record.model.temperature, "since start", "since stop", "time of day", "calendar")
    names += ("location", "running")
    # A day at most: where no start or stop was seen, the time since is a placeholder that trees would split at.
    columns = [
        *blocks.signals.T,
        blocks.course,
        np.minimum(blocks.since_start, DAY_S),
        np.minimum(blocks.since_stop, DAY_S),
        blocks.time % DAY_S,
        blocks.time - blocks.time[0],
        blocks.location.astype(float),
        blocks.running,
    ]
    features = np.column_stack(columns)
    # Winsorised, since trees of squared loss would spend their few splits on single extreme blocks.
    low, high = np.quantile(blocks.heat, [0.01, 0.99])
    heat = np.clip(blocks.heat, low, high)
    predicted = _out_of_fold(features, heat, blocks, cycles, seed)
    weight = blocks.seconds
    order = np.searchsorted(cycles, blocks.cycle)
    # What a prediction f gains on a cycle: |h|^2 - |h - f|^2 = 2 h f - f^2; under a flip of h's sign only 2 h f turns.
    cross, size = np.zeros(cycles.size), np.zeros(cycles.size)
    np.add.at(cross, order, 2.0 * weight * heat * predicted)
    np.add.at(size, order, weight * predicted**2)
    total = float(np.sum(weight * heat**2))
    signs = flips(cycles.size, seed, DRAWS)
    drawn = signs @ cross
    share = float((cross.sum() - size.sum()) / max(total, 1e-300))
    p = float(np.mean(drawn >= cross.sum() - 1e-12))
    rms = float(np.sqrt(total / max(float(weight.sum()), 1e-300)))
    return Ceiling(share, p, rms, _drivers(names, features, predicted))


def _out_of_fold(features: Array, heat: Array, blocks: Blocks, cycles: Indices, seed: int) -> Array:
    """(b,) the trees' prediction of each block's heat, learned on the other folds' cycles."""
    # Whole cycles are held out, not blocks: the blocks of one cycle share its scatter, and trees would learn it.
    rng = np.random.default_rng(seed)
    fold = rng.permutation(np.arange(cycles.size) % min(FOLDS, cycles.size))[np.searchsorted(cycles, blocks.cycle)]
    predicted = np.zeros(heat.size)
    with one_thread():
        for number in np.unique(fold):
            out = fold == number
            trees = tree_regressor(
                max_iter=60,
                learning_rate=0.1,
                max_leaf_nodes=8,
                min_samples_leaf=12,
                l2_regularization=5.0,
                early_stopping=False,
                random_state=0,
            )
            trees.fit(features[~out], heat[~out])
            predicted[out] = trees.predict(features[out])
    return predicted


def _drivers(names: tuple[str, ...], features: Array, predicted: Array) -> tuple[tuple[str, float], ...]:
    """The features that the prediction goes with most: rank correlations of at least 0.2 in size, three at most."""
    rank = np.argsort(np.argsort(predicted)).astype(float)
    drivers = []
    for name, column in zip(names, features.T, strict=True):
        if np.ptp(column) > 0 and np.ptp(predicted) > 0:
            size = abs(float(np.corrcoef(np.argsort(np.argsort(column)).astype(float), rank)[0, 1]))
            if size >= 0.2:
                drivers.append((name, size))
    return tuple(sorted(drivers, key=lambda pair: -pair[1])[:3])
