"""What the historian and the audit log have promised is there after their writer was killed.

`python -m benchmarks.record_kills` does it a thousand times.
"""

import sqlite3
from contextlib import closing
from pathlib import Path
from random import Random

import pytest

from benchmarks.record_kills import Kept, killed, missing

KILLS, SEED = 4, 1


@pytest.mark.timeout(1200)
def test_kills_of_writers_lose_nothing_that_was_promised(tmp_path: Path) -> None:
    kept = killed(tmp_path, KILLS, Random(SEED))
    assert kept.wrong == []
    assert kept.kills == KILLS and kept.entries and kept.there == kept.promised > 0
    # The judge sees a row that is gone, and one that never was.
    kept.rows.add(1)
    kept.entries.add(1)
    lost = missing(tmp_path, kept)
    assert "entry 1 of the audit log is lost" in lost and "row 1 of alarms is lost" in lost
    with closing(sqlite3.connect(tmp_path / "audit.sqlite")) as connection:
        connection.executescript("DROP TRIGGER audit_no_loss; DELETE FROM audit WHERE id = 1")
    assert len(missing(tmp_path, Kept(entries=set(kept.entries)))) > 1
