"""The gateway's part in the witness of its audit log: signed heads each hour, at a stop, arming and disarming."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from itertools import count
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.machine.writing.arming import ArmingError
from gateway.settings import Config
from gateway.store import (
    FIXED,
    HEAD_EVENT,
    HEAD_STATE,
    AuditEntry,
    AuditError,
    AuditRow,
    FileRule,
    HeadSink,
    ReliedFiles,
    SignedHead,
    SigningKeyError,
    WitnessPlaces,
    acknowledgement,
    confirmation,
    default_places,
    examine,
    heads_file,
    load_or_make_key,
    numbered_files,
    sign_head,
    trusted_key,
)

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

    from gateway.store import HistorianView


SIGN_SECONDS = 3600.0
LEAST_DIGITS = 16
"""So many digits of a lost head are enough to acknowledge it by."""


def witness_places(config: Config) -> WitnessPlaces:
    """Where the audit log of a plant file, its key and its witnesses are now."""
    logs = tuple(numbered_files(config.log.path)) if config.log.path is not None else ()
    historian = config.historian.path if config.historian.path.exists() else None
    return WitnessPlaces(
        audit=config.audit, key=config.audit_key, heads=config.audit_heads, historian=historian, logs=logs
    )


def find_places(audit: Path, config: Config | None) -> WitnessPlaces:
    """Those of this audit log: the plant file's if it is its own, else what lies beside it."""
    return witness_places(config) if config is not None and config.audit == audit else default_places(audit)


def obstacle(places: WitnessPlaces) -> tuple[str, SignedHead | None]:
    """Why nobody may arm on this audit log ("" if one may), and the lost head that a person has to acknowledge."""
    try:
        load_or_make_key(places.key)
        verdict = examine(places, public=trusted_key(places, None))
    except (SigningKeyError, AuditError) as error:
        return str(error), None
    if verdict.broken:
        remedy = "keep the file as evidence: move it away while the gateway is stopped, and arm on a new one"
        return f"{places.audit}: {verdict.broken}; {remedy}", None
    if (lost := verdict.lost) is not None:
        # What is wrong with a witness itself is the audit command's to say, and no reason not to arm.
        return (
            f"{places.audit}: row {lost.row} was signed and is not in it, so it was cut, emptied or begun anew; look "
            f"for what was lost, and where it is lost indeed arm with --acknowledge-head {lost.head}"
        ), lost
    return "", None


def clear_for_arming(
    places: WitnessPlaces,
    store: Callable[[AuditEntry], AuditRow | None],
    *,
    by: str,
    now: float,
    acknowledged: Sequence[str] = (),
    sinks: Sequence[HeadSink] = (),
) -> Ed25519PrivateKey:
    """See that the audit log is whole and its end witnessed, with the lost heads acknowledged that a person names.

    Gives the key that confirms the arming. `store` puts a row on the disk, None if it could not. Raises ArmingError.
    """
    reason, lost = obstacle(places)
    names = [name.lower() for name in acknowledged if len(name) >= LEAST_DIGITS]
    # As often as heads are named: behind the newest lost one there may be another, of a log before it.
    for _ in names:
        if lost is None or not any(lost.head.startswith(name) for name in names):
            break
        row = store(acknowledgement(lost, by, now))
        if row is None or store(confirmation(row, load_or_make_key(places.key), now)) is None:
            raise ArmingError("not armed, as the audit log does not take the acknowledgement")
        countersign(places, now, sinks)
        reason, lost = obstacle(places)
    if reason:
        raise ArmingError(f"not armed: {reason}")
    # Before it counts: an arming whose head cannot be signed is none.
    countersign(places, now, sinks)
    return load_or_make_key(places.key)


def countersign(places: WitnessPlaces, now: float, sinks: Sequence[HeadSink] = ()) -> None:
    """Sign the newest head, and give it to the heads file and to the other sinks. Raises ArmingError."""
    try:
        sign_head(places.audit, load_or_make_key(places.key), now, [partial(heads_file, path=places.heads), *sinks])
    except OSError as error:
        raise ArmingError(f"the audit log's head cannot be witnessed: {error}") from None


class HeadWitnessing:
    """Signs the heads of a running gateway's audit log, into its historian and its log too."""

    def __init__(
        self, config: Config, historian: HistorianView, log: FilteringBoundLogger, files: ReliedFiles | None = None
    ) -> None:
        self._config, self._historian, self._log = config, historian, log
        self._files = files or ReliedFiles()
        self._failure = ""
        self._one_at_a_time, self._turns, self._signed = Lock(), count(1), 0

    @property
    def places(self) -> WitnessPlaces:
        """As they are now: the log has other files from day to day."""
        return witness_places(self._config)

    @property
    def sinks(self) -> tuple[HeadSink, ...]:
        """Who takes a signed head besides the heads file; a way north is one more."""
        return self._to_historian, self._to_log

    def turn(self) -> int:
        """The next turn, for whoever signs in a thread: it is taken when the signing is asked for."""
        return next(self._turns)

    def sign(self, now: float, turn: int | None = None) -> None:
        """Sign the newest head; what stands in the way is logged when it is new.

        One at a time, from any thread, and never out of `turn` (by default the next one): where a later one has been
        signed meanwhile it is of all rows that this one would be of. The turns and not the times say which is later,
        since a clock may be set back.
        """
        turn = self.turn() if turn is None else turn
        with self._one_at_a_time:
            if turn < self._signed:
                return
            self._files.look()
            try:
                countersign(self.places, now, self.sinks)
                self._rely_on_files()
                self._failure, self._signed = "", turn
            except ArmingError as error:
                if str(error) != self._failure:
                    self._log.error("the audit log's end is not witnessed", reason=str(error))
                self._failure = str(error)

    def _rely_on_files(self) -> None:
        """As they are now: nothing is signed with another key unnoticed; heads go on in another file."""
        if not self._files.knows("signing key"):
            self._files.watch("signing key", {self._config.audit_key: FIXED})
        self._files.watch("signed heads", {self._config.audit_heads: FileRule(grows=True, late=True)})
        self._files.look()

    def _to_historian(self, head: SignedHead) -> None:
        self._historian.save(HEAD_STATE, head.time, asdict(head))

    def _to_log(self, head: SignedHead) -> None:
        self._log.info(HEAD_EVENT, **asdict(head))
