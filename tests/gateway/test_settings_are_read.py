"""A setting that is accepted and that nobody reads promises what it does not do: there is none."""

from dataclasses import fields
from pathlib import Path

import pytest
from pydantic import BaseModel, Field

import drivers
import gateway
from drivers.can.settings import CanSettings
from drivers.canopen.options import Options
from drivers.device_file import DeviceFile, TagTable
from drivers.modbus.settings import ModbusSettings
from drivers.settings import Section
from drivers.soft.driver import SoftSettings
from drivers.tag import Tag
from drivers.vehicle.replay import CanLogSettings
from gateway.machine.alarms import AlarmCondition
from gateway.settings import NorthboundSecrets, NotifySecrets, PageSection
from gateway.settings.alarm_kinds import AlarmRow
from gateway.settings.config import _PlantFile
from gateway.settings.links import DeviceSection
from tests.rig.readers import sections_in, unread

DRIVERS = (ModbusSettings, SoftSettings, CanSettings, Options, CanLogSettings)
FILES = (_PlantFile, DeviceFile, NotifySecrets, NorthboundSecrets)
ROOMS = ("settings", "store", "machine", "outside", "plant", "network", "cli", "commission")


def product() -> list[str]:
    """The text of drivers and gateway, without the laboratory: what it reads alone no running gateway does."""
    own, homes = Path(gateway.__file__).parent, [Path(drivers.__file__).parent]
    return [
        file.read_text(encoding="utf-8")
        for home in [*homes, *(own / room for room in ROOMS)]
        for file in home.rglob("*.py")
    ]


def handed_on() -> set[str]:
    """What is read by others under the same name: of an alarm's row by its condition, of a device by its driver, of a
    row of tags by the tag."""
    conditions = {field.name for field in fields(AlarmCondition)} | {"name", "latch", "enabled", "tag"}
    settings = {name for driver in DRIVERS for name in driver.model_fields}
    links = {"host", "port", "unit", "node", "timeout", "attempts"} & settings
    owners = {AlarmRow: conditions, DeviceSection: links, TagTable: {field.name for field in fields(Tag)}}
    return {f"{owner.__name__}.{name}" for owner, names in owners.items() for name in names}


def test_every_setting_is_read() -> None:
    assert set(unread(sections_in(*FILES, *DRIVERS), product())) - handed_on() == set()


class _Page(PageSection):
    refresh_s: float = Field(1.0, description="the seconds between two looks")


class _File(Section):
    page: _Page = Field(default_factory=_Page)


WAYS = {
    "at its key": "wait(config.page.refresh_s)",
    "by a name": "page, other = config.page, 1\nwait(page.refresh_s)",
    "of a loop": "for each in config.page:\n    wait(each.refresh_s)",
    "by an annotation": "def look(one: _Page) -> None:\n    wait(one.refresh_s)",
    "by a base": "def look(one: PageSection) -> None:\n    wait(one.refresh_s)",
    "kept": "class Looking:\n    def __init__(self, one: _Page) -> None:\n        self._own = one\n"
    "    def look(self) -> None:\n        wait(self._own.refresh_s)",
}


@pytest.mark.parametrize("way", WAYS)
def test_a_read_is_found(way: str) -> None:
    assert "_Page.refresh_s" not in unread(sections_in(_File), [WAYS[way]])


@pytest.mark.parametrize(
    "text",
    ["", "wait(config.box.refresh_s)", "page.refresh_s = 1.0", "refresh_s = config.page.host", "wait('refresh_s')"],
)
def test_a_setting_that_nobody_reads_is_found(text: str) -> None:
    sections: dict[type[BaseModel], frozenset[str]] = dict(sections_in(_File))
    assert "_Page.refresh_s" in unread(sections, [text])
