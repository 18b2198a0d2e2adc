"""`scan models`: the SunSpec models that a device has, one behind the other, and where each begins."""

from typing import Any

from drivers.errors import DeviceException, ReplyMismatch, ReplyTimeout
from drivers.survey import AsksRegisters
from gateway.commission.session import Site, mention_gateway
from gateway.commission.survey.addresses import LAST_ADDRESS, Register
from gateway.console import CommandResult

BASES = (40000, 0, 50000)
_MARK = (0x5375, 0x6E53)
"""SunSpec Information Model Specification, 6.1: `SunS` in two holding registers, at one of these addresses."""
_END = 0xFFFF
MOST_MODELS = 200


async def scan_models(site: Site, bases: tuple[int, ...] = BASES) -> CommandResult:
    """Each model's number, address and length, and how its points are imported."""
    mention_gateway(site)
    models: list[dict[str, Any]] = []
    async with site.registers() as survey:
        base = await _base(survey, bases)
        if base is not None:
            await _walk(site, survey, base + len(_MARK), models)
    places = ", ".join(f"holding:{each}" for each in bases)
    complaint = "" if base is not None else f"no SunSpec device: its mark 'SunS' is not at {places}"
    return CommandResult({"base": None if base is None else f"holding:{base}", "models": models}, complaint)


async def _base(survey: AsksRegisters, bases: tuple[int, ...]) -> int | None:
    """Where the mark stands; a device refuses or is silent to an address that it does not have. Raises DriverError."""
    silence: ReplyTimeout | ReplyMismatch | None = None
    answered = False
    for base in bases:
        try:
            words = await survey.read("holding", base, len(_MARK))
        except DeviceException:
            answered = True
        except (ReplyTimeout, ReplyMismatch) as error:
            silence = error
        else:
            answered = True
            if words.words == _MARK:
                return base
    if silence is not None and not answered:
        raise silence
    return None


async def _walk(site: Site, survey: AsksRegisters, at: int, models: list[dict[str, Any]]) -> None:
    for _ in range(MOST_MODELS):
        if at >= LAST_ADDRESS:
            break
        try:
            words = await survey.read("holding", at, 2)
        except (DeviceException, ReplyTimeout, ReplyMismatch) as error:
            site.notes.append(f"behind the last model holding:{at} is not read: {error}")
            return
        number, length = words.words
        if number == _END:
            return
        place = Register("holding", at)
        models.append(
            {
                "model": number,
                "first": str(place),
                "reference": place.reference,
                "registers": length + 2,
                "import": f"decanter plc import model_{number}.json --shift {at}",
            }
        )
        at += length + 2
    site.notes.append(f"the chain of models has no end within {MOST_MODELS} models and {LAST_ADDRESS} registers")
