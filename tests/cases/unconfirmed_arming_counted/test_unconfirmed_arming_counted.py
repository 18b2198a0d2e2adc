"""An ARMED row that anybody had appended to the audit log armed the next start, and so did one of which its person had
been told "not armed" if the gateway was killed before the row that cancelled it."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.machine.writing.arming import arm_in_log, arming_entry, disarm_in_log, next_start, sign_arming, uptime
from gateway.machine.writing.witnessing import countersign, witness_places
from gateway.settings.config import Config
from gateway.store.arming_rows import cancel_entry, find_arming
from gateway.store.audit import ARMED, CONFIRMED, EXPIRED, AuditEntry, AuditRow, open_audit, read, verify
from gateway.store.confirming import confirmation
from gateway.store.signing import load_or_make_key
from gateway.store.witness import examine
from tests.gateway.support import EPOCH, JumpClock, config_in, two_modes
from tests.gateway.test_arming import SHADOW, bench_of, go

FORGED = arming_entry(sign_arming("Ada", "run", 480, EPOCH + 20.0), EPOCH + 20.0, "command")


def appended(path: Path, *entries: AuditEntry) -> list[AuditRow]:
    """What anybody can do who may write to the file: each row is well formed, each hash right."""
    audit = open_audit(path)
    rows = [row for entry in entries if (row := audit.record(entry)) is not None]
    assert audit.close() and len(rows) == len(entries)
    return rows


def alone(config: Config) -> None:
    """Appended behind the newest head."""
    appended(config.audit, FORGED)


def under_a_head(config: Config) -> None:
    """Appended while a gateway runs, which signs a head over it within the hour."""
    appended(config.audit, FORGED)
    countersign(witness_places(config), EPOCH + 30.0)


def confirmed_by_another_key(config: Config) -> None:
    (row,) = appended(config.audit, FORGED)
    appended(config.audit, confirmation(row, Ed25519PrivateKey.generate(), EPOCH + 21.0))


def confirmation_copied(config: Config) -> None:
    """The confirmation of a true arming, for another row; and once more as it is."""
    (true,) = read(config.audit, [CONFIRMED])
    (row,) = appended(config.audit, FORGED)
    detail = {**true.entry.detail, "row": row.id, "hash": row.hash}
    appended(config.audit, replace(true.entry, detail=detail), true.entry)


def strange(config: Config) -> None:
    """Rows whose details are none, or of other kinds than the gateway's."""
    kinds: tuple[dict[str, object], ...] = ({}, {"until": "late"}, {"until": [1], "row": "x"})
    entries = [AuditEntry(EPOCH + 20.0, kind, "Eve", "r", detail) for kind in (ARMED, CONFIRMED) for detail in kinds]
    appended(config.audit, *entries, AuditEntry(EPOCH + 20.0, ARMED, "Eve", "r", [1]))  # type: ignore[arg-type]


@pytest.mark.parametrize("forgery", [alone, under_a_head, confirmed_by_another_key, confirmation_copied, strange])
async def test_a_row_that_somebody_appended_arms_nobody(tmp_path: Path, forgery: Callable[[Config], None]) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    arm_in_log(config.audit, sign_arming("Bea", "before", 5, EPOCH), EPOCH)
    disarm_in_log(config.audit, "Bea", "enough", EPOCH + 10.0)
    countersign(witness_places(config), EPOCH + 11.0)
    forgery(config)
    assert verify(config.audit).problem == "" and examine(witness_places(config)).problem == "", "nothing else shows it"
    assert find_arming(config.audit, EPOCH + 31.0) is None, "the commands that write see it the same way"
    start = next_start(config, config.audit, EPOCH + 31.0, uptime())
    assert start.arming is None and (forgery is strange or "is not confirmed" in start.sentence)
    bench = bench_of(config, JumpClock(EPOCH + 31.0))
    status = await go(config, bench, 10)
    assert status["writeback"]["mode"] == "shadow" and not bench.written
    rows = read(config.audit, [EXPIRED])
    assert len(rows) == (forgery is not strange), "a start puts on record that it does not count"


def test_a_kill_between_the_reply_not_armed_and_its_cancelling_row_leaves_no_arming(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW)
    # The commit of the row was under way when the wait for it ended; nothing was written after it any more.
    appended(config.audit, FORGED)
    assert next_start(config, config.audit, EPOCH + 31.0, uptime()).arming is None
    # What was in force before still is.
    arm_in_log(config.audit, sign_arming("Bea", "before", 5, EPOCH + 40.0), EPOCH + 40.0)
    appended(config.audit, replace(FORGED, time=EPOCH + 41.0))
    start = next_start(config, config.audit, EPOCH + 42.0, uptime())
    assert start.arming is not None and start.arming.by == "Bea"


def test_a_confirmed_arming_is_bound_to_what_stands_in_its_row(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW)
    arm_in_log(config.audit, sign_arming("Ada", "run", 5, EPOCH), EPOCH)
    assert find_arming(config.audit, EPOCH + 1.0) is not None
    with closing(sqlite3.connect(config.audit)) as connection, connection:
        connection.execute("DROP TRIGGER audit_no_change")
        connection.execute("UPDATE audit SET detail = replace(detail, '1700000300', '1700090000') WHERE kind = 'armed'")
    assert find_arming(config.audit, EPOCH + 1.0) is None, "its hash was left as it was"


def test_a_forged_cancelling_row_brings_no_longer_arming_back(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW)
    arm_in_log(config.audit, sign_arming("Ada", "all day", 480, EPOCH), EPOCH)
    arm_in_log(config.audit, sign_arming("Bea", "shorter", 5, EPOCH + 10.0), EPOCH + 10.0)
    newest = read(config.audit, [ARMED])[-1]
    appended(config.audit, cancel_entry(newest.entry, "forged"))
    found = find_arming(config.audit, EPOCH + 20.0)
    assert found is not None and found.entry.who == "Bea"


def test_the_words_of_a_file_are_used_up_by_an_arming_that_was_not_confirmed(tmp_path: Path) -> None:
    config = config_in(tmp_path, '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "run"\nminutes = 10\n')
    start = next_start(config, config.audit, EPOCH, uptime())
    assert start.arming is not None
    entry = arming_entry(start.arming, EPOCH, "gateway began", file=start.file)
    appended(config.audit, entry)
    assert next_start(config, config.audit, EPOCH + 60.0, uptime()).arming is None
    # One that was refused, and is said to be cancelled, has used nothing up.
    appended(config.audit, cancel_entry(entry, "not stored in time"))
    assert next_start(config, config.audit, EPOCH + 60.0, uptime()).arming is not None


async def test_a_disarming_that_is_cut_off_is_missed(tmp_path: Path) -> None:
    """Without a head of its own the row could be cut, and the arming before it would be the newest word again."""
    config = config_in(tmp_path, SHADOW, model=two_modes())
    arm_in_log(config.audit, sign_arming("Ada", "run", 60, EPOCH), EPOCH)
    countersign(witness_places(config), EPOCH)
    disarm_in_log(config.audit, "Bea", "enough", EPOCH + 10.0)
    countersign(witness_places(config), EPOCH + 10.0)  # as the command and the gateway do
    with closing(sqlite3.connect(config.audit)) as connection, connection:
        connection.execute("DROP TRIGGER audit_no_loss")
        connection.execute("DELETE FROM audit WHERE kind = 'disarmed'")
    bench = bench_of(config, JumpClock(EPOCH + 20.0))
    assert (await go(config, bench, 10))["writeback"]["mode"] == "shadow" and not bench.written


def test_a_lost_key_confirms_nothing_and_a_key_of_others_is_said(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW)
    arm_in_log(config.audit, sign_arming("Ada", "run", 60, EPOCH), EPOCH)
    config.audit_key.chmod(0o644)
    start = next_start(config, config.audit, EPOCH + 1.0, uptime())
    assert start.arming is None and "has mode 0644" in start.sentence
    assert disarm_in_log(config.audit, "Bea", "enough", EPOCH + 2.0) is not None, "to disarm needs no key"
    config.audit_key.unlink()
    load_or_make_key(config.audit_key)
    arm_in_log(config.audit, sign_arming("Ada", "run", 60, EPOCH + 3.0), EPOCH + 3.0)
    assert next_start(config, config.audit, EPOCH + 4.0, uptime()).arming is not None
