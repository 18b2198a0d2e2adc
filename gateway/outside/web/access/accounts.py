"""The file of accounts: names, roles and what Argon2id makes of passwords; made at the box with `decanter user`.

There is no default account. The file is read anew whenever it has changed, so that an account that was removed, or
given another password or role, counts so from the next request on.
"""

import asyncio
import fcntl
import os
import stat
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from argon2 import PasswordHasher, Type
from argon2.exceptions import Argon2Error, InvalidHashError
from pydantic import Field, StringConstraints, ValidationError

from drivers.errors import OneLineError
from drivers.named_files import contents
from drivers.settings import Section, first_sentence
from gateway.network import address_origin
from gateway.outside.web.access.roles import AccountRole
from gateway.store import write_durably

LEAST_LENGTH, MOST_LENGTH = 12, 128
"""Characters of a password (OWASP ASVS 4.0, 2.1.1 and 2.1.2)."""
MOST_BYTES = 1 << 20
MOST_WAITING, WAITING_OF_ADDRESS = 8, 2
"""Passwords that wait to be looked at, in all and of one address; more are refused at once."""
HASHER = PasswordHasher(time_cost=2, memory_cost=19 * 1024, parallelism=1, type=Type.ID)
"""OWASP's least parameters for Argon2id: a box of two cores and 1 GB that reads a PLC is to check a password beside."""


class AccountsError(OneLineError, ValueError):
    """The file of accounts cannot be used, or not so; the message is one sentence."""


AccountName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,39}$")]


class PageAccount(Section):
    """One account; `changed` counts its changes, and ends the sessions that began before."""

    role: Annotated[AccountRole, Field(strict=False)] = Field(description=f"one of {', '.join(AccountRole)}")
    password: str = Field(min_length=1, max_length=500, description="what Argon2id made of the password")
    changed: int = Field(1, ge=1, description="a whole number from 1")


class _AccountFile(Section):
    format: Literal[1] = Field(description="1")
    accounts: dict[AccountName, PageAccount] = Field(description="an object of accounts by their names")


def read_accounts(path: Path) -> dict[str, PageAccount]:
    """The accounts by their names; none where there is no file. Raises AccountsError."""
    try:
        text = contents(path, MOST_BYTES)
        mode = path.stat().st_mode
    except FileNotFoundError:
        return {}
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise AccountsError(f"{path}: cannot be read ({reason}); give its user the right to read it") from None
    if mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise AccountsError(f"{path}: others than its owner may write it; take that right away (chmod 600)")
    try:
        return _AccountFile.model_validate_json(text).accounts
    except ValidationError as error:
        raise AccountsError(first_sentence(_AccountFile, error, str(path))) from None


def accounts_problem(path: Path) -> str:
    """Why there is no usable file of accounts at the path, in a sentence without it; "" where there is one."""
    try:
        return "" if read_accounts(path) else "has no accounts any more"
    except AccountsError as error:
        return str(error).removeprefix(f"{path}: ")


@contextmanager
def _edit_accounts(path: Path) -> Iterator[dict[str, PageAccount]]:
    """The accounts to be changed, then written; two commands at a time take turns. Raises AccountsError, OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = os.open(path.with_name(f".{path.name}.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        accounts = read_accounts(path)
        yield accounts
        text = _AccountFile(format=1, accounts=accounts).model_dump_json(indent=1)
        write_durably(path, text.encode() + b"\n", mode=0o600)
    finally:
        os.close(lock)


def add_account(path: Path, name: str, role: AccountRole, password: str) -> None:
    """Make an account. Raises AccountsError for a name that is there or cannot be, and for a bad password."""
    with _edit_accounts(path) as accounts:
        if name in accounts:
            raise AccountsError(f"there is an account {name!r} already; change its password, or remove it first")
        _check_password(name, password)
        accounts[name] = PageAccount(role=role, password=HASHER.hash(password))
        try:
            _AccountFile(format=1, accounts=accounts)
        except ValidationError:
            words = "give letters, digits, '_', '-' and '.', 40 at most"
            raise AccountsError(f"{name[:60]!r} is no name of an account; {words}") from None


def change_password(path: Path, name: str, password: str) -> None:
    """Give an account another password; its sessions end. Raises AccountsError."""
    with _edit_accounts(path) as accounts:
        before = _require_account(accounts, name)
        _check_password(name, password)
        update = {"password": HASHER.hash(password), "changed": before.changed + 1}
        accounts[name] = before.model_copy(update=update)


def remove_account(path: Path, name: str) -> None:
    """Remove an account; its sessions end. Raises AccountsError."""
    with _edit_accounts(path) as accounts:
        _require_account(accounts, name)
        del accounts[name]


def _require_account(accounts: Mapping[str, PageAccount], name: str) -> PageAccount:
    if name not in accounts:
        raise AccountsError(f"there is no account {name[:60]!r}; there are {', '.join(accounts) or 'none'}")
    return accounts[name]


def password_problem(name: str, password: str) -> str:
    """What is wrong with a new password; "" if nothing is."""
    if not LEAST_LENGTH <= len(password) <= MOST_LENGTH:
        return f"has {len(password)} characters; give {LEAST_LENGTH} to {MOST_LENGTH}"
    if name.lower() in password.lower() or len(set(password)) < 5:
        return "holds the account's name, or the same few characters again and again; give another one"
    return ""


def _check_password(name: str, password: str) -> None:
    if problem := password_problem(name, password):
        raise AccountsError(f"the password {problem}")


class Accounts:
    """The accounts as the file has them now."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stamp: tuple[int, int, int] | None = None
        self._accounts: dict[str, PageAccount] = {}

    def get(self, name: str) -> PageAccount | None:
        """The account of that name. Raises AccountsError where the file cannot be used: then nobody has one."""
        try:
            there = self.path.stat()
            stamp = (there.st_ino, there.st_mtime_ns, there.st_size)
        except OSError:
            stamp = None
        if stamp is None or stamp != self._stamp:
            self._stamp, self._accounts = None, {}
            self._accounts = read_accounts(self.path)
            self._stamp = stamp
        return self._accounts.get(name)


class PasswordChecks:
    """Looks at passwords in a thread, one at a time: each takes 19 MB, and its time."""

    def __init__(self) -> None:
        self._waiting = Counter[str]()
        self._turn = asyncio.Semaphore(1)
        # A name that is not there takes as long to refuse as a wrong password does.
        self._nobody = HASHER.hash(os.urandom(16).hex())

    def has_room(self, address: str) -> bool:
        """Whether a password from an address may wait for its turn."""
        return self._waiting.total() < MOST_WAITING and self._waiting[address_origin(address)] < WAITING_OF_ADDRESS

    async def right(self, account: PageAccount | None, password: str, address: str) -> bool:
        """Whether the password is the account's; as long without an account."""
        origin = address_origin(address)
        self._waiting[origin] += 1
        try:
            async with self._turn:
                return await asyncio.to_thread(self._verify, account, password)
        finally:
            self._waiting -= Counter((origin,))  # what is at 0 is left out

    def _verify(self, account: PageAccount | None, password: str) -> bool:
        try:
            return HASHER.verify(account.password if account else self._nobody, password) and account is not None
        except (Argon2Error, InvalidHashError):
            return False
