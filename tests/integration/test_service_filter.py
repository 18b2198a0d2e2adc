"""The gateway under the system calls that its unit leaves it: what it does at the plant it does there too."""

import json
import time
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.outside.web.access import add_account
from gateway.settings.config import load_config
from tests.page.served import PASSWORD, Client, eventually
from tests.rig import service_filter
from tests.rig.pair import TEMPERATURE, make_rig, restless_trace

UNIT = Path(__file__).parents[2] / "deploy/decanter.service"
PAGE = "[page]\nenabled = true\nport = 0\n"


def test_reading_the_block_the_page_its_trends_and_a_backup_go_with_the_calls_that_the_unit_allows(
    tmp_path: Path,
) -> None:
    if lack := service_filter.missing(UNIT):
        pytest.skip(f"no program can be run under the unit's filter: {lack}")
    rig = replace(make_rig(tmp_path, restless_trace(60.0), period=0.2), runner=service_filter.runner(UNIT))
    with rig.plant.open("a", encoding="utf-8") as file:
        file.write(PAGE)
    add_account(load_config(rig.plant).users, "ada", "administrator", PASSWORD)
    with rig.plc() as plc, rig.gateway(plc) as gateway:
        gateway.wait_for(lambda status: status["writeback"].get("accepted", 0) > 5)
        log = rig.records / "gateway.jsonl"

        def address() -> str:
            lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
            return next((line["address"] for line in lines if line["event"] == "the page is served"), "")

        ada = Client(int(eventually(address).rpartition(":")[2]))
        assert ada.log_in("ada") == 200
        now = time.time()
        status, trend = ada.ask("GET", f"/api/trend?machine=decanter&tag={TEMPERATURE}&start={now - 60}&end={now}")
        assert status == 200, trend
        status, made = ada.ask("POST", "/api/backup", {})
        assert status == 200, made
        assert gateway.stop()[0] == 0, gateway.words()
