"""What all commissioning commands share: device, evidence, steps, records, the way through a running gateway."""

from gateway.commission.session.execution import audit_path, find_target, login, perform
from gateway.commission.session.gateway_line import mention_gateway, read_samples, running_gateway
from gateway.commission.session.records import (
    CommandRecord,
    RecordsError,
    find_break,
    format_moment,
    read_records,
    versions,
)
from gateway.commission.session.site import Site, find_period, list_block_words, require_device
from gateway.commission.session.steps import CheckStep, conclude_steps, failed_step, ok, step_lines, warning
from gateway.commission.session.target import (
    CONNECT_S,
    DEFAULT_DRIVER,
    Target,
    TargetError,
    gateway_target,
    make_target,
)
