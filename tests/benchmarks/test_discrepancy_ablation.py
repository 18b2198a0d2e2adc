"""The ablation of the rules of a diagnosis: what is remembered of one under other rules is what a new one would say."""

from dataclasses import fields, replace

import numpy as np
import pytest

from benchmarks.discrepancy.ablation import OFF, WAYS, remembered, table, variants, worth
from benchmarks.discrepancy.remembered import Memory, WorkLimitError
from benchmarks.discrepancy.seal import Label
from sim.lab.discrepancy import diagnose
from sim.lab.discrepancy.output import document
from sim.lab.discrepancy.rules import RULES, DecisionRules
from tests.discrepancy.plants import model, plant


def test_a_function_runs_again_for_other_contents_and_for_other_rules_that_it_read() -> None:
    ran: list[float] = []

    def scaled(values: np.ndarray, rules: DecisionRules) -> float:
        ran.append(float(values.sum()) * rules.margin_nats)
        return ran[-1]

    memory = Memory(counted="scaled", limit=3)
    call = memory.remembering(scaled)
    for margin, share, values in ((6.0, 0.1, [1.0, 2.0]), (6.0, 0.2, [1.0, 2.0]), (3.0, 0.2, [1.0, 2.0])):
        call(np.array(values), memory.under(replace(RULES, margin_nats=margin, margin_share=share)))
    assert ran == [18.0, 9.0]
    with memory.noting() as noted:
        assert call(np.array([1.0, 2.0]), memory.under(RULES)) == 18.0
    assert (noted, len(ran)) == ({"margin_nats"}, 2)
    rules = memory.under(RULES)
    with pytest.raises(WorkLimitError):
        for value in range(5):
            call(np.array([float(value)]), rules)


@pytest.mark.benchmark
def test_what_is_remembered_under_a_rule_is_what_a_new_diagnosis_says() -> None:
    traces, rules = [plant(3, days=2, pump=2e-4)], replace(RULES, moved_least_sigmas=0.0, moved_least_share=0.0)
    memory = Memory(counted="fit")
    with memory.standing_in(remembered()):
        usual = diagnose(model(), traces, seed=0, rules=memory.under(RULES)).diagnosis
        assert memory.fresh > 0
        other = diagnose(model(), traces, seed=0, rules=memory.under(rules)).diagnosis
    assert memory.fresh == 0, "the fits are the same"
    assert len(other.shifts) > len(usual.shifts)
    assert document(other) == document(diagnose(model(), traces, seed=0, rules=rules).diagnosis)


def test_every_rule_has_its_variants() -> None:
    names = [each.name for each in fields(DecisionRules)]
    assert set(OFF) == set(names) - {"held_out_share"}
    for name in OFF:
        made = dict(variants(name))
        assert set(made) <= set(WAYS) and "off" in made, name
        assert all(getattr(rules, name) != getattr(RULES, name) for rules in made.values())


def test_the_table_says_which_way_the_scores_go() -> None:
    spec = {"effects": ["pump-cooling"], "missing": []}
    label = Label("a", spec, {}, {}, (), 0.0, 0.1, 0.1, "")
    named = {"verdict": "named", "effects": [{"name": "pump-cooling", "class": ["pump-cooling"]}], "held_out": None}
    none = {"verdict": "unexplained", "effects": [], "held_out": None}
    wrong = {**named, "effects": [{"name": "dead-time", "class": ["dead-time"]}]}
    assert [worth(label, each) for each in (named, none, wrong)] == ["right", "nothing", "wrong"]
    said = table(
        {"a": label}, [{"case": "a", "said": none, "others": {"margin_nats": {"off": named, "halved": wrong}}}]
    )
    line = next(line for line in said.splitlines() if line.startswith("margin_nats"))
    assert line.split() == ["margin_nats", "1", "1/1/0", "1/1/0", "+1-0/+0-1/+0-0", "1/1/0", "0/0/0"]
