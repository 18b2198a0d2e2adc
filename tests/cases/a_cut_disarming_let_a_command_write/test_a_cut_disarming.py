"""The row of a disarming was cut off the audit log, and the commands that write went by the arming before it."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from drivers.errors import WriteForbidden
from gateway.commission.writeback.block_writer import arming_in_force
from gateway.machine.writing import arm_in_log, countersign, disarm_in_log, sign_arming, witness_places
from gateway.store.audit import DISARMED
from tests.gateway.support import EPOCH, config_in

SHADOW = '[writeback]\nmode = "shadow"\n'


def cut(path: Path, kind: str) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DROP TRIGGER audit_no_loss")
        connection.execute("DELETE FROM audit WHERE kind = ?", (kind,))


@pytest.mark.parametrize("disarmed", [True, False])
def test_a_command_writes_by_no_arming_on_a_log_that_lacks_a_signed_row(tmp_path: Path, disarmed: bool) -> None:
    config = config_in(tmp_path, SHADOW)
    places = witness_places(config)
    arm_in_log(config.audit, sign_arming("Ada", "run", 60, EPOCH), EPOCH)
    countersign(places, EPOCH)
    assert arming_in_force(places, EPOCH + 1.0).by == "Ada"
    if disarmed:
        disarm_in_log(config.audit, "Bea", "enough", EPOCH + 10.0)
        countersign(places, EPOCH + 10.0)
        with pytest.raises(WriteForbidden, match="not armed: nothing is written; arm first"):
            arming_in_force(places, EPOCH + 20.0)
        cut(config.audit, DISARMED)
        with pytest.raises(WriteForbidden, match=r"not armed: nothing is written: .*row 3 was signed and is not in it"):
            arming_in_force(places, EPOCH + 20.0)


def test_nor_on_a_log_whose_chain_is_broken(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW)
    places = witness_places(config)
    disarm_in_log(config.audit, "Bea", "not yet", EPOCH)
    arm_in_log(config.audit, sign_arming("Ada", "run", 60, EPOCH), EPOCH)
    with closing(sqlite3.connect(config.audit)) as connection, connection:
        connection.execute("DROP TRIGGER audit_no_change")
        connection.execute("UPDATE audit SET reason = 'never' WHERE kind = ?", (DISARMED,))
    with pytest.raises(WriteForbidden, match=r"not armed: nothing is written: .*keep the file as evidence"):
        arming_in_force(places, EPOCH + 1.0)
