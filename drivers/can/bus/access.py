"""One way to open a CAN bus: any python-can interface by its name, "hub" among them."""

from collections.abc import Mapping
from typing import Any

import can

from drivers.can.bus.hub_bus import HubBus
from drivers.can.bus.tapped import TappedBus
from drivers.errors import DriverError, LinkDown
from drivers.tap import current


def open_bus(
    interface: str,
    channel: str,
    bitrate: int | None = None,
    *,
    fd: bool = False,
    filters: can.typechecking.CanFilters | None = None,
    options: Mapping[str, Any] | None = None,
) -> can.BusABC:
    """Open a bus: `interface` a python-can name ("socketcan", "pcan", "slcan", "virtual", ...) or "hub".

    `channel` is the interface's own ("can0", "/dev/ttyACM0", a hub's path); `bitrate` in bit/s where the interface
    sets it; `options` are passed on to the interface. No configuration file of python-can is read. Raises DriverError
    for an interface that does not exist here, LinkDown where the bus cannot be opened now.
    """
    more: dict[str, Any] = dict(options or {})
    if bitrate is not None:
        more["bitrate"] = bitrate
    if fd:
        more["fd"] = True
    bus: can.BusABC
    try:
        if interface == "hub":
            bus = HubBus(channel, filters, **more)
        else:
            bus = can.Bus(channel, interface, ignore_config=True, can_filters=filters, **more)
    except NotImplementedError as error:
        raise DriverError(f"CAN interface {interface!r} cannot be used here: {error}") from None
    except (can.CanError, OSError, ValueError, TypeError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise LinkDown(f"CAN {interface} {channel}: {reason}") from None
    tap = current()
    return bus if tap is None else TappedBus(bus, tap, f"{interface} {channel}")
