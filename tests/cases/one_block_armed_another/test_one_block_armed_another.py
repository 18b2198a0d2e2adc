"""One audit log for all blocks of a plant: an arming of one block let the others be written, and a disarming of one
took back them all."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.machine.writing.arming import arm_in_log, arming_entry, disarm_in_log, next_start, sign_arming
from gateway.settings.config import Config
from gateway.store.arming_rows import Uptime, armed_subjects, armings, cancel_entry, find_arming, given_words
from gateway.store.audit import ARMED, CANCELLED, CONFIRMED, DISARMED, EXPIRED, AuditEntry, open_audit, read, verify
from tests.gateway.support import EPOCH, config_in, two_modes
from tests.gateway.test_arming import SHADOW

ARMING = sign_arming("Ada", "run", 5, EPOCH)
A, B = "first/T", "second/T"


def appended(path: Path, *entries: AuditEntry) -> None:
    """What anybody can do who may write to the file."""
    audit = open_audit(path)
    assert all(audit.record(entry) for entry in entries) and audit.close()


@pytest.fixture
def config(tmp_path: Path) -> Config:
    return config_in(tmp_path, SHADOW, model=two_modes())


def about_another(path: Path) -> None:
    """The rows of the arming once more, about another subject."""
    appended(path, *(row.entry.with_subject(B) for row in read(path)))


def copied_and_confirmed_by_the_other(path: Path) -> None:
    """The ARMED row about another subject, and the confirmation of the true one as if it were its own."""
    armed, confirmed = (row.entry for row in read(path))
    appended(path, armed.with_subject(B))
    row = read(path)[-1]
    detail = {**confirmed.detail, "row": row.id, "hash": row.hash, "subject": B}
    appended(path, replace(confirmed, detail=detail), replace(confirmed, detail={**detail, "hash": "0"}))


def confirmed_once_more(path: Path) -> None:
    """The confirmation of the true row, about another subject: it says nothing of a row of that."""
    armed, confirmed = (row.entry for row in read(path))
    appended(path, confirmed.with_subject(B), armed.with_subject(B), confirmed.with_subject(B), confirmed)


def strange_subjects(path: Path) -> None:
    armed, confirmed = (row.entry for row in read(path))
    for subject in (None, "", 7, [B], {B: B}, True):
        for entry in (armed, confirmed):
            appended(path, replace(entry, detail={**entry.detail, "subject": subject}))


@pytest.mark.parametrize(
    "attack", [about_another, copied_and_confirmed_by_the_other, confirmed_once_more, strange_subjects]
)
@pytest.mark.parametrize("true", ["", A])
def test_an_arming_of_one_subject_arms_no_other(config: Config, true: str, attack: Callable[[Path], None]) -> None:
    arm_in_log(config.audit, ARMING, EPOCH, subject=true)
    attack(config.audit)
    assert verify(config.audit).problem == ""
    for subject in {"", A, B, "None", "first", "first/T2"} - {true}:
        assert find_arming(config.audit, EPOCH + 1.0, subject=subject) is None
        assert (
            next_start(
                replace(config, machine=subject, several=bool(subject)), config.audit, EPOCH + 1.0, Uptime("", 0.0)
            ).arming
            is None
        )
    found = find_arming(config.audit, EPOCH + 1.0, subject=true)
    assert found is not None and found.id == 1


def test_what_takes_back_one_leaves_the_others(config: Config) -> None:
    for subject in ("", A, B):
        arm_in_log(config.audit, ARMING, EPOCH, subject=subject)
    assert armed_subjects(config.audit) == ["", A, B]
    armed = {row.entry.subject: row.entry for row in read(config.audit, [ARMED])}
    appended(
        config.audit,
        AuditEntry(EPOCH + 1, EXPIRED, "Ada", "over").with_subject(B),
        cancel_entry(armed[B], "not in time"),
    )
    assert find_arming(config.audit, EPOCH + 2, subject=B) is None
    assert (
        find_arming(config.audit, EPOCH + 2, subject=A) is not None and find_arming(config.audit, EPOCH + 2) is not None
    )
    taken = disarm_in_log(config.audit, "Bea", "enough", EPOCH + 3, subject=A)
    assert taken is not None and taken.entry.subject == A
    assert find_arming(config.audit, EPOCH + 4, subject=A) is None and find_arming(config.audit, EPOCH + 4) is not None
    assert next(armings(config.audit, subject=A)).entry.kind == DISARMED
    assert [row.entry.subject for row in given_words(config.audit, subject=A)] == [A, A]


def test_the_rows_of_the_first_block_are_those_of_a_gateway_with_one(config: Config) -> None:
    """Nothing in them is another than before: a former log goes on, and a former gateway reads what is new in it."""
    arm_in_log(config.audit, ARMING, EPOCH)
    disarm_in_log(config.audit, "Bea", "enough", EPOCH + 3)
    cancelled = cancel_entry(arming_entry(ARMING, EPOCH, "command"), "late")
    assert all("subject" not in entry.detail for entry in (cancelled, *(row.entry for row in read(config.audit))))
    arm_in_log(config.audit, ARMING, EPOCH + 4, subject=A)
    rows = read(config.audit)
    assert [(row.entry.kind, row.entry.subject) for row in rows[-2:]] == [(ARMED, A), (CONFIRMED, A)]
    assert cancel_entry(rows[-2].entry, "late").subject == A and cancelled.kind == CANCELLED


@pytest.mark.parametrize("subject", ["a\x1b", "a\nb", "\ud800", "x" * 201])
def test_a_subject_that_would_be_stored_as_another_text_is_refused(config: Config, subject: str) -> None:
    with pytest.raises(ValueError, match="is no subject; give printable text"):
        arm_in_log(config.audit, ARMING, EPOCH, subject=subject)
    assert not config.audit.exists() or read(config.audit) == []
