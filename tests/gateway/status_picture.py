"""A whole picture of a gateway that is well, as JSON, for tests of what is made of it."""

from typing import Any

from tests.gateway.support import EPOCH, TEMPERATURE


def tag(value: float | None, quality: str = "GOOD", age: float = 0.2, reason: str = "") -> dict[str, Any]:
    return {"value": value, "quality": quality, "time": EPOCH - age, "age": age, "reason": reason, "unit": "degC"}


def alarm(name: str, state: str = "unacknowledged", *, active: bool = True, since: float = EPOCH) -> dict[str, Any]:
    row = {"name": name, "tag": TEMPERATURE, "priority": 1, "state": state, "active": active, "since": since}
    return row | {"acknowledged_by": "", "response": "reduce the load"}


def picture(**changes: Any) -> dict[str, Any]:
    """The status with some of its keys others; `link__alive=False` changes one key of a table."""
    status: dict[str, Any] = {
        "machine": "decanter",
        "time": EPOCH,
        "phase": "running",
        "speed": 1.0,
        "place": "host 10.0.0.7 port 502 (decanter_plc)",
        "temperature": TEMPERATURE,
        "unit": "degC",
        "limit": 80.0,
        "link": {
            "alive": True,
            "connected": True,
            "reason": "",
            "last_good": EPOCH - 0.2,
            "outages": [],
            "outage_count": 1,
        },
        "links": [{"name": "main", "active": True}],
        "scan": {"count": 1000, "early": 0, "missed": 3, "period": 1.0, "age": 0.2, "late": False},
        "further": [],
        "values": {TEMPERATURE: tag(45.678), "Assorbimento": tag(210.0)},
        "prediction": {
            "time": EPOCH - 0.2,
            "location": "ON/100-200",
            "location_index": 3,
            "known": True,
            "inputs_good": True,
            "worst": 0,
            "age": 0.2,
            "measured": 45.678,
            "mean": 45.6,
            "low": 45.1,
            "high": 46.1,
            "free_run": 44.0,
            "anomaly": 0.3,
            "zone": "green",
            "reset": False,
            "free_sigma": 0.5,
            "borrowed": False,
        },
        "forecast": {
            "time": EPOCH - 3.0,
            "age": 3.0,
            "usable": True,
            "levels": [0.05, 0.25, 0.5, 0.75, 0.95],
            "horizons": [60.0, 300.0, 900.0],
            "quantiles": [[45.0, 45.5, 46.0, 46.5, 47.0]] * 3,
            "p_limit": [0.0, 0.1, 0.25],
            "factors": [1.0, 1.0, 1.0],
            "block": {"minutes_low": 5.04, "minutes_median": 11.21, "minutes_high": None, "p_limit": 0.25},
        },
        "model": {
            "name": "two modes",
            "hash": "1f2e3d4c5b6a7988",
            "version": "0001-1f2e3d4c",
            "written": EPOCH - 86400.0,
            "refused": "",
        },
        "guards": {},
        "events": 12,
        "recent_events": [[EPOCH, "A_1", "x"]] * 9,
        "alarms": {"inputs bad": "normal", "over limit T": "normal"},
        "alarm_summary": [],
        "writeback": {"mode": "shadow", "armed_until": None, "armed_by": None, "written": 0},
        "historian": {"path": "out/history.sqlite", "dropped": 0, "refused": 0, "failure": "", "complaint": ""},
        "parts": {"status": {"running": True, "restarts": 0, "failure": ""}},
        "clock": {"believed": True, "complaint": ""},
        "driver": {},
        "complaints": [],
        "failures": 0,
        "last_failure": "",
    }
    for key, value in changes.items():
        table, _, inner = key.partition("__")
        status[table] = {**status[table], inner: value} if inner else value
    return status
