"""Who may do what at the page: accounts made at the box, sessions that end, lock-out."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.outside.web.access.accounts import (
        Accounts,
        AccountsError,
        PasswordChecks,
        accounts_problem,
        add_account,
        change_password,
        password_problem,
        read_accounts,
        remove_account,
    )
    from gateway.outside.web.access.lockout import Lockout
    from gateway.outside.web.access.roles import ROLES, AccountRole
    from gateway.outside.web.access.sessions import Session, Sessions
else:
    __getattr__ = lazy_getattr(__name__)
