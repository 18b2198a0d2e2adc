"""How a Modbus device is reached: the wire that each transport makes."""

import datetime as dt
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from pymodbus.pdu import ModbusPDU

from drivers.driver import BeforeSending, Clock, anyhow
from drivers.errors import DeviceException, DriverError, LinkDown, LinkFault
from drivers.modbus.numbered import NumberedWire
from drivers.modbus.replies import TransactionIds
from drivers.modbus.serial_line import LineWire, Quiet
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.wire import Secured, Wire, WireReply

_ILLEGAL_FUNCTION = 1


class AnyWire(Protocol):
    """What every wire offers: see `Wire`."""

    foreign: int
    fault: LinkFault
    refusal_hint: str

    async def connect(self) -> None: ...

    def abandon(self) -> None: ...

    async def ask(
        self,
        request: ModbusPDU,
        deadline: float,
        before_sending: BeforeSending = anyhow,
        *,
        again: bool = False,
        most_open: int = 2,
    ) -> WireReply: ...


@dataclass(frozen=True, slots=True)
class ModbusTransport:
    """`wire` makes a wire, not yet connected; `cautions` says what should not stay as it is.

    To make a wire raises LinkDown where what it needs cannot be used now.
    """

    wire: Callable[[Callable[[str], None]], AnyWire]
    cautions: Callable[[], tuple[str, ...]]


def explain(error: DeviceException, wire: AnyWire) -> DeviceException:
    """The device's refusal with what it may mean on the wire over which it came."""
    if error.code != _ILLEGAL_FUNCTION or not wire.refusal_hint:
        return error
    return DeviceException(error.code, f"{error}; {wire.refusal_hint}")


def make_transport(
    settings: ModbusSettings, clock: Clock, ids: TransactionIds, on_late: Callable[[int, bool], None] | None = None
) -> ModbusTransport:
    """The transport of checked settings. Certificates are read for each connection: what is wrong with them costs this
    one, until they are whole, and new ones are used from the next one on.

    `ids` number the requests of all its wires.
    With `on_late` its wires carry the requests of several units; it hears of which unit a reply came too late,
    and whether the unit itself gave it.
    """
    place, answers_as = (settings.host, settings.port), settings.answers_as

    def make_wire(on_lost: Callable[[str], None], secured: Secured | None = None) -> AnyWire:
        if on_late is None:
            return Wire(*place, ids=ids, clock=clock, on_lost=on_lost, secured=secured, answers_as=answers_as)
        return NumberedWire(
            *place, ids=ids, clock=clock, on_lost=on_lost, on_late=on_late, secured=secured, answers_as=answers_as
        )

    if settings.transport == "tcp" and not settings.by_shape:
        return ModbusTransport(make_wire, tuple)
    if settings.transport != "tls":  # a line, or a connection that is treated as one
        # One for all wires to come: what is still under way on the line outlives a reconnection.
        quiet = Quiet()
        heard = on_late or (lambda _, __: None)
        return ModbusTransport(
            lambda on_lost: LineWire(settings, quiet, clock=clock, on_lost=on_lost, on_late=heard), tuple
        )
    # Certificates cost 11 MB of memory, which a gateway over plain TCP does without.
    from drivers.modbus import tls

    folder = Path(settings.certificates)

    def make_tls_wire(on_lost: Callable[[str], None]) -> AnyWire:
        try:
            identity = tls.load_identity(folder)
        except DriverError as error:
            raise LinkDown(str(error)) from None
        name, hint = settings.tls_name or settings.host, tls.refusal_hint(identity.role)
        return make_wire(on_lost, Secured(identity.context, name, tls.sentence, hint))

    return ModbusTransport(make_tls_wire, lambda: tls.cautions(folder, dt.datetime.now(dt.UTC)))
