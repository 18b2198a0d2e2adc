"""A loop test beside a gateway that writes took its arming for one that is over, and put that on record.

The command had read the clock before the gateway stored its next block, so that the clock seemed to stand before the
newest record. A gateway that runs is looked for first: then nobody else writes to the log.
"""

import fcntl
import time
from pathlib import Path

from click.testing import CliRunner

from gateway.cli.main import main
from gateway.store import ARMED, AuditEntry, open_audit, read
from tests.gateway.support import config_in, two_modes

SHADOW = '[writeback]\nmode = "shadow"\n'
AHEAD_S = 60.0
"""The block stored between the command's look at the clock and at the log, by much more than that ever takes."""


def test_a_loop_test_beside_a_gateway_that_writes_ends_no_arming(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    named = ("--config", str(config.path), "--by", "Ada", "--audit", str(config.audit))
    done = CliRunner().invoke(main, ["arm", "--minutes", "5", "--reason", "test", *named])
    assert done.exit_code == 0, done.output
    audit = open_audit(config.audit)
    assert audit.record(AuditEntry(time.time() + AHEAD_S, "write"))
    audit.close()
    with config.historian.path.with_name(config.historian.path.name + ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = CliRunner().invoke(main, ["plc", "check", "write", "alarms", *named])
    assert done.exit_code == 2 and "a gateway runs" in done.stderr, done.output
    assert [row.entry.kind for row in read(config.audit)] == [ARMED, "confirmed", "write"]
