"""The words for how a gateway is."""

from enum import StrEnum


class Health(StrEnum):
    """The word for a gateway; `decanter top --once` has an exit code for each."""

    WELL = "well"
    ATTENTION = "attention"
    NO_READINGS = "no readings"
    ABSENT = "absent"
    SILENT = "silent"
