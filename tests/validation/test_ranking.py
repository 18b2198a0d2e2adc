"""Ranking: known scores, wins, tests and criteria; what few traces cannot tell is said; the order does not matter."""

import json
from collections.abc import Sequence
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.engine.open_loop_run import Score
from sim.lab.judge.differences import compare_pairs, holm
from sim.lab.judge.fitness import CRITERIA, Facts, FitnessLimits, fitness_verdict, judge, parse_limits
from sim.lab.judge.ranking import Ranking, Weights, rank, score
from sim.lab.judge.ranking_page import as_plain, draw_ranking, page, spreads, win_matrix
from sim.lab.judge.results import Seen, TraceResult

KNOWN = Facts(synthetic=False, verified=True)


def result(model: str, trace: str, mae: float = 1.0, **changes: object) -> TraceResult:
    """A result without a fault; every error figure grows with `mae`."""
    made = TraceResult(
        model,
        trace,
        "carried",
        readings=100,
        accepted=True,
        at_samples=Score(mae, mae, 0.0, 100),
        max_error=3.0 * mae,
        error_sigma=0.5 * mae,
        coverage=0.9,
        crps=0.7 * mae,
        persistence=10.0,
        seen="no",
        level=50.0,
        error_quantiles=tuple(mae * quantile for quantile in (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)),
    )
    return replace(made, **changes)


def campaign(count: int = 8, **maes: float) -> list[TraceResult]:
    return [result(model, f"t{n}", mae * (1 + 0.01 * n)) for model, mae in maes.items() for n in range(count)]


def finding(
    results: list[TraceResult], criterion: str, facts: Facts = KNOWN, limits: FitnessLimits | None = None
) -> object:
    return {one.criterion: one for one in judge(results, facts, limits or FitnessLimits())}[criterion].kept


def test_the_score_is_the_weighted_sum() -> None:
    one = result("a", "t", 2.0)
    assert score(one, Weights()) == pytest.approx(0.5 * 2 + 0.3 * 6 + 0.2 * 1)
    assert score(one, Weights(0, 1, 0)) == 6.0
    assert score(replace(one, max_error=nan), Weights(1, 0, 0)) == 2.0


@pytest.mark.parametrize("weights", [(0, 0, 0), (-1, 1, 1), (nan, 1, 1)])
def test_weights_that_make_no_score_are_refused(weights: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="weights of the score"):
        Weights(*weights)


def test_the_best_is_first_and_eight_clean_wins_are_told_for_three_models() -> None:
    found = rank(campaign(middle=2.0, worst=3.0, best=1.0))
    assert [(one.entrant, one.rank, one.wins) for one in found.standings] == [
        ("best", 1, 8.0),
        ("middle", 2, 0.0),
        ("worst", 3, 0.0),
    ]
    # 2 / 2^8 is the least that eight traces give; three equal p-values all count three times (Holm).
    assert [pair.p for pair in found.pairs] == pytest.approx([3 / 128] * 3)
    assert {(pair.better, pair.wins) for pair in found.pairs} == {("best", (8.0, 0.0)), ("middle", (8.0, 0.0))}
    names, wins = win_matrix(found)
    assert names == ("best", "middle", "worst")
    assert np.nan_to_num(wins).tolist() == [[0, 8, 8], [0, 0, 8], [0, 0, 0]]


def test_of_few_traces_it_says_that_nothing_can_be_told() -> None:
    found = rank(campaign(5, good=1.0, bad=9.0))
    assert found.pairs[0].better is None
    assert found.pairs[0].sentence.startswith("nothing can be told from 5 traces: even if one were better on all")
    assert rank(campaign(6, good=1.0, bad=9.0)).pairs[0].better == "good"
    assert rank(campaign(6, good=1.0, bad=9.0, ugly=20.0)).pairs[0].better is None  # three pairs need seven traces


def test_equal_models_share_a_rank_and_their_wins_and_are_not_told_apart() -> None:
    found = rank(campaign(a=1.0, b=1.0))
    assert [(one.rank, one.wins) for one in found.standings] == [(1, 4.0), (1, 4.0)]
    assert (found.pairs[0].sentence, found.pairs[0].p, found.pairs[0].wins) == ("not told apart", 1.0, (4.0, 4.0))


def test_models_are_compared_on_the_traces_that_all_have_and_a_broken_one_takes_none_away() -> None:
    results = campaign(a=1.0, b=2.0)
    results[3] = replace(results[3], failure="no reading", stage=5)
    results += [result("broken", f"t{n}", nan, failure="cannot run", stage=4) for n in range(8)]
    found = rank(results)
    assert found.common == ("t0", "t1", "t2", "t4", "t5", "t6", "t7")
    assert [(one.entrant, one.rank, one.failed) for one in found.standings] == [
        ("a", 1, 1),
        ("b", 2, 0),
        ("broken", None, 8),
    ]
    assert found.pairs[0].difference.n == 7
    assert any("not compared on t3" in note and " a" in note for note in found.notes)
    assert any(note.startswith("broken has no figure") for note in found.notes)


def test_without_a_common_trace_there_is_no_order() -> None:
    found = rank([result("a", "t1"), result("b", "t2")])
    assert [one.rank for one in found.standings] == [None, None]
    assert found.pairs[0].sentence == "nothing can be told: they have no trace in common"


def test_both_semantics_of_one_model_are_ranked_apart() -> None:
    both = [*campaign(m=1.0), *(replace(one, semantics="resampled") for one in campaign(m=2.0))]
    assert [one.entrant for one in rank(both).standings] == ["m (carried)", "m (resampled)"]


@pytest.mark.parametrize(
    ("results", "words"),
    [([], "there is no result to rank"), ([result("a", "t"), result("a", "t")], "two results on the trace 't'")],
)
def test_what_cannot_be_ranked_is_refused(results: list[TraceResult], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        rank(results)


def plain(ranking: Ranking) -> dict[str, tuple[int | None, float, float]]:
    return {one.entrant: (one.rank, round(one.score, 9), round(one.wins, 9)) for one in ranking.standings}


@settings(max_examples=20, deadline=None)
@given(st.randoms(use_true_random=False))
def test_the_ranking_does_not_depend_on_the_order_of_the_results(random: object) -> None:
    results = campaign(a=1.0, b=1.3, c=2.0)
    shuffled = results.copy()
    random.shuffle(shuffled)
    assert plain(rank(shuffled)) == plain(rank(results))


def test_holm_gives_the_known_corrections() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_the_paired_interval_covers_its_mean_in_about_95_percent_and_the_test_keeps_its_level() -> None:
    rng = np.random.default_rng(5)
    found = [compare_pairs(rng.normal(0.3, 1.0, 17), rng, resamples=400) for _ in range(300)]
    covered = np.mean([one.low <= 0.3 <= one.high for one in found])
    assert 0.87 <= covered <= 0.97  # the percentile interval of 17 values covers a little less than it says
    null = [compare_pairs(rng.normal(0.0, 1.0, 17), rng, resamples=10).p for _ in range(400)]
    assert 0.02 <= np.mean(np.array(null) < 0.05) <= 0.08


@pytest.mark.parametrize(
    ("change", "criterion", "kept"),
    [
        ({}, "clamps", True),
        ({"clamps": 1}, "clamps", False),
        ({"accepted": False, "rejected": "event 3"}, "accepted", False),
        ({"failure": "no reading", "stage": 5}, "passed", False),
        ({"max_error": 700.0}, "diverging", False),
        ({"max_error": nan}, "diverging", False),
        ({"coverage": 0.1}, "coverage", False),
        ({"coverage": 1.0}, "coverage", True),
        ({"persistence": 0.1}, "persistence", False),
        ({"persistence": nan}, "persistence", True),
    ],
)
def test_one_trace_decides_a_criterion(change: dict[str, object], criterion: str, kept: bool) -> None:
    others = 1 if criterion in ("coverage", "persistence") and change.get("coverage") != 1.0 else 5
    results = [result("m", "odd", **change), *(result("m", f"t{n}") for n in range(others))]
    if change.get("persistence") == 0.1:
        results = results[:1]
    assert finding(results, criterion) is kept


@pytest.mark.parametrize(
    ("facts", "criterion", "kept"),
    [
        (Facts(), "verified", None),
        (Facts(verified=False, gate="T grows"), "verified", False),
        (Facts(verified=True), "verified", True),
        (Facts(), "from a plant", None),
        (Facts(synthetic=True), "from a plant", False),
        (Facts(synthetic=False), "from a plant", True),
    ],
)
def test_what_is_known_of_the_model_decides_a_criterion(facts: Facts, criterion: str, kept: bool | None) -> None:
    assert finding([result("m", "t0"), result("m", "t1")], criterion, facts) is kept


@pytest.mark.parametrize(
    ("seen", "kept"),
    [
        (("content", "name"), False),
        (("content", "no"), True),
        (("unknown", "unknown"), None),
        (("unknown", "no"), True),
    ],
)
def test_unseen_traces_are_those_that_are_known_to_be(seen: tuple[Seen, Seen], kept: bool | None) -> None:
    assert finding([result("m", f"t{n}", seen=each) for n, each in enumerate(seen)], "unseen") is kept


def test_fit_limited_and_unfit_follow_from_the_findings() -> None:
    results = [result("m", "t0")]
    assert fitness_verdict(judge(results, KNOWN, FitnessLimits())).word == "fit"
    assert fitness_verdict(judge(results, Facts(), FitnessLimits())).word == "limited"
    assert fitness_verdict(judge(results, replace(KNOWN, verified=False), FitnessLimits())).word == "unfit"
    assert [one.criterion for one in judge(results, KNOWN, FitnessLimits())] == list(CRITERIA)


def test_whatever_is_not_kept_says_what_to_do_next() -> None:
    results = [result("m", "t0", coverage=0.2, seen="unknown")]
    unfit = fitness_verdict(judge(results, KNOWN, FitnessLimits())).sentence
    assert (
        unfit.startswith("unfit: 20.0 % of the readings in the 90 % band") and "; next: learn with more traces" in unfit
    )
    limited = fitness_verdict(judge([result("m", "t0", seen="unknown")], KNOWN, FitnessLimits())).sentence
    assert limited.startswith("limited: the model does not say which traces") and "that it has not seen" in limited
    assert fitness_verdict(judge([result("m", "t0")], KNOWN, FitnessLimits())).sentence == "fit"


def test_an_error_in_per_cent_of_the_readings_has_a_limit_and_stands_beside_the_score() -> None:
    hot, cold = result("m", "hot", 2.0), result("m", "cold", 2.0, level=2.5)
    assert finding([hot], "acceptable") is True and finding([hot, cold], "acceptable") is False  # 4 %, 80 %
    assert finding([hot, cold], "acceptable", limits=parse_limits([("percent", "90")])) is True
    assert (
        finding([replace(hot, level=nan)], "acceptable") is None
        and finding([replace(hot, level=0.0)], "acceptable") is None
    )
    standing = rank([hot, cold]).standings[0]
    assert standing.score == pytest.approx(3.0) and standing.score_percent == pytest.approx((6.0 + 120.0) / 2)
    ranking = rank([hot, cold, result("m", "still", 2.0, level=0.0)])
    assert ranking.standings[0].score_percent == pytest.approx((6.0 + 120.0) / 2)
    assert ranking.standings[0].percent_traces == 2
    assert any(note.startswith("S % leaves out 1 of 3 traces: their readings are all 0") for note in ranking.notes)


def test_coverage_and_persistence_are_judged_on_traces_that_were_not_trained_on() -> None:
    good, bad = result("m", "one", coverage=0.9), result("m", "other", coverage=0.2)
    assert finding([replace(good, seen="content"), replace(bad, seen="no")], "coverage") is False
    assert finding([replace(good, seen="no"), replace(bad, seen="content")], "coverage") is True


def test_limits_come_from_names_and_numbers() -> None:
    found = parse_limits([("coverage_low", "0.5"), ("clamps", "3")], synthetic=True)
    assert found == FitnessLimits(coverage_low=0.5, clamps=3.0, synthetic=True)
    for pairs, words in (
        ([("clamp", "3")], "no limit 'clamp'; there are coverage_low"),
        ([("clamps", "few")], "limit clamps is 'few'"),
        ([("coverage_low", "1.5")], "two ascending shares"),
        ([("largest", "nan")], "must be positive"),
        ([("clamps", "nan")], "counts"),
    ):
        with pytest.raises(ValueError, match=words):
            parse_limits(pairs)


def test_in_sample_is_said_beside_the_model_and_that_it_is_favoured() -> None:
    def first_seen(results: Sequence[TraceResult], how: Seen) -> list[TraceResult]:
        """The results of model a on the first trace as of one that it was trained on."""
        return [replace(one, seen=how) if (one.model, one.trace) == ("a", "t0") else one for one in results]

    found = rank(first_seen(campaign(a=1.0, b=2.0), "content"), {"a": KNOWN, "b": KNOWN})
    assert [one.in_sample for one in found.standings] == ["in-sample (1 of 8 traces)", ""]
    assert any(note.startswith("in-sample: a saw") for note in found.notes)
    by_name = rank(first_seen(campaign(a=1.0), "name"), {"a": KNOWN})
    assert by_name.standings[0].in_sample == "in-sample (1 of 8 traces, by name)"


def test_the_pooled_errors_are_the_quantiles_of_all_readings() -> None:
    rng = np.random.default_rng(0)
    samples = [rng.normal(0.0, 1.0, 4000), rng.normal(3.0, 0.5, 1000)]
    results = [
        result(
            "m",
            f"t{n}",
            readings=one.size,
            error_quantiles=tuple(np.quantile(one, [0, 0.05, 0.25, 0.5, 0.75, 0.95, 1])),
        )
        for n, one in enumerate(samples)
    ]
    (found,) = spreads(rank(results), results)
    exact = np.quantile(np.concatenate(samples), [0.05, 0.25, 0.5, 0.75, 0.95])
    assert found.levels == pytest.approx(exact, abs=0.15)  # seven quantiles a trace stand for its law
    assert (found.low, found.high) == (samples[0].min(), max(one.max() for one in samples))


def test_the_page_stands_alone_escapes_names_and_names_every_failed_criterion(tmp_path: Path) -> None:
    results = [*campaign(**{"<b>$odd$": 1.0, "bad": 9.0}), result("broken", "t0", nan, failure="<script>", stage=4)]
    ranking = rank(results, {"bad": replace(KNOWN, verified=False, gate="T grows without bound")})
    text = page(ranking, results)
    assert "&lt;b&gt;$odd$" in text and "<b>$odd$" not in text and "<script" not in text
    assert "T grows without bound" in text and "<svg" in text and "src=" not in text and 'href="http' not in text
    assert page(ranking, results).count("<h3>") == 3
    assert draw_ranking(ranking, results, tmp_path / "new" / "r.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="cannot be a picture"):
        draw_ranking(ranking, results, tmp_path / "r.txt")


def test_a_ranking_of_one_broken_model_still_has_a_page() -> None:
    results = [result("broken", "t0", nan, failure="cannot run", stage=4)]
    assert "cannot run" in page(rank(results), results)


def test_the_plain_form_has_all_figures() -> None:
    found = as_plain(rank(campaign(a=1.0, b=2.0)))
    assert {row["entrant"]: row["fitness"] for row in found["models"]} == {"a": "limited", "b": "limited"}
    assert found["scores"]["a"]["t0"] == pytest.approx(0.5 + 0.9 + 0.1)
    assert json.loads(json.dumps(found))["common"] == [f"t{n}" for n in range(8)]
