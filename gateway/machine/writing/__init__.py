"""What is written back to the PLC: the block, who may write it and when."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from gateway.machine.writing.arming import (
        ArmingError,
        arm_in_log,
        arming_of,
        disarm_in_log,
        end_by_mode,
        keep_disarming,
        next_start,
        own_process,
        signed,
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
        obstacle,
        places_for,
        places_of,
    )
    from gateway.machine.writing.writeback import FAILED, REFUSED, WRITE, Arming
    from gateway.machine.writing.writeback_stage import AuditTrail, WritebackStage, open_audit_trail
else:
    __getattr__ = opened_at_use(__name__)
