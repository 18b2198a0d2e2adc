"""The HTML report: whole without anything outside it, nothing from a file is markup, figures where they belong."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from math import nan
from pathlib import Path

import pytest

from sim.lab.formats.find import FoundModel
from sim.lab.judge.campaign import model_jobs
from sim.lab.judge.discovery import Discovery
from sim.lab.judge.free_run import TraceOutcome, TraceRunSettings, run_job
from sim.lab.judge.pictures import drawings
from sim.lab.judge.report import (
    CampaignSummary,
    ModelReport,
    ReportEntry,
    choose_figures,
    error_boxes,
    error_histogram,
    index_html,
    model_html,
)
from sim.lab.judge.results import Interval, TraceResult
from sim.lab.judge.stages import Prepared, Stage, records
from sim.lab.judge.verdicts import gain, summaries, verdict
from sim.lab.pictures import draw
from sim.sha.trace import Trace
from tests.validation.small_plant import location, plant_model, plant_trace

EVIL = '<script>alert(1)</script> & "quotes"'
CAMPAIGN = CampaignSummary("2026-01-01 00:00 UTC", {"runs": "200"})


def prepared(label: str = "plant") -> Prepared:
    model = plant_model("plant", sensor=0.2, sigma=1.0)
    cold = replace(model, sha=replace(model.sha, locations=(location("off", 15.0), location("on", 40.0))))
    parsed = FoundModel(label, model.sha, model, None, (f"note {label}",))
    variants = {"carried": model, "resampled": cold}
    return Prepared(
        label=label,
        where=label,
        parsed=parsed,
        structure=model,
        variants=variants,
        refusals={},
        stages=(),
        discovery=Discovery("by hand", Path(label), ()),
    )


def outcomes(one: Prepared, name: str = "run") -> list[TraceOutcome]:
    """Along three traces and one without a temperature."""
    traces = [replace(plant_trace(f"{name}{number}", noise=0.2, seed=number), synthetic=True) for number in (1, 2, 10)]
    bad = Trace(f"{name}-cold", traces[0].times, {"Motor": traces[0].signals["Motor"]})
    return [run_job(job) for job in model_jobs(one, [*traces, bad], TraceRunSettings(runs=200))]


@pytest.fixture(scope="module")
def html(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report of a model and of traces with nasty names, pictures and all."""
    one = prepared(EVIL)
    done = outcomes(one, EVIL)
    home = tmp_path_factory.mktemp("report")
    wanted = drawings(home / "pictures", done, "T", {})
    for drawing in wanted.values():
        draw(drawing.picture, drawing.png)  # without the PDF, which no report holds
    results = [outcome.result for outcome in done]
    pictures = choose_figures(results, {key: drawing.png for key, drawing in wanted.items()}, home)
    report = ModelReport(
        campaign=CAMPAIGN,
        prepared=one,
        stages=[Stage(1, EVIL, EVIL), *records(EVIL, done)],
        results=results,
        pictures=pictures,
        missing={EVIL: 3},
    )
    return model_html(report)


class Outside(HTMLParser):
    """Collects tags, and every address that a browser would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.fetched += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]


def test_the_report_fetches_nothing_and_holds_its_pictures(html: str) -> None:
    reader = Outside()
    reader.feed(html)
    assert len(reader.fetched) == 6 and all(one.startswith("data:image/png;base64,") for one in reader.fetched)
    assert "url(" not in html and "@import" not in html


def test_no_name_from_outside_becomes_markup(html: str) -> None:
    reader = Outside()
    reader.feed(html)
    assert "script" not in reader.tags and "&lt;script&gt;" in html


def test_the_report_has_each_trace_its_verdict_the_failures_sentence_and_says_synthetic(html: str) -> None:
    assert html.count('class="word failed">failed<') == 4  # the table and the verdicts, two semantics
    assert "has no signal" in html and "SYNTHETIC" in html
    order = [html.index(f"run{number}") if f"run{number}" in html else -1 for number in (1, 2)]
    assert order == sorted(order)
    assert "temperature carried over events" in html


def test_traces_stand_in_the_order_of_their_numbers() -> None:
    done = outcomes(prepared())
    report = ModelReport(
        campaign=CAMPAIGN, prepared=prepared(), stages=[], results=[outcome.result for outcome in reversed(done)]
    )
    names = [one.trace for one, _ in report.judged_results]
    assert names == ["run1", "run2", "run10", "run-cold"] * 2


def test_a_box_lies_where_its_errors_are() -> None:
    (result, *_) = [outcome.result for outcome in outcomes(prepared())]
    boxes = error_boxes([replace(result, error_quantiles=(-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 4.0))])
    assert boxes is not None
    at = {text: x for x, text in boxes.ticks}
    assert {"-2", "-1", "0", "+1", "+4"} <= set(at)
    assert boxes.boxes[0].x[0] == pytest.approx(at["-2"]) and boxes.boxes[0].x[6] == pytest.approx(at["+4"])
    assert boxes.zero == pytest.approx(at["0"]) == pytest.approx(boxes.boxes[0].x[3])


def test_a_bar_counts_the_final_errors_of_its_width() -> None:
    bars = error_histogram([-1.0, -0.4, 0.2, 0.3, 2.6], "°C")
    at = {text: x for x, text in bars.ticks}
    counted = {round(bar.x, 6): bar.count for bar in bars.bars}
    assert sum(counted.values()) == 5 and counted[round(at["+0"], 6)] == 2 and bars.zero == pytest.approx(at["+0"])
    assert (bars.count, bars.mean) == (5, pytest.approx(0.34)) and bars.sigma == pytest.approx(1.3667, abs=1e-4)
    assert min(bar.y for bar in bars.bars) == next(bar.y for bar in bars.bars if bar.count == 2)
    assert sum(bar.count for bar in error_histogram([3.0] * 5, "°C").bars) == 5
    assert sum(bar.count for bar in error_histogram([0.0] * 5, "°C").bars) == 5


def test_a_histogram_and_mean_and_sigma_stand_in_the_report_from_five_traces_on() -> None:
    (result, *_) = [outcome.result for outcome in outcomes(prepared())]
    final = [(f"t{number}", 0.5 * number) for number in range(5)]
    results = [replace(result, trace=trace, final_error=error, seen="no", level=20.0) for trace, error in final]
    report = ModelReport(campaign=CAMPAIGN, prepared=prepared(), stages=[], results=results)
    page = model_html(report)
    assert "unseen traces: +1.00 ± 0.79 °C, 5 traces" in page and "MAE in per cent of the readings" in page
    assert f"{result.mae.value:.2f} ± 0.00 °C" in page
    assert "Histogram" not in model_html(replace(report, results=results[:4]))


@pytest.mark.parametrize("quantiles", [(0.0,) * 7, (5.0,) * 7, (-1e-9,) * 7, (1e6,) * 7])
def test_boxes_without_width_are_drawn_all_the_same(quantiles: tuple[float, ...]) -> None:
    (result, *_) = [outcome.result for outcome in outcomes(prepared())]
    boxes = error_boxes([replace(result, error_quantiles=quantiles)])
    assert boxes is not None and all(0 <= x <= boxes.width for x in boxes.boxes[0].x)
    assert error_boxes([]) is None


def test_verdicts_have_reasons_and_a_good_trace_has_none() -> None:
    own, thesis = (
        [one.result for one in outcomes(prepared()) if one.result.semantics == name]
        for name in ("carried", "resampled")
    )
    assert verdict(own[0]).word == "good" and verdict(own[0]).reasons == ()
    assert verdict(own[-1]).word == "failed" and verdict(own[-1]).reasons[0].startswith("stage 5: ")
    off = verdict(thesis[0])
    assert off.word == "review" and any("three sigma" in reason for reason in off.reasons)


def test_the_gain_is_counted_on_the_traces_that_both_semantics_have() -> None:
    results = [one.result for one in outcomes(prepared())]
    found = gain(results)
    assert found is not None and (found.traces, found.wins) == (3, 3)
    assert found.carried.mae < found.resampled.mae and f"{found.resampled.mae:.3f}" in found.sentence
    assert gain([one for one in results if one.semantics == "carried"]) is None


def test_the_index_links_each_report_by_its_folder() -> None:
    one = prepared()
    entry = ReportEntry(
        "plant",
        ModelReport(campaign=CAMPAIGN, prepared=one, stages=[], results=[outcome.result for outcome in outcomes(one)]),
    )
    text = index_html(CAMPAIGN, [entry], [Stage(1, "plant", "found")])
    assert re.findall(r'href="([^"]+)"', text) == ["plant/report.html"] * 2


def test_what_stands_first_is_of_traces_that_the_model_has_not_seen() -> None:
    one, (first, second, *_) = prepared(), [outcome.result for outcome in outcomes(prepared())]
    worse = replace(second, mae=Interval(3.92))
    seen, unseen, unknown = replace(first, seen="content"), replace(worse, seen="no"), replace(second, seen="unknown")

    def text(*results: TraceResult) -> str:
        return model_html(ModelReport(campaign=CAMPAIGN, prepared=one, stages=[], results=results))

    mixed = text(seen, unseen)
    assert mixed.index("Unseen traces") < mixed.index("3.92") < mixed.index("In-sample (the model was learned")
    assert 'class="notice"><b>In-sample' not in mixed
    assert mixed.index(f'>{unseen.trace}&nbsp;*</td><td class="l">no<') < mixed.index('<td class="l">yes<')
    assert 'class="notice"><b>In-sample' in text(seen, replace(seen, trace="other", seen="name"))
    assert 'class="notice"><b>Not known what was seen' in text(unknown)
    assert [each.sample for each in summaries([seen, unseen, unknown])] == ["unseen", "not known", "in-sample"]


def test_a_last_reading_of_0_has_no_per_cent() -> None:
    """The error in per cent of 0 is no number, and `nan %` no words."""
    one = prepared()
    done = outcomes(one)
    cold = [replace(each, result=replace(each.result, final_percent=nan)) for each in done]
    stages = records(one.label, cold)
    assert "(–), coverage" in stages[-1].found
    results = [outcome.result for outcome in cold]
    page = model_html(ModelReport(campaign=CAMPAIGN, prepared=one, stages=stages, results=results))
    assert "<span>final error</span>" in page
    assert "nan" not in page.replace("</", "") and "– %" not in page
