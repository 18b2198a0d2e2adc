"""A running gateway with its section: metrics that promtool and the dashboard agree with, an alarm acknowledged."""

import asyncio
import json
import re
import subprocess
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from prometheus_client.parser import text_string_to_metric_families

from drivers.settings import ConfigError
from gateway.machine.alarms import read_journal
from gateway.machine.reading import plant_clock
from gateway.outside.northbound import check_northbound, northbound
from gateway.outside.northbound.metrics import METRICS
from gateway.plant.app import run
from gateway.settings import load_config
from tests.cli.support import decanter
from tests.gateway.support import CURRENT, ROOT, RUNNING, TEMPERATURE, Bench, config_in, plant_file, two_modes
from tests.rig.servers import Line, free_port, program, running

MOSQUITTO, PROMTOOL = program("mosquitto"), program("promtool")
DASHBOARD = ROOT / "config/grafana/decanter.json"


def scraped(port: int, accept: str = "") -> tuple[str, str]:
    with urlopen(Request(f"http://127.0.0.1:{port}/metrics", headers={"Accept": accept})) as answer:
        return answer.headers["Content-Type"], answer.read().decode()


async def test_a_gateway_is_scraped_and_an_alarm_is_acknowledged_from_outside(tmp_path: Path) -> None:
    """In real time, twenty times as fast: a bearing that is over its limit."""
    if MOSQUITTO is None:
        pytest.skip("needs mosquitto (apt-get install mosquitto)")
    port, metrics = free_port(), free_port()
    (tmp_path / "mosquitto.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n", encoding="utf-8")
    section = (
        f"[alarms]\nlimit = 45.0\n[northbound.metrics]\nport = {metrics}\n[[northbound.mqtt]]\nname = 'it'\n"
        f"host = '127.0.0.1'\nport = {port}\ntls = false\npayload = 'json'\ncommands = true\n"
        f"[forecast]\nperiod = 5.0\nruns = 50\nhorizons = [10.0, 60.0]\n"
    )
    config = config_in(tmp_path, section, model=two_modes())
    clock = plant_clock(20.0)
    bench = Bench(config, clock)  # type: ignore[arg-type]
    for read in range(5, 10_000):
        bench.plan[read] = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: 60.0 + read % 2}
    over, states, samples = f"over limit {TEMPERATURE}", list[Any](), set[float]()

    def heard(client: Client, _data: Any, message: Any) -> None:
        *_, table, signal = message.topic.split("/")
        if table == "samples" and signal == TEMPERATURE:
            samples.add(json.loads(message.payload)["time"])
        if table == "alarms" and signal == over:
            row = json.loads(message.payload)
            states.append(row)
            if row["state"] == "unacknowledged":
                client.publish(f"decanter/gateway/{config.machine}/acknowledge", "no such alarm")
                client.publish(f"decanter/gateway/{config.machine}/acknowledge", over)

    with running([MOSQUITTO, "-c", str(tmp_path / "mosquitto.conf")], port):
        client = Client(CallbackAPIVersion.VERSION2)
        client.on_message = heard
        client.connect("127.0.0.1", port)
        client.subscribe("decanter/gateway/#")
        client.loop_start()
        gateway = asyncio.create_task(run(config, clock=clock, stop=bench.stop, driver=bench))
        try:
            async with asyncio.timeout(120.0):
                while len(states) < 2 or len(samples) <= 20 or bench.reads < 60:
                    assert not gateway.done() or gateway.result() is None
                    await asyncio.sleep(0.05)
            media_type, text = await asyncio.to_thread(scraped, metrics)
            _, open_metrics = await asyncio.to_thread(scraped, metrics, "application/openmetrics-text; version=1.0.0")
        finally:
            bench.stop.set()
            await gateway
            client.disconnect()
            client.loop_stop()
    assert [row["state"] for row in states[:2]] == ["unacknowledged", "acknowledged"]
    assert states[1]["acknowledged_by"] == "mqtt it" and len(samples) > 20
    log = (tmp_path / "gateway.jsonl").read_text(encoding="utf-8")
    assert "a command is refused" in log and "no such alarm" in log

    assert media_type.startswith("text/plain") and open_metrics.endswith("# EOF\n")
    families = {family.name: family for family in text_string_to_metric_families(text)}
    values = {(s.name, *sorted(s.labels.values())): s.value for f in families.values() for s in f.samples}
    assert values["decanter_value", TEMPERATURE, config.machine, "degC"] in (60.0, 61.0)
    assert values["decanter_alarm_active", "1", config.machine, over] == 1.0
    assert values["decanter_alarm_waiting", "1", config.machine, over] == 0.0
    assert values["decanter_limit", TEMPERATURE, config.machine] == 45.0
    assert values["decanter_northbound_connected", "it"] == 1.0 and values["decanter_northbound_rows_total", "it"] > 100
    assert {row.name for row in METRICS} <= set(re.findall(r"^# TYPE (\S+)", text, re.M))
    if PROMTOOL is not None:
        checked = subprocess.run(
            [PROMTOOL, "check", "metrics"], input=text, capture_output=True, text=True, check=False
        )
        assert (checked.returncode, checked.stdout, checked.stderr) == (0, "", "")


async def test_a_broker_that_is_gone_is_an_alarm_until_it_is_there_again(tmp_path: Path) -> None:
    """In real time, sixty times as fast: the alarm's two minutes are two seconds."""
    if MOSQUITTO is None:
        pytest.skip("needs mosquitto (apt-get install mosquitto)")
    port = free_port()
    (tmp_path / "mosquitto.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n", encoding="utf-8")
    with running([MOSQUITTO, "-c", str(tmp_path / "mosquitto.conf")], port):
        line = Line(port)
        section = (
            f"[[northbound.mqtt]]\nname = 'it'\nhost = '127.0.0.1'\nport = {line.port}\ntls = false\n"
            "[[alarm]]\nname = 'northbound'\non_delay = 120.0\n"
        )
        config = config_in(tmp_path, section)
        clock = plant_clock(60.0)
        bench = Bench(config, clock)  # type: ignore[arg-type]
        bench.plan[5] = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: 60.0}

        async def logged_as(state: str) -> None:
            """A last line may be half written."""
            while not any(
                '"northbound"' in row and f'"{state}"' in row
                for row in (tmp_path / "gateway.jsonl").read_text(encoding="utf-8").splitlines()
            ):
                await asyncio.sleep(0.05)

        gateway = asyncio.create_task(run(config, clock=clock, stop=bench.stop, driver=bench))
        try:
            async with asyncio.timeout(120.0):
                while bench.reads < 60:
                    assert not gateway.done() or gateway.result() is None
                    await asyncio.sleep(0.05)
                line.cut()
                await logged_as("unacknowledged")
                line.mend()
                await logged_as("returned unacknowledged")
        finally:
            line.cut()
            bench.stop.set()
            await gateway
    # On a busy machine the broker may not have been heard of for as long before, too.
    *_, raised, over = (row for row in read_journal(config.historian.path) if row.alarm == "northbound")
    assert (raised.state, over.state) == ("unacknowledged", "returned unacknowledged")
    log = (tmp_path / "gateway.jsonl").read_text(encoding="utf-8").splitlines()
    gone = next(row for row in map(json.loads, log) if row.get("sink") == "it")
    assert gone["event"].startswith("a system cannot be told") and raised.priority == 3
    assert over.time > raised.time


def test_the_dashboard_asks_for_metrics_that_there_are(tmp_path: Path) -> None:
    dashboard = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    asked = set(re.findall(r"decanter_\w+", " ".join([*expressions, str(dashboard["templating"])])))
    feeds = {
        f"decanter_northbound_{name}" for name in ("connected", "rows_waiting", "rows_lost_total", "rows_refused_total")
    }
    assert asked - feeds <= {metric.name for metric in METRICS} and len(asked) > 15
    if PROMTOOL is None:
        pytest.skip("needs promtool (apt-get install prometheus)")
    rules = [{"record": "it", "expr": re.sub(r"\$(\w+)", "x", expression)} for expression in expressions]
    path = tmp_path / "rules.json"  # JSON is YAML
    path.write_text(
        json.dumps({"groups": [{"name": f"g{n}", "rules": [rule]} for n, rule in enumerate(rules)]}), "utf-8"
    )
    checked = subprocess.run([PROMTOOL, "check", "rules", str(path)], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[[northbound.mqtt]]\nname = 'a'\nhost = 'b.example'\ntls = false", "would be told in the clear"),
        ("[[northbound.mqtt]]\nname = 'a/b'\nhost = 'b.example'", r"letters, digits, '_', '-' and '\.'"),
        ("[[northbound.mqtt]]\nname = 'a'\nhost = 'b'\nversion = '4'", "the version of MQTT, '5' or '3.1.1'"),
        ("[[northbound.mqtt]]\nname = 'a'\nhost = 'b'\ncertificate = 'c.pem'", "certificate and key go together"),
        ("[[northbound.mqtt]]\nname = 'a'\nhost = 'b'\ntables = ['audit']", "'alarms'"),
        ("[[northbound.influx]]\nname = 'a'\nurl = 'http://x.example:8086'\nbucket = 'b'", "in the clear"),
        ("[[northbound.influx]]\nname = 'a'\nurl = 'https://u:p@x.example'\nbucket = 'b'", "without log-in"),
        ("[[northbound.influx]]\nname = 'a'\nurl = 'https://x.example'", "needs either database .* or bucket"),
        (
            "[[northbound.influx]]\nname = 'a'\nurl = 'https://x.example'\nbucket = 'b'\n"
            "[[northbound.mqtt]]\nname = 'a'\nhost = 'b'",
            "'a' is named twice",
        ),
        ("[northbound]\nbacklog_hours = 0", "how old a row may be"),
    ],
)  # fmt: skip
def test_what_cannot_be_told_is_refused_in_a_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        load_config(plant_file(tmp_path, text))


def test_secrets_and_extras_that_are_missing_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "[northbound]\nsecrets = 'north.toml'\n[[northbound.mqtt]]\nname = 'a'\nhost = 'b'\nuser = 'u'"
    config = load_config(plant_file(tmp_path, text))
    with pytest.raises(ConfigError, match=r"north.toml: cannot be read .*mode 600"):
        check_northbound(config)
    secrets = tmp_path / "north.toml"
    secrets.write_text("[passwords]\nb = 'sesame'\n", encoding="utf-8")
    secrets.chmod(0o644)
    with pytest.raises(ConfigError, match="others may read the secrets"):
        check_northbound(config)
    secrets.chmod(0o600)
    with pytest.raises(ConfigError) as lacking:
        check_northbound(config)
    assert "there is no sink 'b'" in str(lacking.value) and "has none for 'a'" in str(lacking.value)
    assert "sesame" not in str(lacking.value)
    secrets.write_text("[passwords]\na = 'sesame'\n", encoding="utf-8")
    assert check_northbound(config).passwords == {"a": "sesame"}
    assert "what is on record is told to a" in decanter("plc", "check", "--offline", "--config", config.path).output

    def absent(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name.partition(".")[0])

    monkeypatch.setattr(northbound, "import_module", absent)
    with pytest.raises(ConfigError) as missing:
        check_northbound(config)
    assert str(missing.value) == (
        f"{config.path}: northbound.mqtt: needs paho, which is not installed; pip install 'decanter-gateway[mqtt]', "
        "or on Debian install the package decanter-gateway"
    )
    checked = decanter("plc", "check", "--offline", "--config", config.path)
    assert checked.exit_code == 1 and "needs paho" in checked.output
