"""Arming and disarming from the command line: in the gateway that runs, or in the audit log where none does."""

import time
from pathlib import Path
from typing import Any

from drivers.errors import DriverError
from gateway.commission.outcome import Outcome, Site
from gateway.commission.plc_side.by_hand import gateway_runs, hand, layout_of
from gateway.commission.through import running_gateway
from gateway.machine.writing.arming import ArmingError, arm_in_log, disarm_in_log, signed
from gateway.store.audit import head


async def arm(site: Site, audit_path: Path, by: str, reason: str, minutes: float) -> Outcome:
    """Arm for some minutes. Raises ArmingError, AuditError, ValueError or OSError."""
    layout_of(site)
    now = time.time()
    arming = signed(by, reason, minutes, now)
    if (config := site.target.config) is not None and config.writeback.mode == "off":
        site.notes.append("writeback.mode is 'off': a gateway with this plant file computes and writes nothing")
    reply = _told(site, "arm", by=arming.by, reason=arming.reason, minutes=minutes)
    if reply is None:
        arm_in_log(audit_path, arming, now)
    told = "the audit log" if reply is None else f"the running gateway (pid {reply['pid']})"
    until = arming.until if reply is None else float(reply["until"])
    data = {"by": arming.by, "reason": arming.reason, "minutes": minutes, "until": until, "told": told}
    return Outcome({**data, "audit": str(audit_path), "head": head(audit_path)})


async def disarm(site: Site, audit_path: Path, by: str, reason: str) -> Outcome:
    """Take the arming back; what can be written of validity 0 is written first.

    Raises ArmingError, AuditError, ValueError or OSError.
    """
    reply = _told(site, "disarm", by=by, reason=reason)
    if reply is not None:
        was, said = bool(reply["was_armed"]), f"the running gateway (pid {reply['pid']}) writes no more"
    else:
        said = await _last_word(site, audit_path)
        was = disarm_in_log(audit_path, by, reason, time.time()) is not None
    data = {"by": by, "reason": reason, "was_armed": was, "said": said if was else "nothing was armed"}
    return Outcome({**data, "audit": str(audit_path), "head": head(audit_path) if audit_path.exists() else ""})


def _told(site: Site, command: str, **keys: Any) -> dict[str, Any] | None:
    """The running gateway's answer; None where none runs. Raises ArmingError for one that cannot be asked."""
    line = running_gateway(site.target)
    if line is not None:
        try:
            return line.ask(command, **keys)
        finally:
            line.close()
    if site.target.config is not None and gateway_runs(site.target.config.historian.path):
        raise ArmingError("a gateway runs with this plant file, and its control socket does not answer; stop it first")
    return None


async def _last_word(site: Site, audit_path: Path) -> str:
    """Validity 0, written once if possible; what became of it."""
    try:
        async with hand(site, audit_path) as one:
            await one.block()
            one.written = 0  # it is the last word already
    except (DriverError, ValueError) as error:
        return f"validity 0 was not written ({error}); the PLC's own timer covers it"
    return "validity 0 was written"
