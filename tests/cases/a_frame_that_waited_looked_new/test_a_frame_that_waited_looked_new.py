"""A frame that waited in a socket while the event loop was busy bore the time at which the loop came to it."""

import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import can
import pytest

from drivers.can.bus import arrival, open_bus
from drivers.can.bus.arrival import Arrivals, ClockBefore
from drivers.can.bus.hub import Hub
from drivers.can.driver import open_can
from drivers.canopen.port import Port, StampedFrame
from drivers.supervision import Supervisor
from drivers.tag import Quality, Tag
from tests.cases.a_backlog_was_read_as_now.buses import ThreadedBus

SPEED = Tag("speed", "0x181:0|16")
BUSY_S = 0.5
SAID = can.Message(arbitration_id=0x181, data=bytes((7, 0)), is_extended_id=False)
EPOCH, TIMES = 1000.0, 60.0


def clock() -> float:
    """A plant's clock: sixty seconds a second."""
    return EPOCH + TIMES * time.monotonic()


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[Hub]:
    with Hub(tmp_path / "bus") as made:
        yield made


@pytest.fixture
async def speaker(hub: Hub, tmp_path: Path) -> AsyncIterator[can.BusABC]:
    bus = open_bus("hub", str(tmp_path / "bus"))
    yield bus
    bus.shutdown()


def busy(hub: Hub, speaker: can.BusABC, said: int = 1) -> float:
    """Have frames come while the loop does something else; the latest moment at which they had come."""
    before = hub.statistics()["delivered"]
    for _ in range(said):
        speaker.send(SAID)
    deadline = time.monotonic() + 60.0
    while hub.statistics()["delivered"] < before + said:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    came = time.monotonic()
    time.sleep(BUSY_S)
    return came


async def test_over_raw_can_a_frame_is_as_old_as_it_is(hub: Hub, speaker: can.BusABC, tmp_path: Path) -> None:
    place = {"interface": "hub", "channel": str(tmp_path / "bus"), "connect_timeout": 20.0}
    driver = open_can({**place, "message_timeout": 60.0, "max_silence": 60.0}, clock=clock)
    await driver.open()
    await driver.read([SPEED])
    came = busy(hub, speaker)
    (sample,) = await driver.read([SPEED])
    assert sample.value == 7
    assert sample.time <= EPOCH + TIMES * came + 0.01
    await driver.close()


async def test_over_raw_can_it_counts_for_its_timeout_and_no_longer(
    hub: Hub, speaker: can.BusABC, tmp_path: Path
) -> None:
    settings = {
        "interface": "hub",
        "channel": str(tmp_path / "bus"),
        "message_timeout": BUSY_S / 2,
        "max_silence": 60.0,
        "connect_timeout": 20.0,
    }
    driver = open_can(settings, clock=clock)
    await driver.open()
    await driver.read([SPEED])
    busy(hub, speaker)
    (sample,) = await driver.read([SPEED])
    assert sample.quality is Quality.TIMEOUT
    await driver.close()


async def test_over_canopen_a_frame_is_as_old_as_it_is(hub: Hub, speaker: can.BusABC, tmp_path: Path) -> None:
    frames: list[StampedFrame] = []
    bus = open_bus("hub", str(tmp_path / "bus"))
    port = Port(bus, clock, frames.append, lambda reason: None, supervisor=Supervisor())
    came = busy(hub, speaker, said=3)
    port.drain()
    assert len(frames) == 3
    assert all(frame.moment <= came and frame.time <= EPOCH + TIMES * came + 0.01 for frame in frames)
    assert frames == sorted(frames, key=lambda frame: frame.moment)
    port.close()


class Threaded(ThreadedBus):
    """It counts how often the thread has come for a frame."""

    asked = 0

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self.asked += 1
        return super()._recv_internal(timeout)


async def test_a_thread_stamps_what_it_takes_for_the_loop() -> None:
    frames: list[StampedFrame] = []
    bus = Threaded()
    port = Port(bus, clock, frames.append, lambda reason: None, supervisor=Supervisor())
    bus.say(SAID)
    deadline = time.monotonic() + 60.0
    while bus.waiting:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    asked = bus.asked
    while bus.asked == asked:  # it has come for the next one, and so is done with the first
        assert time.monotonic() < deadline
        time.sleep(0.001)
    came = time.monotonic()
    time.sleep(BUSY_S)
    port.drain()
    assert [frame.moment <= came for frame in frames] == [True]
    port.close()
    await port.join()


def test_what_waits_in_a_hub_that_stands_still_becomes_no_younger(tmp_path: Path) -> None:
    """Also the hub is a process that may be late: what counts is when the sender gave the frame away."""
    with Hub(tmp_path / "bus") as hub:
        speaker, listener = (open_bus("hub", str(tmp_path / "bus")) for _ in range(2))
        deadline = time.monotonic() + 60.0
        while hub.statistics()["clients"] < 2:
            assert time.monotonic() < deadline
            time.sleep(0.001)
        frames = 3000
        for _ in range(frames):
            speaker.send(SAID)
        said = time.time()
        time.sleep(BUSY_S)
        stamps = [one.timestamp for _ in range(frames) if (one := listener.recv(60.0)) is not None]
        assert len(stamps) == frames
        assert stamps == sorted(stamps)
        assert stamps[-1] <= said + 0.001
        for bus in (speaker, listener):
            bus.shutdown()


class Clocks:
    """The wall clock and the monotonic one as the test sets them."""

    def __init__(self) -> None:
        self.wall, self.now = 1e9, 500.0

    def time(self) -> float:
        return self.wall

    def monotonic(self) -> float:
        return self.now

    def go_on(self, seconds: float) -> None:
        self.wall += seconds
        self.now += seconds


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Clocks:
    made = Clocks()
    monkeypatch.setattr(arrival, "time", made)
    return made


def stamped(timestamp: float) -> can.Message:
    return can.Message(arbitration_id=1, timestamp=timestamp)


@pytest.mark.parametrize("step", [-3600.0, -0.3, 0.0, 0.3, 3600.0])
def test_a_clock_that_is_set_while_a_frame_waits_makes_it_no_younger(
    clocks: Clocks, speaker: can.BusABC, step: float
) -> None:
    arrivals = Arrivals(speaker)
    assert arrivals.moment(stamped(clocks.wall)) == clocks.now
    clocks.go_on(1.0)
    arrivals.found_empty(clocks.now)
    empty = clocks.now
    clocks.go_on(0.5)
    came, stamp = clocks.now, clocks.wall
    clocks.wall += step
    clocks.go_on(0.8)
    assert empty - 1e-6 <= arrivals.moment(stamped(stamp)) <= came + 1e-6


@pytest.mark.parametrize("own", [0.0, 17.5, 1e9 - 0.5])
def test_a_clock_of_an_interface_is_not_believed(clocks: Clocks, own: float) -> None:
    arrivals = Arrivals(ThreadedBus())
    for _ in range(3):
        clocks.go_on(1.0)
        assert arrivals.moment(stamped(own)) == clocks.now
        arrivals.found_empty(clocks.now)


def test_what_a_clock_showed_before_is_by_its_own_speed_and_never_later_than_now(clocks: Clocks) -> None:
    shows: Callable[[], float] = lambda: 100.0 * clocks.now  # noqa: E731
    before = ClockBefore(shows)
    for _ in range(5):
        clocks.go_on(0.7)
        assert before.clock_time(clocks.now - 0.5) == pytest.approx(100.0 * (clocks.now - 0.5))
        assert before.clock_time(clocks.now + 0.1) == pytest.approx(100.0 * clocks.now)
