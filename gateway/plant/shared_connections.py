"""Which of a plant's machines share a process: those on one connection do, the rest is spread evenly."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import suppress

from drivers.driver import capabilities, load_function
from drivers.errors import DriverError
from drivers.settings import ConfigError
from gateway.settings import Config, DeviceLink


def split_over(configs: Sequence[Config], workers: int, before: Mapping[str, int]) -> dict[str, int]:
    """The number of each machine's worker process, from 0, fewer than `workers` of them.

    `before` are the places of machines that stay where they are. Raises ConfigError for machines that have come to
    share a connection and would have to leave their places.
    """
    places = dict(before)
    groups = on_one_connection(configs)
    # The largest first: what is spread last is what can be spread most evenly.
    for group in sorted(groups, key=len, reverse=True):
        names = [config.machine for config in group]
        homes = {before[name]: name for name in names if name in before}
        if len(homes) > 1:
            raise ConfigError(
                [
                    f"{group[0].path}: machines {', '.join(homes.values())} have come to share a connection and run in "
                    "different processes; stop the gateway and start it anew"
                ]
            )
        loads = [sum(place == number for place in places.values()) for number in range(workers)]
        home = next(iter(homes), loads.index(min(loads)))
        places |= dict.fromkeys(names, home)
    return places


def on_one_connection(configs: Sequence[Config]) -> list[list[Config]]:
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
