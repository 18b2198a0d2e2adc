"""What a supervisor says of its parts."""

from drivers.supervision import Supervisor


def test_complaints_of_named_parts_are_of_its_own_and_in_their_order() -> None:
    records, machine = Supervisor(), Supervisor()
    records.include("mill", machine)
    assert records.all_well and records.part_complaints(["historian", "audit"]) == []
    machine.failed("audit", ValueError("of the machine"))
    assert not records.all_well and records.part_complaints(["historian", "audit"]) == []
    assert list(records.complaints) == ["mill: audit"]
    for part in ("audit", "status", "historian"):
        records.failed(part, OSError("gone"))
    assert records.part_complaints(["historian", "audit"]) == [
        records.complaints[name] for name in ("historian", "audit")
    ]
    records.exclude("mill")
    assert set(records.complaints) == {"audit", "status", "historian"}
