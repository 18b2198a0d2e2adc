"""What is written back to the PLC: the block, who may write it and when."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.machine.writing.arming import (
        ArmingError,
        arm_in_log,
        disarm_in_log,
        end_by_mode,
        keep_disarming,
        next_start,
        own_process,
        parse_arming,
        sign_arming,
        uptime,
    )
    from gateway.machine.writing.block import (
        NO_NUMBER,
        NO_TEMPERATURE,
        SessionWords,
        Validity,
        build,
        crc,
        next_heartbeat,
        read_numbers,
    )
    from gateway.machine.writing.block_stage import BlockStage
    from gateway.machine.writing.witnessing import (
        SIGN_SECONDS,
        clear_for_arming,
        countersign,
        find_places,
        obstacle,
        witness_places,
    )
    from gateway.machine.writing.writeback import FAILED, REFUSED, WRITE, Arming
    from gateway.machine.writing.writeback_stage import AuditTrail, WritebackStage, open_audit_trail
else:
    __getattr__ = lazy_getattr(__name__)
