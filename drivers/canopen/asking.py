"""Asking the node for one object: its bytes with the moments of request and answer, or what stood in the way."""

from dataclasses import dataclass

from drivers.canopen.channel import SdoChannel
from drivers.canopen.place import ObjectPlace
from drivers.driver import Clock
from drivers.errors import AddressError, DeviceException, DriverError, LinkDown, ReplyTimeout
from drivers.tag import Quality

_QUALITY: dict[int, Quality] = {
    0x06010000: Quality.CONFIGURATION_ERROR,
    0x06010001: Quality.CONFIGURATION_ERROR,
    0x06020000: Quality.CONFIGURATION_ERROR,
    0x06060000: Quality.DEVICE_FAILURE,
    0x06090011: Quality.CONFIGURATION_ERROR,
    0x060A0023: Quality.NO_DATA,
    0x08000022: Quality.OUT_OF_SERVICE,
    0x08000024: Quality.NO_DATA,
}
"""What an abort code says of a reading; any other one is DEVICE_FAILURE."""


@dataclass(frozen=True, slots=True)
class SdoAnswer:
    """An object's bytes, or None with quality and reason. Times by the driver's clock."""

    payload: bytes | None
    time: float
    sent: float
    quality: Quality = Quality.GOOD
    reason: str = ""


async def ask(sdo: SdoChannel, place: ObjectPlace, size: int | None, clock: Clock, *, block: bool) -> SdoAnswer:
    """Read one object by SDO. Never raises for what bus or device do."""
    sent = clock()
    try:
        payload = await sdo.read(place, size, block=block)
    except DriverError as error:
        return SdoAnswer(None, clock(), sent, error_quality(error), str(error))
    return SdoAnswer(payload, clock(), sent)


def error_quality(error: DriverError) -> Quality:
    """What a request without a value makes of a reading."""
    if isinstance(error, AddressError):
        return Quality.CONFIGURATION_ERROR
    if isinstance(error, DeviceException):
        return _QUALITY.get(error.code, Quality.DEVICE_FAILURE)
    if isinstance(error, ReplyTimeout):
        return Quality.TIMEOUT
    return Quality.NOT_CONNECTED if isinstance(error, LinkDown) else Quality.COMMUNICATION_ERROR
