"""The forecasts of ten machines were made at once, each with its arrays: 30 MB that one after another needs not."""

import asyncio
import ctypes
import threading
from pathlib import Path
from random import Random
from typing import Any

import pytest

from drivers.supervision import Supervisor
from gateway.plant import keep_freed_memory
from gateway.plant.fleet import FORECASTS_AT_ONCE, Fleet
from gateway.plant.log import open_log
from gateway.settings import load_plant
from tests.gateway.support import JumpClock, plant_file, two_modes


async def test_at_most_so_many_jobs_run_as_there_are_turns_and_one_that_fails_gives_its_turn_back() -> None:
    supervisor, turns, lock = Supervisor(), asyncio.Semaphore(2), threading.Lock()
    together, most, both = 0, 0, threading.Barrier(2)

    def work(number: int) -> int:
        nonlocal together, most
        with lock:
            together += 1
            most = max(most, together)
        both.wait(60.0)  # two of them are under way at once, or nobody gets on
        with lock:
            together -= 1
        if number == 1:
            raise ValueError("one of them")
        return number

    jobs = [supervisor.job("forecast", lambda number=number: work(number), turns) for number in range(6)]  # type: ignore[misc]
    done = await asyncio.gather(*jobs, return_exceptions=True)
    assert most == 2 and [one for one in done if isinstance(one, int)] == [0, 2, 3, 4, 5]
    assert isinstance(done[1], ValueError)


async def test_all_machines_of_a_gateway_share_the_turns(tmp_path: Path) -> None:
    file = plant_file(tmp_path, model=two_modes())
    rows = "".join(f'[[machine]]\nname = "m{n}"\ndevice = {{ port = {5020 + n} }}\n' for n in range(3))
    file.write_text(file.read_text(encoding="utf-8") + rows, encoding="utf-8")
    with open_log(None, "error") as log:
        fleet = Fleet(load_plant(file), clock=JumpClock(), log=log, rng=Random(0))
    try:
        outlooks: list[Any] = [machine.model.outlook for machine in fleet.machines.values() if machine.model]
        (turns,) = {one._turns for one in outlooks}
        assert len(outlooks) == 3 and turns._value == FORECASTS_AT_ONCE
    finally:
        fleet.records.close()


def test_a_c_library_without_the_call_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda _name: object())
    keep_freed_memory()
