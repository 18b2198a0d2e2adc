"""A diagnosis on a schedule: whether the drift alarm asks for one, and its model as a candidate in the store."""

import json
import sqlite3
from dataclasses import dataclass
from pathlib import Path

from gateway.machine.model import MIN_CYCLE_READINGS, make_drift_rule
from gateway.settings import AlarmSection
from gateway.store import newest_scan, stored_rows
from sim.artefacts import (
    FINDING_FILE,
    DiagnosisFinding,
    FoundEffect,
    current,
    is_store,
    read_finding,
    version_directory,
    versions,
)
from sim.lab.discrepancy import Diagnosis
from sim.lab.formats import save
from sim.sha import Model

HOUR = 3600.0


@dataclass(frozen=True, slots=True)
class RecordedDrift:
    """On how many `cycles` running the model's free run was beyond its limit, and from how many on the alarm comes.

    `alarm_cycles` is the plant's own number (`alarms.drift_cycles`), which its gateway puts on record. `not_looked_at`
    is the reason where no cycle was judged.
    """

    cycles: int
    alarm_cycles: int
    not_looked_at: str = ""

    @property
    def stands(self) -> bool:
        """Whether the drift alarm's condition holds."""
        return not self.not_looked_at and self.cycles >= self.alarm_cycles

    def why_not_due(self) -> str:
        """Why it starts nothing, where it does not stand."""
        if self.not_looked_at:
            return f"drift was not looked at: {self.not_looked_at}"
        return f"the free run was beyond its limit on {self.cycles} cycles running, fewer than {self.alarm_cycles}"

    def as_plain(self) -> dict[str, str]:
        """What a result says beside "not due" where drift was not looked at."""
        return {"drift_not_looked_at": self.not_looked_at} if self.not_looked_at else {}


def recorded_drift(
    connection: sqlite3.Connection, historian: Path, *, machine: str | None, model: Model
) -> RecordedDrift:
    """The guards' last word about the `model` of a temperature, in the newest hour of the `historian` that is open.

    Raises HistorianError, or ValueError where the historian has no scan yet.
    """
    last = newest_scan(connection, machine=machine)
    if last is None:
        raise ValueError(f"{historian}: this historian has no scan yet; let the gateway run first")
    temperature = model.temperature
    rows = stored_rows(connection, "guards", ("time", "content"), last - HOUR, machine=machine, temperature=temperature)
    said = json.loads(rows[-1][1] or "{}").get("drift", {}) if rows else {}
    # A gateway of a former release does not say from how many cycles on its alarm comes.
    alarm = said.get("alarm_cycles", AlarmSection.model_fields["drift_cycles"].default)
    cycles = int(said.get("cycles", 0))
    reason = ""
    if make_drift_rule(model, None) is None:
        reason = f"the model of {temperature} has no switch, so nothing says when a cycle begins"
    elif not rows:
        reason = f"the newest hour of {historian} has nothing of a model of {temperature}"
    elif not cycles and said.get("error") is None:
        reason = (
            f"no whole cycle has been judged; one goes from a start of the machine to the next, with "
            f"{MIN_CYCLE_READINGS} readings or more"
        )
    return RecordedDrift(cycles, int(alarm), reason)


def require_store(where: str) -> Path:
    """The store at `where`, in which a candidate can be saved. Raises ValueError where it is none."""
    store = Path(where)
    if not is_store(store):
        raise ValueError(
            f"{where}: --propose saves a candidate in a store of versions, and this is none; give --model the store"
        )
    return store


def make_finding(diagnosis: Diagnosis, diagnosed: str) -> DiagnosisFinding:
    """What is kept beside the candidate of a diagnosis of the version `diagnosed`. Raises ValueError without a name."""
    held = diagnosis.held_out
    if held is None or not diagnosis.effects:
        raise ValueError("a diagnosis that names nothing has no finding")
    effects = tuple(
        FoundEffect(name=each.name, members=each.members, plain=each.plain, experiment=each.experiment)
        for each in diagnosis.effects
    )
    return DiagnosisFinding(
        diagnosed=diagnosed,
        effects=effects,
        before=held.rmse_before,
        after=held.rmse_after,
        floor=held.noise_floor,
        unit=diagnosis.unit,
    )


def propose(store: Path, new: Model, diagnosis: Diagnosis, *, created: float) -> tuple[str, bool]:
    """(the candidate, whether it is new): the model saved as a version with its finding, and promoted by nobody.

    One that waits already for the same finding about the version that runs stays the only one: a schedule would
    else add one a night until somebody decides. Raises ArtefactError.
    """
    running = current(store)
    finding = make_finding(diagnosis, running)
    for name in versions(store):
        known = read_finding(version_directory(store, name))
        if known is not None and (known.diagnosed, _names(known)) == (running, _names(finding)):
            return name, False
    # Its parameters are fitted anew and it has an effect more: nobody has judged it yet.
    return save(store, new, created=created, parent=running, more={FINDING_FILE: finding.text()}), True


def _names(finding: DiagnosisFinding) -> frozenset[str]:
    return frozenset(effect.name for effect in finding.effects)
