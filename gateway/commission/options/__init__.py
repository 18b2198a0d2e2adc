"""The options that all `decanter plc` commands share, in a room of their own: the help of `plc` loads nothing else."""

from gateway.commission.options.files import (
    DRY_RUN,
    HEARTBEAT,
    KEEP,
    ORDERS,
    TYPES,
    list_options,
    pairs,
)
from gateway.commission.options.shared import (
    SharedOption,
    SharedOptions,
    audit_option,
    bit_option,
    link_options,
    only_option,
    period_option,
    place_options,
    plant_options,
    record_options,
    shared_options,
)
