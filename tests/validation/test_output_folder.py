"""The folder of a campaign: what is refused, what is replaced, and results that come back as they went."""

import json
from dataclasses import replace
from math import isnan, nan
from pathlib import Path

import pytest

from sim.engine.open_loop_run import Score
from sim.lab.judge.output_folder import (
    check_folder,
    claim_folder,
    hold_folder,
    places,
    read_results,
    results_csv,
    results_json,
)
from sim.lab.judge.results import Interval, TraceResult

FULL = TraceResult(
    "plant",
    "cd1",
    "carried",
    synthetic=True,
    events=47,
    at_events=Score(0.4, 0.3, -0.1, 47),
    mae=Interval(0.5, 0.4, 0.6),
    flags=("clamps: 3", 'it said, "no"'),
    error_quantiles=(-1.0, -0.5, 0.0, 0.1, 0.2, 0.3, 1.0),
)
FAILED = TraceResult("plant", "cd2", "carried", stage=5, failure="it has no reading")


def same(left: TraceResult, right: TraceResult) -> bool:
    return repr(left) == repr(right)  # NaN is not equal to itself, and is the same all the same


def test_results_come_back_as_they_were_written(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(results_json([FULL, FAILED]), encoding="utf-8")
    assert all(same(*pair) for pair in zip(read_results(tmp_path), [FULL, FAILED], strict=True))
    assert isnan(read_results(tmp_path / "results.json")[1].mae.value)


def test_json_is_strict_and_csv_has_a_column_a_number() -> None:
    def refuse(word: str) -> None:
        raise AssertionError(word)

    json.loads(results_json([replace(FULL, crps=nan)]), parse_constant=refuse)
    header, first, second = results_csv([FULL, FAILED]).splitlines()
    assert {"mae", "mae_low", "mae_high", "at_events_count", "dense_rmse"} <= set(header.split(","))
    assert len(header.split(",")) == len(second.split(",")) and "nan" not in first + second


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"results": [3]}', '{"results": [{"model": "m"}]}', "\x00"])
def test_what_is_no_results_file_is_one_sentence(text: str, tmp_path: Path) -> None:
    file = tmp_path / "results.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"results\.json: these are no results"):
        read_results(file)
    with pytest.raises(ValueError, match="cannot be read"):
        read_results(tmp_path / "none.json")


def test_a_new_or_an_empty_folder_is_taken_and_marked_as_running(tmp_path: Path) -> None:
    for out in (tmp_path, tmp_path / "a" / "b"):
        assert check_folder(out, overwrite=False) == []
        claim_folder(out, [], ["plant"], {"seed": 1})
        assert json.loads((out / "campaign.json").read_text(encoding="utf-8"))["state"] == "running"


def test_a_campaign_json_of_another_kind_is_refused(tmp_path: Path) -> None:
    for text in ("{}", "not JSON", "[1]"):
        (tmp_path / "campaign.json").write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match="no campaign of ours"):
            check_folder(tmp_path, overwrite=True)


def test_only_what_a_campaign_writes_is_stale_whatever_its_json_claims(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "report.html").touch()
    out = tmp_path / "out"
    claim_folder(out, [], ["plant"], {})
    document = json.loads((out / "campaign.json").read_text(encoding="utf-8"))
    document["folders"] = {"plant": "plant", "evil": "../outside", "odd": 3}
    (out / "campaign.json").write_text(json.dumps(document), encoding="utf-8")
    (out / "plant" / "pictures").mkdir(parents=True)
    for name in (
        "plant/report.html",
        "plant/01_discovery.json",
        "plant/pictures/cd1.png",
        "plant/mine.txt",
        "mine.csv",
    ):
        (out / name).touch()
    stale = [str(file.relative_to(out)) for file in check_folder(out, overwrite=True)]
    assert stale == ["plant/01_discovery.json", "plant/pictures/cd1.png", "plant/report.html"]


def test_names_become_harmless_and_different_parts_of_a_path() -> None:
    found = places(["../../etc", "a/b", "A B", "a b", "", "x" * 300])
    assert len({name.casefold() for name in found.values()}) == 6
    assert all(name and "/" not in name and not name.startswith(".") and len(name) < 90 for name in found.values())


def test_a_folder_is_held_by_one_campaign_and_free_again_whatever_ended_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(RuntimeError), hold_folder(out):
        with pytest.raises(ValueError, match="another command is writing there"), hold_folder(out):
            raise AssertionError("two campaigns in one folder")
        raise RuntimeError
    with hold_folder(out):
        assert list(out.iterdir()) == []  # the lock leaves nothing behind
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"file: cannot be written \(file exists\)"), hold_folder(tmp_path / "file"):
        pass


def test_results_that_were_changed_after_the_campaign_was_sealed_are_refused(tmp_path: Path) -> None:
    folder = claim_folder(tmp_path, [], ["plant"], {})
    folder.write("results.json", results_json([FULL]))
    folder.write("plant/04_model_generation.json", "{}")
    folder.write("plant/pictures/cd1.png", "")
    seal = folder.seal()
    listed = (tmp_path / "campaign.sha256").read_text(encoding="utf-8")
    assert {line[66:] for line in listed.splitlines()[:-1]} >= {"results.json", "plant/04_model_generation.json"}
    assert listed.endswith(f"# seal {seal}\n")
    (tmp_path / "plant/pictures/cd1.png").unlink()  # is not read
    assert same(*read_results(tmp_path), FULL)
    for name in ("results.json", "plant/04_model_generation.json"):
        (tmp_path / name).write_text(results_json([replace(FULL, crps=0.1)]), encoding="utf-8")
        with pytest.raises(ValueError, match=f"{name}: was changed, after the campaign was sealed"):
            read_results(tmp_path)
    with pytest.raises(ValueError, match="after the campaign was sealed"):
        read_results(tmp_path / "results.json")


def test_results_of_an_earlier_release_have_the_level_of_their_last_reading(tmp_path: Path) -> None:
    former = json.loads(results_json([replace(FULL, final_error=-2.0, final_percent=4.0)]))
    del former["results"][0]["level"]
    (tmp_path / "results.json").write_text(json.dumps(former), encoding="utf-8")
    assert read_results(tmp_path)[0].level == pytest.approx(50.0)


def test_what_can_no_longer_be_written_is_named(tmp_path: Path) -> None:
    folder = claim_folder(tmp_path, [], ["plant"], {})
    (tmp_path / "plant").touch()
    with pytest.raises(ValueError, match=r"plant/report\.html: cannot be written \(.*begin again with --overwrite"):
        folder.write("plant/report.html", "")
