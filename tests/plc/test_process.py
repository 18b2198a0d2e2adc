"""The software PLC as a process: started, asked over real sockets, ordered about, killed."""

import json
import random
import signal
import socket
import struct
import subprocess
import time
from itertools import pairwise
from pathlib import Path

import pytest

from drivers.tag import Quality, Sample
from sim.plc.control import obey
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from sim.plc.program.replay import TraceReplay, read_trace
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import read_recording
from tests.plc.bench import (
    ACCEPTED,
    ACKNOWLEDGE,
    BLOCK,
    BLOCK_WORDS,
    DECANTER,
    HEARTBEAT,
    PATIENCE_S,
    PERMIT,
    REFUSAL,
    REFUSED,
    ROOT,
    USABLE,
    Process,
    block,
    client,
    command_line,
    ramp,
    refusal,
    running,
    trace_file,
    wait_until,
)

READ_ONE = struct.pack(">BHH", 3, 101, 1)


def test_the_ready_line_names_port_process_and_clock() -> None:
    with running("--speed", "60", "--epoch", "1000", "--control-port", "0") as plc:
        ready = plc.ready
        assert (ready["event"], ready["pid"], ready["speed"], ready["epoch"]) == ("ready", plc.popen.pid, 60, 1000)
        assert 0 < ready["port"] != ready["control_port"] > 0
        before = time.monotonic()
        told = plc.order("status")["plant_time"]
        bounds = [1000 + (moment - ready["monotonic"]) * 60 for moment in (before, time.monotonic())]
        assert bounds[0] <= told <= bounds[1]


def test_a_second_process_can_go_on_with_the_clock_of_the_first() -> None:
    with running("--epoch", "1000", "--monotonic", "5.5", "--speed", "2") as plc:
        assert (plc.ready["epoch"], plc.ready["monotonic"]) == (1000, 5.5)


def test_what_is_served_is_the_row_at_the_position(ramp_plc: Process) -> None:
    with client(ramp_plc.port) as raw:
        assert raw.words(100, 2) == [0, 0]
        for position, row in ((0.05, 0), (0.1, 1), (1.2501, 12), (4.9, 49), (0.31, 3)):
            assert ramp_plc.order("seek", position=position)["row"] == row
            wait_until(lambda row=row: raw.words(101) == [row * 10])
            assert raw.words(100, 2) == [row % 2, row * 10]
            assert raw.words(109) == [row]


def test_while_it_runs_every_answer_is_the_row_of_the_images_moment(tmp_path: Path) -> None:
    record = tmp_path / "r.jsonl"
    options = ("--trace", ramp(tmp_path), "--speed", "4", "--record", record, "--epoch", "0")
    with running(*options) as plc, client(plc.port) as raw:
        seen = [raw.words(100, 10) for _ in range(300)]
        plc.stop()
    assert all(words[0] == words[1] // 10 % 2 and words[9] == words[1] // 10 for words in seen), "a torn image"
    recording = read_recording(record)
    current = [row for row in recording.truth if row.tag == "Assorbimento" and row.value is not None]
    began = next(row for row in recording.events if row.event == "start").time
    for row in current[1:]:
        assert isinstance(row.value, float)
        assert int((row.time - began) / 0.1 + 1e-6) == row.value
    versions = {row.version: row.value for row in current}
    for request in recording.requests:
        assert request.reply is not None
        latest = max(version for version in versions if version <= request.version)
        assert struct.unpack(">H", request.reply[11:13])[0] == versions[latest] * 10


def test_registers_without_a_reading_hold_their_sentinel_and_strange_signals_are_named_once(tmp_path: Path) -> None:
    trace = trace_file(tmp_path, ["0,,7,1", "1,5,8,1"], "time,Assorbimento,Strange,PlcHeartbeat")
    with running("--trace", trace, "--hold") as plc, client(plc.port) as raw:
        assert raw.words(101, 2) == [0xFFFF, 0xFFFF]
        assert raw.words(109) == [0x8000]
        assert raw.words(105, 2)[1] & 0x7F80 == 0x7F80  # NaN, low word first
        assert plc.ready["replay"]["ignored"] == ["Strange", "PlcHeartbeat"]
        plc.stop()
        assert plc.popen.stderr is not None
        assert plc.popen.stderr.read().count("Strange") == 1


def test_pause_resume_speed_loop_and_the_end(tmp_path: Path) -> None:
    with running("--trace", ramp(tmp_path, rows=4), "--hold", "--offset", "0.1") as plc:
        assert plc.order("status")["position"] == 0.1
        plc.order("start")
        paused = plc.order("pause")["position"]
        assert plc.order("status")["position"] == paused >= 0.1
        plc.order("speed", speed=50.0)
        plc.order("resume")
        wait_until(lambda: bool(plc.order("status")["ended"]))
        assert plc.order("status")["position"] == pytest.approx(0.3)
        wait_until(lambda: bool(plc.order("status")) and len(plc.events) == 1)
        assert plc.events[0]["event"] == "end_of_trace"
        plc.order("loop", on=True)
        positions = [plc.order("status")["position"] for _ in range(200)]
        assert any(late < early for early, late in pairwise(positions))
        assert not plc.order("status")["ended"]


def test_the_heartbeat_counts_and_never_reads_zero_while_the_program_runs() -> None:
    with running("--cycle", "0.001") as plc, client(plc.port) as raw:
        seen = [raw.words(HEARTBEAT)[0] for _ in range(200)]
        assert min(seen) >= 1 and seen == sorted(seen) and seen[-1] > seen[0]


def test_several_requests_in_one_segment_are_all_answered_in_order(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        frame = struct.pack(">HHHB", 7, 0, 6, 1) + READ_ONE
        raw.sock.sendall(b"".join(struct.pack(">H", number) + frame[2:] for number in range(20)))
        assert [raw.frame()[0] for _ in range(20)] == list(range(20))


def test_a_request_byte_by_byte_is_answered_once(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        for octet in struct.pack(">HHHB", 7, 0, 6, 1) + READ_ONE:
            raw.sock.sendall(bytes((octet,)))
            time.sleep(0.002)
        assert raw.frame() == (7, 1, bytes.fromhex("0302ffff"))
        assert raw.silent_for(0.1)


@pytest.mark.parametrize(("protocol", "length"), [(1, 6), (0, 0), (0, 1), (0, 255), (0, 65535)])
def test_a_header_that_is_not_modbus_closes_the_connection_and_no_other(
    plain_plc: Process, protocol: int, length: int
) -> None:
    with client(plain_plc.port) as other, client(plain_plc.port) as raw:
        raw.sock.sendall(struct.pack(">HHHB", 1, protocol, length, 1))
        assert raw.sock.recv(1) == b""
        assert other.words(101) == [0xFFFF]


def test_a_strange_unit_gets_silence_or_by_setting_exception_11(plain_plc: Process) -> None:
    with client(plain_plc.port) as raw:
        raw.send(READ_ONE, unit=2)
        assert raw.silent_for(0.2)
        assert raw.words(101) == [0xFFFF]
    with running("--unknown-unit", "exception") as plc, client(plc.port) as raw:
        raw.send(READ_ONE, unit=2)
        assert raw.frame() == (1, 2, bytes((0x83, 11)))


def test_two_clients_are_served_at_once_and_a_third_by_setting_is_closed() -> None:
    with running("--max-clients", "2") as plc, client(plc.port) as one, client(plc.port) as two:
        assert one.words(101) == two.words(101) == one.words(102)
        with client(plc.port) as three:
            assert three.sock.recv(1) == b""
        one.sock.close()
        wait_until(lambda: plc.order("status")["connections"] == 1)
        with client(plc.port) as three:
            assert three.words(101) == [0xFFFF]


def test_the_register_limit_is_the_maps_or_the_settings() -> None:
    with running("--max-registers", "10") as plc, client(plc.port) as raw:
        assert len(raw.words(100, 10)) == 10
        assert raw.ask(struct.pack(">BHH", 3, 100, 11)) == bytes((0x83, 3))


def test_only_the_block_and_the_test_registers_can_be_written() -> None:
    with running("--writable", "holding:300-301") as plc, client(plc.port) as raw:
        assert raw.write(300, [1, 2]) == struct.pack(">BHH", 16, 300, 2)
        assert raw.words(300, 2) == [1, 2]
        # Four registers lie between the two blocks, and none behind the second.
        for address in (100, 302, BLOCK - 1, BLOCK + 1, BLOCK + 29, BLOCK + 31):
            assert raw.write(address, [1] * BLOCK_WORDS) == bytes((0x90, 2)), address
        assert raw.ask(struct.pack(">BHH", 3, 130, 1)) == bytes((0x83, 2))
        assert raw.words(BLOCK, BLOCK_WORDS) == [0] * BLOCK_WORDS
        assert raw.write(BLOCK + 30, [1] * BLOCK_WORDS) == struct.pack(">BHH", 16, BLOCK + 30, BLOCK_WORDS)


def test_the_gateways_block_is_judged_stored_counted_and_timed_out(tmp_path: Path) -> None:
    quick = tmp_path / "quick.toml"
    quick.write_text(DECANTER.read_text().replace("timeout_s = 5.0", "timeout_s = 1.5"))
    record = tmp_path / "r.jsonl"
    with running("--record", record, map_path=quick) as plc, client(plc.port) as raw:
        assert raw.words(PERMIT) == [1]
        assert raw.write(BLOCK, block(1, 1)) == struct.pack(">BHH", 16, BLOCK, BLOCK_WORDS)
        wait_until(lambda: raw.words(USABLE) == [1])
        assert raw.words(BLOCK, BLOCK_WORDS) == block(1, 1)
        raw.write(BLOCK, block(2, 1))
        wait_until(lambda: raw.words(REFUSED) == [1])
        assert raw.words(REFUSAL) == [4] and raw.words(ACCEPTED) == [1]
        wait_until(lambda: raw.words(USABLE) == [0])
        plc.order("acknowledge", bits=5)
        plc.order("permit", on=False)
        wait_until(lambda: raw.words(ACKNOWLEDGE) == [5] and raw.words(PERMIT) == [0])
        plc.stop()
    recording = read_recording(record)
    assert [(row.accepted, row.verdict) for row in recording.blocks] == [
        (True, "none"),
        (False, "heartbeat did not change"),
    ]
    assert recording.blocks[0].fields is not None
    assert recording.blocks[0].fields["temperature_now"] == pytest.approx(45.12)
    usable = [(row.event, row.monotonic) for row in recording.events if row.event.startswith("prediction")]
    assert [event for event, _ in usable] == ["prediction usable", "prediction not usable"]
    assert usable[1][1] - recording.blocks[0].monotonic > 1.5


def test_a_forced_tag_holds_its_value_until_it_is_released(ramp_plc: Process) -> None:
    with client(ramp_plc.port) as raw:
        assert ramp_plc.order("force", tag="Assorbimento", value=250.5)["ok"]
        wait_until(lambda: raw.words(101) == [2505])
        assert ramp_plc.order("force", tag="Coppia", value=12)["ok"]
        assert ramp_plc.order("release")["tags"] == ["Assorbimento", "Coppia"]
        wait_until(lambda: raw.words(101, 2) == [0, 0xFFFF])


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("no json", "no JSON object"),
        ("[1]", "no JSON object"),
        ('{"command": "dance"}', "there is no 'dance'"),
        ('{"command": ["seek"]}', "known are start"),
        ('{"command": "seek"}', "position: is missing"),
        ('{"command": "seek", "position": "1"}', "position: must be a number"),
        ('{"command": "seek", "position": -1}', "outside the trace"),
        ('{"command": "seek", "position": 1e999}', "finite"),
        ('{"command": "speed", "speed": 0}', "not positive"),
        ('{"command": "stop", "now": true}', "now: there is no such key"),
        ('{"command": "force", "tag": "X", "value": 1}', "no tag 'X'"),
        ('{"command": "force", "tag": "Assorbimento", "value": 1e6}', "cannot hold"),
        ('{"command": "force", "tag": "Assorbimento", "value": "a"}', "a number"),
        ('{"command": "force", "tag": "TFango", "value": 1e999}', "got inf"),
        (f'{{"command": "force", "tag": "TCuscinettiRiduttore", "value": 1{"0" * 400}}}', "cannot hold"),
        ('{"command": "force", "tag": "PresenzaAllarme", "value": null}', "not available"),
        ('{"command": "acknowledge", "bits": 65536}', "0 to 65535"),
        ('{"command": "clear", "number": 3}', "no fault 3"),
        ('{"command": "fault", "fault": {"kind": "frozen", "tags": ["X"]}}', "no tag 'X'"),
    ],
)
def test_a_command_that_cannot_be_done_is_answered_with_the_reason(tmp_path: Path, line: str, reason: str) -> None:
    plc = Plc(read_map(DECANTER), EmulatorClock(0.0, 0.0), TraceReplay(read_trace(ramp(tmp_path)), 0.0))
    plc.begin(0.0)
    reply = obey(plc, line, 0.0)
    assert not reply["ok"] and reason in str(reply["error"]), reply


def test_the_loopback_port_takes_the_same_commands() -> None:
    with running("--control-port", "0") as plc:
        with socket.create_connection(("127.0.0.1", plc.ready["control_port"]), timeout=PATIENCE_S) as sock:
            stream = sock.makefile("rw")
            stream.write('{"command": "status", "id": "a"}\n{"command": "stop"}\n')
            stream.flush()
            first = json.loads(stream.readline())
            assert (first["id"], first["ok"], first["running"]) == ("a", True, True)
        assert plc.popen.wait(PATIENCE_S) == 0


@pytest.mark.parametrize("way", ["SIGTERM", "SIGINT", "end of stdin"])
def test_it_stops_cleanly(tmp_path: Path, way: str) -> None:
    record = tmp_path / "r.jsonl"
    with running("--record", record) as plc, client(plc.port) as raw:
        raw.words(101)
        assert plc.popen.stdin is not None
        if way == "end of stdin":
            plc.popen.stdin.close()
        else:
            plc.popen.send_signal(getattr(signal, way))
        assert plc.popen.wait(PATIENCE_S) == 0
        assert plc.line() == {"event": "stopped", "lost_rows": 0}
        assert plc.popen.stderr is not None
        assert plc.popen.stderr.read() == ""
        assert raw.sock.recv(1) == b""
    assert read_recording(record).events[-1].event in ("stopped", "disconnected")


def test_sigkill_loses_nothing_that_was_answered(tmp_path: Path) -> None:
    record = tmp_path / "r.jsonl"
    answered, samples = [], []
    options = ("--record", record, "--trace", ramp(tmp_path), "--loop", "--epoch", "0", "--monotonic", "0")
    for _ in range(3):
        with running(*options) as plc, client(plc.port) as raw:
            for _ in range(40):
                sent = time.monotonic()
                value = raw.words(101)[0] / 10
                answered.append(raw.sock.getsockname()[1])
                samples.append(Sample("Assorbimento", value, Quality.GOOD, time.monotonic(), sent))
            plc.popen.kill()
            plc.popen.wait()
    recording = read_recording(record)
    assert [int(row.peer.rpartition(":")[2]) for row in recording.requests] == answered
    assert (len(recording.runs), recording.missing, recording.damaged) == (3, 0, 0)
    assert wrong_good(recording, samples) == []
    late = [Sample("Assorbimento", (s.value + 25) % 50, s.quality, s.time, s.sent) for s in samples]
    assert len(wrong_good(recording, late)) == len(samples)


def test_garbage_never_kills_the_server() -> None:
    draw = random.Random(7)
    with running() as plc:
        for number in range(150):
            with client(plc.port) as raw:
                noise = draw.randbytes(draw.randrange(1, 300))
                header = struct.pack(">HHHB", number, 0, min(len(noise) + 1, 254), 1)
                raw.sock.sendall(noise if number % 2 else header + noise[:253])
        # Connections that still wait to be accepted may fill the places for a moment: then a client is sent away.
        wait_until(lambda: _answers(plc.port))
        plc.stop()
        assert plc.popen.stderr is not None
        assert plc.popen.stderr.read() == ""


def _answers(port: int) -> bool:
    try:
        with client(port) as raw:
            return raw.words(101) == [0xFFFF]
    except ConnectionError:
        return False


def test_it_explains_its_faults_and_commands() -> None:
    done = subprocess.run(command_line("--explain"), capture_output=True, text=True, timeout=PATIENCE_S, cwd=ROOT)
    assert done.returncode == 0
    assert "| `half_open` |" in done.stdout and "| `seek` | position |" in done.stdout


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--trace", "none.csv"], 2, ["none.csv", "no such file"]),
        (["--faults", "none.toml"], 2, ["none.toml", "no such file"]),
        (["--speed", "0"], 2, ["--speed", "not positive"]),
        (["--speed", "nan"], 2, ["--speed", "not positive"]),
        (["--writable", "input:3"], 2, ["--writable", "input:3"]),
        (["--record", "/nowhere/r.jsonl"], 2, ["/nowhere/r.jsonl", "cannot be written"]),
        (["--host", "203.0.113.1"], 3, ["cannot listen", "--port"]),
        (["--speed", "fast"], 2, ["--speed", "fast"]),
    ],
)
def test_input_that_cannot_be_used_ends_with_a_sentence_and_a_code(
    options: list[str], code: int, words: list[str]
) -> None:
    exit_code, stderr = refusal(*options)
    assert exit_code == code
    for word in words:
        assert word in stderr


def test_a_process_that_cannot_begin_says_so_in_one_line() -> None:
    command = command_line("--trace", "none.csv")
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, cwd=ROOT, check=False)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
