"""What all commissioning commands share: device, evidence, steps, records, the way through a running gateway."""

from gateway.commission.session.execution import audit_path, login, perform, target_of
from gateway.commission.session.gateway_line import mention_gateway, read_through, running_gateway
from gateway.commission.session.records import (
    CommandRecord,
    RecordsError,
    at,
    broken_at,
    read_records,
    versions,
)
from gateway.commission.session.site import Site, device_of, period_of, words_of
from gateway.commission.session.steps import CheckStep, failed, ok, result_of, step_lines, warning
from gateway.commission.session.target import CONNECT_S, DEFAULT_DRIVER, Target, TargetError, gateway_of, make_target
