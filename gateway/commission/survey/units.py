"""`scan units`: who answers behind one connection."""

import time
from collections.abc import Sequence
from typing import Any

from drivers.driver import LINKS
from drivers.errors import NO_WAY_TO_UNIT, DeviceException, LinkDown, LinkFault, ReplyMismatch, ReplyTimeout
from drivers.survey import AsksRegisters
from gateway.commission.session import Site, mention_gateway
from gateway.commission.survey.addresses import Register
from gateway.commission.survey.registers import first_register
from gateway.console import CommandResult, Progress
from gateway.entry import Exit

UNIT_S = 0.25
MOST_SILENT = 20
"""Silent units in a row after which the scan ends, unless the units were named."""
RESERVED = 251
"""248 to 255 are no device's (Modbus over serial line V1.02, 2.2); 255 and 0 are what TCP devices without one take."""


async def scan_units(site: Site, units: Sequence[int] | None, progress: Progress) -> CommandResult:
    """Every unit asked once, and once more if silent; a refusal is an answer too, except a gateway's own.

    None: 1 to 247, until MOST_SILENT in a row are silent. When one answers, a number is asked that no device may have.
    """
    mention_gateway(site)
    configured = site.target.settings
    # Silence is the usual answer here, and 247 usual timeouts would take minutes.
    hurried = {"timeout": configured.get("timeout", UNIT_S)}
    if site.target.kind in LINKS and LINKS[site.target.kind].line:
        hurried["longest_reply"] = configured.get("longest_reply", hurried["timeout"])
    register = first_register(site.target)
    wanted = range(1, 248) if units is None else units
    rows: list[dict[str, Any]] = []
    asked = silent = 0
    answered = ignored = False
    nobody: dict[str, Any] | None = None
    async with site.registers(**hurried) as survey:
        scan = _UnitScan(survey, register)
        for place, unit in enumerate(wanted):
            progress(f"unit {unit}", place / len(wanted))
            row = await scan.ask_unit(unit)
            asked += 1
            silent = 0 if row else silent + 1
            if row is not None:
                if not answered:
                    # Not before something answers: it may hang up on a number that is not its own.
                    nobody = await scan.ask_unit(RESERVED) if RESERVED not in wanted else None
                    ignored = nobody is not None and not nobody["refused"]
                answered = True
                # What refuses the number that nobody has in the same words is the one that passes requests on.
                if not (row["refused"] and nobody and nobody["answer"] == row["answer"]):
                    # A device that answers to any number need not say again who it is.
                    row["identity"] = "" if ignored and rows else await scan.ask_identity(unit)
                    rows.append(row)
            if units is None and silent == MOST_SILENT:
                break
    if ignored:
        site.notes.append(
            f"unit {RESERVED} answers too, a number that no device may have: the device ignores the unit number, and "
            "what answers is one device, unless a gateway answers for itself"
        )
    if scan.disliked:
        site.notes.append(f"unit {scan.disliked} took function 43 (who are you?) badly: no other unit was asked it")
    if asked < len(wanted):
        site.notes.append(
            f"stopped after {MOST_SILENT} silent units in a row: {wanted[asked]} to {wanted[-1]} were not asked "
            f"(`decanter plc scan units {wanted[asked]}-{wanted[-1]}` asks them)"
        )
    data = {"units": rows, "asked": asked, "ignores_unit": ignored}
    sentence = f"none of {asked} units answers: wrong port, or frames of another kind (see `decanter plc probe`)"
    return CommandResult(data, "" if rows else sentence, Exit.TIMEOUT)


class _UnitScan:
    """One connection on which unit after unit is asked for the same register.

    `disliked` is the unit that function 43 was too much for, 0 for none: it is not asked of any other then.
    """

    def __init__(self, survey: AsksRegisters, register: Register) -> None:
        self._survey, self._register = survey, register
        self.disliked = 0

    async def ask_unit(self, unit: int) -> dict[str, Any] | None:
        """What one unit answers; None if nothing. Raises LinkDown when the connection does not come back."""
        begun = time.monotonic()
        for last in (False, True):
            try:
                words = await self._survey.read(self._register.table, self._register.number, 1, unit)
            except DeviceException as error:
                if error.code in NO_WAY_TO_UNIT:
                    return None
                answer, refused = str(error), True
            except (ReplyTimeout, ReplyMismatch, LinkDown) as error:
                # Some devices hang up on a number that is not theirs; one that is gone for good does not take the call.
                if isinstance(error, LinkDown) and error.fault is not LinkFault.CLOSED:
                    raise
                if last:
                    return None
                begun = time.monotonic()
                continue
            else:
                answer, refused = f"{self._register} is {words.words[0]}", False
            ms = 1e3 * (time.monotonic() - begun)
            return {"unit": unit, "answer": answer, "ms": ms, "identity": "", "refused": refused}
        return None

    async def ask_identity(self, unit: int) -> str:
        """What the unit says of itself; "" if nothing. Most devices refuse function 43; some fall silent or hang up."""
        if self.disliked:
            return ""
        try:
            return " ".join((await self._survey.identity(unit)).values())
        except DeviceException:
            return ""
        except (ReplyTimeout, ReplyMismatch, LinkDown):
            self.disliked = unit
            return ""
