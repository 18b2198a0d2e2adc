"""What the contract suite runs on: a driver, a device with known values, and what a test can do to that device."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from drivers.driver import Driver
from drivers.tag import DType, Tag
from tests.drivers.conftest import open_anyway, read_until_good

LEVEL = Tag("level", "holding:10", scale=0.1, low=0, high=100)
STATE = Tag("state", "holding:11")
FLAG = Tag("flag", "holding:12", DType.BOOL, bit=1)
SETPOINT = Tag("setpoint", "holding:20", scale=0.01, low=-50, high=50, dtype=DType.INT16)
MODE = Tag("mode", "holding:21")


@dataclass(frozen=True)
class Tags:
    """The five tags of the suite. A bench on another fieldbus gives them other addresses and keeps all the rest."""

    level: Tag = LEVEL
    state: Tag = STATE
    flag: Tag = FLAG
    setpoint: Tag = SETPOINT
    mode: Tag = MODE

    @property
    def read(self) -> tuple[Tag, Tag, Tag]:
        """The tags that the device measures."""
        return self.level, self.state, self.flag

    @property
    def write_map(self) -> tuple[Tag, Tag]:
        """The tags that the driver may write."""
        return self.setpoint, self.mode


@dataclass
class Bench:
    """A driver on a device that holds 12.5, 7 and True, setpoint 0 and mode 0.

    `lose` takes the device away and `restore` brings it back, `forget_writes` makes it confirm writes and not keep
    them. `period` (s): the device speaks by itself this often, so that a sample has no moment of sending and is as old
    as the last message. `counter` is the statistic that grows with every use.
    """

    driver: Driver
    lose: Callable[[], Awaitable[None]]
    restore: Callable[[], Awaitable[None]]
    forget_writes: Callable[[], None]
    tags: Tags = field(default_factory=Tags)
    period: float | None = None
    counter: str = "requests"

    async def open(self) -> None:
        """Open the driver; where the device speaks by itself, wait until it has."""
        await self.driver.open()
        if self.period is not None:
            for tag in (*self.tags.read, *self.tags.write_map):
                await read_until_good(self.driver, tag)

    async def open_anyway(self) -> None:
        """Open the driver whose device may be away."""
        await open_anyway(self.driver)
