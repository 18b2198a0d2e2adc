"""What holds for the gateway's tests: their audit log lies on a disk that may be busy with other things."""

from tests.rig.patient_disk import patient_disk

__all__ = ["patient_disk"]
