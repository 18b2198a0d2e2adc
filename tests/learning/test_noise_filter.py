"""The noise filter takes many sets of noises at once, and works out only once what several of them share."""

import numpy as np
import pytest

from sim.lab.learning.bins.candidates import CANDIDATES, build, build_basis, process_groups
from sim.lab.learning.free_run import fit_free_run
from sim.lab.learning.noise import GRADIENT_STEP, _filter_knots, _steps, _tasks
from sim.lab.learning.runs import free_runs
from sim.lab.learning.structure import bare_sha, level_signals
from sim.sha import Array
from sim.sha.events import DECANTER
from tests.learning.plants import Truth, simulate


@pytest.mark.parametrize("memory", [None, 400.0])
def test_each_set_of_noises_is_filtered_as_it_would_be_alone_and_what_they_share_once(memory: float | None) -> None:
    traces = simulate(Truth(), 3, cycles=4, rows=300)
    runs = free_runs(traces, bare_sha(DECANTER), "T", signals=level_signals(DECANTER))
    base = build_basis(runs, DECANTER)
    _, shape, _ = build(CANDIDATES[0], base)
    groups = process_groups(DECANTER)
    steps = _steps(runs, shape, fit_free_run(runs, shape), groups)
    (task,) = _tasks(steps, groups, shape, 1e-3, (memory,))
    theta = task.start()
    trials = np.repeat(theta[:, None], theta.size + 1, axis=1)
    trials[:, 1:] += GRADIENT_STEP * np.eye(theta.size)

    def filtered(points: Array) -> tuple[Array, Array, int]:
        sensor, process, scatter, rough = task.unpack(points)
        found = _filter_knots(task.steps, task.table, sensor=sensor, process=process, scatter=scatter, rough=rough)
        return found.score[found.slot], found.state[:, found.slot], found.score.size

    scores, states, size = filtered(trials)
    assert np.isfinite(scores).any() and np.isnan(scores).any()  # knots outside all chunks have none
    for number in range(theta.size + 1):
        score, state, _ = filtered(trials[:, [number]])
        np.testing.assert_array_equal(scores[:, [number]], score)
        np.testing.assert_array_equal(states[:, :, [number]], state)
    assert size < 0.95 * scores.size
