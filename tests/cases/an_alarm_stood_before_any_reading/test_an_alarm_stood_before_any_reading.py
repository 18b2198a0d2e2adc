"""A limit of 85 was raised to 92 at 89 degrees, and after the restart the page said "is above 92", before any reading.

An alarm that stood against another limit is over until a reading raises it; one that stood against today's goes on.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gateway.plant.status import snapshot
from gateway.settings import Config
from tests.gateway.support import TEMPERATURE, config_in
from tests.gateway.test_alarm_desk import HOT, QUICK, standing


def with_limit(folder: Path, limit: float) -> Config:
    config = config_in(folder, QUICK)
    return replace(config, alarms=config.alarms.model_copy(update={"limit": limit}))


@pytest.mark.parametrize("acknowledged", [False, True])
@pytest.mark.parametrize(
    ("limit", "reading", "before", "after"),
    [
        (85.0, 89.0, True, "as it was"),
        (92.0, 89.0, False, "over"),
        (92.0, 91.9, False, "over"),
        (92.0, 95.0, False, "unacknowledged"),
    ],
)
async def test_after_a_restart_an_alarm_is_raised_by_a_reading_alone(
    acknowledged: bool, limit: float, reading: float, before: bool, after: str, tmp_path: Path
) -> None:
    async with standing(with_limit(tmp_path, 85.0)) as stand:
        await stand.scan()
        await stand.scan(**{TEMPERATURE: 89.0})
        if acknowledged:
            await stand.ask("acknowledge", alarm=HOT, by="A. Rossi")
        was = stand.state()
    over = "normal" if acknowledged else "returned unacknowledged"
    async with standing(with_limit(tmp_path, limit), at=10.0) as stand:
        assert stand.state() == (was if before else over)
        assert {row.beyond for row in snapshot(stand.machine).alarm_summary} <= {None}, "nothing has been read"
        await stand.scan(**{TEMPERATURE: reading})
        assert stand.state() == {"as it was": was, "over": over}.get(after, after)
        rows: dict[str, Any] = {row.name: row.beyond for row in snapshot(stand.machine).alarm_summary}
        if HOT in rows:
            assert rows[HOT] is (reading > limit)
