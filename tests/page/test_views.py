"""What the page says in words: sentences from a status, in three languages from one table."""

import asyncio
import errno
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from string import Formatter
from typing import Any

import pytest

import drivers
import gateway.machine
import gateway.outside.texts
import gateway.outside.web
from drivers.codec import judge
from drivers.errors import DeviceException
from drivers.modbus.verify import EXCEPTIONS, check_reply, parse_request
from drivers.modbus.wire import LATE, no_connection
from drivers.tag import Tag
from gateway.outside.panel import status_rows
from gateway.outside.status import read_status
from gateway.outside.status.health import CHECKS
from gateway.outside.texts import LANGUAGES, all_words, preferred_language
from gateway.outside.web import machine_view
from gateway.outside.web.views import duration
from gateway.settings import ALARM_KINDS, parse_kind
from sim.lab.discrepancy.fitting import catalogue
from sim.phrase import Phrase
from tests.gateway.status_picture import alarm, picture, tag
from tests.gateway.support import EPOCH, TEMPERATURE
from tests.page.served import page_views
from tests.rig.habit_wires import TAGS, Habit, driven

WORDS = all_words()
LABELS = {TEMPERATURE: "gearbox bearing", "decanter": "Decanter 2"}
BY_WHOM = {
    "olga at 127.0.0.1": "olga an 127.0.0.1",
    "olga at home at fe80::1": "olga at home an fe80::1",
    "Anna at the door": "Anna at the door",
    "anna": "anna",
    "": "",
}
"""Who did something, on record -> in German, in a mail as on the page."""
DURATIONS = {
    -3000.0: "–",
    0.0: "0,0 s",
    9.9: "9,9 s",
    119.0: "119 s",
    120.0: "2 min",
    7199.0: "120 min",
    7200.0: "2,0 h",
    172_799.0: "48,0 h",
    172_800.0: "2,0 d",
    864_000.0: "10,0 d",
}
"""Seconds -> in German, in a mail as on the page."""


def row(language: str = "en", **changes: Any) -> dict[str, Any]:
    found: dict[str, Any] = machine_view(WORDS[language], LABELS, read_status(picture(**changes)))["temperatures"][0]
    return found


def forecast(low: float | None, median: float | None, high: float | None, p: float = 0.25) -> dict[str, Any]:
    minutes = {"minutes_low": low, "minutes_median": median, "minutes_high": high}
    made: dict[str, Any] = picture()["forecast"]
    return {"forecast__block": {**made["block"], **minutes}, "forecast__p_limit": [0.0, 0.1, p]}


def test_the_sentence_says_when_the_limit_is_reached_if_it_goes_on_so() -> None:
    what = "Decanter 2: gearbox bearing 45.7 °C, reaches 80 °C in 11 min (5 to beyond 15) if it goes on so"
    assert row()["sentence"].replace("\u00a0", " ") == what
    assert row(**forecast(9.0, 11.0, 14.0))["sentence"].endswith("in 11 min (9 to 14) if it goes on so")
    german = row("de", **forecast(0.4, 11.0, 14.0))["sentence"].replace("\u00a0", " ")
    assert german == (
        "Decanter 2: gearbox bearing 45,7 °C, erreicht 80 °C in 11 min (< 1 bis 14), wenn es so weitergeht"
    )
    assert (row()["level"], row()["valid"]) == ("attention", "good")


def test_what_there_is_to_do_begins_with_the_limit_and_leaves_out_what_was_put_aside() -> None:
    def standing(kind: str, **changes: Any) -> dict[str, Any]:
        known = {"tag": TEMPERATURE, "kind": kind, "limit": 80.0, "standing": True, "beyond": True}
        return alarm(f"{kind} {TEMPERATURE}") | known | {"own_response": False} | changes

    aside = {"state": "out of service", "active": False}
    review, over = standing("review", priority=3), standing("over limit", **aside)
    hot = {"values__" + TEMPERATURE: tag(86.0)}
    for alarms in ([], [over], [over, review], [standing("drift", priority=3)]):
        assert "above 80" in row(**hot, alarm_summary=alarms)["action"], alarms
    calm = {"values__" + TEMPERATURE: tag(45.0), **forecast(None, None, None, 0.0)}
    assert "unfit" in row(**calm, alarm_summary=[review])["action"]
    for put_aside in (review | aside, standing("sensor jumping", **aside)):
        assert row(**calm, alarm_summary=[put_aside])["action"] == row(**calm)["action"]


def test_in_place_of_a_bad_sensor_the_model_speaks_and_says_so() -> None:
    v = {"since": EPOCH - 720.0, "reason": "sensor frozen", "mean": 61.2, "low": 57.3, "high": 65.8, "stopped": ""}
    said = row(prediction__virtual=v)
    assert said["sentence"].replace("\u00a0", " ") == (
        "Decanter 2: gearbox bearing: sensor bad; by the model 61 °C (57 to 66), for 12 min"
    )
    assert (said["value"], said["level"], said["valid"]) == (None, "attention", "doubtful")
    assert "secondo il modello 61" in row("it", prediction__virtual=v)["sentence"]
    assert "nach dem Modell 61" in row("de", prediction__virtual=v)["sentence"]
    over = row(prediction__virtual=v, **{"values__" + TEMPERATURE: tag(85.0)})
    assert over["level"] == "alarm" and "above its limit" in over["sentence"], "what it shows is not waved away"
    for stopped in ("too long", "too wide", "state not known"):
        gone = row(prediction__virtual=v | {"mean": None, "low": None, "high": None, "stopped": stopped})
        assert (gone["level"], gone["valid"]) == ("unknown", "none") and "not known by the model" in gone["sentence"]


def test_what_is_beyond_the_horizons_is_not_promised() -> None:
    stays = row(**forecast(None, None, None))
    assert stays["sentence"].endswith("stays below 80\u00a0°C for the next 15 min if it goes on so")
    assert stays["level"] == "normal"
    may = row(**forecast(12.0, None, None, p=0.14))
    assert "may reach 80\u00a0°C from 12 min on (14 % within 15 min)" in may["sentence"] and may["level"] == "normal"


@pytest.mark.parametrize(
    ("changes", "said", "level", "valid"),
    [
        ({"values__" + TEMPERATURE: tag(85.0)}, "85.0\u00a0°C, above its limit of 80\u00a0°C", "alarm", "good"),
        ({"forecast": None}, "no forecast: the newest one is too old", "normal", "none"),
        ({"forecast__usable": False}, "no forecast: the newest one is too old", "normal", "none"),
        ({"prediction__known": False}, "no forecast: the state of the plant is not known", "normal", "none"),
        ({"model": None, "prediction": None, "forecast": None}, "no model is configured", "normal", "none"),
        ({"prediction__zone": "red"}, "reaches 80\u00a0°C", "attention", "doubtful"),
    ],
)
def test_what_the_sentence_is_worth_is_said_beside_it(
    changes: dict[str, Any], said: str, level: str, valid: str
) -> None:
    found = row(**changes)
    assert said in found["sentence"] and (found["level"], found["valid"]) == (level, valid)


def test_a_forecast_beyond_three_deviations_of_the_past_is_said_and_no_doubt_of_its_own() -> None:
    like = {"moments": 23, "mean": 41.0, "sigma": 1.5, "deviations": 0.5, "flagged": False}
    usual = row(forecast__past=[None, like, like])
    assert usual["validity"] == row()["validity"] and usual["valid"] == "good"
    far, further = (like | {"deviations": off, "flagged": True} for off in (3.2, -4.1))
    found = row(forecast__past=[far, further, None])
    said = "in 5 min it is 4.1 standard deviations from what was measured after 23 like moments (41.0 ± 1.5 °C)"
    assert found["validity"] == f"{usual['validity']}; {said}" and found["valid"] == "good"
    for language in LANGUAGES:
        assert row(language, forecast__past=[far, further, None])["validity"].count("23") == 1

    rows = status_rows(read_status(picture(forecast__past=[like, further, None])))
    assert str(rows["in 5 min"]).endswith("; 4.1 sd from 41.0 with sd 1.5 after 23 like moments")
    assert all("like moments" not in str(rows[name]) for name in ("in 1 min", "in 15 min"))


@pytest.mark.parametrize(
    ("seconds", "en", "de"), [(900.0, "15", "15"), (90.0, "1.5", "1,5"), (20.0, "0.33", "0,33"), (300.0, "5", "5")]
)
def test_the_minutes_of_a_horizon_are_not_rounded_to_another_one(seconds: float, en: str, de: str) -> None:
    assert (all_words()["en"].minutes(seconds), all_words()["de"].minutes(seconds)) == (en, de)
    like = {"moments": 23, "mean": 41.0, "sigma": 1.5, "deviations": 3.2, "flagged": True}
    found = row(forecast__past=[like], forecast__horizons=[seconds])
    assert f"in {en} min it is" in found["validity"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"link__alive": False, "link__last_good": EPOCH - 200.0}, "no reading for 3 min; nothing is known of now"),
        ({"scan__late": True, "link__last_good": EPOCH - 5.0}, "no reading for 5.0 s; nothing is known of now"),
        ({"link__alive": False, "link__last_good": None}, "has not been read yet"),
        ({"values__" + TEMPERATURE: tag(45.0, "OUT_OF_RANGE", reason="300 is no reading")}, "(300 is no reading)"),
        ({"values__" + TEMPERATURE: tag(None, "TIMEOUT")}, "(no answer in time)"),
    ],
)
def test_a_number_that_is_no_present_one_is_not_given(changes: dict[str, Any], said: str) -> None:
    found = row(**changes)
    assert said in found["sentence"] and "45" not in found["sentence"]
    assert (found["value"], found["level"], found["valid"]) == (None, "unknown", "none")


def test_a_value_above_its_limit_is_measured_whatever_the_forecast_is_worth() -> None:
    hot = row(**{"values__" + TEMPERATURE: tag(85.0), "prediction__zone": "red"})
    assert (hot["level"], hot["valid"], hot["validity"]) == ("alarm", "good", WORDS["en"].say("validity.measured"))


def test_a_machine_is_as_bad_as_the_worst_of_it() -> None:
    def level(**changes: Any) -> str:
        return str(
            machine_view(WORDS["en"], {}, read_status(picture(**forecast(None, None, None), **changes)))["level"]
        )

    assert level() == "normal"
    assert level(alarm_summary=[alarm("over limit T")]) == "alarm"
    assert level(alarm_summary=[alarm("over limit T", "acknowledged")]) == "attention"
    assert level(alarm_summary=[alarm("over limit T", "shelved", active=False)]) == "normal"
    assert level(alarm_summary=[alarm("over limit T", "returned unacknowledged", active=False)]) == "over"


def test_every_text_is_there_in_every_language_with_the_same_parts_and_is_used() -> None:
    home = Path(gateway.outside.web.__file__).parent
    texts_home = Path(gateway.outside.texts.__file__).parent
    table = tomllib.loads((texts_home / "texts.toml").read_text(encoding="utf-8"))
    files = (*home.rglob("*.js"), *home.rglob("*.py"), *texts_home.rglob("*.py"))
    used = "".join(file.read_text(encoding="utf-8") for file in files)
    used += (home / "templates/page.html.j2").read_text(encoding="utf-8")
    for section, keys in table.items():
        for key, texts in keys.items():
            assert tuple(texts) == LANGUAGES, f"{section}.{key}"
            parts = {
                language: {part for _, part, _, _ in Formatter().parse(text) if part}
                for language, text in texts.items()
            }
            assert len({frozenset(each) for each in parts.values()}) == 1, f"{section}.{key}"
            assert re.search(rf"{section}\.(?:{key}\b|\$\{{|\{{)", used), f"{section}.{key} is used nowhere"


def test_every_word_that_the_page_says_is_there_and_every_view_has_its_name() -> None:
    home = Path(gateway.outside.web.__file__).parent / "static"
    scripts = "".join(file.read_text(encoding="utf-8") for file in home.glob("*.js"))
    said = set(re.findall(r'say\(\s*"([^"]+)"', scripts)) | {f"nav.{view}" for view in page_views()}
    assert said and said - set(WORDS["en"].texts) == set()


def test_every_kind_of_alarm_and_every_check_has_its_words() -> None:
    texts = WORDS["en"].texts
    for section, names in (("kind", ALARM_KINDS), ("check", CHECKS)):
        keys = {f"{section}.{re.sub('[ -]', '_', name)}" for name in names}
        assert keys == {key for key in texts if key.startswith(f"{section}.")}
    kinds = {"over limit T 1": "over limit", "clock not steered": "clock not steered", "clock": "clock", "clocks": ""}
    assert {name: parse_kind(name) for name in kinds} == kinds


def test_what_to_do_is_said_in_the_readers_language_unless_the_plant_has_words_of_its_own() -> None:
    texts = WORDS["en"].texts
    for name, kind in ALARM_KINDS.items():
        own = texts[f"response.{name.replace(' ', '_')}"]
        assert own == kind.response.replace("{limit:g}", "{limit}") or name == "sensor drifting"
    hot = alarm(f"over limit {TEMPERATURE}") | {"tag": TEMPERATURE, "kind": "over limit", "limit": 47.5}

    def said(language: str, **changes: Any) -> str:
        status = read_status(picture(alarm_summary=[hot | changes]))
        return str(machine_view(WORDS[language], LABELS, status)["alarms"][0]["response"])

    do = "gearbox bearing liegt über 47,5 °C: Last verringern und Schmierung prüfen"
    assert said("de", own_response=False) == do
    assert said("de", response="Zulauf drosseln") == "Zulauf drosseln"


def test_every_effect_that_can_be_named_has_its_words_and_its_experiment_as_a_diagnosis_says_them() -> None:
    texts = WORDS["en"].texts
    for section, own in (
        ("effect", {entry.name: entry.plain for entry in catalogue()}),
        ("experiment", {entry.name: entry.experiment for entry in catalogue()}),
    ):
        said = {key.partition(".")[2]: text for key, text in texts.items() if key.startswith(f"{section}.")}
        assert said == own
        assert [name for name, text in own.items() if not (isinstance(text, Phrase) and text.whole)] == []


def test_a_temperature_that_is_only_watched_has_a_row_without_a_forecast() -> None:
    other = {"watched": {"Feed": 70.0}, "values__Feed": tag(45.0)}
    for language, said in (("en", "no model"), ("it", "nessun modello"), ("de", "kein Modell")):
        shown = machine_view(WORDS[language], {"Feed": "feed bearing"}, read_status(picture(**other)))
        predicted, watched = shown["temperatures"]
        assert (predicted["predicted"], watched["predicted"]) == (True, False)
        assert (watched["tag"], watched["label"], watched["value"], watched["limit"]) == (
            "Feed",
            "feed bearing",
            45.0,
            70.0,
        )
        assert said in watched["sentence"] and (watched["level"], watched["valid"]) == ("normal", "none")
        assert shown["labels"] == {"Feed": "feed bearing"}
    hot = machine_view(WORDS["en"], {}, read_status(picture(**other | {"values__Feed": tag(71.0)})))
    assert (hot["temperatures"][1]["level"], hot["level"]) == ("alarm", "alarm")
    gone = machine_view(WORDS["en"], {}, read_status(picture(**other | {"values__Feed": tag(45.0, "TIMEOUT")})))
    assert (gone["temperatures"][1]["value"], gone["temperatures"][1]["level"]) == (None, "unknown")


@pytest.mark.parametrize(
    ("accepted", "language"),
    [("", "en"), ("it-IT,it;q=0.9,en;q=0.8", "it"), ("fr, de;q=0.5, en;q=0.4", "de"), ("*", "en"), ("x" * 9999, "en")],
)
def test_the_browser_is_answered_in_the_language_that_it_prefers(accepted: str, language: str) -> None:
    assert preferred_language(accepted) == language


def test_what_is_found_of_model_and_blocks_is_said_in_the_readers_language() -> None:
    bad = {"verdict": "unfit", "verdict_sentence": "unfit: worse than the last reading held"}
    plain = picture()
    unfit = read_status(plain | {"model": plain["model"] | bad})
    refused = {"mode": "armed", "last_verdict": "not permitted", "last_reason": ""}
    cases = {
        "model": (unfit, "das Modell ist unbrauchbar: worse", "il modello non è idoneo: worse"),
        "write-back": (
            read_status(plain | {"writeback": plain["writeback"] | refused}),
            "scharf, und der neueste Block wurde nicht geschrieben (not permitted): kein Grund",
            "armato, e l'ultimo blocco non è stato scritto (not permitted): nessun motivo",
        ),
    }
    for check, (status, german, italian) in cases.items():
        for language, wanted in (("de", german), ("it", italian)):
            found = machine_view(all_words()[language], {}, status)["findings"]
            assert any(each["check"] == check and each["sentence"].startswith(wanted) for each in found), found


def test_what_drivers_say_has_words_in_each_language() -> None:
    high = Tag("T", "holding:0", high=150.0, unit="degC")
    said = [
        judge(high, 151.5)[1],
        judge(replace(high, low=-5.5), -20.5)[1],
        str(no_connection("10.0.0.7:502", ConnectionRefusedError(errno.ECONNREFUSED, "Connect call failed"), None)),
        f"not connected: {no_connection('10.0.0.7:502', OSError(errno.EHOSTUNREACH, 'No route to host'), None)}",
        "2.0 s ago holding:100 count 12: no reply within 0.3 s",
        "has not moved for 61 s (limit 60 s)",
        "holding:0 count 2: no reply within 0.15 s" + LATE.format(0.25),
    ]
    assert [WORDS["de"].reason(text) for text in said] == [
        "151,5 degC liegt über dem größten glaubhaften Wert 150",
        "-20,5 degC liegt unter dem kleinsten glaubhaften Wert -5,5",
        "10.0.0.7:502 verbindet sich nicht: Verbindung abgelehnt",
        "nicht verbunden: 10.0.0.7:502 verbindet sich nicht: kein Weg zum Gerät",
        "vor 2,0 s holding:100 count 12: keine Antwort innerhalb von 0,3 s",
        "hat sich seit 61 s nicht bewegt (Grenze 60 s)",
        "holding:0 count 2: keine Antwort innerhalb von 0,15 s (eine kam 0,25 s nach der Anfrage, zu spät: "
        "ein längeres timeout angeben)",
    ]
    assert [WORDS["en"].reason(text) for text in said] == said
    # What nobody has put into words is not cut to fit.
    for strange in (
        "",
        "boiling",
        "a while ago: no reply within reason",
        "not connected: a cable of the maker's own",
        "not connected: " * 9999,
    ):
        assert WORDS["it"].reason(strange) == ""


async def test_a_plc_that_fell_silent_is_said_in_each_language() -> None:
    told = set()
    for most in (1, 3):
        rule: dict[str, Any] = {"max_failures": most, "attempts": 1, "backoff_first": 5.0, "backoff_cap": 5.0}
        async with asyncio.timeout(60), driven(Habit(quiet=1e6), **rule) as driver:
            while not driver.statistics()["dead_peers"]:
                told |= {sample.reason for sample in await driver.read([TAGS[5]])}
                await asyncio.sleep(0.01)
            told |= {sample.reason for sample in await driver.read([TAGS[5]])}
    assert any("the peer is dead: 1 " in text for text in told) and any("exchanges in a row" in text for text in told)
    for text in filter(None, told):
        assert WORDS["de"].reason(text) and WORDS["it"].reason(text), text


def test_a_sentence_with_a_hint_is_not_torn() -> None:
    number = "the device sent nan"
    assert WORDS["de"].reason(number) == "das Gerät hat nan gesendet"
    hint = "; the words look swapped: as CDAB it reads 45.12"
    high = judge(Tag("T", "holding:0", high=150.0, unit="degC"), 151.5)[1]
    for whole in (number, "the device sent 1e+38", high):
        assert WORDS["de"].reason(whole) and not WORDS["de"].reason(whole + hint)


def test_an_exception_is_said_in_the_readers_language_alone() -> None:
    question = parse_request(bytes.fromhex("00010000000601030064000c"))
    for code in EXCEPTIONS:
        with pytest.raises(DeviceException) as refused:
            check_reply(question, bytes((0, 1, 0, 0, 0, 3, 1, 0x83, code)))
        for language in ("de", "it"):
            told = WORDS[language].reason(str(refused.value))
            assert told and EXCEPTIONS[code][0] not in told, str(refused.value)


def test_the_sentences_that_are_put_into_words_are_those_of_the_drivers() -> None:
    homes = [Path(module.__file__ or "").parent for module in (drivers, gateway.machine)]
    said = "".join(file.read_text(encoding="utf-8") for home in homes for file in home.rglob("*.py"))
    said = re.sub(r"\\(.)", r"\1", re.sub(r'"\s*\n\s*f?"', "", said))
    # Those of the C library, and those that a driver makes of two: the test above has such as they are made.
    apart = {"refused", "no_route", "no_network", "reset", "closed_within", "too_low", "too_high"}
    apart |= {"no_reply_late", "dead_peer", "dead_peer_once"}
    for key, text in WORDS["en"].texts.items():
        name = key.removeprefix("reason.")
        if name != key and name not in apart:
            for part in re.split(r"\{\w+\}", text):
                assert part.strip(" ()") in said, f"{key}: no driver says {part!r}"


def test_a_phrase_is_filled_in_every_language_with_its_own_decimal_sign() -> None:
    inner = Phrase("late", it="tardi", de="spät")
    said = Phrase("{what} by {s} s", it="{what} di {s} s", de="{what} um {s} s").fill(what=inner, s="1.5")
    assert (str(said), said.it, said.de) == ("late by 1.5 s", "tardi di 1,5 s", "spät um 1,5 s")


def test_a_mail_says_who_and_for_how_long_as_the_page_does() -> None:
    assert {who: WORDS["de"].by_whom(who) for who in BY_WHOM} == BY_WHOM
    assert {seconds: duration(WORDS["de"], seconds) for seconds in DURATIONS} == DURATIONS
