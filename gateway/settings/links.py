"""The ways to one device: what the plant file says of each, and whether they can stand in for one another."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from drivers.driver import capabilities
from drivers.settings import Section, split_place
from gateway.settings.devices import DeviceMap, complete_paths, load_device

_NamedFile = Annotated[Path, Field(strict=False)]
"""A device file as the plant file names it: what an arming is for has it so. `make_links` makes it complete."""
_OF_ONE_LINK = ("file", "host", "port", "unit", "node", "timeout", "attempts")


class LinkSection(BaseModel):
    """`[[device.links]]`: what is not listed here is a setting of the link's driver, which checks it."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)

    name: str = Field(min_length=1, description="a short name for this way to the device")
    file: _NamedFile = Field(description="the path of the device file with this link's addresses")


class DeviceSection(Section):
    """Where the device is, and the file of its addresses: one link by `file`, `host`, `port`, or several by `links`.

    The first link is the primary one. Times of switching are real seconds.
    """

    file: _NamedFile | None = Field(None, description="the path of the register map, relative to this file")
    host: str = Field("127.0.0.1", min_length=1, description="the PLC's address or name")
    port: int = Field(502, ge=1, le=65535, description="a TCP port from 1 to 65535")
    unit: int | None = Field(None, ge=0, le=255, description="the Modbus unit, 0 to 255, the device file's without it")
    node: int | None = Field(None, ge=1, le=127, description="the CANopen node, 1 to 127, the device file's without it")
    timeout: float = Field(0.5, gt=0, le=60, description="the deadline of one request in seconds, at most 60")
    attempts: int | None = Field(None, ge=1, le=5, description="how often a read is sent, 1 to 5")
    heartbeat_period: float = Field(0.0, ge=0, description="the longest time in real seconds between two heartbeats")
    links: Annotated[tuple[LinkSection, ...], Field(strict=False)] = Field((), description="[[device.links]] tables")
    switch_after: float = Field(0.3, gt=0, le=60, description="seconds after which a scan no longer waits for a link")
    return_after: float = Field(10.0, ge=0, description="seconds for which the primary must be well to be used again")

    @field_validator("host")
    @classmethod
    def _is_one_word(cls, host: str) -> str:
        if host.split() != [host]:
            raise ValueError(f"{host!r} has a space in it; give the PLC's address or name")
        split_place(host)
        return host

    @model_validator(mode="after")
    def _one_form(self) -> "DeviceSection":
        present = [key for key in _OF_ONE_LINK if key in self.model_fields_set]
        if self.links and present:
            raise ValueError(f"{present[0]!r} stands beside [[device.links]]; put it into each of them")
        if not self.links and self.file is None:
            raise ValueError("'file' is missing; give the path of the register map, or [[device.links]] tables")
        return self


@dataclass(frozen=True, slots=True)
class DeviceLink:
    """One way to the device: its name, its own addresses, and all settings of its driver."""

    name: str
    map: DeviceMap
    settings: Mapping[str, Any]

    @property
    def place(self) -> str:
        """Where it leads, for a person."""
        keys = ("host", "port", "serial", "interface", "channel", "node", "unit")
        return " ".join(f"{key} {self.settings[key]}" for key in keys if key in self.settings) or "in this process"


def make_links(section: DeviceSection, home: Path) -> tuple[DeviceLink, ...]:
    """The links in their order, with their device files. Raises ConfigError for a file that cannot be used."""
    if section.file is not None:
        device = load_device(home / section.file)
        # The keys of [device] as settings: what is written there, and for a device on a network their defaults too.
        networked = capabilities(device.driver).networked and "serial" not in device.settings
        wanted = {"host", "timeout"} if networked else set()
        overrides = section.model_dump(include=set(_OF_ONE_LINK[1:]) & (section.model_fields_set | wanted))
        return (DeviceLink(device.driver, device, dict(device.settings) | overrides),)
    links = []
    for row in section.links:
        device = load_device(home / row.file)
        own = complete_paths(device.driver, row.model_extra or {}, home)
        links.append(DeviceLink(row.name, device, dict(device.settings) | own))
    return tuple(links)


def link_problems(links: Sequence[DeviceLink], speed: float) -> list[str]:
    """What keeps links from standing in for one another, and a replay's speed at what may be a real plant."""
    names = [link.name for link in links]
    problems = [
        f"device.links[{index}].name: {name!r} is already used; give each link a name of its own"
        for index, name in enumerate(names)
        if name in names[:index]
    ]
    for index, link in enumerate(links[1:], start=1):
        problems += [f"device.links[{index}].file: {reason}" for reason in _differences(links[0].map, link.map)]
    hosts = [str(link.settings["host"]) for link in links if "host" in link.settings]
    if speed != 1.0 and (far := [host for host in hosts if not _loopback(host)]):
        problems.append(
            f"clock.speed: {speed:g} is only for a software PLC on this machine, and device.host is {far[0]!r}; set "
            "speed to 1"
        )
    return problems


def _differences(first: DeviceMap, other: DeviceMap) -> list[str]:
    """Why the second device file cannot stand in for the first, in sentences."""
    ours, theirs = first.by_name, other.by_name
    missing = [name for name in ours if name not in theirs]
    reasons = []
    if missing:
        reasons.append(f"{other.path} has no tag {missing[0]!r}, which {first.path} has; the links must share all tags")
    reasons += [
        f"{name!r} is in {theirs[name].unit!r} in {other.path} and in {tag.unit!r} in {first.path}; make them the same"
        for name, tag in ours.items()
        if name in theirs and theirs[name].unit != tag.unit
    ]
    if first.heartbeat != other.heartbeat or first.heartbeat is None:
        reasons.append(
            f"{other.path} has the heartbeat {other.heartbeat!r} and {first.path} {first.heartbeat!r}; give both the "
            "tag of the same heartbeat: it tells that both links lead to the same PLC"
        )
    ours_blocks, their_blocks = (
        [(block.version, block.fields, block.temperature, block.suffix) for block in device.writebacks]
        for device in (first, other)
    )
    if ours_blocks and ours_blocks != their_blocks:
        reasons.append(f"{other.path} has another [writeback] block than {first.path}; the links must share its fields")
    return reasons


def _loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
