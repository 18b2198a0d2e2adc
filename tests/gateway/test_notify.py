"""Messages about alarms: real mail and web hooks, again until delivered, the next recipient, never a scan later."""

import asyncio
import email
import json
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from email import policy
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from gateway.cli.main import main
from gateway.machine.alarms import Alarm, AlarmCondition, AlarmState
from gateway.network.certificates import make_all
from gateway.outside.notify import AlarmMessage, Notifier, RefusedError, UndeliveredError, make_senders
from gateway.outside.notify.notifier import MAX_WAITING_DELIVERIES
from gateway.settings import NotifySecrets, NotifySection, RecipientRow, load_secrets
from tests.gateway.support import EPOCH, TEMPERATURE, Bench, JumpClock, config_in
from tests.gateway.test_alarm_machine import Kept, Silent
from tests.gateway.test_app import go

PASSWORD, TOKEN = "correct horse", "battery-staple"
HOT = AlarmCondition(
    "over limit T", "T", bit=0, limit=80.0, priority=1, response="reduce the load", consequence="damage"
)
MESSAGE = AlarmMessage(
    machine="decanter", alarm=HOT.name, tag="T", priority=1, state="unacknowledged", raised=EPOCH, first_up=True,
    response=HOT.response, consequence=HOT.consequence,
)  # fmt: skip


def until(true: Any, seconds: float = 120.0) -> None:
    """Wait until it is so."""
    end = monotonic() + seconds
    while not true():
        assert monotonic() < end, "it did not come about in time"
        sleep(0.005)


# ---------------------------------------------------------------- mail


@dataclass
class MailServer:
    folder: Path
    certificates: Path
    port: int

    def section(self, address: str = "shift@example.com", *, secrets: Path, **smtp: Any) -> NotifySection:
        server = {"host": "127.0.0.1", "port": self.port, "user": "gateway", "sender": "gateway@example.com"}
        server |= {"ca": self.certificates / "ca.pem", **smtp}
        return NotifySection.model_validate(
            {"secrets": secrets, "smtp": server, "to": [{"name": "shift", "email": address, "priority": 4}]}
        )

    def mails(self) -> list[Any]:
        names = sorted(self.folder.glob("*.eml"))
        return [email.message_from_bytes(path.read_bytes(), policy=policy.default) for path in names]


@pytest.fixture(scope="module")
def mail_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MailServer]:
    """A server that puts its first message off."""
    folder = tmp_path_factory.mktemp("mail")
    certificates = make_all(tmp_path_factory.mktemp("smtp") / "certificates", hosts=["127.0.0.1"])
    command = [sys.executable, "-m", "tests.rig.smtp_server", str(folder), str(certificates), "gateway", PASSWORD, "1"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield MailServer(folder, certificates, int(process.stdout.readline()))
        process.kill()


def secrets_in(folder: Path, text: str = f'smtp_password = "{PASSWORD}"\n', mode: int = 0o600) -> Path:
    path = folder / "secrets.toml"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_a_mail_that_is_put_off_comes_once_with_what_to_do(mail_server: MailServer, tmp_path: Path) -> None:
    section = mail_server.section(secrets=secrets_in(tmp_path))
    send = make_senders(section, load_secrets(section))["shift"]
    with pytest.raises(UndeliveredError, match="answers 451"):
        send([MESSAGE], EPOCH)
    send([MESSAGE], EPOCH)
    (mail,) = mail_server.mails()
    assert mail["To"] == "shift@example.com" and mail["Auto-Submitted"] == "auto-generated"
    assert mail["Subject"] == "alarm, priority 1: over limit T (decanter)"
    text = mail.get_content()
    assert "what to do: reduce the load" in text and "otherwise: damage" in text and "first of all" in text
    assert "2023-11-14 22:13:20 UTC" in text


def test_a_wrong_password_and_an_unknown_address_are_told_apart_and_quoted_nowhere(
    mail_server: MailServer, tmp_path: Path
) -> None:
    section = mail_server.section(secrets=secrets_in(tmp_path, 'smtp_password = "wrong"\n'))
    with pytest.raises(UndeliveredError, match=r"refuses smtp\.user \(535\)") as wrong:
        make_senders(section, load_secrets(section))["shift"]([MESSAGE], EPOCH)
    assert "wrong" not in str(wrong.value)
    section = mail_server.section("nobody@example.com", secrets=secrets_in(tmp_path))
    with pytest.raises(RefusedError, match=r"does not take the address \(550\)"):
        make_senders(section, load_secrets(section))["shift"]([MESSAGE], EPOCH)


def test_a_server_whose_certificate_nobody_vouches_for_gets_no_password(
    mail_server: MailServer, tmp_path: Path
) -> None:
    section = mail_server.section(secrets=secrets_in(tmp_path), ca=None)
    with pytest.raises(UndeliveredError, match="TLS: CERTIFICATE_VERIFY_FAILED"):
        make_senders(section, load_secrets(section))["shift"]([MESSAGE], EPOCH)


# ---------------------------------------------------------------- secrets and settings


@pytest.mark.parametrize(
    ("text", "mode", "sentence"),
    [
        (f'smtp_password = "{PASSWORD}"\n', 0o640, "others may read the secrets (mode 640)"),
        (f'smtp_passwort = "{PASSWORD}"\n', 0o600, "smtp_passwort"),
        (f'smtp_password = ["{PASSWORD}"]\n', 0o600, "smtp_password: must be text"),
        (f'smtp_password = "{PASSWORD}\n', 0o600, "is not TOML"),
        ("", 0o600, "smtp_password: is missing"),
    ],
)
def test_secrets_that_cannot_be_used_are_refused_and_not_quoted(
    text: str, mode: int, sentence: str, tmp_path: Path
) -> None:
    section = MailServer(tmp_path, tmp_path, 25).section(secrets=secrets_in(tmp_path, text, mode), ca=None)
    with pytest.raises(ConfigError) as refused:
        load_secrets(section)
    assert sentence in str(refused.value) and PASSWORD not in str(refused.value)


SMTP = '[notify.smtp]\nhost = "mail.example.com"\nsender = "a@example.com"\n'


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('[[notify.to]]\nname = "a"\nemail = "a@example.com"\n', "mail needs a server"),
        ('[[notify.to]]\nname = "a"\n', "needs either email or webhook"),
        ('[[notify.to]]\nname = "a"\nwebhook = "http://example.com/x"\n', "in the clear"),
        ('[[notify.to]]\nname = "a"\nwebhook = "https://u:p@example.com/x"\n', "holds a password"),
        ('[[notify.to]]\nname = "a"\nwebhook = "ftp://example.com"\n', "no address of a web hook"),
        ('[[notify.to]]\nname = "a"\nwebhook = "secret"\n', "needs the file of secrets"),
        (SMTP + '[[notify.to]]\nname = "a"\nemail = "a\\n@example.com"\n', "one line"),
        (SMTP + '[[notify.to]]\nname = "a"\nemail = "nobody"\n', "no mail address"),
        (SMTP + 'user = "me"\n', "smtp.user needs a password"),
        (SMTP + 'user = "me"\nsecurity = "none"\n', "password in the clear"),
        (SMTP + '[[notify.to]]\nname = "a"\nemail = "a@b.c"\npriority = 9\n', "must be at most 4"),
        (SMTP + '[[notify.to]]\nname = "a"\nmail = "a@b.c"\n', "there is no such key"),
        (SMTP + '[[notify.to]]\nname = "a"\nemail = "a@b.c"\n' * 2, "named twice"),
    ],
)
def test_recipients_that_cannot_be_are_refused_in_one_sentence(text: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as refused:
        config_in(tmp_path, text)
    assert len(refused.value.problems) == 1 and sentence in refused.value.problems[0], refused.value


# ---------------------------------------------------------------- when who is told


@dataclass
class Hand:
    """A monotonic clock that stands until it is set, and senders that note what they are given."""

    time: float = 100.0
    sent: list[tuple[float, str, tuple[str, ...]]] = field(default_factory=list)
    failing: dict[str, Exception] = field(default_factory=dict)
    tries: list[tuple[float, str]] = field(default_factory=list)

    def clock(self) -> float:
        return self.time

    def now(self) -> float:
        return EPOCH + self.time

    def sender(self, name: str) -> Any:
        def send(messages: Sequence[AlarmMessage], _: float) -> None:
            self.tries.append((self.time, name))
            if name in self.failing:
                raise self.failing[name]
            self.sent.append((self.time, name, tuple(message.alarm for message in messages)))

        return send


ROWS = [
    RecipientRow(name="shift", email="shift@example.com", priority=2),
    RecipientRow(name="chief", email="chief@example.com", priority=1, after=15.0),
]


@contextmanager
def telling(hand: Hand, kept: Kept | None = None, unseen: Sequence[tuple[AlarmCondition, Alarm]] = ()) -> Iterator[Any]:
    rows = ROWS
    senders = {row.name: hand.sender(row.name) for row in rows}
    log: Any = Silent()
    notifier = Notifier(rows, senders, now=hand.now, supervisor=Supervisor(), log=log, clock=hand.clock)
    store: Any = kept or Kept()
    notifier.attach("decanter", store, unseen, known=("rising", "link", HOT.name))
    try:
        yield notifier
    finally:
        notifier.close()


def at(hand: Hand, notifier: Notifier, time: float) -> None:
    """Set the clock, and wake who waits by it."""
    hand.time = time
    with notifier._wake:
        notifier._changed.add("decanter")
        notifier._wake.notify_all()
    sleep(0.02)


def raised(hand: Hand, name: str = HOT.name, priority: int = 1) -> tuple[AlarmCondition, Alarm, Alarm]:
    condition = AlarmCondition(name, "T", bit=0, limit=80.0, priority=priority)
    before = Alarm(name, "T", priority)
    now = hand.now()
    after = Alarm(name, "T", priority, AlarmState.UNACKNOWLEDGED, now, standing=True, raised=now)
    return condition, before, after


def test_the_next_recipient_is_told_when_nobody_acknowledges() -> None:
    hand = Hand()
    with telling(hand) as notifier:
        notifier.take("decanter", *raised(hand))
        until(lambda: hand.sent)
        at(hand, notifier, 100.0 + 899.0)
        assert hand.sent == [(100.0, "shift", (HOT.name,))]
        at(hand, notifier, 100.0 + 900.0)
        until(lambda: len(hand.sent) == 2)
        assert hand.sent[1] == (1000.0, "chief", (HOT.name,)) and notifier.waiting == 0


@pytest.mark.parametrize("state", [AlarmState.ACKNOWLEDGED, AlarmState.NORMAL, AlarmState.SHELVED])
def test_nobody_else_is_told_of_what_somebody_knows(state: AlarmState) -> None:
    hand = Hand()
    with telling(hand) as notifier:
        condition, before, after = raised(hand)
        notifier.take("decanter", condition, before, after)
        until(lambda: hand.sent)
        notifier.take("decanter", condition, after, Alarm(HOT.name, "T", 1, state, hand.now()))
        at(hand, notifier, 5000.0)
        assert len(hand.sent) == 1 and notifier.waiting == 0


def test_what_returns_by_itself_is_still_escalated_and_what_is_less_urgent_is_not_sent() -> None:
    hand = Hand()
    with telling(hand) as notifier:
        condition, before, after = raised(hand)
        notifier.take("decanter", condition, before, after)
        notifier.take("decanter", condition, after, Alarm(HOT.name, "T", 1, AlarmState.RETURNED, hand.now()))
        notifier.take("decanter", *raised(hand, "review", priority=3))
        notifier.take("decanter", *raised(hand, "rising", priority=2))
        at(hand, notifier, 110.0)
        until(lambda: sum(len(row[2]) for row in hand.sent) == 2)
        at(hand, notifier, 2000.0)
        until(lambda: len([row for row in hand.sent if row[1] == "chief"]) == 1)
        assert {alarm for _, _, alarms in hand.sent for alarm in alarms} == {HOT.name, "rising"}


def test_an_alarm_that_chatters_is_told_once_until_somebody_acknowledges() -> None:
    hand = Hand()
    with telling(hand) as notifier:
        condition, before, after = raised(hand)
        notifier.take("decanter", condition, before, after)
        until(lambda: hand.sent)
        for _ in range(20):
            at_rest = Alarm(HOT.name, "T", 1, AlarmState.RETURNED, hand.now(), raised=after.raised)
            notifier.take("decanter", condition, after, at_rest)
            condition, _, after = raised(hand)
            notifier.take("decanter", condition, at_rest, after)
            hand.time += 10.0
        assert notifier.waiting == 1 and len(hand.sent) == 1, "only the escalation waits"
        known = Alarm(HOT.name, "T", 1, AlarmState.NORMAL, hand.now())
        notifier.take("decanter", condition, after, known)
        notifier.take("decanter", condition, known, raised(hand)[2])
        at(hand, notifier, hand.time + 10.0)
        until(lambda: len(hand.sent) == 2)


def test_a_token_that_no_header_holds_is_refused_and_not_quoted() -> None:
    row = {"name": "a", "webhook": "http://127.0.0.1:1/x"}
    section = NotifySection.model_validate({"to": [row]})
    send = make_senders(section, NotifySecrets(tokens={"a": f"{TOKEN}\n"}))["a"]
    with pytest.raises(RefusedError) as refused:
        send([MESSAGE], EPOCH)
    assert TOKEN not in str(refused.value)


def test_a_recipient_that_fails_is_tried_at_growing_pauses_and_then_told_everything_at_once() -> None:
    hand = Hand(failing={"shift": UndeliveredError("the mail server cannot be used")})
    with telling(hand) as notifier:
        notifier.take("decanter", *raised(hand))
        until(lambda: len(hand.tries) == 1)
        assert not notifier.complaint
        for count, time in enumerate((100.9, 101.0, 102.9, 103.0), start=1):
            at(hand, notifier, time)
            until(lambda count=count: len(hand.tries) >= 1 + count // 2)
        assert [time for time, name in hand.tries if name == "shift"] == [100.0, 101.0, 103.0]
        notifier.take("decanter", *raised(hand, "link", priority=1))
        at(hand, notifier, 200.0)
        until(lambda: len(hand.tries) == 4)
        assert notifier.complaint == "shift: the mail server cannot be used"
        hand.failing.clear()
        at(hand, notifier, 300.0)
        until(lambda: hand.sent)
        assert hand.sent == [(300.0, "shift", (HOT.name, "link"))] and not notifier.complaint


def test_of_too_many_the_least_urgent_are_given_up_and_counted() -> None:
    hand = Hand(failing={"shift": UndeliveredError("away")})
    with telling(hand) as notifier:
        notifier.take("decanter", *raised(hand))
        for number in range(MAX_WAITING_DELIVERIES + 20):
            notifier.take("decanter", *raised(hand, f"rising {number}", priority=2))
        until(lambda: notifier.waiting == MAX_WAITING_DELIVERIES)
        assert notifier.given_up == 22 and (f"decanter\n{HOT.name}\n{hand.now()!r}", "shift") in notifier._waiting


def test_a_restart_forgets_no_message_and_sends_none_anew() -> None:
    hand, kept = Hand(), Kept()
    condition, before, after = raised(hand)
    with telling(hand, kept) as notifier:
        notifier.take("decanter", condition, before, after)
        until(lambda: hand.sent)
        until(lambda: json.loads(kept.states["messages"][1])["known"])
        hand.failing["shift"] = UndeliveredError("away")
        hand.time = 400.0
        notifier.take("decanter", *raised(hand, "link"))
        until(lambda: len(hand.tries) == 2)
    hand.failing.clear()
    with telling(hand, kept, [(condition, after)]) as notifier:
        until(lambda: len(hand.sent) == 2)
        assert hand.sent[1][1:] == ("shift", ("link",)), "the first one knows already of the alarm that still waits"
        at(hand, notifier, 1001.0)
        until(lambda: len(hand.sent) == 3)
        assert hand.sent[2] == (1001.0, "chief", (HOT.name,))


# ---------------------------------------------------------------- the gateway and a web hook


@dataclass
class Hook:
    """A web hook that answers `statuses` one after the other, then 204; `held` keeps it from answering."""

    statuses: list[int]
    got: list[tuple[dict[str, str], dict[str, Any]]] = field(default_factory=list)
    held: threading.Event = field(default_factory=threading.Event)
    port: int = 0


@contextmanager
def hook(*statuses: int) -> Iterator[Hook]:
    seen = Hook(list(statuses))

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            seen.held.wait(60.0)
            status = seen.statuses.pop(0) if seen.statuses else 204
            if status == 204:
                seen.got.append((dict(self.headers), body))
            self.send_response(status)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            return

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        seen.port = server.server_address[1]
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield seen
        finally:
            seen.held.set()
            server.shutdown()
            thread.join()


async def test_the_gateway_tells_a_web_hook_once_without_a_scan_waiting_and_its_log_has_no_secret(
    tmp_path: Path,
) -> None:
    with hook(503) as seen:
        address = f"http://127.0.0.1:{seen.port}/alarms?key={TOKEN}-in-the-address"
        secrets_in(tmp_path, f'[webhooks]\nshift = "{address}"\n[tokens]\nshift = "{TOKEN}"\n')
        text = '[notify]\nsecrets = "secrets.toml"\n[[notify.to]]\nname = "shift"\nwebhook = "secret"\npriority = 1\n'
        config = config_in(tmp_path, "[alarms]\noff_delay = 0\n" + text)
        clock = JumpClock()
        bench = Bench(config, clock)
        bench.plan[10] = {TEMPERATURE: 90.0}
        # The hook does not answer until a hundred scans are done.
        bench.plan[200] = {TEMPERATURE: 20.0}
        running = asyncio.create_task(go(config, bench, 100_000))
        while bench.reads < 300:
            await asyncio.sleep(0.001)
        assert not seen.got, "while it does not answer the scans go on"
        seen.held.set()
        async with asyncio.timeout(120.0):
            while not seen.got:
                await asyncio.sleep(0.01)
        bench.stop.set()
        await running
    ((headers, body),) = seen.got
    assert headers["Authorization"] == f"Bearer {TOKEN}" and len(headers["Idempotency-Key"]) == 32
    (alarm,) = body["alarms"]
    assert (alarm["alarm"], alarm["priority"], alarm["machine"]) == (f"over limit {TEMPERATURE}", 1, "decanter")
    log = (tmp_path / "gateway.jsonl").read_text()
    assert "the web hook answers 503" in log and TOKEN not in log


def test_a_hook_that_refuses_for_good_is_not_asked_again_and_one_that_says_later_is() -> None:
    section = NotifySection.model_validate({"to": [{"name": "a", "webhook": "http://127.0.0.1:1/x"}]})
    with pytest.raises(UndeliveredError, match="cannot be reached"):
        make_senders(section, load_secrets(section))["a"]([MESSAGE], EPOCH)
    with hook(404, 302, 429) as seen:
        seen.held.set()
        section = NotifySection.model_validate({"to": [{"name": "a", "webhook": f"http://127.0.0.1:{seen.port}/x"}]})
        send = make_senders(section, load_secrets(section))["a"]
        for kind in (RefusedError, RefusedError, UndeliveredError):
            with pytest.raises(kind):
                send([MESSAGE], EPOCH)


def test_plc_check_says_that_the_secrets_cannot_be_used_before_the_gateway_is_started(tmp_path: Path) -> None:
    secrets = secrets_in(tmp_path, mode=0o644)
    text = f'[notify]\nsecrets = "{secrets}"\n[[notify.to]]\nname = "a"\nwebhook = "https://example.com/x"\n'
    config = config_in(tmp_path, text)
    words = ["plc", "check", "--offline", "--config", str(config.path), "--json"]
    refused = CliRunner().invoke(main, words)
    assert refused.exit_code == 1 and "chmod 600" in refused.output and PASSWORD not in refused.output
    secrets.chmod(0o600)
    assert "alarms are told to a" in CliRunner().invoke(main, words).output
