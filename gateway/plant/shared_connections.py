"""Which of a plant's machines share a connection, a line or a bus."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from contextlib import suppress

from drivers.driver import capabilities, load_function
from drivers.errors import DriverError
from gateway.settings import Config, DeviceLink


def connection_groups(configs: Sequence[Config]) -> list[list[Config]]:
    """The machines in groups, in the order of the file: one that shares a connection with any of a group is of it."""
    groups: list[tuple[set[Hashable], list[Config]]] = []
    for config in configs:
        places, members = {place for link in config.links for place in _places(link)}, [config]
        apart = []
        for known, others in groups:
            if known & places:
                places, members = known | places, [*others, *members]
            else:
                apart.append((known, others))
        groups = [*apart, (places, members)]
    return [[config for config in configs if config in members] for _, members in groups]


def _places(link: DeviceLink) -> Iterator[Hashable]:
    """What a link's device may share with others: a connection with several units behind it, a bus."""
    device, settings = capabilities(link.map.driver), link.settings
    if device.shares:
        # Settings that are wrong share nothing: the driver says so when it is made.
        with suppress(DriverError):
            yield load_function(device.shares)(settings)
    if device.bus:
        yield "bus", settings.get("interface"), settings.get("channel")
