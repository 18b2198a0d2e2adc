"""Accounts, sessions, lock-out and what may not be served: without a socket."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.settings import ConfigError
from gateway.cli.main import main
from gateway.outside.web import check_page
from gateway.outside.web.access import (
    AccountRole,
    Accounts,
    AccountsError,
    Lockout,
    Sessions,
    add_account,
    change_password,
    password_problem,
    read_accounts,
)
from gateway.settings import load_plant
from tests.gateway.support import config_in, plant_file
from tests.page.served import PASSWORD


@dataclass
class Hand:
    """A clock that is moved by hand."""

    time: float = 1000.0

    def __call__(self) -> float:
        return self.time


def run(folder: Path, *words: str, text: str = PASSWORD + "\n") -> tuple[int, str]:
    done = CliRunner().invoke(main, ["user", *words, "--config", str(folder / "plant.toml")], input=text)
    return done.exit_code, done.output


def test_accounts_are_made_at_the_box_and_nobody_has_one_before(tmp_path: Path) -> None:
    plant_file(tmp_path)
    file = tmp_path / "users.json"
    assert "there is no account yet" in run(tmp_path, "list")[1]
    assert run(tmp_path, "add", "olga", "--role", "operator")[0] == 0
    assert file.stat().st_mode & 0o777 == 0o600 and PASSWORD not in file.read_text(encoding="utf-8")
    assert "$argon2id$" in file.read_text(encoding="utf-8")
    code, said = run(tmp_path, "list", "--json")
    assert code == 0 and json.loads(said)["accounts"] == {"olga": "operator"}
    assert run(tmp_path, "password", "olga", text="another horse battery\n")[0] == 0
    assert read_accounts(file)["olga"].changed == 2
    assert run(tmp_path, "remove", "olga")[0] == 0 and read_accounts(file) == {}


@pytest.mark.parametrize(
    ("words", "text", "said"),
    [
        (("add", "olga", "--role", "operator"), "short\n", "the password has 5 characters; give 12 to 128"),
        (("add", "olga", "--role", "operator"), "xolgaolgaolgax\n", "holds the account's name"),
        (("add", "olga", "--role", "operator"), "aaaaaaaaaaaaaaa\n", "the same few characters"),
        (("add", "ol ga", "--role", "operator"), PASSWORD + "\n", "is no name of an account"),
        (("add", "ada", "--role", "administrator"), PASSWORD + "\n", "there is an account 'ada' already"),
        (("remove", "nobody"), "", "there is no account 'nobody'; there are ada"),
    ],
)
def test_what_cannot_be_an_account_is_one_sentence(
    tmp_path: Path, words: tuple[str, ...], text: str, said: str
) -> None:
    plant_file(tmp_path)
    add_account(tmp_path / "users.json", "ada", AccountRole.ADMINISTRATOR, PASSWORD)
    code, output = run(tmp_path, *words, text=text)
    assert code == 2 and said in output and output.count("\n") == 1
    assert list(read_accounts(tmp_path / "users.json")) == ["ada"]


@pytest.mark.parametrize(
    ("content", "mode", "said"),
    [
        ("{", 0o600, "users.json"),
        ('{"format": 1, "accounts": {"a": {"role": "king", "password": "x"}}}', 0o600, "role"),
        ('{"format": 1, "accounts": {}}', 0o666, "others than its owner may write it"),
    ],
)
def test_a_file_of_accounts_that_cannot_be_trusted_lets_nobody_in(
    tmp_path: Path, content: str, mode: int, said: str
) -> None:
    file = tmp_path / "users.json"
    file.write_text(content, encoding="utf-8")
    file.chmod(mode)
    with pytest.raises(AccountsError, match=said) as caught:
        Accounts(file).get("a")
    assert "\n" not in str(caught.value)


def test_a_session_ends_idle_after_a_shift_and_with_its_account(tmp_path: Path) -> None:
    file, clock = tmp_path / "users.json", Hand()
    add_account(file, "olga", AccountRole.OPERATOR, PASSWORD)
    accounts = Accounts(file)
    account = accounts.get("olga")
    assert account is not None
    sessions = Sessions(accounts, 600.0, clock)
    idle, _ = sessions.open("olga", account, "::1")
    busy, session = sessions.open("olga", account, "::1")
    for _ in range(70):
        clock.time += 590.0
        assert sessions.find(busy, use=True) is not None
        assert sessions.remaining_seconds(session) <= 600.0
    assert sessions.find(idle) is None and sessions.find("guessed") is None
    clock.time += 12 * 3600.0 - 70 * 590.0 + 1.0
    session.used = clock.time
    assert sessions.find(busy, use=True) is None, "a shift is over, however busy"
    other, _ = sessions.open("olga", account, "::1")
    change_password(file, "olga", "another horse battery")
    assert sessions.find(other) is None


def test_wrong_passwords_lock_the_account_longer_each_time_and_the_address_at_last() -> None:
    clock = Hand()
    lockout, waits = Lockout(clock), []
    for _ in range(10):
        lockout.failed("olga", "10.0.0.9")
        waits.append(lockout.wait("olga", "10.0.0.9"))
        clock.time += waits[-1]
    assert waits == [0.0, 0.0, 0.0, 0.0, 30.0, 60.0, 120.0, 240.0, 480.0, 900.0]
    assert lockout.wait("ada", "10.0.0.9") == 0.0
    for number in range(10):
        lockout.failed(f"name {number}", "10.0.0.9")
    assert lockout.wait("ada", "10.0.0.9") == 30.0 and lockout.wait("ada", "10.0.0.10") == 0.0
    lockout.note_success("olga", "10.0.0.10")
    assert lockout.wait("olga", "10.0.0.10") == 0.0


def test_what_is_remembered_of_wrong_passwords_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.outside.web.access.lockout.MOST_KEPT", 10)
    lockout = Lockout(Hand())
    for number in range(100):
        lockout.failed(f"name {number}", f"address {number}")
    assert len(lockout._failed) == 10


def test_a_password_is_long_and_not_the_name() -> None:
    assert password_problem("olga", PASSWORD) == ""
    assert password_problem("olga", "x" * 200).startswith("has 200 characters")


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "gateway.plant.local"])
def test_elsewhere_than_on_this_computer_it_is_refused_without_tls(tmp_path: Path, host: str) -> None:
    plant_file(tmp_path, f'[page]\nenabled = true\nhost = "{host}"\n')
    with pytest.raises(ConfigError, match="give certificates") as caught:
        load_plant(tmp_path / "plant.toml")
    assert len(caught.value.problems) == 1


def test_with_tls_it_needs_an_account_and_a_certificate_that_can_be_used(tmp_path: Path) -> None:
    text = '[page]\nenabled = true\nhost = "0.0.0.0"\ncertificates = "tls"\n'
    config = config_in(tmp_path, text)
    with pytest.raises(ConfigError, match=r"there is no account in .*users.json; make one with"):
        check_page(config)
    add_account(config.users, "ada", AccountRole.ADMINISTRATOR, PASSWORD)
    with pytest.raises(ConfigError, match=r"server.pem and server.key in .*tls cannot be used"):
        check_page(config)
