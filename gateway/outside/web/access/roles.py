"""What accounts of the page may do."""

from collections.abc import Mapping
from enum import StrEnum


class AccountRole(StrEnum):
    """What an account may do; each may do what those before it may."""

    OPERATOR = "operator"
    ENGINEER = "engineer"
    ADMINISTRATOR = "administrator"


ROLES: Mapping[AccountRole, str] = {
    AccountRole.OPERATOR: "acknowledges, resets and shelves alarms",
    AccountRole.ENGINEER: "arms and disarms, takes alarms out of service, too",
    AccountRole.ADMINISTRATOR: "has the plant file read anew, too",
}
"""The roles in their order, each with what it adds."""
