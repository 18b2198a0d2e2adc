"""A machine that predicts both of its bearings: each has its own model, limit, alarms, block and rows."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from gateway.settings import load_config
from gateway.store import history, machines, reading, stored_rows
from sim.artefacts.model_json import model_text
from tests.gateway.support import CURRENT, RUNNING, TEMPERATURE, Bench, PacedClock, plant_file, two_modes
from tests.gateway.test_app import ARMED, go

OTHER = "TCuscinettiAlimentazione"
SCANS = 60


async def through(folder: Path) -> tuple[dict[str, Any], Bench]:
    """A run of SCANS in which the gearbox bearing warms up to 40 degC and the other one past its limit of 60."""
    (folder / "second.json").write_text(model_text(replace(two_modes(), temperature=OTHER)), encoding="utf-8")
    (folder / "first.json").write_text(model_text(two_modes()), encoding="utf-8")
    tables = (
        f'[[temperature]]\ntag = "{TEMPERATURE}"\nmodel = "first.json"\n'
        f'[[temperature]]\ntag = "{OTHER}"\nmodel = "second.json"\nlimit = 60.0\n'
    )
    given = {key.replace("__", ".", 1): value for key, value in (ARMED | {"forecast__period": 5.0}).items()}
    config = load_config(plant_file(folder, tables), given)
    bench = Bench(config, PacedClock(pause_s=0.002), armed=True)
    for read in range(5, SCANS):
        share = read / SCANS
        bench.plan[read] = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: 25.0 + 15.0 * share, OTHER: 25.0 + 45.0 * share}
    bench.soft.put("ChallengeAlimentazione", 7)
    return await go(config, bench, SCANS), bench


async def test_both_bearings_are_predicted_judged_by_their_own_limits_and_written(tmp_path: Path) -> None:
    last, bench = await through(tmp_path)
    (second,) = last["further"]
    assert (last["temperature"], second["temperature"]) == (TEMPERATURE, OTHER)
    assert (last["limit"], second["limit"]) == (80.0, 60.0)
    assert last["prediction"]["measured"] < 41.0 and second["prediction"]["measured"] > 65.0
    assert last["alarms"][f"over limit {TEMPERATURE}"] == "normal"
    assert last["alarms"][f"over limit {OTHER}"] != "normal"
    assert last["alarms"]["anomaly"] and last["alarms"][f"anomaly {OTHER}"]
    # Each block speaks of its own temperature; the alarm of one bearing is not in the word of the other.
    shown = {}
    for prefix in ("", "WritebackAlimentazione."):
        block = next(w for w in reversed(bench.written) if w.get(prefix + "validity"))
        shown[prefix] = (block[prefix + "temperature_now"] / 100, bool(block[prefix + "alarms"] & 1))
    assert abs(shown[""][0] - 40.0) < 1.0 and not shown[""][1]
    assert abs(shown["WritebackAlimentazione."][0] - 70.0) < 5.0 and shown["WritebackAlimentazione."][1]
    with reading(tmp_path / "history.sqlite") as connection:
        assert machines(connection) == [("decanter", [TEMPERATURE, OTHER])]
        for temperature, warmest in ((TEMPERATURE, 40.0), (OTHER, 70.0)):
            rows = stored_rows(connection, "predictions", ("time", "measured"), temperature=temperature)
            assert abs(max(row[1] for row in rows if row[1] is not None) - warmest) < 1.0
            assert stored_rows(connection, "writes", ("time", "verdict"), temperature=temperature)
    assert history(tmp_path / "history.sqlite", temperature=OTHER).measured.max() > 65.0


async def test_one_arming_is_for_both_blocks_and_a_stop_takes_both_back(tmp_path: Path) -> None:
    last, bench = await through(tmp_path)
    assert last["writeback"]["mode"] == last["further"][0]["writeback"]["mode"] == "armed"
    validities = [value for write in bench.written for name, value in write.items() if name.endswith("validity")]
    assert validities[-2:] == [0, 0] and any(validities[:-2])
    lines = (tmp_path / "gateway.jsonl").read_text(encoding="utf-8").splitlines()
    assert sum(json.loads(line)["event"] == "armed" for line in lines) == 1
