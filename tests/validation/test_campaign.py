"""Campaigns over many traces: the same numbers in one process, in several and on a cluster; a failure stops nobody."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from sim.lab import workers
from sim.lab.formats.find import FoundModel
from sim.lab.judge import campaign
from sim.lab.judge.campaign import (
    Runner,
    Unread,
    cluster_runner,
    local_runner,
    model_jobs,
    outcomes_by_model,
    unread_traces,
)
from sim.lab.judge.discovery import Discovery
from sim.lab.judge.free_run import TraceRunSettings
from sim.lab.judge.output_folder import results_json
from sim.lab.judge.results import TraceResult
from sim.lab.judge.stages import Prepared
from sim.lab.recordings.load_report import FileReport, LoadReport
from sim.lab.workers import await_future, cluster, parallel
from sim.sha.trace import Trace
from tests.validation.killed import divided, twice
from tests.validation.small_plant import plant_model, plant_trace

SETTINGS = TraceRunSettings(runs=300)
GOOD = [plant_trace(f"run{number}", noise=0.2, seed=number) for number in range(4)]
COLD = Trace("cold", GOOD[0].times, {"Motor": GOOD[0].signals["Motor"]})

CLUSTER = """
import sys, time
from distributed import LocalCluster
options = {"processes": False, "protocol": "tcp", "threads_per_worker": 1, "dashboard_address": None}
if __name__ == "__main__":
    with LocalCluster(n_workers=0, **options) as local:
        print(local.scheduler_address, flush=True)
        for line in sys.stdin:
            local.scale(int(line))
            while len(local.scheduler.workers) != int(line):
                time.sleep(0.01)
            print("scaled", flush=True)
"""
"""A scheduler, and as many workers beside it in one process as the last line on its input says; at first none."""


def prepared(label: str, **options: float) -> Prepared:
    model = plant_model(label, **options)
    parsed = FoundModel(label, model.sha, model)
    return Prepared(
        label=label,
        where=label,
        parsed=parsed,
        structure=model,
        variants={"carried": model},
        refusals={},
        stages=(),
        discovery=Discovery("by hand", Path(), ()),
    )


MODELS = [prepared("sharp", sensor=0.2), prepared("wide", sensor=0.2, sigma=3.0, noise=0.1)]


def results(run: Runner, traces: Sequence[Trace], without: Sequence[Unread] = ()) -> list[TraceResult]:
    found = outcomes_by_model(
        MODELS, traces, without=without, settings=SETTINGS, run=run, progress=lambda what, share: None
    )
    return [replace(outcome.result, seconds=0.0) for _, outcomes in found for outcome in outcomes]


def as_text(found: Sequence[TraceResult]) -> str:
    return results_json(found)


@dataclass
class Dask:
    """A process of its own with a scheduler."""

    process: subprocess.Popen[str]
    address: str

    def scale(self, workers: int) -> None:
        """Have so many workers."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"{workers}\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "scaled\n"


@pytest.fixture(scope="module")
def dask() -> Iterator[Dask]:
    """Started once; without workers until a test asks for them."""
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", CLUSTER], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        yield Dask(process, process.stdout.readline().strip())
        process.communicate(timeout=200)


def test_several_processes_give_the_very_same_results_in_the_same_order(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = results(local_runner(1), [*GOOD, COLD])
    monkeypatch.setattr(campaign, "MIN_PARALLEL_TEMPERATURES", 0)
    assert as_text(results(local_runner(2), [*GOOD, COLD])) == as_text(alone)
    assert [(one.model, one.trace) for one in alone[:6]] == [
        *(("sharp", name) for name in ("run0", "run1", "run2", "run3", "cold")),
        ("wide", "run0"),
    ]


def test_a_result_depends_on_its_model_and_trace_and_not_on_what_runs_beside_them() -> None:
    everything = {(one.model, one.trace): one for one in results(local_runner(1), GOOD)}
    backwards = results(local_runner(1), GOOD[:1:-1])
    assert as_text(backwards) == as_text([everything[one.model, one.trace] for one in backwards])


def test_a_dask_cluster_gives_the_very_same_results(dask: Dask) -> None:
    dask.scale(2)
    with cluster_runner(dask.address) as run:
        found = results(run, [*GOOD, COLD])
    dask.scale(0)
    assert as_text(found) == as_text(results(local_runner(1), [*GOOD, COLD]))


def test_work_on_a_cluster_comes_as_it_is_done_and_what_cannot_be_done_is_lost_alone(dask: Dask) -> None:
    dask.scale(2)
    with cluster(dask.address) as run:
        found = list(run(divided, [1, 0, 2, 4], lambda number, reason: f"{number}: {reason}", ordered=False))
    dask.scale(0)
    assert {each for each in found if isinstance(each, float)} == {8.0, 4.0, 2.0}
    (lost,) = (each for each in found if isinstance(each, str))
    assert lost.startswith("0: the cluster could not run it (ZeroDivisionError")


def test_a_scheduler_that_does_not_answer_or_has_no_worker_is_one_sentence(
    dask: Dask, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "REACH_TIMEOUT_S", 0.2)  # where there is nobody, waiting longer changes nothing
    with (
        pytest.raises(ValueError, match=r"tcp://127\.0\.0\.1:1: no Dask scheduler answers"),
        cluster("tcp://127.0.0.1:1"),
    ):
        pass
    with pytest.raises(ValueError, match="no Dask scheduler answers"), cluster("nonsense://x"):
        pass
    monkeypatch.setattr(workers, "REACH_TIMEOUT_S", 1.0)
    with pytest.raises(ValueError, match="has no worker"), cluster(dask.address):
        pass


@pytest.mark.parametrize(
    "address", ["foo", "", "http://h:1", "tcp://h", "tcp://h:x", "tcp://h:1 x", "tls://127.0.0.1:1"]
)
def test_what_is_no_address_is_one_sentence_at_once_and_nothing_is_said_afterwards(
    address: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ValueError, match=r"give tcp://HOST:PORT|certificates"), cluster(address):
        pass
    assert capfd.readouterr().err == ""


class Waiting:
    """A future of a cluster and its client, as far as they are asked: nothing comes, or the future was given up."""

    def __init__(self, workers: Sequence[dict[str, int]], given_up: bool = False) -> None:
        self.workers, self.given_up, self.asked = list(workers), given_up, 0

    def exception(self, timeout: float) -> None:
        self.asked += 1
        if not self.given_up and self.workers:
            raise TimeoutError

    def cancelled(self) -> bool:
        return self.given_up

    def scheduler_info(self) -> dict[str, dict[str, int]]:
        return {"workers": self.workers.pop(0)}


def test_a_cluster_without_workers_or_scheduler_ends_the_campaign_with_a_sentence() -> None:
    gone = Waiting([{}] * 9)
    with pytest.raises(ValueError, match="tcp://h:1: the cluster has no worker any more"):
        await_future(gone, gone, "tcp://h:1")
    assert gone.asked == 3
    lost = Waiting([], given_up=True)
    with pytest.raises(ValueError, match="the connection to the Dask scheduler was lost"):
        await_future(lost, lost, "tcp://h:1")
    restarted = Waiting([{}, {}, {"one": 1}, {}, {}])
    assert await_future(restarted, restarted, "tcp://h:1") is None
    assert restarted.asked == 6


def test_what_a_worker_raised_is_what_went_wrong() -> None:
    future: Future[int] = Future()
    future.set_exception(MemoryError("too large"))
    assert isinstance(await_future(future, None, "tcp://h:1"), MemoryError)


def test_the_work_of_a_process_that_was_killed_is_done_again(tmp_path: Path) -> None:
    tasks = [(number, str(tmp_path / "killed") if number == 5 else "", False) for number in range(12)]
    assert list(parallel(twice, tasks, 2)) == [2 * number for number in range(12)]
    assert (tmp_path / "killed").exists()


def test_work_that_kills_its_process_each_time_is_lost_alone_or_the_end(tmp_path: Path) -> None:
    killer = (2, str(tmp_path / "killed"), True)
    tasks = [(1, "", False), killer, (3, "", False)]
    assert list(parallel(twice, tasks, 2, lambda task: -task[0])) == [2, -2, 6]
    with pytest.raises(ValueError, match="a worker process was killed"):
        list(parallel(twice, [killer], 2))


def test_without_dask_the_sentence_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"decanter-gateway\[cluster\]"), cluster("tcp://127.0.0.1:1"):
        pass


def test_a_trace_that_fails_is_reported_and_the_others_go_on() -> None:
    found = results(local_runner(1), [COLD, *GOOD], [Unread("broken", "broken.csv: it has no header")])
    failed = [(one.model, one.trace, one.stage) for one in found if one.failure]
    assert failed == [(name, trace, 5) for name in ("sharp", "wide") for trace in ("cold", "broken")]
    assert sum(np.isfinite(one.mae.value) for one in found) == 8


def test_a_model_that_cannot_run_has_a_row_for_each_trace_that_says_why() -> None:
    refused = replace(MODELS[0], variants={}, refusals={"": "its flow is quadratic"})
    jobs = model_jobs(refused, GOOD, SETTINGS)
    assert [(job.semantics, job.refusal) for job in jobs] == [("none", "its flow is quadratic")] * 4


def test_only_the_signals_that_the_model_sees_travel_to_a_worker() -> None:
    rich = replace(GOOD[0], signals={**GOOD[0].signals, "Vibration": GOOD[0].times})
    (job,) = model_jobs(MODELS[0], [rich], SETTINGS)
    assert set(job.trace.signals) == {"Motor", "T"}


def test_a_part_of_a_trace_that_could_not_be_read_is_no_lost_trace(tmp_path: Path) -> None:
    part = FileReport(tmp_path / "run0" / "part2.csv", error="part2.csv: it is empty")
    lost = FileReport(tmp_path / "lost.csv", error="lost.csv: it is empty")
    assert unread_traces(LoadReport((part, lost)), GOOD) == (Unread("lost", "lost.csv: it is empty"),)
