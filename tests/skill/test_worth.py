"""Where a model is worth its trouble and where persistence is better, said plainly from forecasts that are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri

from sim.forecast.ensemble import DENSE_LEVELS
from sim.lab.judge.rows import MIN_FORECASTS, SkillRow, independent
from sim.lab.judge.worth import forecast_skill

NORMAL = ndtri(np.array(DENSE_LEVELS))


def rows(horizon: float, machine: str = "A", **errors: float) -> list[SkillRow]:
    """Forecasts of each method that miss every outcome by its error (degC), at ten moments a horizon apart."""
    return [
        SkillRow(
            machine=machine,
            trace="A",
            method=method,
            horizon=horizon,
            origin=horizon * moment,
            outcome=40.0,
            quantiles=40.0 + error + 0.1 * NORMAL,
        )
        for method, error in errors.items()
        for moment in range(10)
    ]


def test_it_is_said_at_which_horizons_the_model_is_not_worth_its_trouble() -> None:
    made = rows(900.0, ours=0.5, persistence=5.0) + rows(60.0, ours=1.0, persistence=0.5)
    found = forecast_skill(made + rows(300.0, ours=1.0, persistence=1.0), ["ours"])
    assert [each.verdict for each in found.worth] == ["worse", "as good", "better"]
    assert found.sentences == [
        "at 60 s persistence is better (CRPS 0.444 against 0.944 °C): the model is not worth its trouble there",
        "at 300 s persistence is as good (CRPS 0.944 against 0.944 °C): the model is not worth its trouble there",
        "at 900 s the model is better than persistence (CRPS 0.444 against 4.94 °C)",
    ]
    plain = found.as_plain()
    assert plain["sentences"] == found.sentences and plain["worth"][0]["verdict"] == "worse"
    by_horizon = {(row["horizon"], row["method"]): row for row in plain["by horizon"]}
    assert by_horizon[60.0, "ours"]["mae"] == pytest.approx(1.0)


def test_a_machine_is_named_where_it_says_otherwise_and_the_best_other_method_is() -> None:
    made = rows(60.0, "A", ours=0.5, persistence=5.0, trees=2.0) + rows(60.0, "B", ours=1.0, persistence=0.3, trees=2.0)
    found = forecast_skill(made, ["ours"], unit="kW")
    assert len(found.sentences) == 2
    assert found.sentences[0].startswith("at 60 s the model is better than trees (CRPS ")
    assert found.sentences[1].startswith("on B at 60 s persistence is better (CRPS 0.24")
    assert found.sentences[1].endswith(" kW): the model is not worth its trouble there")


def test_several_models_are_named_and_methods_without_a_common_moment_are_not_compared() -> None:
    two = forecast_skill(rows(60.0, one=0.5, two=9.0, persistence=2.0), ["one", "two"])
    assert [sentence.partition(":")[0] for sentence in two.sentences] == ["one", "two"]
    apart = rows(60.0, ours=1.0) + [replace(row, origin=row.origin + 1.0) for row in rows(60.0, persistence=1.0)]
    found = forecast_skill(apart, ["ours"], notes=["first"])
    assert found.worth == () and found.sentences == []
    assert found.notes == ("first", "the methods have no forecast for the same moment, so they cannot be compared")


def test_moments_at_which_nothing_was_read_are_counted_and_of_few_others_nothing_is_known() -> None:
    made = [replace(row, origin=100.0 * at) for at, row in enumerate(rows(100.0, ours=0.5) * 4)]
    made += [replace(row, method="persistence", quantiles=row.quantiles + 5.0) for row in made]
    for lost, verdict in ((0, "better"), (12, "better"), (25, "not known")):
        found = forecast_skill(
            [replace(row, outcome=np.nan) if row.origin < 100.0 * lost else row for row in made], ["ours"]
        )
        assert [each.verdict for each in found.worth] == [verdict] and found.worth[0].due == 40
        said = f"at 100 s {40 - lost} of 40 moments have an outcome"
        assert any(note.startswith(said) for note in found.notes) == (lost > 0)
    assert "15 of 40 moments have an outcome" in found.sentences[0]


def test_moments_that_a_rival_was_not_asked_at_are_not_taken_for_unread_ones() -> None:
    own = [replace(row, origin=60.0 * at) for at, row in enumerate(rows(60.0, ours=0.5) * 4)]
    beside = [replace(row, method="persistence", quantiles=row.quantiles + 5.0) for row in own[::4]]
    (found,) = forecast_skill(own + beside, ["ours"]).worth
    assert (found.verdict, found.due, found.scored) == ("better", 10, 10)


def test_a_method_of_which_nothing_was_read_does_not_keep_the_others_from_being_compared() -> None:
    unread = [replace(row, trace="B", outcome=np.nan) for row in rows(60.0, third=0.5)]
    found = forecast_skill(rows(60.0, ours=0.5, persistence=5.0) + unread, ["ours"])
    assert [each.verdict for each in found.worth] == ["better"]


@pytest.mark.parametrize(
    ("step", "count", "worth"),
    [(30.0, 4, "1.1"), (30.0, 31, "2"), (900.0, 7, "7"), (9000.0, 7, "7"), (449.0, 15, "7.9")],
)
def test_from_few_forecasts_that_do_not_overlap_nothing_is_known(step: float, count: int, worth: str) -> None:
    made = [
        replace(row, origin=step * moment)
        for row in rows(900.0, ours=0.5, persistence=5.0)[::10]
        for moment in range(count)
    ]
    (found,) = forecast_skill(made, ["ours"]).worth
    assert (found.verdict, found.scored) == ("not known", count) and found.independent < MIN_FORECASTS
    assert forecast_skill(made, ["ours"]).sentences == [
        "at 900 s it is not known whether the model is better than persistence (CRPS 0.444 against 4.94 °C): "
        f"{count} forecasts had an outcome, worth {worth} that do not overlap; 8 is the fewest that tell"
    ]


def test_traces_and_machines_count_together_and_a_machine_of_which_nothing_is_known_has_no_sentence() -> None:
    few = [row for row in rows(60.0, "B", ours=1.0, persistence=0.3) if row.origin < 240.0]
    own = [row for row in few if row.method == "ours"]
    assert independent(own) == 4.0 and independent([]) == 0.0
    assert independent([*own, *(replace(row, trace="other") for row in own)]) == 8.0
    found = forecast_skill([*rows(60.0, "A", ours=0.5, persistence=5.0), *few], ["ours"])
    assert [(each.machine, each.verdict) for each in found.worth] == [
        ("", "better"),
        ("A", "better"),
        ("B", "not known"),
    ]
    assert [sentence.partition(" (")[0] for sentence in found.sentences] == [
        "at 60 s the model is better than persistence"
    ]
