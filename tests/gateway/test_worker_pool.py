"""A plant split over worker processes: who goes where, what is refused, and what becomes of one that does not work."""

import asyncio
import io
import json
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from gateway.machine.reading import plant_clock
from gateway.plant import channel as channels
from gateway.plant import open_log, worker_pool
from gateway.plant.split import split_over
from gateway.plant.worker_pool import WorkerPool
from gateway.plant.worker_records import RecordsHealth, SentAudit, SentHistorian, WorkerRecords
from gateway.settings import Config, configs_from_json, configs_to_json, load_plant
from gateway.store import AuditEntry, LostRows, read
from tests.gateway.support import EPOCH, MAP, ROOT


def plant_of(folder: Path, *machines: str, workers: object = 2, top: str = "") -> tuple[Config, ...]:
    """A plant file with `[[machine]]` tables, each given as its name and the rest of its table."""
    rows = "\n".join(f"[[machine]]\n{machine}" for machine in machines)
    text = f'[plant]\nworkers = {workers}\n[device]\nfile = "{MAP}"\n[historian]\npath = "h.sqlite"\n{top}\n{rows}\n'
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return load_plant(path)


def named(*names: str) -> tuple[str, ...]:
    return tuple(f'name = "{name}"\ndevice = {{ port = {1500 + number} }}' for number, name in enumerate(names))


# ---------------------------------------------------------------- the file


@pytest.mark.parametrize("workers", ["0", "-1", "65", "1.5", '"two"', "true"])
def test_a_number_of_processes_that_cannot_be_is_refused_in_a_sentence(tmp_path: Path, workers: str) -> None:
    with pytest.raises(ConfigError) as refused:
        plant_of(tmp_path, *named("a", "b"), workers=workers)
    (problem,) = refused.value.problems
    assert "plant.workers: " in problem and "a whole number of processes" in problem


def test_the_number_is_the_whole_plants(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"machine 'a': plant: is common to all machines"):
        plant_of(tmp_path, 'name = "a"\nplant = { workers = 2 }')


def test_configurations_reach_a_process_as_they_are(tmp_path: Path) -> None:
    devices = [ROOT / "config/devices" / name for name in ("decanter_can.toml", "decanter_canopen.toml")]
    rows = [f'name = "n{place}"\ndevice = {{ file = "{file}" }}' for place, file in enumerate(devices)]
    links = "".join(
        f'\n[[machine.device.links]]\nname = "{name}"\nfile = "{MAP}"\nport = {port}'
        for name, port in (("x", 5), ("y", 6))
    )
    text = "\n".join(f"[[machine]]\n{row}" for row in (*rows, f'name = "twice"{links}'))
    path = tmp_path / "plant.toml"
    path.write_text(f"[historian]\ndisarm_after = false\n{text}\n", encoding="utf-8")
    plant = load_plant(path)
    assert configs_from_json(configs_to_json(plant)) == plant


# ---------------------------------------------------------------- who goes where


def test_machines_are_spread_evenly_and_those_on_one_connection_stay_together(tmp_path: Path) -> None:
    together = [f'name = "u{unit}"\ndevice = {{ host = "Gate", port = 502, unit = {unit} }}' for unit in (1, 2, 3)]
    plant = plant_of(tmp_path, *named("a", "b", "c"), *together)
    places = split_over(plant, 2, {})
    assert places == {"u1": 0, "u2": 0, "u3": 0, "a": 1, "b": 1, "c": 1}
    # No more processes than there are connections to have.
    assert set(split_over(plant, 64, {}).values()) == {0, 1, 2, 3}
    # One that is new goes where its connection is, any other where least is.
    assert split_over(plant, 2, {"u1": 1, "a": 0, "b": 0})["u3"] == 1
    assert split_over(plant[:3], 2, {"a": 0, "b": 0})["c"] == 1


def test_machines_that_come_to_share_a_connection_are_not_torn_from_their_processes(tmp_path: Path) -> None:
    links = "".join(
        f'\n[[machine.device.links]]\nname = "{port}"\nfile = "{MAP}"\nhost = "127.0.0.1"\nport = {port}\nunit = 9'
        for port in (1500, 1501)
    )
    plant = plant_of(tmp_path, *(f"{row}" for row in named("a", "b")))
    assert split_over(plant, 2, {}) == {"a": 0, "b": 1}
    path = plant[0].path
    text = path.read_text(encoding="utf-8").replace(f'[device]\nfile = "{MAP}"\n', "")
    text = text.replace("device = {", f'device = {{ file = "{MAP}",')
    path.write_text(text + f'[[machine]]\nname = "both"{links}\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"machines a, b have come to share a connection"):
        split_over(load_plant(path), 2, {"a": 0, "b": 1})
    assert set(split_over(load_plant(path), 2, {}).values()) == {0}


# ---------------------------------------------------------------- a process that does not work


@asynccontextmanager
async def pool_of(plant: tuple[Config, ...], log: io.StringIO) -> AsyncIterator[WorkerPool]:
    with open_log(None, console=log) as logger:
        pool = WorkerPool(
            plant,
            clock=plant_clock(),
            log=logger,
            log_failure=lambda: "",
            read_anew=lambda: plant,
            look_seconds=0.02,
        )
        await pool.open()
        try:
            yield pool
        finally:
            await pool.stop()


@pytest.fixture(autouse=True)
def stub(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_pool, "WORKER", "tests.gateway.stub_worker")


def asked(machine: str) -> bytes:
    return json.dumps({"command": "read", "machine": machine}).encode()


async def test_one_that_hangs_is_killed_and_begun_anew_and_the_other_is_asked_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Long enough for one that works, on a machine that does much else.
    monkeypatch.setattr(worker_pool, "HANG_SECONDS", 3.0)
    log = io.StringIO()
    async with asyncio.timeout(120.0), pool_of(plant_of(tmp_path, *named("a", "hangs")), log) as pool:
        while (answer := await pool.answer(asked("hangs")))["ok"] is False or not answer["status"]["former"]:
            assert (await pool.answer(asked("a")))["ok"]
            await asyncio.sleep(0.02)
        assert "worker 2 (hangs): it had not answered since " in answer["status"]["former"]
        assert "UTC (3 s) and was killed" in answer["status"]["former"]
        assert (await pool.answer(asked("a")))["status"]["former"] == ""
        assert pool.supervisor.report()["worker 2"]["restarts"] == 1
        # What feeds the watchdog: scans as the processes tell them, and that one was begun anew.
        before = pool.progress()
        assert (before["a"].restarts, before["hangs"].restarts) == (0, 1)
        while (now := pool.progress())["a"].completed <= before["a"].completed or now["hangs"] == before["hangs"]:
            await asyncio.sleep(0.02)
    assert "a part of the gateway failed and is begun anew" in log.getvalue() and "Traceback" not in log.getvalue()


async def test_one_that_hangs_is_named_with_its_machines_and_since_when_and_is_disarmed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_pool, "ALIVE_SECONDS", 0.2)
    top = '[writeback]\nmode = "shadow"\n'
    plant = plant_of(tmp_path, *named("a", "hangs"), top=top)
    async with asyncio.timeout(120.0), pool_of(plant, io.StringIO()) as pool:
        while (answer := await pool.answer(asked("hangs")))["ok"]:
            pass
        assert answer["reason"].startswith("worker 2 (hangs) has not answered since ")
        assert "UTC (" in answer["reason"] and "is killed and begun anew after 10 s" in answer["reason"]
        words = {"command": "disarm", "machine": "hangs", "by": "Ada", "reason": "doubt"}
        assert (await pool.answer(json.dumps(words).encode()))["ok"]
        assert [(row.entry.kind, row.entry.subject) for row in read(plant[0].audit)] == [("disarmed", "hangs")]
        while not (await pool.answer(asked("a")))["ok"]:  # on a busy machine it may be late for once, too
            pass


async def test_one_that_was_begun_anew_is_not_shown_as_the_one_before_it_was(tmp_path: Path) -> None:
    async with asyncio.timeout(120.0), pool_of(plant_of(tmp_path, *named("a", "mute")), io.StringIO()) as pool:
        while not (shown := pool._pictures().get("mute")) or not shown["link"]["alive"]:
            await asyncio.sleep(0.02)
        assert shown["phase"] == "running"
        worker = pool._workers[1]
        worker.kill()
        while not (worker.ready and worker.former):
            await asyncio.sleep(0.002)
        shown = pool._pictures()["mute"]
        assert not shown["link"]["alive"] and shown["phase"] == "starting" and shown["scan"]["late"]
        assert "is being begun anew: worker 2 (mute): its process was ended by SIGKILL" in shown["link"]["reason"]


async def test_messages_that_one_process_cannot_deliver_are_known_where_the_plants_alarms_are(tmp_path: Path) -> None:
    async with asyncio.timeout(120.0), pool_of(plant_of(tmp_path, *named("a", "unheard")), io.StringIO()) as pool:
        while not (told := pool._health(["a"])["undelivered"]):
            await asyncio.sleep(0.02)
        assert told == "shift: nobody answers"
    line: Any = Line(rows={"health": {**vars(RecordsHealth()), "undelivered": told}})
    silent: Any = None
    first = plant_of(tmp_path, *named("a", "b"))[:1]
    records = WorkerRecords(first, line, clock=plant_clock(), log=silent, supervisor=Supervisor())
    assert records.undelivered() == ""
    records.historian.of("a").put("scans", [(EPOCH, 0.1, 0)])
    assert records.historian.flush()
    assert records.undelivered() == told
    assert records.close()


@pytest.mark.parametrize(
    ("machine", "reason"), [("refuses", "machine 'refuses': no"), ("falls", "its process ended with code 3, before")]
)
async def test_a_plant_that_may_not_begin_leaves_nothing_behind(tmp_path: Path, machine: str, reason: str) -> None:
    plant = plant_of(tmp_path, *named("a", machine))
    with pytest.raises(ConfigError, match=reason):
        async with asyncio.timeout(120.0), pool_of(plant, io.StringIO()):
            pass
    assert [path.name for path in tmp_path.iterdir()] == ["plant.toml"]


def test_a_process_ends_with_its_supervisor_whatever_it_is_doing() -> None:
    ours, theirs = socket.socketpair()
    busy = (
        "import socket, sys\n"
        "from drivers.supervision import Supervisor\n"
        "from gateway.plant.channel import SupervisorChannel\n"
        "SupervisorChannel(socket.socket(fileno=int(sys.argv[1])), Supervisor(), print).tell('begun')\n"
        "while True: pass"
    )
    with theirs:
        command = [sys.executable, "-c", busy, str(theirs.fileno())]
        process = subprocess.Popen(command, pass_fds=(theirs.fileno(),), cwd=ROOT)
    try:
        assert b"begun" in ours.recv(100)
        ours.close()
        assert process.wait(120.0) == channels.ORPHANED
    finally:
        process.kill()
        process.wait()


# ---------------------------------------------------------------- the records of a process


class Line:
    """A channel whose supervisor takes everything, or what `answer` says."""

    def __init__(self, **answers: Any) -> None:
        self.said: list[tuple[str, dict[str, Any]]] = []
        self.answers = answers

    def ask(self, what: str, **content: Any) -> dict[str, Any]:
        channels.packed_line(content)  # raises as the real one does
        self.said.append((what, content))
        known = {"rows": {"health": vars(RecordsHealth())}, "flush": {"done": True}, **self.answers}
        return dict(known[what])

    def tell(self, what: str, **content: Any) -> None:
        self.said.append((what, content))


def test_rows_reach_the_supervisor_and_one_that_is_no_json_costs_that_row(tmp_path: Path) -> None:
    line: Any = Line()
    store = SentHistorian(tmp_path / "h.sqlite", line, Supervisor(), RecordsHealth())
    view = store.of("a")
    view.put("scans", [(EPOCH, 0.1, 0), (EPOCH + 1, object(), 0), (EPOCH + 2, float("nan"), 0)])
    view.put("writes", [(EPOCH, 1, "armed", "written", 7, None, "", b"\x01\xff")])
    assert store.flush()
    assert store.close()
    rows = [
        (table, channels.plain_rows(json.loads(channels.packed_line({"rows": rows}))["rows"]))
        for what, content in line.said
        if what == "rows"
        for _, table, rows in content["batch"]
    ]
    times = [row[0] for table, part in rows if table == "scans" for row in part]
    assert times == [EPOCH, EPOCH + 2]
    assert next(part for table, part in rows if table == "writes")[0][-1] == b"\x01\xff"
    assert view.refused == 1 and "cannot be stored" in view.complaint


def test_what_ails_the_supervisors_stores_is_known_in_the_process(tmp_path: Path) -> None:
    health = {**vars(RecordsHealth()), "failure": "the disk is full", "log": "no log"}
    health["lost"] = {"a": {"dropped": 3, "refused": 1, "what": "rows were dropped", "at": time.monotonic()}}
    line: Any = Line(rows={"health": health})
    here = RecordsHealth()
    store = SentHistorian(tmp_path / "h.sqlite", line, Supervisor(), here)
    view = store.of("a")
    assert store.flush()
    assert (view.failure, here.log) == ("the disk is full", "no log")
    assert (view.dropped, view.refused, store.of("b").dropped) == (3, 1, 0)
    assert store.lost_by("a").complaint == "rows were dropped" and store.lost_by("b") == LostRows()
    assert store.close()


def test_an_audit_row_counts_only_when_the_supervisor_says_that_it_is_stored(tmp_path: Path) -> None:
    files = ("", "", 0)
    line: Any = Line(audit={"error": "the disk is full", "files": files})
    audit = SentAudit(tmp_path / "audit.sqlite", line, Supervisor(), "")
    entry = AuditEntry(EPOCH, "write", "A").of("a")
    assert audit.record(entry, 2.0) is None
    assert "the disk is full" in audit.complaint_of("a")
    line.answers["audit"] = {"error": "", "rows": [(7, "ab")], "files": files, "ended": {}}
    row = audit.record(entry, 5.0)
    assert row is not None and (row.id, row.hash, row.entry) == (7, "ab", entry)
    assert audit.complaint_of("a") == "" and audit.close()
