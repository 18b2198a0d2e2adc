"""Stated confidence against what was right: a quarter of the weight lies outside of the catalogue."""

import json
from dataclasses import asdict
from pathlib import Path

from click.testing import CliRunner

from benchmarks.discrepancy.confidence import Claim, constants, main, reliability
from benchmarks.discrepancy.seal import Label, write_labels
from sim.lab.discrepancy.posterior import NamesEvidence

CLEAR = NamesEvidence(heat_left=0.0, excess_left=0.0, excess_error=0.05)
GAINS = {"wear-drift": 90.0, "dead-time": 10.0}


def claim(number: int, *, outside: bool, given: bool = True, evidence: NamesEvidence | None = CLEAR) -> Claim:
    step = {"members": ["wear-drift"], "gains": GAINS, "threshold": 14.0}
    return Claim(
        case=f"case{number}",
        outside=outside,
        truth=() if outside else ("wear-drift",),
        given=given,
        steps=() if evidence is None else (step,),
        evidence=evidence,
    )


def test_cases_outside_weigh_a_quarter_however_many_they_are() -> None:
    inside = [claim(number, outside=False) for number in range(2)]
    for count in (1, 4):
        said = reliability([*inside, *(claim(number, outside=True) for number in range(count))])
        assert f"2 cases inside, {count} outside the catalogue; named 2 and {count}" in said
        assert "| 75.0 % | " in said and f"| 2/{2 + count} |" in said


def test_what_is_withheld_is_not_held_against_what_is_stated_and_teaches_the_constants() -> None:
    spread = NamesEvidence(heat_left=0.6, excess_left=0.8, excess_error=0.1)
    claims = [
        claim(0, outside=False),
        claim(1, outside=True, given=False, evidence=spread),
        claim(2, outside=True, given=False, evidence=None),
    ]
    assert "| 100.0 % | " in reliability(claims) and "1/1 |" in reliability(claims)
    said = constants(claims)
    assert "1.00 of the cases inside, 0.50 of those outside" in said
    assert "| share of the held-out excess that is left | 0.000 (0.00, 0.00, 0.00; 1) | 0.800 " in said


def test_the_table_reads_results_and_says_when_there_are_none(tmp_path: Path) -> None:
    spec = {"effects": ["wear-drift"]}
    label = Label("case0", spec, {}, {}, (), 0.0, 0.1, 0.1, "one")
    write_labels(tmp_path, "batch", [label])
    asked = CliRunner().invoke(main, ["table", str(tmp_path)])
    assert asked.exit_code == 1 and "run the cases first" in asked.output
    folder = tmp_path / "confidence" / "confidence"
    folder.mkdir(parents=True)
    (folder / "case0-whole.json").write_text(json.dumps(asdict(claim(0, outside=False))), encoding="utf-8")
    asked = CliRunner().invoke(main, ["table", str(tmp_path), "--cases"])
    assert asked.exit_code == 0, asked.output
    assert "| case0 | inside | right | given wear-drift |" in asked.output


def test_a_claim_is_right_where_one_of_its_members_acts() -> None:
    assert claim(0, outside=False).right and not claim(0, outside=True).right
    assert 0.95 < claim(0, outside=False).stated[0] <= 0.99
