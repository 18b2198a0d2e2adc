"""A plant whose historian packs early, and feeds that look often."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.outside.northbound import feed
from gateway.store import historian, schema
from tests.northbound.rig import Plant


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plant]:
    for table, rows in {"samples": 200, "predictions": 60, "scans": 60}.items():
        monkeypatch.setitem(schema.PACKED, table, rows)  # type: ignore[arg-type]
    for name in ("POLL_SECONDS", "FIRST_RETRY", "LONGEST_RETRY", "SAVE_SECONDS"):
        monkeypatch.setattr(feed, name, 0.05)
    monkeypatch.setattr(historian, "BATCH_SECONDS", 0.05)
    plant = Plant(tmp_path)
    yield plant
    plant.close()
