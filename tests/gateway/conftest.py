"""What holds for the gateway's tests: their audit log lies on a disk that may be busy with other things."""

import pytest


@pytest.fixture(autouse=True)
def _patient_disk(patient_disk: None) -> None:
    """In all of them."""
