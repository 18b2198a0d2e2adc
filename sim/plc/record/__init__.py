"""The recorder of the software PLC, and the judge of what clients called good."""

from sim.plc.record.recorder import PlcRecorder
