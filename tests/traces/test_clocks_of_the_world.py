"""Clocks that a person reads at once: durations that say their units, halves of the day and names of many languages."""

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from sim.lab.recordings.clock_words import plain_time
from tests.traces.exports import BEGIN, STEP, recording, wide
from tests.traces.test_dialects import EPOCH, asked, is_the_plant, mapped

SPOKEN: dict[str, Callable[[int], str]] = {
    "seconds": lambda s: f"{s} sec",
    "hours and minutes": lambda s: f"{s // 3600} hr {s // 60 % 60} min {s % 60} s",
    "controller": lambda s: f"T#{s // 60}m{s % 60}s0ms",
    "ISO 8601": lambda s: f"PT{s // 60}M{s % 60}S",
    "thousandths": lambda s: f"{s * 1000}ms",
}


@pytest.mark.parametrize("form", SPOKEN)
def test_an_elapsed_time_whose_parts_say_their_units(form: str, tmp_path: Path) -> None:
    """The plant's rows are 10 s apart, whatever a program calls them."""
    export = wide(tmp_path / "e.csv", clock=lambda t: SPOKEN[form](int((t - BEGIN).total_seconds())))
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert report.refused == 0


@pytest.mark.parametrize(("per_second", "unit"), [(1e3, "ms"), (1e6, "us")])
def test_elapsed_times_of_no_unit_that_are_hardly_seconds_are_asked_for(
    per_second: float, unit: str, tmp_path: Path
) -> None:
    """They were read as seconds: ten thousand from row to row, and a model of a plant that takes months to warm."""
    export = wide(tmp_path / "e.csv", clock=lambda t: f"{(t - BEGIN).total_seconds() * per_second:.0f}")
    assert f"--unit Time={unit}" in asked(export, tmp_path / "m.toml")
    for place, option in enumerate((["--yes"], ["--unit", f"Time={unit}"])):
        (trace,), _, _ = mapped(export, tmp_path / f"m{place}.toml", *option)
        is_the_plant(trace, tmp_path / f"m{place}.toml")
    (trace,), _, _ = mapped(export, tmp_path / "seconds.toml", "--unit", "Time=s")
    assert trace.times[1] - trace.times[0] == pytest.approx(STEP * per_second)
    done = asked(export, tmp_path / "none.toml", "--unit", "Time=degC")
    assert "s, ms, us" in done


def _halves(form: str, morning: str, afternoon: str) -> Callable[[datetime], str]:
    return lambda t: form.format(
        day=t, hour=t.hour % 12 or 12, clock=f"{t:%M:%S}", half=morning if t.hour < 12 else afternoon
    )


HALVES = {
    "Zeit": _halves("{day:%d.%m.%Y} {hour}:{clock} {half}", "vorm.", "nachm."),
    "Tid": _halves("{day:%Y-%m-%d} {hour}:{clock} {half}", "fm", "em"),
    "Ώρα": _halves("{day:%d/%m/%Y} {hour}:{clock} {half}", "π.μ.", "μ.μ."),
    "Idő": _halves("{day:%Y. %m. %d.} {half} {hour}:{clock}", "de.", "du."),
    "일시": _halves("{day:%Y. %m. %d.} {half} {hour}:{clock}", "오전", "오후"),
    "Čas": _halves("{day:%d. %m. %Y} {hour}:{clock} {half}", "dop.", "odp."),
    "Aika": lambda t: f"{t.day}.{t.month}.{t.year} klo {t.hour}.{t:%M.%S}",
    "Tarih": _halves("{day:%d.%m.%Y} {hour}:{clock} {half}", "ÖÖ", "ÖS"),
}


@pytest.mark.parametrize("name", HALVES)
def test_halves_of_the_day_and_dates_of_more_languages(name: str, tmp_path: Path) -> None:
    """Over noon: an afternoon that is not understood is no morning."""
    plant = recording()
    late = timedelta(hours=1, minutes=45)
    export = wide(tmp_path / "e.csv", header=f"{name};Temp bearing;Motor current;Running", mark=";",
                  clock=lambda t: HALVES[name](t + late))  # fmt: skip
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert report.refused == 0 and trace.times[0] == (plant.moments[0] + late - EPOCH).total_seconds()


def test_small_words_of_other_languages_stay_what_they_are() -> None:
    assert plain_time("de 13 marzo de 2024 9:58") == "13 Mar 2024 9:58"
    assert plain_time("Mi 13. März 2024 09:58:00 Uhr") == "13 Mar 2024 09:58:00"
    assert plain_time("2024. 3. 13. 오후 1:58:00") == "2024.3.13 1:58:00 PM"
