"""The software PLC: a test bench in a process of its own that replays a trace over Modbus TCP and misbehaves on order.

Started as `python -m sim.plc --device config/devices/decanter_plc.toml --trace trace.csv`. The running gateway never
imports it; it never imports the gateway's codec, so that a byte-order mistake cannot cancel itself out.
"""
