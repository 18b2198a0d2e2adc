"""What has no name gets a law to look at; a person may name it, and then it is an effect that can be tested."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim.artefacts.effect_lines import read_effect_lines
from sim.lab.discrepancy.advice import advice_lines, in_words, law_sentence, overlap_sentence
from sim.lab.discrepancy.diagnosis import CandidateLaw, Diagnosis, HeatPlace
from sim.lab.discrepancy.fitting.baseline import build_frame, move_frame
from sim.lab.discrepancy.fitting.candidates import catalogue, own_roles
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.law_search import candidate_laws
from sim.lab.discrepancy.layout import measured_signals, present_roles, required_signals
from sim.lab.discrepancy.naming import step
from sim.lab.discrepancy.output.diagnosis_json import document, document_text
from sim.lab.discrepancy.output.report import Occasion, report_html
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.workflow import diagnose
from tests.cli.support import decanter, only_object, refused
from tests.discrepancy.plants import PERIOD, model
from tests.discrepancy.valves import Hidden, plant

DAY = 86400.0
SPREAD = 0.39
"""degC: what the small plant's model allows itself."""


def laws_of(hidden: Hidden, seed: int = 1, days: int = 4) -> tuple[CandidateLaw, ...]:
    """The laws of what the plant's own model leaves, without the naming before."""
    trace = plant(seed, hidden, days)
    record = build_record(model(), [trace], measured_signals(model(), [trace], RULES))
    last = int(np.quantile(np.unique(record.cycle), 0.7))
    training = record.select(record.cycle < last)
    base = fit(move_frame(build_frame(record), training), rounds=2)
    return candidate_laws(base, record, last, SPREAD, RULES)


def coupled(_: float, x: float, signals: dict[str, float]) -> float:
    return 1e-4 * signals["Valvola"] * (signals["TMandata"] - x)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return diagnose(model(), [plant(1, coupled, days=3)], seed=0, most=1).diagnosis


def test_a_hidden_exchange_is_described_by_its_law_and_not_named(found: Diagnosis) -> None:
    assert (found.verdict, found.effects) == ("unexplained", ())
    law = found.laws[0]
    assert law.expression == "(TMandata - temperature) * max(Valvola, 0)" and not law.running
    assert law.strength == pytest.approx(1e-4, rel=0.15)
    assert law.share > 0.8 and law.cycles[0] == law.cycles[1] >= 3 and law.tried > 300
    assert law_sentence(law).startswith("not a name: ") and "held-out cycles (" in law_sentence(law)
    assert "to find out: change TMandata at constant Valvola, then Valvola at constant TMandata" in law_sentence(law)
    written = document(found)["laws"][0]
    assert (
        written["expression"] == law.expression
        and written["cycles"] == f"{law.cycles[0]}/{law.cycles[1]}"
        and written["tried"] == law.tried
    )
    assert any(look.startswith("what goes with (TMandata - temperature)") for look in advice_lines(found))


def test_the_report_shows_laws_and_what_to_look_at_first(found: Diagnosis, tmp_path: Path) -> None:
    page = report_html(found, Occasion("small", "T", "now", {}, {}, tmp_path), {})
    assert "Laws to look at" in page and "diagnose adopt" in page and "not a name: " in page
    assert page.index("Look at the machine:") < page.index("<section>")


def test_a_law_that_a_person_names_is_named_by_the_next_diagnosis(found: Diagnosis, tmp_path: Path) -> None:
    out, file = tmp_path / "out", tmp_path / "effects.toml"
    out.mkdir()
    (out / "diagnosis.json").write_text(document_text(found), encoding="utf-8")
    asked = ("diagnose", "adopt", out, "--effects", file)
    result = decanter(*asked, "--name", "rinse", "--meaning", "rinsing water", "--look", "the rinsing valve", "--json")
    assert only_object(result.stdout)["heat"] == "gain * ((TMandata - temperature) * max(Valvola, 0))"
    (line,) = read_effect_lines(file)
    assert (line.name, line.meaning, line.look, line.acts) == (
        "rinse",
        "rinsing water",
        "the rinsing valve",
        "anywhere",
    )
    refused(decanter(*asked, "--name", "rinse"), 2, "has an effect 'rinse' already")
    refused(decanter(*asked, "--name", "pump-cooling"), 2, "--name: 'pump-cooling' is a kind of the catalogue")
    refused(decanter(*asked, "--name", "more", "--law", "3"), 2, "there is no law 3")
    refused(decanter("diagnose", "adopt", tmp_path, "--name", "a", "--effects", file), 2, "diagnosis.json")
    assert read_effect_lines(file) == (line,), "what is refused writes nothing"

    # Other days of the same plant: tested like the kinds of the catalogue, on top of its own model.
    trace = plant(2, coupled, days=2)
    entries = catalogue([line])
    present = present_roles([trace], {"current": "Assorbimento", **own_roles([line])})
    base = fit(build_frame(build_record(model(), [trace], required_signals(model(), present))), rounds=2)
    offered = [entry for entry in entries if entry.name in ("rinse", "startup-churning", "quadratic-current-heating")]
    best = step(base, offered, present, rules=RULES).best
    assert best is not None and best.fitted is not None
    assert (best.entry.name, best.gain > 60.0) == ("rinse", True)
    assert best.fitted.state.named[-1].strength == pytest.approx(1e-4, rel=0.2)


@pytest.mark.parametrize(
    ("hidden", "expected"),
    [
        (lambda _, x, s: 4e-3 * (s["MarciaDecanter"] > 0) * (max(s["Livello"] - 60, 0) / 40) ** 1.3, "max(Livello"),
        (lambda t, x, s: 2e-3 * float(np.sin(2 * np.pi * t / (3.1 * 3600) + 1)), "every_18"),
    ],
    ids=["a bend that is no power of two", "a rhythm"],
)
def test_forms_that_the_family_has_not_exactly_are_recognised(hidden: Hidden, expected: str) -> None:
    laws = laws_of(hidden)
    assert laws and expected in laws[0].expression, [law.expression for law in laws]
    assert (laws[0].line is None) == ("every_" in expected), "no engine has a rhythm"


def greased(at: tuple[float, ...]) -> Hidden:
    """Heat after events at some moments (s), on a curve that is gone after eight running hours."""
    ran = dict.fromkeys(at, 0.0)

    def hidden(t: float, x: float, signals: dict[str, float]) -> float:
        turns = signals["MarciaDecanter"] > 0
        for moment in at:
            ran[moment] += PERIOD * turns * (t >= moment)
        left = sum(max(1.0 - ran[moment] / 28800.0, 0.0) ** 2 * (t >= moment) for moment in at)
        return 6e-3 * turns * left

    return hidden


def failing(t: float, x: float, signals: dict[str, float]) -> float:
    """A cooler that turns with the machine and fails within three hours of the second day."""
    return 1.5e-4 * (x - 15.0) * (signals["MarciaDecanter"] > 0) * min(max((t - 1.3 * DAY) / 10800.0, 0.0), 1.0)


@pytest.mark.parametrize(
    ("hidden", "words"),
    [
        (
            greased((0.7 * DAY, 1.9 * DAY)),
            r"heat after (2 events \(at|an event at) 2023-11-15 1[3-7]:\d\d UTC.*, fading over \d+\.\d running hours",
        ),
        (failing, r"less cooling while the machine runs, since 2023-11-16 (0[4-9]|1[01]):\d\d UTC"),
        (
            lambda t, x, s: 2.5e-3 * ((t + 1.7e9) % DAY // 3600.0 in range(9, 16)),
            r"heat that comes with the clock, between (08:[3-5]|09:[0-2])\d UTC and (15:[3-5]|16:[0-2])\d UTC",
        ),
        (
            lambda t, x, s: 4e-3 * (s["MarciaDecanter"] > 0) * (t > 1.5 * DAY),
            r"heat while the machine runs, since 2023-11-16 (0[5-9]|1[0-5]):\d\d UTC",
        ),
    ],
    ids=["fading events", "less cooling", "the clock", "a beginning"],
)
def test_what_comes_with_a_date_or_the_clock_is_said_with_it(hidden: Hidden, words: str) -> None:
    laws = laws_of(hidden, seed=2, days=4)
    assert laws and re.fullmatch(words, laws[0].words), [(law.words, law.gain) for law in laws]
    assert f"of what is left goes with {laws[0].words}" in law_sentence(laws[0])
    assert laws[0].line is None and laws[0].cycles[0] >= 0.6 * laws[0].cycles[1]


def test_what_is_left_by_an_event_is_told_of_each_step_of_a_signal() -> None:
    level = {"slow": 0.0}

    def hidden(t: float, x: float, signals: dict[str, float]) -> float:
        level["slow"] += PERIOD / 500.0 * (signals["Livello"] - level["slow"])
        return 2e-4 * abs(signals["Livello"] - level["slow"])

    (law, *_) = laws_of(hidden)
    assert law.words.startswith("heat that follows each step of Livello, up or down, and fades over ")


def test_nothing_is_offered_where_nothing_that_is_measured_goes_with_it() -> None:
    shifts = np.random.default_rng(5).standard_normal(2000)
    assert laws_of(lambda t, x, s: 2e-3 * float(shifts[int(t // 2500)])) == ()


def test_history_is_told_in_words() -> None:
    assert in_words("every_187min_2") == "a rhythm of 187 min"
    assert in_words("Livello - lag_Livello_15min") == "Livello - Livello over the last 15min"
    assert in_words("exp(-since / 600)") == "exp(-seconds since the start / 600)"
    assert in_words("exp(-since_stop / 600)") == "exp(-seconds since the stop / 600)"


def test_shares_that_overlap_are_said_to_overlap() -> None:
    place = HeatPlace(
        location="ON", after="W_ON", seconds=(0.0, 240.0), share=0.6, heat=1.0, cycles=(5, 5), p=0.01, correlates=""
    )
    stratum = replace(place, seconds=(0.0, np.inf), share=0.7, correlates="P", when="P above 0.5")
    assert "do not add up: in ON, 0–4 min after W_ON and P above 0.5" in overlap_sentence([place, stratum])
    assert overlap_sentence([place, replace(place, seconds=(240.0, 900.0))]) == ""
    assert overlap_sentence([stratum, replace(stratum, when="P up to 0.5")]) == ""
    assert overlap_sentence([place, replace(stratum, location="OFF")]) == ""
