"""Opening the device: one driver, or one for all links together; fails loudly and precisely."""

from functools import partial

from drivers.connections import Connections
from drivers.driver import Driver, capabilities, open_driver
from drivers.errors import AddressError, DriverError
from drivers.settings import ConfigError
from gateway.machine.reading import Clock, RedundancyRules, Redundant, RedundantPath
from gateway.settings import Config, DeviceLink


def make_driver(config: Config, clock: Clock, connections: Connections | None = None) -> Driver:
    """The device's driver, not yet opened, able to write the blocks and nothing else; one for all links together.

    With `connections` it shares those of other machines that are at the same place. Raises ConfigError.
    """
    if len(config.links) == 1:
        return link_driver(config, config.links[0], clock, connections)
    paths = []
    for link in config.links:
        # The words of the blocks too: each link has its own addresses for them.
        addressed = {tag.name: tag for tag in (*link.map.tags, *link.map.block_words)}
        paths.append(RedundantPath(link.name, link_driver(config, link, clock, connections), addressed))
    beat = max(config.scan.period, config.device.heartbeat_period * clock.speed)
    rules = RedundancyRules(config.device.switch_after, config.device.return_after, config.map.heartbeat, beat)
    return Redundant(paths, rules, clock.now)


def link_driver(config: Config, link: DeviceLink, clock: Clock, connections: Connections | None = None) -> Driver:
    """The driver of one link, with the closed write map unless the mode is off. Raises ConfigError.

    In shadow it may be armed later; a link that cannot write is one that reads then.
    """
    mode = config.writeback.mode
    write_map = link.map.block_words if mode != "off" else ()
    opened = partial(open_driver, link.map.driver, link.settings, clock=clock.now, connections=connections)
    try:
        try:
            return opened(write_map=write_map)
        except AddressError:
            if mode == "armed":
                raise
            return opened()
    except DriverError as error:
        raise ConfigError([f"{link.map.path}: device: {error}"]) from None


def scans_on_change(config: Config) -> bool:
    """Whether a change that a device tells by itself brings a scan of its own."""
    configured = config.scan.on_change
    return any(capabilities(link.map.driver).speaks for link in config.links) if configured is None else configured
