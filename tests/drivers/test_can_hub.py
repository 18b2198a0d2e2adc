"""The bus between processes: what a hub promises to those who join it."""

import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from drivers.can.bus.access import open_bus
from drivers.can.bus.hub import Hub
from drivers.can.bus.hub_bus import pack, unpack
from drivers.errors import DriverError, LinkDown

FOREIGN = """
import sys
import can  # and nothing of ours: the interface is found by its entry point

with can.Bus(interface="hub", channel=sys.argv[1]) as bus:
    bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"hello"))
    for message in bus:
        bus.send(can.Message(arbitration_id=message.arbitration_id + 1, is_extended_id=True, data=message.data[::-1]))
        break
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "bus"


@pytest.fixture
def hub(path: Path) -> Iterator[Hub]:
    with Hub(path, queue=100) as made:
        yield made


def joined(hub: Hub, path: Path, count: int) -> list[can.BusABC]:
    buses = [open_bus("hub", str(path)) for _ in range(count)]
    settled(lambda: hub.statistics()["clients"] == count)
    return buses


def settled(condition: object) -> None:
    assert callable(condition)
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def message(number: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=number, is_extended_id=False, data=data)


def test_every_frame_reaches_all_others_in_order_and_not_its_sender(hub: Hub, path: Path) -> None:
    buses = joined(hub, path, 3)
    for place in range(200):
        buses[0].send(message(place))
    for bus in buses[1:]:
        received = [bus.recv(60.0) for _ in range(200)]
        assert [one.arbitration_id for one in received if one is not None] == list(range(200))
    assert buses[0].recv(0.05) is None
    for bus in buses:
        bus.shutdown()


def test_all_kinds_of_frames_come_out_as_they_went_in() -> None:
    for one in (
        can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"12345678"),
        can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=b""),
        can.Message(arbitration_id=0x10, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(arbitration_id=0x44, is_error_frame=True, dlc=8, data=bytes(8)),
        can.Message(arbitration_id=0x10, is_fd=True, bitrate_switch=True, is_extended_id=False, data=bytes(range(48))),
    ):
        assert unpack(pack(one)).equals(one, timestamp_delta=None, check_channel=False, check_direction=False)


def test_a_client_that_does_not_listen_stalls_nobody_and_is_told_what_it_missed(hub: Hub, path: Path) -> None:
    sender, listener, sleeper = joined(hub, path, 3)
    received: list[int] = []

    def listen() -> None:
        while len(received) < 10_000 and (one := listener.recv(5.0)) is not None:
            received.append(int.from_bytes(one.data, "big"))

    thread = threading.Thread(target=listen)
    thread.start()
    for place in range(10_000):
        sender.send(message(0x100, place.to_bytes(4, "big")))
        if place % 50 == 0:
            # A listener that keeps up is not the one whose queue this test is about.
            settled(lambda sent=place: len(received) >= sent - 60)
    thread.join()
    assert received == list(range(10_000))

    dropped = hub.statistics()["dropped"]
    kept = []
    while (not kept or not kept[-1].is_error_frame) and (one := sleeper.recv(10.0)) is not None:
        kept.append(one)
    assert dropped > 0
    assert len(kept) == 10_000 - dropped + 1
    assert kept[-1].is_error_frame
    assert kept[-1].data[1] == 0x01
    sender.send(message(0x101))
    after = sleeper.recv(60.0)
    assert after is not None
    assert after.arbitration_id == 0x101
    for bus in (sender, listener, sleeper):
        bus.shutdown()


def test_a_hub_that_ends_is_an_interface_that_is_down(path: Path) -> None:
    with Hub(path) as hub:
        (bus,) = joined(hub, path, 1)
    with pytest.raises(can.CanOperationError, match="interface is down"):
        bus.recv(1.0)
    with pytest.raises(can.CanOperationError, match="interface is down"):
        bus.send(message(1))
    bus.shutdown()
    with pytest.raises(LinkDown, match="no CAN hub"):
        open_bus("hub", str(path))


def test_a_path_left_behind_is_taken_over_and_a_living_hubs_is_not(path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-m", "drivers.can.bus.hub", str(path)], stdout=subprocess.PIPE)
    assert dead.stdout is not None
    dead.stdout.readline()
    dead.kill()
    dead.wait()
    dead.stdout.close()
    assert path.is_socket()
    with Hub(path) as hub:
        with pytest.raises(OSError, match="no CAN hub at"):
            Hub(path)
        (bus,) = joined(hub, path, 1)
        bus.shutdown()


def test_packets_that_are_no_frames_are_counted_and_forwarded_to_nobody(hub: Hub, path: Path) -> None:
    (bus,) = joined(hub, path, 1)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as strange:
        strange.connect(str(path))
        strange.send(b"no frame")
        strange.send(pack(message(0x42)))
        one = bus.recv(60.0)
    assert one is not None
    assert one.arbitration_id == 0x42
    assert hub.statistics()["malformed"] == 1
    bus.shutdown()


def test_bus_off_keeps_a_client_off_the_bus_until_the_restart(hub: Hub, path: Path) -> None:
    wire, node = joined(hub, path, 2)
    wire.send(can.Message(arbitration_id=0x40, is_error_frame=True, dlc=8, data=bytes(8)))
    wire.send(message(0x1))
    error = node.recv(60.0)
    assert error is not None
    assert error.is_error_frame
    assert node.state is can.BusState.ERROR
    assert node.recv(0.1) is None
    with pytest.raises(can.CanOperationError, match="bus-off"):
        node.send(message(0x2))
    wire.send(can.Message(arbitration_id=0x100, is_error_frame=True, dlc=8, data=bytes(8)))
    wire.send(message(0x3))
    assert [one.arbitration_id for one in (node.recv(60.0), node.recv(2.0)) if one] == [0x100, 0x3]
    node.send(message(0x4))
    for bus in (wire, node):
        bus.shutdown()


def test_filters_own_messages_and_a_file_descriptor_work_as_python_can_says(hub: Hub, path: Path) -> None:
    (other,) = joined(hub, path, 1)
    filters: list[can.typechecking.CanFilter] = [{"can_id": 0x10, "can_mask": 0x7F0, "extended": False}]
    bus = open_bus("hub", str(path), filters=filters, options={"receive_own_messages": True})
    settled(lambda: hub.statistics()["clients"] == 2)
    assert bus.fileno() > 0
    for number in (0x20, 0x15):
        other.send(message(number))
    one = bus.recv(60.0)
    assert one is not None
    assert one.arbitration_id == 0x15
    bus.send(message(0x11))
    own = bus.recv(60.0)
    assert own is not None
    assert own.arbitration_id == 0x11
    for open_one in (bus, other):
        open_one.shutdown()


def test_any_python_can_program_can_join(hub: Hub, path: Path) -> None:
    (bus,) = joined(hub, path, 1)
    with subprocess.Popen([sys.executable, "-c", FOREIGN, str(path)], cwd=path.parent) as program:
        heard = bus.recv(60.0)
        assert heard is not None
        assert (heard.arbitration_id, bytes(heard.data)) == (0x123, b"hello")
        bus.send(message(0x200, b"abc"))
        answer = bus.recv(60.0)
        assert answer is not None
        assert (answer.arbitration_id, answer.is_extended_id, bytes(answer.data)) == (0x201, True, b"cba")
        assert program.wait(60.0) == 0
    bus.shutdown()


def test_the_hub_as_a_process_says_when_it_is_ready_and_what_it_has_carried(path: Path) -> None:
    command = [sys.executable, "-m", "drivers.can.bus.hub", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline()) == {"event": "ready", "path": str(path)}
        with open_bus("hub", str(path)) as one, open_bus("hub", str(path)) as other:
            time.sleep(0.1)
            one.send(message(5))
            assert other.recv(60.0) is not None
        process.send_signal(signal.SIGTERM)
        last = json.loads(process.stdout.readline())
        assert (last["event"], last["frames"], last["delivered"]) == ("stopped", 1, 1)
        assert process.wait(60.0) == 0
    assert not path.exists()


def test_a_place_where_no_socket_can_be_is_one_sentence(tmp_path: Path) -> None:
    for place in (tmp_path / "nowhere" / "bus", tmp_path / ("x" * 120)):
        command = [sys.executable, "-m", "drivers.can.bus.hub", str(place)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 1
        assert done.stderr.startswith(f"no CAN hub at {place}")
        assert len(done.stderr.splitlines()) == 1


def test_an_interface_that_does_not_exist_here_is_a_drivererror() -> None:
    with pytest.raises(DriverError, match="'nonsense' cannot be used here"):
        open_bus("nonsense", "x")
