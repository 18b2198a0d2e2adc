"""Each fault as a raw socket sees it, with the real process."""

import socket
import struct
import time
from pathlib import Path

import pytest

from drivers.tag import Quality, Sample
from sim.plc.program.faults import FAULT_FACES, FAULTS
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import read_recording
from tests.plc.bench import (
    ACCEPTED,
    BLOCK,
    BLOCK_WORDS,
    HEARTBEAT,
    Process,
    Raw,
    block,
    client,
    ramp,
    running,
    wait_until,
)

ASK = struct.pack(">BHH", 3, 101, 2)
ANSWER = bytes.fromhex("0304ffffffff")


def refused(port: int) -> bool:
    """True if connecting is refused."""
    try:
        socket.create_connection(("127.0.0.1", port), timeout=60).close()
    except ConnectionRefusedError:
        return True
    return False


def ended(raw: Raw) -> bool:
    """True if the connection is gone; fails if it stays."""
    try:
        return raw.sock.recv(1) == b""
    except ConnectionResetError:
        return True


def test_refuse_closes_the_listener_and_resets_who_is_there(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        assert raw.ask(ASK) == ANSWER
        number = plain_plc.fault("refuse")
        with pytest.raises(ConnectionResetError):
            raw.sock.recv(1)
        assert refused(plain_plc.port)
        plain_plc.order("clear", number=number)
        wait_until(lambda: not refused(plain_plc.port))
        with client(plain_plc.port) as again:
            assert again.ask(ASK) == ANSWER


def test_silent_takes_connections_and_requests_and_answers_none(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        number = plain_plc.fault("silent")
        raw.send(ASK)
        with client(plain_plc.port) as other:
            other.send(ASK)
            assert other.silent_for(0.2) and raw.silent_for(0.2)
        plain_plc.order("clear", number=number)
        wait_until(lambda: plain_plc.order("status")["faults"] == [])
        assert raw.ask(ASK) == ANSWER


def test_half_open_lets_old_connections_go_deaf_and_serves_new_ones() -> None:
    with running("--max-clients", "1") as plc, client(plc.port) as old:
        assert old.ask(ASK) == ANSWER
        number = plc.fault("half_open")
        with client(plc.port) as new:
            assert new.ask(ASK) == ANSWER
            plc.order("clear", number=number)
            old.send(ASK)
            assert old.silent_for(0.2)


def test_reset_comes_after_part_of_the_reply(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        plain_plc.fault("reset", after=9, count=1)
        sent = raw.send(ASK)
        assert raw.exactly(9) == struct.pack(">HHHB", sent, 0, 7, 1) + ANSWER[:2]
        with pytest.raises(ConnectionResetError):
            raw.sock.recv(1)
        with client(plain_plc.port) as again:
            assert again.ask(ASK) == ANSWER


def test_a_late_reply_holds_what_was_true_when_it_was_asked(ramp_plc: Process) -> None:
    with client(ramp_plc.port) as raw:
        ramp_plc.fault("late", delay_s=0.4, count=1)
        before = time.monotonic()
        raw.send(struct.pack(">BHH", 3, 101, 1))
        ramp_plc.order("seek", position=2.0)
        assert raw.frame()[2] == bytes.fromhex("03020000")
        assert time.monotonic() - before >= 0.4
        assert raw.words(101) == [200]


@pytest.mark.parametrize(
    ("kind", "keys", "reply"),
    [
        ("wrong_unit", {}, (0, 2, ANSWER)),
        ("wrong_function", {}, (0, 1, b"\x04" + ANSWER[1:])),
        ("wrong_count", {}, (0, 1, bytes.fromhex("0302ffff"))),
        ("wrong_count", {"delta": 1}, (0, 1, bytes.fromhex("0306ffffffff0000"))),
        ("wrong_transaction", {"offset": 5}, (5, 1, ANSWER)),
        ("exception", {"code": 6}, (0, 1, bytes((0x83, 6)))),
        ("illegal_register", {"registers": ["holding:102"]}, (0, 1, bytes((0x83, 2)))),
        ("split", {}, (0, 1, ANSWER)),
    ],
)
def test_a_bent_reply_arrives_once_and_the_next_is_right(
    plain_plc: Process, kind: str, keys: dict[str, object], reply: tuple[int, int, bytes]
) -> None:
    with client(plain_plc.port) as raw:
        plain_plc.fault(kind, count=1, **keys)
        sent = raw.send(ASK)
        transaction, unit, pdu = raw.frame()
        assert (transaction - sent, unit, pdu) == reply
        assert raw.ask(ASK) == ANSWER


def test_an_illegal_register_leaves_its_neighbours_alone(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        plain_plc.fault("illegal_register", registers=["holding:102"])
        assert raw.ask(struct.pack(">BHH", 3, 100, 10)) == bytes((0x83, 2))
        assert raw.words(100, 2) == [0, 0xFFFF]
        assert len(raw.words(103, 8)) == 8


def test_a_duplicate_reply_arrives_twice_and_garbage_instead_of_one(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        plain_plc.fault("duplicate", count=1)
        sent = raw.send(ASK)
        assert raw.frame() == raw.frame() == (sent, 1, ANSWER)
        plain_plc.fault("garbage", length=11, count=1)
        raw.send(ASK)
        assert len(raw.exactly(11)) == 11
        assert raw.ask(ASK) == ANSWER


def test_frozen_stands_still_with_the_heartbeat_while_the_truth_goes_on(tmp_path: Path) -> None:
    record = tmp_path / "r.jsonl"
    with running("--trace", ramp(tmp_path), "--hold", "--record", record) as plc, client(plc.port) as raw:
        number = plc.fault("frozen")
        stood = raw.words(100, 13)
        plc.order("seek", position=3.0)
        version = plc.order("status")["version"]
        wait_until(lambda: plc.order("status")["version"] > version + 2)
        sent = plc.order("status")["plant_time"]
        assert raw.words(100, 13) == stood
        sample = Sample("Assorbimento", stood[1] / 10, Quality.GOOD, plc.order("status")["plant_time"], sent)
        plc.order("clear", number=number)
        wait_until(lambda: raw.words(101) == [300] and raw.words(HEARTBEAT) != stood[12:])
        plc.stop()
    recording = read_recording(record)
    assert len(wrong_good(recording, [sample])) == 1, "the judge must know that the truth had moved on"
    assert wrong_good(recording, [sample], tolerance_s=60.0) == []


def test_one_tag_can_freeze_alone(ramp_plc: Process) -> None:
    with client(ramp_plc.port) as raw:
        ramp_plc.fault("frozen", tags=["Assorbimento"])
        ramp_plc.order("seek", position=3.0)
        wait_until(lambda: raw.words(109) == [30])
        assert raw.words(101) == [0]


def zeros_seen(port: int) -> tuple[bool, int]:
    """After a restart: whether the whole image, heartbeat included, read 0, and the current once it runs again."""
    zeros = False
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        try:
            with client(port) as raw:
                words = raw.words(100, 19)
        except OSError:
            continue
        if words[12]:
            return zeros, words[1]
        assert words == [0] * 19
        zeros = True
    raise AssertionError("the program never ran again")


def test_a_restart_drops_everyone_reads_zeros_and_runs_again(tmp_path: Path) -> None:
    record = tmp_path / "r.jsonl"
    options = ("--trace", ramp(tmp_path), "--hold", "--offset", "2.0", "--record", record)
    with running(*options) as plc, client(plc.port) as raw:
        raw.write(BLOCK, block(1, 1))
        wait_until(lambda: raw.words(ACCEPTED) == [1])
        assert plc.order("fault", fault={"kind": "restart", "down_s": 1.0, "zeros_s": 1.0})["ok"]
        assert ended(raw)
        assert refused(plc.port)
        assert zeros_seen(plc.port) == (True, 200)
        with client(plc.port) as again:
            assert again.words(ACCEPTED) == [0]
            assert again.words(BLOCK, BLOCK_WORDS) == [0] * BLOCK_WORDS
            assert plc.order("status")["faults"] == []
        plc.stop()
    truth = [row for row in read_recording(record).truth if row.tag in ("Assorbimento", "PlcHeartbeat")]
    dark = next(index for index, row in enumerate(truth) if row.tag == "Assorbimento" and index and row.value is None)
    assert [row.value for row in truth if row.version == truth[dark].version] == [None, 0]
    assert next(row.value for row in truth[dark:] if row.tag == "Assorbimento" and row.value) == 20.0


def test_an_ignored_write_is_confirmed_and_not_stored() -> None:
    with running() as plc, client(plc.port) as raw:
        plc.fault("write_ignored", count=1, functions=[16])
        assert raw.write(BLOCK, block(1, 1)) == struct.pack(">BHH", 16, BLOCK, BLOCK_WORDS)
        assert raw.words(BLOCK, BLOCK_WORDS) == [0] * BLOCK_WORDS
        assert raw.write(BLOCK, block(2, 2)) == struct.pack(">BHH", 16, BLOCK, BLOCK_WORDS)
        assert raw.words(BLOCK, 2) == [2, 2]
        wait_until(lambda: raw.words(ACCEPTED) == [1])


def test_a_schedule_from_a_file_begins_with_the_replay_and_is_recorded(tmp_path: Path) -> None:
    (tmp_path / "f.toml").write_text('[[fault]]\nkind = "exception"\ncode = 6\ncount = 2\nstart = 0.1\n')
    record = tmp_path / "r.jsonl"
    options = ("--trace", ramp(tmp_path), "--hold", "--faults", tmp_path / "f.toml", "--record", record)
    with running(*options) as plc, client(plc.port) as raw:
        time.sleep(0.2)
        assert raw.ask(ASK)[0] == 3  # held: the schedule has not begun
        plc.order("start")
        wait_until(lambda: raw.ask(ASK)[0] == 0x83)
        assert raw.ask(ASK) == bytes((0x83, 6))
        assert raw.ask(ASK)[0] == 3
        wait_until(lambda: plc.order("status")["faults"] == [])
        plc.stop()
    recording = read_recording(record)
    struck = [row for row in recording.requests if row.faults]
    assert [(row.faults, row.exception) for row in struck] == [(("exception",), 6)] * 2
    events = [row.event for row in recording.events if row.event.startswith("fault")]
    assert events == ["fault began", "fault ended"]
    began = next(row for row in recording.events if row.event == "fault began")
    started = next(row for row in recording.events if row.event == "start")
    assert began.monotonic - started.monotonic >= 0.1


def test_every_fault_of_the_table_is_observed_here() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    """Those of single faces are observed where the faces are."""
    assert [kind for kind in FAULTS if f'"{kind}"' not in text and kind not in FAULT_FACES] == []


def test_two_faults_in_force_are_both_seen(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        plain_plc.fault("wrong_unit", count=1)
        plain_plc.fault("wrong_transaction", count=1)
        sent = raw.send(ASK)
        assert raw.frame() == (sent + 1, 2, ANSWER)
