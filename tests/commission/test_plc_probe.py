"""`decanter plc probe` and `doctor` as a new user meets them: each thing that is wrong has a sentence and a code."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.commission.bench import Handler, answer, at, closes, free_port, plc, server, silent, ssh, tls, web
from tests.plc.bench import Process, running


@pytest.fixture(scope="module")
def device() -> Iterator[Process]:
    with running("--max-clients", "1") as process:
        yield process


def test_a_device_that_is_there_is_named_with_its_tables_and_round_trip(device: Process, tmp_path: Path) -> None:
    data = answer(tmp_path, "probe", *at(device))
    assert data["ok"] and data["exit"] == 0
    assert data["identity"]["vendor"] == "decanter"
    assert {step["state"] for step in data["steps"]} == {"ok"}
    assert data["tables"]["holding"].startswith("offered")
    assert 0 < data["round_trip_ms"]["min"] <= data["round_trip_ms"]["max"]


def test_a_name_that_does_not_exist_cannot_be_connected_to(tmp_path: Path) -> None:
    result = plc(tmp_path, "probe", "--host", "no-such-plc.invalid")
    assert result.exit_code == 3
    assert "no name that this machine can resolve" in result.stderr


def test_a_closed_port_is_told_from_a_host_that_is_away(tmp_path: Path) -> None:
    result = plc(tmp_path, "probe", "--host", "127.0.0.1", "--port", free_port())
    assert result.exit_code == 3
    assert "is there and refuses port" in result.stderr


def test_a_host_that_answers_nothing_is_told_from_a_closed_port(tmp_path: Path) -> None:
    # A listener whose queue is full lets a connection attempt wait, as an address where nobody is does.
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        port = listener.getsockname()[1]
        fillers = [socket.socket() for _ in range(4)]
        for filler in fillers:
            filler.setblocking(False)
            filler.connect_ex(("127.0.0.1", port))
        result = plc(tmp_path, "probe", "--host", "127.0.0.1", "--port", port, "--set", "connect_timeout=0.3")
        for filler in fillers:
            filler.close()
    assert result.exit_code == 3
    assert "nobody answers at 127.0.0.1" in result.stderr


def test_a_wrong_unit_is_named_with_the_unit_that_answers(device: Process, tmp_path: Path) -> None:
    result = plc(tmp_path, "probe", *at(device), "--unit", 9, "--timeout", 0.2)
    assert result.exit_code == 5
    assert "unit 9 does not answer, and unit 1 does: give --unit 1" in result.stderr


def test_a_gateway_without_the_unit_behind_it_is_a_device_exception(tmp_path: Path) -> None:
    with running("--unknown-unit", "exception") as process:
        result = plc(tmp_path, "probe", *at(process), "--unit", 9)
    assert result.exit_code == 4
    assert "cannot reach it (exception 11)" in result.stderr


@pytest.mark.parametrize(
    ("handle", "words"),
    [(ssh, "it looks like an SSH server"), (web, "it looks like a web server"), (tls, "it looks like TLS")],
    ids=["ssh", "web", "tls"],
)
def test_a_port_that_is_no_modbus_port_is_called_by_what_it_looks_like(
    tmp_path: Path, handle: Handler, words: str
) -> None:
    with server(handle) as port:
        result = plc(tmp_path, "probe", "--host", "127.0.0.1", "--port", port, "--timeout", 0.2)
    assert words in result.stderr and "is no Modbus port" in result.stderr
    assert result.exit_code == 3


def test_a_port_that_stays_silent_is_a_timeout_with_what_it_may_be(tmp_path: Path) -> None:
    with server(silent) as port:
        result = plc(tmp_path, "probe", "--host", "127.0.0.1", "--port", port, "--timeout", 0.1)
    assert result.exit_code == 5
    assert "answers no request" in result.stderr and "--link modbus-rtu-tcp" in result.stderr


def test_a_plc_that_is_busy_with_another_client_is_told_from_all_others(device: Process, tmp_path: Path) -> None:
    with socket.create_connection(("127.0.0.1", device.port)):
        result = plc(tmp_path, "probe", *at(device))
    assert result.exit_code == 3
    assert "busy with another client" in result.stderr


def test_a_server_that_closes_at_once_looks_busy(tmp_path: Path) -> None:
    with server(closes) as port:
        result = plc(tmp_path, "read", "holding:0", "--host", "127.0.0.1", "--port", port)
    assert result.exit_code == 3
    assert "busy with another client" in result.output


def test_without_any_device_named_the_usage_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = plc(tmp_path, "probe")
    assert result.exit_code == 2
    assert "--host HOST" in result.stderr and "--config FILE" in result.stderr


def test_a_bus_that_is_not_there_is_said_for_can(tmp_path: Path) -> None:
    result = plc(tmp_path, "probe", "--link", "can", "--interface", "hub", "--channel", tmp_path / "none")
    assert result.exit_code == 3
    assert "is the hub or adapter there?" in result.stderr


def test_a_serial_port_that_is_not_there_is_said(tmp_path: Path) -> None:
    result = plc(tmp_path, "probe", "--serial", tmp_path / "ttyUSB9")
    assert result.exit_code == 3
    assert "is the adapter plugged in" in result.stderr


def test_the_doctor_looks_at_this_machine_and_speaks_to_nobody(device: Process, tmp_path: Path) -> None:
    data = answer(tmp_path, "check", "computer", *at(device))
    names = [step["step"] for step in data["steps"]]
    assert {"software", "clock", "network", "disk", "records", "can", "serial", "way"} <= set(names)
    assert data["frames"]["sent"] == 0


def test_the_doctor_finds_a_changed_record(tmp_path: Path) -> None:
    for _ in range(3):
        answer(tmp_path, "check", "computer")
    path = tmp_path / "records.jsonl"
    path.write_text(path.read_text(encoding="utf-8").replace("the engineer", "somebody else", 1), encoding="utf-8")
    result = plc(tmp_path, "check", "computer")
    assert result.exit_code == 1
    assert "line 2 does not follow" in result.stderr
