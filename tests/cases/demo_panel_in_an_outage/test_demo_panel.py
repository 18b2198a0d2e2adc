"""In its outage the demo's panel said "link good, 0 outages", and it ended with "not usable" and no reason."""

from typing import Any

import pytest
from rich.console import Console
from rich.text import Text

from gateway.demo.live import DemoPhase, demo_phase, demo_table
from gateway.outside.panel import frame_rows, status_rows
from gateway.outside.status import read_status
from sim.plc.control import obey
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from tests.cli.test_demo_parts import PLC, STATUS
from tests.plc.bench import DECANTER, block
from tests.plc.test_writeback import tell

REFUSING = {"number": 1, "kind": "refuse", "in_force": True, "hits": 0}
OVER = REFUSING | {"in_force": False}
SILENT = STATUS["link"] | {"alive": False, "outage_count": 1, "reason": "127.0.0.1:502 does not connect"}


def account(*faults: dict[str, Any], ended: bool = False) -> dict[str, Any]:
    return PLC | {"faults": list(faults), "ended": ended}


def shown(status: dict[str, Any], plc: dict[str, Any], phase: DemoPhase) -> str:
    console = Console(width=100)
    with console.capture() as captured:
        console.print(demo_table(status, plc, "T [red]", phase))
    return " ".join(captured.get().split())


def test_an_outage_is_shown_once_the_gateway_has_noticed_it_and_with_its_own_words() -> None:
    unnoticed = demo_phase(STATUS, account(REFUSING), DemoPhase.RUNNING)
    assert unnoticed is DemoPhase.RUNNING
    silent = STATUS | {"link": SILENT}
    phase = demo_phase(silent, account(REFUSING), unnoticed)
    assert phase is DemoPhase.OUTAGE
    text = shown(silent, account(REFUSING), phase)
    assert "OUTAGE" in text and "link no good reading for" in text and "127.0.0.1:502 does not connect" in text
    assert "1 outage " in text and "link good" not in text


def test_what_comes_after_an_outage_and_what_nobody_ordered_have_names_of_their_own() -> None:
    silent = STATUS | {"link": SILENT}
    recovering = demo_phase(silent, account(OVER), DemoPhase.OUTAGE)
    assert recovering is DemoPhase.RECOVERING
    assert demo_phase(silent, account(OVER), recovering) is DemoPhase.RECOVERING
    assert demo_phase(STATUS, account(OVER), recovering) is DemoPhase.RUNNING
    assert demo_phase(silent, account(), DemoPhase.RUNNING) is DemoPhase.LOST
    assert demo_phase(silent, account(OVER, ended=True), recovering) is DemoPhase.ENDED


def test_the_panel_of_a_gateway_needs_no_software_plc() -> None:
    console = Console(width=80)
    with console.capture() as captured:
        console.print(frame_rows(Text("a gateway"), status_rows(read_status(STATUS))))
    assert "45.68 °C GOOD" in " ".join(captured.get().split())


NOT_YET, SILENCE, STALE = "no block has been accepted yet", "no block has been accepted for 6.0 s", "no fresh forecast"


@pytest.mark.parametrize(
    ("validity", "later", "permit", "words"),
    [
        (None, 0.0, True, NOT_YET),
        (31, 6.0, True, SILENCE),
        (31, 0.1, False, "no write permit"),
        (2 + 4 + 16, 0.1, True, STALE),
        (4 + 8 + 16, 0.1, True, "its inputs are not good"),
        (2 + 4 + 8 + 16, 0.1, True, "zone red"),
        (0, 0.1, True, "taken its prediction back"),
    ],
)
def test_a_prediction_that_is_not_usable_says_why(validity: int | None, later: float, permit: bool, words: str) -> None:
    plc = Plc(read_map(DECANTER), EmulatorClock(0.0, 0.0, monotonic=lambda: 0.0))
    plc.begin(0.0)
    if validity is not None:
        tell(plc, block(1, 1, validity=validity), 0.0)
    plc.permit = permit
    plc.cycle(later)
    status: Any = obey(plc, '{"command": "status"}', later)
    assert status["usable"] is False and words in status["unusable"]
    text = shown(STATUS, status | {"ended": False}, DemoPhase.ENDED)
    assert f"not usable, own logic in force: {status['unusable']}" in text


def test_a_usable_one_has_no_reason_against_it() -> None:
    plc = Plc(read_map(DECANTER), EmulatorClock(0.0, 0.0, monotonic=lambda: 0.0))
    plc.begin(0.0)
    tell(plc, block(1, 1, validity=31), 0.0)
    status: Any = obey(plc, '{"command": "status"}', 0.1)
    assert status["usable"] is True and status["unusable"] == ""
