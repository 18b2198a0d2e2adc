"""The page said "will pass its limit" at 59 degrees and falling, "confidence high" beside a band that held 33 %.

Nor did it show on its first view that something was written to a PLC, or say before an arming what would be.
"""

from itertools import product
from typing import Any, get_args

import pytest

from drivers.device_file import REFUSALS
from drivers.tag import Quality
from gateway.machine.writing.block import SessionWords, Validity, build, read_numbers
from gateway.machine.writing.writeback import Verdict
from gateway.outside.status import read_status
from gateway.outside.texts import LANGUAGES, all_words
from gateway.outside.web import machine_view
from gateway.settings import ALARM_KINDS
from gateway.settings.devices import load_device
from tests.gateway.status_picture import alarm, picture, tag
from tests.gateway.support import EPOCH, MAP, TEMPERATURE

WORDS = all_words()
LABELS = {TEMPERATURE: "gearbox bearing", "decanter": "Decanter 2"}
SHOWN = (
    ("unacknowledged", True, True),
    ("acknowledged", True, True),
    ("returned unacknowledged", False, False),
    ("latched unacknowledged", True, False),
    ("shelved", False, True),
    ("shelved", False, False),
)
"""State, whether it is shown as standing, whether its condition stands."""
HEAT = ("over limit", "predicted over limit", "rising", "anomaly")


def view(language: str = "en", **changes: Any) -> dict[str, Any]:
    return machine_view(WORDS[language], LABELS, read_status(picture(**changes)))


def of_kind(kind: str, state: str = "unacknowledged", *, on: str = TEMPERATURE, **more: Any) -> dict[str, Any]:
    active = state in ("unacknowledged", "acknowledged") or state.startswith("latched")
    row = alarm(f"{kind} {on}", state, active=active) | {"kind": kind, "tag": on, "limit": 80.0}
    return row | {"standing": active, "beyond": active, "own_response": False} | more


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("kind", ALARM_KINDS)
def test_what_an_alarm_tells_is_in_the_present_only_while_it_is_so(kind: str, language: str) -> None:
    texts = WORDS[language].texts
    key = kind.replace(" ", "_")
    for (state, active, stands), beyond in product(SHOWN, (True, False, None)):
        told = of_kind(kind, state, active=active, standing=stands, beyond=beyond)
        for silent in (False, True):
            (row,) = view(language, alarm_summary=[told], link__alive=not silent)["alarms"]
            of_bearing = ALARM_KINDS[kind].subject in ("watched", "predicted")
            so = stands and beyond is True and not (silent and of_bearing)
            assert row["holds"] is so
            assert row["title"].endswith(texts[f"{'kind' if so else 'past'}.{key}"])
            assert (row["sentence"] == row["response"]) is so


def test_what_is_over_stands_apart_without_a_colour_and_says_what_is_now() -> None:
    stood = of_kind("rising", "unacknowledged")
    back = of_kind("over limit", "returned unacknowledged")
    aside = of_kind("sensor noisy", "shelved")
    shown = view(alarm_summary=[back, aside, stood], **{"values__" + TEMPERATURE: tag(59.0)})["alarms"]
    assert [(row["kind"], row["section"], row["level"]) for row in shown] == [
        ("rising", "standing", "alarm"),
        ("over limit", "over", "over"),
        ("sensor noisy", "aside", "normal"),
    ]
    assert shown[1]["title"] == "gearbox bearing: was over its limit"
    assert shown[1]["sentence"] == "now 59.0\u00a0°C"


@pytest.mark.parametrize("language", LANGUAGES)
def test_what_stands_while_nothing_is_known_of_it_is_not_said_as_what_is_over(language: str) -> None:
    texts = WORDS[language]
    past = texts.say("past.over_limit")
    lost = {**picture()["link"], "alive": False}
    broken = {"values__" + TEMPERATURE: tag(412.0, "SENSOR_FAILURE")}
    unknown = f"gearbox bearing: {texts.say('alarm.last_known', title=past)}"
    # A link that is lost, a sensor that breaks during the alarm, a restart with another limit before any reading.
    for told, more in ((True, {"link": lost}), (None, broken), (None, {"scan__age": None})):
        shown = view(language, alarm_summary=[of_kind("over limit", beyond=told)], **more)
        (row,) = shown["alarms"]
        assert (row["section"], row["title"]) == ("standing", unknown)
        assert (row["sentence"], row["otherwise"]) == (texts.say("alarm.not_known_now"), "")
        (temperature,) = shown["temperatures"]
        assert (temperature["value"], temperature["when"][0], temperature["level"]) == (None, "–", "unknown")
        assert temperature["action"] == texts.say("action.look")
    back = of_kind("over limit", "returned unacknowledged", beyond=None)
    (row,) = view(language, alarm_summary=[back], link=lost)["alarms"]
    assert (row["section"], row["title"]) == ("over", f"gearbox bearing: {past}")


def test_two_limits_at_once_are_two_rows_each_with_what_is_to_be_done_about_it() -> None:
    both = [of_kind("over limit"), of_kind("over limit", on="Feed"), of_kind("rising", on="Feed")]
    values = {TEMPERATURE: tag(83.0), "Feed": tag(91.0)}
    shown = view(alarm_summary=both, values=values, watched={"Feed": 90.0}, limit=80.0)
    assert {row["name"]: row["under"] for row in shown["alarms"]} == {
        f"over limit {TEMPERATURE}": "",
        "over limit Feed": "",
        "rising Feed": "over limit Feed",
    }
    assert [(row["level"], row["when"]) for row in shown["temperatures"]] == [
        ("alarm", ["0\u00a0min", "3.0 °C above it"]),
        ("alarm", ["0\u00a0min", "1.0 °C above it"]),
    ]
    assert [row["action"].partition(" ")[0] for row in shown["temperatures"]] == ["gearbox", "Feed"]


def test_one_cause_is_one_row_with_its_parts_below() -> None:
    here = [of_kind(kind, priority=2) for kind in HEAT[1:]] + [of_kind(HEAT[0])]
    more = [of_kind("sensor frozen"), of_kind("rising", on="Feed"), of_kind("anomaly", "returned unacknowledged")]
    rows = view(alarm_summary=here + more)["alarms"]
    under = {row["name"]: row["under"] for row in rows if row["section"] == "standing"}
    assert under == {
        f"over limit {TEMPERATURE}": "",
        **{f"{kind} {TEMPERATURE}": f"over limit {TEMPERATURE}" for kind in HEAT[1:]},
        f"sensor frozen {TEMPERATURE}": "",
        "rising Feed": "",
    }
    assert [row["under"] for row in rows if row["section"] == "over"] == [""], "what is over is no part of what stands"
    assert rows[0]["kind"] == "over limit", "the most urgent is the row"


def armed(**more: Any) -> dict[str, Any]:
    device = load_device(MAP)
    layout = device.writeback
    assert layout is not None
    values = {"temperature_now": -3.25, "band_low": -4.0, "p_limit": 0.25, "horizon": 900.0, "horizon_median": 46.0}
    session = SessionWords(challenge=77, writer=4711, sequence=1, heartbeat=1)
    words = build(layout, values, Validity.USABLE, session).words
    numbers = read_numbers(layout, words)
    assert numbers["temperature_now"] == pytest.approx(-3.25) and numbers["p_limit"] == pytest.approx(0.25)
    assert (numbers["band_high"], numbers["minutes_low"]) == (None, None) and "writer" not in numbers
    block = {"address": layout.words[0].address, "words": len(layout.words), "numbers": numbers}
    own = {"mode": "armed", "writer": 4711, "refused": 3, "last_refusal": "another writer", "block": block}
    return {"writeback": {**picture()["writeback"], **own, **more}}


def test_a_machine_says_whether_something_is_written_to_it_by_any_of_its_blocks() -> None:
    further = {key: picture()[key] for key in ("temperature", "unit", "limit", "prediction", "forecast", "model")}
    further |= {"guards": {}, "writeback": {"mode": "armed"}}
    assert view()["mode"] == "shadow"
    assert view(**armed())["mode"] == "armed"
    assert view(further=[further])["mode"] == "armed"
    assert (view(writeback={"mode": "off"})["mode"], view(writeback={"mode": "off"})["arming"]) == ("off", None)


def test_before_an_arming_it_is_said_where_and_what_would_be_written() -> None:
    about = view(**armed(), values__Challenge=tag(77.0))["arming"]
    assert about["address"] == "host 10.0.0.7 port 502 (decanter_plc)"
    assert "77" in about["identity"] and "4711" in about["identity"]
    (block,) = about["blocks"]
    assert (block["label"], block["words"]) == ("gearbox bearing", 26) and block["address"].startswith("holding:")
    assert block["refusals"] == "another writer (3 refused)"
    assert {name: text.replace("\u00a0", " ") for name, text in block["numbers"]} == {
        "Predicted now": "-3.2 °C",
        "90 % band": "-4.0 – not known °C",
        "median in 15 min": "46.0 °C",
        "P(limit) in 15 min": "25 %",
        "Minutes to the limit": "beyond 15",
        "… at the earliest and at the latest": "beyond 15",
    }
    for language in LANGUAGES:
        assert view(language)["arming"]["blocks"][0]["numbers"] == [], "before the first block"


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_word_for_the_confidence_is_the_measured_one(language: str) -> None:
    texts = WORDS[language].texts

    def first(*coverage: float | None, zone: str = "green") -> dict[str, Any]:
        changes = {"forecast__coverage": list(coverage), "prediction__zone": zone}
        row: dict[str, Any] = view(language, **changes)["temperatures"][0]
        return row

    for share in (0.0, 0.33, 0.59, 0.79, 0.8, 0.9, 1.0):
        row = first(share, None, share)
        high = row["confidence"]["word"] == texts["confidence.high"]
        assert (high, row["valid"]) == ((True, "good") if share >= 0.8 else (False, "doubtful"))
        assert f"{100 * share:.0f} %" in row["validity"] and f"{100 * share:.0f} %" in row["confidence"]["coverage"]
        assert first(share, zone="red")["confidence"]["word"] == texts["confidence.low"]
    for row in (first(), first(None, None)):
        assert row["confidence"]["word"] == texts["confidence.unmeasured"]
        assert row["validity"] == texts["validity.unmeasured"]
    assert first(0.33)["confidence"]["word"] == texts["confidence.low"]


@pytest.mark.parametrize(
    ("low", "median", "high", "said"),
    [
        (None, None, None, {"median": "beyond 15", "band": ""}),
        (16.0, 17.0, 18.0, {"median": "beyond 15", "band": ""}),
        (12.0, None, None, {"median": "beyond 15", "band": "12 – beyond 15"}),
        (0.4, 11.0, 14.0, {"median": "11", "band": "< 1 – 14"}),
    ],
)
def test_what_is_beyond_the_forecast_has_no_band(
    low: float | None, median: float | None, high: float | None, said: dict[str, str]
) -> None:
    minutes = {"minutes_low": low, "minutes_median": median, "minutes_high": high}
    block = {**picture()["forecast"]["block"], **minutes}
    assert view(forecast__block=block)["temperatures"][0]["to_limit"] == said


def test_a_familiarity_that_is_not_known_is_not_shown() -> None:
    nothing = {"kind": "", "features": [], "values": [], "bound": None}
    own = {"zone": "unknown", "limit": 1.5, "time": EPOCH, "strangeness": None, "expected_error": None}
    own |= {"outside": False, "thing": nothing, "sentence": ""}
    for strangeness, shown in ((None, False), (0.4, True)):
        row = view(prediction__familiarity=own | {"strangeness": strangeness})["temperatures"][0]
        assert (row["familiarity"] is not None) is shown


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_code_of_the_gateway_or_the_plc_is_worded_in_the_readers_language(language: str) -> None:
    texts = WORDS[language].texts
    codes = {
        "quality": [each.name.lower() for each in Quality],
        "refusal": [each for each in REFUSALS if each != "none"],
        "verdict": get_args(Verdict),
    }
    for section, names in codes.items():
        keys = {f"{section}.{name.replace(' ', '_')}" for name in names}
        assert keys == {key for key in texts if key.startswith(f"{section}.")}


@pytest.mark.parametrize("language", ["it", "de"])
def test_why_nothing_is_read_is_not_said_in_english_to_who_reads_another_language(language: str) -> None:
    texts = WORDS[language].texts
    english = "[Errno 111] Connect call failed ('10.0.0.7', 502)"
    bad = {f"values__{TEMPERATURE}": tag(None, "NOT_CONNECTED", reason=english)}
    shown = view(language, link__alive=False, link__reason=english, **bad)
    said = [shown["link_reason"], *(each["sentence"] for each in shown["findings"])]
    assert shown["link_reason"] == texts["quality.not_connected"] and "Connect call" not in "".join(said)
    one = view(language, **bad)
    assert texts["quality.not_connected"] in one["temperatures"][0]["sentence"]
    assert texts["quality.not_connected"] in one["findings"][0]["sentence"]
    assert "Connect call" not in one["temperatures"][0]["sentence"] + one["findings"][0]["sentence"]
    assert view("en", link__alive=False, link__reason=english, **bad)["link_reason"] == english, "which says more"
