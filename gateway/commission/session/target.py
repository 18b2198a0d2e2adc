"""Which device a command speaks to, over which link: from a plant file, a device file, or the options alone."""

import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers.capabilities import Capabilities
from drivers.driver import LINKS, Driver, capabilities, link_name, open_driver
from drivers.errors import OneLineError
from drivers.settings import split_place
from drivers.tag import Tag
from drivers.tap import Medium
from gateway.settings import Config, DeviceMap, GatewayPlaces, gateway_places, load_config, load_device

OPTION_OF: dict[str, str] = {"certificates": "--set certificates=DIR"}
"""Where a setting is given by an option of another name."""
DEFAULT_DRIVER = "modbus"
"""Meant where neither a file nor --link says which."""
CONNECT_S = 3.0
"""Seconds for a connection where no plant file says otherwise: a laptop may be far away, over a VPN for one."""


class TargetError(OneLineError, ValueError):
    """What was given names no device, or more than one; the message says what would be right."""


@dataclass(frozen=True, slots=True)
class Target:
    """One device over one link. `settings` are the driver's, `map` its tags and `config` the plant file, where given.

    `files` are those that it was made of. `places` stand in for a plant file that cannot be used, and `machine` is the
    one that was named with it: no device is known then.
    """

    kind: str
    driver: str
    settings: Mapping[str, Any]
    map: DeviceMap | None = None
    config: Config | None = None
    files: tuple[Path, ...] = ()
    places: GatewayPlaces | None = None
    machine: str = ""

    @property
    def place(self) -> str:
        """Where it is, for a person."""
        keys = ("host", "port", "serial", "interface", "channel", "node", "unit")
        sentence = " ".join(f"{key} {self.settings[key]}" for key in keys if key in self.settings)
        return f"{self.kind}, {sentence}" if sentence else self.kind

    @property
    def subject(self) -> str:
        """Whose armings in the audit log are its own: its machine's, where the plant file has several."""
        return self.config.subject if self.config is not None else ""

    @property
    def capabilities(self) -> Capabilities:
        """What its device is like. Raises DriverError for a driver that is not known."""
        return capabilities(self.driver)

    @property
    def medium(self) -> Medium:
        """What its frames are, for the evidence."""
        return LINKS[self.kind].medium if self.kind in LINKS else "tcp"

    @property
    def audit(self) -> Path | None:
        """The audit log that its plant file names; None without one."""
        named = self.config if self.config is not None else self.places
        return named.audit if named is not None else None

    @property
    def tags(self) -> tuple[Tag, ...]:
        """The tags of its device file; none without one."""
        return self.map.tags if self.map is not None else ()

    def with_settings(self, **settings: Any) -> "Target":
        """The same with some settings others."""
        return replace(self, settings={**self.settings, **settings})

    def make_driver(self, write_map: Sequence[Tag] = ()) -> Driver:
        """The driver, not yet opened. Raises DriverError."""
        return open_driver(self.driver, self.settings, clock=time.time, write_map=write_map)

    @asynccontextmanager
    async def open_driver(self, write_map: Sequence[Tag] = ()) -> AsyncIterator[Driver]:
        """The driver with a connection, closed at the end. Raises DriverError where there is none."""
        driver = self.make_driver(write_map)
        try:
            await driver.open()
            yield driver
        finally:
            await driver.close()


def make_target(
    plant: Path | None = None,
    device: Path | None = None,
    link: str | None = None,
    given: Mapping[str, Any] | None = None,
    machine: str | None = None,
) -> Target:
    """The device by a plant file, a device file, or settings alone.

    Of a plant file `machine` names one of several machines, and `link` one of its links.

    `given` are settings that win over those of the files. Raises TargetError or ConfigError.
    """
    settings = dict(given or {})
    if "certificates" in settings and link is None:
        # Said by what no other link has: it wins over the transport of a file.
        settings = {**LINKS["modbus-tls"].settings, **settings}
    if plant is not None and device is not None:
        raise TargetError("--config and --device exclude each other: a plant file names its device files itself")
    if machine is not None and plant is None:
        raise TargetError("--machine names one of a plant file: give that with --config")
    if plant is not None:
        config = load_config(plant, machine=machine)
        row = config.links[0]
        if link is not None:
            # By its own name, else by its kind; of several of a kind the first one is meant (hence the reversal).
            known = {each.name: each for each in reversed(config.links)}
            kinds = {link_name(each.map.driver, each.settings): each for each in reversed(config.links)}
            chosen = known.get(link) or kinds.get(link)
            if chosen is None:
                names = ", ".join(dict.fromkeys(known))
                raise TargetError(f"--link: the plant file has no link {link!r}; it has {names}")
            row = chosen
        target = Target(
            kind=link_name(row.map.driver, row.settings),
            driver=row.map.driver,
            settings={**row.settings, **settings},
            map=row.map,
            config=config,
            files=(plant, *(each.map.path for each in config.links)),
        )
        return _complete(target)
    if device is not None:
        table = load_device(device)
        merged = {**table.settings, **settings}
        kind = link or link_name(table.driver, merged)
        if kind in LINKS and LINKS[kind].driver != table.driver:
            raise TargetError(f"--link: {kind!r} is of driver {LINKS[kind].driver!r}, and {device} of {table.driver!r}")
        return _complete(Target(kind=kind, driver=table.driver, settings=merged, map=table, files=(device,)))
    if link is None and not {"host", "port", "serial", "channel"} & set(settings):
        raise TargetError(
            "which device? Give --host HOST, or --serial PATH, or --link can|canopen --channel CHANNEL, or the plant "
            "file (--config FILE)"
        )
    if link is None and "channel" in settings:
        raise TargetError("--channel is a CAN bus: say --link canopen or --link can")
    return _complete(Target(link or link_name(DEFAULT_DRIVER, settings), "", settings))


def gateway_target(plant: Path, machine: str | None = None, socket: Path | None = None) -> Target | None:
    """The gateway of a plant file that cannot be used any more, or at a `socket`; None where neither is so.

    For what must not depend on the file: no device is known.
    """
    places = gateway_places(plant)
    if socket is not None:
        places = replace(places, socket=socket)
    elif places.problem is None:
        return None
    return Target(kind="", driver="", settings={}, files=(plant,), places=places, machine=machine or "")


def _complete(target: Target) -> Target:
    """With what the link's kind says, and everything that it needs. Raises TargetError."""
    kind = LINKS.get(target.kind)
    if kind is None:
        if target.map is not None:
            return target
        raise TargetError(f"--link: {target.kind!r} is no link; give one of {', '.join(LINKS)}")
    settings = {**kind.settings, **target.settings}
    if isinstance(settings.get("host"), str):
        try:
            host, port = split_place(settings["host"])
        except ValueError as error:
            raise TargetError(f"--host: {error}") from None
        settings |= {"host": host} | ({} if port is None or "port" in settings else {"port": port})
    if target.config is None and settings.get("host"):
        settings.setdefault("connect_timeout", CONNECT_S)
    missing = [OPTION_OF.get(key, f"--{key}") for key in kind.needs if settings.get(key) in (None, "")]
    if missing:
        raise TargetError(f"link {target.kind!r} needs {' and '.join(missing)}")
    if target.map is None:
        settings = {**kind.defaults, **settings}
    return replace(target, driver=kind.driver, settings=settings)
