"""The report of a shift: from a historian and an audit log alone, to the last minute of what they have."""

import json
import re
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.supervision import Supervisor
from drivers.tag import Quality, Tag
from gateway.machine.alarms import BY_PERSONS, GATEWAY, AlarmState, JournalRow
from gateway.outside.texts import LANGUAGES, all_words
from gateway.outside.web.access import AccountRole
from gateway.outside.web.readings import notes_between
from gateway.outside.web.shift import (
    DEEDS,
    MOST_LISTED,
    NOBODY,
    NOTE,
    ON_SHIFT,
    alarm_episodes,
    nearest_limit,
    read_people,
    read_shift,
    select_open,
)
from gateway.outside.web.shift_text import shift_text
from gateway.store import AuditEntry, open_audit
from tests.gateway.support import EPOCH, one_machine
from tests.gateway.test_notify import MailServer, mail_server, secrets_in
from tests.page.served import PAGE, Client, eventually, served

__all__ = ["mail_server"]

HOUR = 3600.0
END = EPOCH + 8 * HOUR
GOOD, BAD = Quality.GOOD.value, Quality.SENSOR_FAILURE.value


def change(time: float, alarm: str, state: str, by: str = "") -> JournalRow:
    return JournalRow(
        time=time, machine="decanter", alarm=alarm, tag="T", priority=2, state=state, value=None, by=by, reason=""
    )


def test_of_each_alarm_it_is_said_what_came_of_it() -> None:
    rows = [
        change(EPOCH - 50.0, "link", "unacknowledged"),
        change(EPOCH - 40.0, "link", "normal"),
        change(EPOCH - 30.0, "device", "unacknowledged"),
        change(EPOCH + 10.0, "predicted over limit T", "unacknowledged"),
        change(EPOCH + 70.0, "predicted over limit T", "acknowledged", "olga"),
        change(EPOCH + 100.0, "over limit T", "unacknowledged"),
        change(EPOCH + 400.0, "over limit T", "returned unacknowledged"),
        change(EPOCH + 410.0, "predicted over limit T", "normal"),
        change(EPOCH + 500.0, "over limit T", "normal", "enzo"),
        change(EPOCH + 600.0, "rising T", "unacknowledged"),
        change(EPOCH + 660.0, "rising T", "returned unacknowledged"),
        change(EPOCH + 700.0, "rising T", "unacknowledged"),
    ]
    device, predicted, over, rising, again = alarm_episodes(rows, EPOCH, END)
    assert (device["alarm"], device["ended"], device["by"]) == ("device", None, ""), "what stood before stands"
    assert (predicted["limit_after"], predicted["ended"] - predicted["raised"]) == (90.0, 400.0)
    assert (predicted["by"], predicted["acknowledged"]) == ("olga", EPOCH + 70.0)
    assert (over["ended"], over["acknowledged"], over["by"]) == (EPOCH + 400.0, EPOCH + 500.0, "enzo")
    assert (over["warning"], over["limit_after"]) == (False, None), "the limit's own alarm warns of nothing"
    assert (rising["warning"], rising["limit_after"], rising["ended"]) == (True, None, EPOCH + 660.0)
    assert (again["raised"], again["ended"]) == (EPOCH + 700.0, None)


def test_a_warning_that_came_over_the_limit_does_not_say_that_it_was_not_passed() -> None:
    rows = [
        change(EPOCH - 90.0, "over limit T", "unacknowledged"),
        change(EPOCH - 80.0, "over limit T", "normal"),
        change(EPOCH, "over limit T", "unacknowledged"),
        change(EPOCH + 2.0, "rising T", "unacknowledged"),
        change(EPOCH + 100.0, "rising T", "normal"),
        change(EPOCH + 300.0, "over limit T", "normal"),
        change(EPOCH + 310.0, "rising T", "unacknowledged"),
        change(EPOCH + 320.0, "rising T", "normal"),
    ]
    _, rising, after = alarm_episodes(rows, EPOCH, END)
    assert (rising["limit_after"], after["limit_after"]) == (0.0, None)
    assert [one["raised"] for one in alarm_episodes(rows, EPOCH + 305.0, END)] == [EPOCH + 310.0]


@pytest.mark.parametrize(
    ("states", "by"),
    [
        (["shelved", "normal"], "olga"),
        (["suppressed by design", "normal"], "enzo"),
        (["out of service", "returned unacknowledged"], "enzo"),
        (["normal"], GATEWAY),
        (["returned unacknowledged", "normal"], GATEWAY),
    ],
)
def test_who_hides_an_alarm_has_not_acknowledged_it(states: list[str], by: str) -> None:
    rows = [change(EPOCH + 10.0 * place, "link", state, by) for place, state in enumerate(states, 1)]
    (one,) = alarm_episodes([change(EPOCH, "link", "unacknowledged"), *rows], EPOCH, END)
    assert (one["acknowledged"], one["by"]) == (None, "")


def test_of_long_records_no_alarm_is_held_against_all_others() -> None:
    looked = Counter[str]()

    class Watched(str):
        __slots__ = ()

        def __eq__(self, other: object) -> bool:
            looked["tag"] += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    rows = [
        replace(change(EPOCH + 10.0 * at + more, alarm, state), tag=Watched("T"))
        for at in range(200)
        for more, alarm, state in (
            (0.0, "rising T", "unacknowledged"),
            (1.0, "over limit T", "unacknowledged"),
            (2.0, "over limit T", "normal"),
            (3.0, "rising T", "normal"),
        )
    ]
    found = alarm_episodes(rows, EPOCH, END)
    assert {one["limit_after"] for one in found if one["warning"]} == {1.0}
    assert looked["tag"] < 10 * len(rows)


def test_what_is_left_unread_of_a_journal_changes_no_report() -> None:
    rng, unread = np.random.default_rng(5), 0
    states = [str(state) for state in AlarmState]
    alarms = ("over limit T", "rising T", "over limit U", "predicted over limit", "link")
    for _ in range(60):
        rows = [
            change(EPOCH + float(time), str(rng.choice(alarms)), str(rng.choice(states)), str(rng.choice(["", "olga"])))
            for time in np.sort(rng.integers(0, 300, 60))
        ]
        stored = [(row.time, row.alarm, row.tag, row.priority, row.state, row.value, row.by) for row in rows]
        start, end = EPOCH + 200.0, EPOCH + 300.0
        kept = select_open(stored, start=start)
        by_row = dict(zip(map(id, stored), rows, strict=True))
        found = alarm_episodes([by_row[id(row)] for row in kept], start, end)
        assert found == alarm_episodes(rows, start, end)
        unread += len(stored) - len(kept)
    assert unread > 300


def test_the_least_time_to_the_limit_is_that_of_the_median_line() -> None:
    def said(time: float, measured: float, *medians: float) -> list[tuple[object, ...]]:
        levels = json.dumps([0.05, 0.5, 0.95])
        return [
            (time, horizon, levels, json.dumps([median - 5.0, median, median + 5.0]), measured)
            for horizon, median in zip((60.0, 300.0, 900.0), medians, strict=True)
        ]

    calm, near = said(EPOCH, 60.0, 60.0, 61.0, 62.0), said(EPOCH + 10.0, 70.0, 72.0, 76.0, 86.0)
    assert nearest_limit([*calm, *near], 80.0) == {
        "forecasts": 2, "horizon": 900.0, "minutes": (300.0 + 600.0 * 0.4) / 60.0, "time": EPOCH + 10.0
    }  # fmt: skip
    assert nearest_limit(calm, 80.0) == {"forecasts": 1, "horizon": 900.0, "minutes": None, "time": None}
    assert nearest_limit(said(EPOCH, 81.0, 82.0, 83.0, 84.0), 80.0)["minutes"] == 0.0
    assert nearest_limit([], 80.0) == {"forecasts": 0, "horizon": None, "minutes": None, "time": None}


def test_it_is_made_of_the_records_of_its_time_alone(tmp_path: Path) -> None:
    path, audit = tmp_path / "history.sqlite", tmp_path / "audit.sqlite"
    store, view = one_machine(path, [Tag("T", "holding:0", unit="degC")])
    # Read each ten seconds for eight hours, but for ten minutes in the third.
    times = [EPOCH + 10.0 * step for step in range(8 * 360) if not 2 * HOUR <= 10.0 * step < 2 * HOUR + 600.0]
    view.put("scans", [(time, 0.01, 0) for time in times])
    view.put("samples", [("T", time, 50.0 + (time - EPOCH) / HOUR, GOOD, time) for time in times])
    # Hotter, and not of this time or of no worth.
    view.put("samples", [("T", EPOCH - 5.0, 99.0, GOOD, EPOCH - 5.0), ("T", times[7] + 1.0, 300.0, BAD, None)])
    followed = store.view("decanter", (), temperature="T")
    followed.put(
        "writes",
        [(EPOCH + 1.0, 1, "shadow", "shadow", 1, 0.1, "", ""), (END + 1.0, 2, "armed", "written", 1, 0.1, "", "")],
    )
    store.flush(60.0)
    store.close()
    shown = read_shift(path, audit=str(audit), start=EPOCH, end=END, gap=15.0, temperatures={"decanter": {"T": 80.0}})
    machine = shown["machines"]["decanter"]
    (row,) = machine["temperatures"]
    assert row["hottest"] == {"value": pytest.approx(50.0 + (times[-1] - EPOCH) / HOUR), "time": times[-1]}
    assert machine["unwatched"] == {"count": 1, "seconds": 610.0}
    assert machine["writes"] == {"shadow": 1}
    assert (shown["on_shift"], shown["notes"], shown["deeds"]) == (None, [], []), "there is no audit log"
    nothing = read_shift(
        path, audit=str(audit), start=END, end=END + HOUR, gap=15.0, temperatures={"decanter": {"T": 80.0}}
    )
    assert nothing["machines"]["decanter"]["unwatched"] == {"count": 1, "seconds": HOUR}
    assert nothing["machines"]["decanter"]["temperatures"][0]["hottest"] is None
    # A machine that has only been added has no rows yet.
    added = read_shift(path, audit=str(audit), start=EPOCH, end=END, gap=15.0, temperatures={"pump": {"T": 80.0}})
    assert added["machines"]["pump"]["unwatched"] == {"count": 1, "seconds": 8 * HOUR}


def test_scans_that_read_nothing_good_are_a_time_in_which_nothing_was_read(tmp_path: Path) -> None:
    path = tmp_path / "history.sqlite"
    store, view = one_machine(path, [Tag("T", "holding:0", unit="degC"), Tag("U", "holding:1", unit="degC")])
    times = [EPOCH + 10.0 * step for step in range(8 * 360)]
    view.put("scans", [(time, 0.01, 0) for time in times])
    lost = Quality.COMMUNICATION_ERROR.value
    # U answers for half an hour longer; then both are lost for 50 s, shorter than what counts where nothing is tried.
    view.put("samples", [("T", times[0], 50.0, GOOD, times[0]), ("T", times[180], None, lost, None)])
    view.put("samples", [("U", times[0], 50.0, GOOD, times[0]), ("U", times[360], None, lost, None)])
    view.put("samples", [("T", times[364], 51.0, GOOD, times[364])])
    store.flush(60.0)

    def unwatched(*tags: str) -> dict[str, Any]:
        limits = dict.fromkeys(tags, 80.0)
        shown = read_shift(
            path, audit=str(tmp_path / "audit"), start=EPOCH, end=END, gap=70.0, temperatures={"decanter": limits}
        )
        found: dict[str, Any] = shown["machines"]["decanter"]["unwatched"]
        return found

    assert unwatched("T", "U") == {"count": 1, "seconds": 50.0}
    assert unwatched("U") == {"count": 1, "seconds": 7 * HOUR + 10.0}, "scans are stored all the same"
    store.close()


def test_what_was_only_tried_is_no_deed_and_what_was_asked_for_is_called_so(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    log = open_audit(path, Supervisor())
    for at, dry_run in ((1.0, True), (2.0, False)):
        log.put(AuditEntry(EPOCH + at, "page: reload", "ada", "", {"dry_run": dry_run}))
    log.close()
    assert [deed["time"] for deed in read_people(path, start=EPOCH, end=END)["deeds"]] == [EPOCH + 2.0]
    # Their rows are written before they are done, and stand where that fails.
    asked = {"en": "asked ", "it": "ha chiesto ", "de": " angefordert"}
    for language, word in asked.items():
        for deed in ("promote", "backup", "reload", "shift_mailed"):
            assert word in all_words()[language].say(f"deed.page_{deed}")


def test_the_notes_of_a_machine_are_not_pushed_out_by_those_of_another(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    log = open_audit(path, Supervisor())
    log.put(AuditEntry(EPOCH + 1.0, NOTE, "olga", "mine", {"machine": "a", "at": EPOCH + 1.0}))
    for at in range(MOST_LISTED + 3):
        log.put(AuditEntry(EPOCH + 2.0 + at, NOTE, "olga", "other", {"machine": "b", "at": EPOCH + 2.0 + at}))
    log.close()
    a, b = (notes_between(path, audit=str(path), machine=name, start=EPOCH, end=END) for name in ("a", "b"))
    assert ([note["text"] for note in a["notes"]], a["left_out"]) == (["mine"], 0)
    assert (len(b["notes"]), b["left_out"]) == (MOST_LISTED, 3)


def test_what_people_did_is_that_of_the_audit_log_and_a_name_holds_for_a_day(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    log = open_audit(path, Supervisor())
    about = {"machine": "decanter", "alarm": "link"}
    for entry in (
        AuditEntry(EPOCH - 9 * HOUR, ON_SHIFT, "olga", "Anna, Luca"),
        AuditEntry(EPOCH - HOUR, "alarm acknowledged", "olga", "", about),
        AuditEntry(EPOCH + 1.0, "write", "olga", "", {"words": [1, 2]}),
        AuditEntry(EPOCH + 2.0, "alarm shelved", "enzo", "cable", about),
        AuditEntry(EPOCH + 3.0, NOTE, "olga", "belt smells", {"machine": "decanter", "at": EPOCH - HOUR}),
        AuditEntry(EPOCH + 4.0, NOTE, "olga", "new grease", {"machine": "decanter", "at": EPOCH + 4.0}),
    ):
        log.put(entry)
    log.close()
    found = read_people(path, start=EPOCH, end=END)
    assert found["deeds"] == [
        {"time": EPOCH + 2.0, "kind": "alarm shelved", "by": "enzo", "reason": "cable", "machine": "decanter"}
        | {"alarm": {"alarm": "link", "kind": "link", "tag": ""}, "version": None}
    ]
    assert [note["text"] for note in found["notes"]] == ["new grease"]
    assert found["on_shift"] == {"names": "Anna, Luca", "by": "olga", "time": EPOCH - 9 * HOUR}
    assert [note["text"] for note in read_people(path, start=EPOCH - 2 * HOUR, end=EPOCH)["notes"]] == ["belt smells"]
    assert read_people(path, start=EPOCH + 15 * HOUR, end=EPOCH + 16 * HOUR)["on_shift"] is None, "it is a day old"
    assert found["left_out"] == {"notes": 0, "deeds": 0}
    again = open_audit(path, Supervisor())
    again.put(AuditEntry(EPOCH + 5.0, ON_SHIFT, "olga", NOBODY))
    again.close()
    assert read_people(path, start=EPOCH, end=END)["on_shift"] is None


def report() -> dict[str, Any]:
    told = {"priority": 2, "of_plant": False, "tag": "T", "state": "normal"}
    warning = told | {"alarm": "rising T", "kind": "rising", "raised": EPOCH + 60.0, "acknowledged": EPOCH + 90.0}
    warning |= {"by": "olga", "ended": EPOCH + 360.0, "warning": True, "limit_after": None}
    limit = told | {"alarm": "over limit T", "kind": "over limit", "raised": EPOCH + 900.0, "acknowledged": None}
    limit |= {"by": "", "ended": None, "warning": False, "limit_after": None}
    nearest = {"forecasts": 2, "horizon": 900.0, "minutes": 7.24, "time": EPOCH + 600.0}
    row = {"tag": "T", "limit": 80.0, "hottest": {"value": 81.25, "time": EPOCH + 905.0}, "nearest": nearest}
    machine = {"alarms": [warning, limit], "temperatures": [row], "states": [], "writes": {"shadow": 12}}
    deed = {
        "time": EPOCH + 90.0,
        "kind": "alarm acknowledged",
        "by": "olga",
        "reason": "",
        "machine": "decanter",
        "alarm": {"alarm": "rising T", "kind": "rising", "tag": "T"},
        "version": None,
    }
    return {
        "start": EPOCH,
        "end": END,
        "machines": {"decanter": machine | {"unwatched": {"count": 1, "seconds": 610.0}}},
        "on_shift": {"names": "Anna", "by": "olga", "time": EPOCH},
        "notes": [{"time": EPOCH + 5.0, "machine": "decanter", "by": "olga", "text": "new grease"}],
        "deeds": [deed],
        "left_out": {"notes": 3, "deeds": 0},
    }


def test_of_a_warning_that_stands_nothing_is_said_for_good() -> None:
    told = report()
    told["machines"]["decanter"]["alarms"][0]["ended"] = None
    for language, said in (("en", "not passed so far; stands"), ("it", "finora non superato"), ("de", "bisher nicht")):
        assert said in shift_text(all_words()[language], {}, {}, told)


def test_its_mail_is_said_in_each_language_with_all_that_is_in_it() -> None:
    labels = {"T": "gearbox bearing", "decanter": "Decanter 2"}
    text = {language: shift_text(all_words()[language], labels, {"T": "degC"}, report()) for language in LANGUAGES}
    for line in (
        "Shift report, 2023-11-14 22:13:20 to 2023-11-15 06:13:20 UTC",
        "On shift: Anna (said by olga, 2023-11-14 22:13:20)",
        "  gearbox bearing: hottest 81.2 °C (2023-11-14 22:28:25), Limit 80.0 °C",
        "  gearbox bearing: least time to the limit 7.2 min (2023-11-14 22:23:20)",
        "  Nothing was read: 10 min (1)",
        "  Blocks by verdict: computed, not written 12",
        "    2023-11-14 22:14:20  gearbox bearing: rose towards its limit: limit not passed; over after 5 min; "
        "Acknowledged by olga, 30 s",
        "    2023-11-14 22:28:20  gearbox bearing: over its limit: stands; Acknowledged by nobody",
        "  3 older ones are not listed.",
        "  2023-11-14 22:13:25  Decanter 2: new grease (olga)",
        "  2023-11-14 22:14:50  olga: alarm acknowledged, Decanter 2, gearbox bearing: rose towards its limit",
    ):
        assert line in text["en"].splitlines()
    assert "am heißesten 81,2 °C" in text["de"] and "limite non superato" in text["it"]
    assert len({len(each.splitlines()) for each in text.values()}) == 1


def test_it_goes_by_the_mail_server_of_the_alarms(mail_server: MailServer, tmp_path: Path) -> None:
    smtp = f'[notify.smtp]\nhost = "127.0.0.1"\nport = {mail_server.port}\nuser = "gateway"\n'
    authority = shutil.copy(mail_server.certificates / "ca.pem", tmp_path)
    smtp += f'sender = "gateway@example.com"\nca = "{authority}"\n'
    to = '[[notify.to]]\nname = "chief"\nemail = "nobody@example.com"\npriority = 1\n'
    to += '[[notify.to]]\nname = "shift"\nemail = "shift@example.com"\npriority = 1\n'
    text = f'{PAGE}[notify]\nsecrets = "{secrets_in(tmp_path)}"\n{smtp}{to}'
    with served(tmp_path / "plant", text, {"olga": AccountRole.OPERATOR}) as gateway:
        client = Client(gateway.port)
        assert client.ask("POST", "/api/shift/mail", {"hours": 8.0})[0] == 401
        eventually(lambda: client.log_in("olga") == 200)
        eventually(lambda: client.ask("GET", "/api/shift")[1]["machines"]["decanter"]["temperatures"][0]["hottest"])
        # The server puts its first message off, which is said; then it takes it, but never the first recipient's.
        status, answered = client.ask("POST", "/api/shift/mail", {"hours": 8.0})
        refused = "the mail server does not take the address (550)"
        assert status == 502
        assert answered["reason"] == f"nobody was told: chief: {refused}; shift: the mail server answers 451"
        told = {"told": ["shift"], "missed": {"chief": refused}}
        assert client.ask("POST", "/api/shift/mail?lang=de", {"hours": 8.0}) == (200, told)
        Path(authority).unlink()
        status, answered = client.ask("POST", "/api/shift/mail", {"hours": 8.0})
        assert status == 502 and f"smtp.ca {authority} cannot be read" in answered["reason"]
        paths = client.ask("GET", "/api/openapi.json")[1]["paths"]
        assert "502" in paths["/api/shift/mail"]["post"]["responses"]
    (mail,) = [each for each in mail_server.mails() if each["Subject"].startswith("Schichtbericht")]
    assert mail["To"] == "shift@example.com" and "am heißesten 45,0 °C" in mail.get_content()
    with served(tmp_path / "without", PAGE, {"olga": AccountRole.OPERATOR}) as gateway:
        client = Client(gateway.port)
        eventually(lambda: client.log_in("olga") == 200)
        status, answered = client.ask("POST", "/api/shift/mail", {"hours": 8.0})
        assert status == 409 and "nobody is told anything by mail" in answered["reason"]


def test_every_deed_has_its_words() -> None:
    kinds = {*DEEDS, *(f"alarm {word}" for word in BY_PERSONS.values())}
    keys = {f"deed.{re.sub('[ -]', '_', kind.replace(':', ''))}" for kind in kinds}
    assert keys == {key for key in all_words()["en"].texts if key.startswith("deed.")}
