"""`decanter plc`: commissioning, one module a command; the options that they share are in `plc_options`."""

import click

from gateway.console.lazy import LazyGroup, Table

COMMANDS: Table = {
    "doctor": (
        "gateway.commission.plc_doctor:doctor",
        "Look at this machine before the plant: clock, network, ports, files.",
    ),
    "probe": ("gateway.commission.plc_probe:probe", "Is the device there, does it speak, and who is it?"),
    "scan": ("gateway.commission.plc_scan:scan", "Look for units, nodes, CAN frames, or readable registers."),
    "read": ("gateway.commission.plc_read:read", "Read tags or bare addresses: raw words and values side by side."),
    "guess": (
        "gateway.commission.plc_guess:guess",
        "Find type, word order, scale and address from what the HMI shows.",
    ),
    "watch": ("gateway.commission.plc_watch:watch", "Watch tags as they change."),
    "bind": (
        "gateway.commission.plc_bind:bind",
        "Bind a place in the device to a tag's name; TOML edits keep comments.",
    ),
    "import": (
        "gateway.commission.plc_bind:import_list",
        "Take the tags of an I/O list (CSV, XLSX) into the device file.",
    ),
    "check": ("gateway.commission.plc_check:check", "Check the configuration, and with the device every tag of it."),
    "plan": (
        "gateway.commission.plc_plan:plan",
        "The requests of one scan, and their longest time against the period.",
    ),
    "verify": (
        "gateway.commission.plc_verify:verify",
        "Compare with the HMI: two values per analogue, both states per bool.",
    ),
    "soak": (
        "gateway.commission.plc_soak:soak",
        "Read for a longer time: cycle times, losses, the period to be recommended.",
    ),
    "codegen": (
        "gateway.commission.plc_codegen:codegen",
        "Generate the PLC's side of the write-back as Structured Text.",
    ),
    "write": ("gateway.commission.plc_write:write", "What would be written to the PLC; nothing is sent."),
    "arm": ("gateway.commission.plc_arm:arm", "Let blocks be written: by whom, why and for how many minutes."),
    "disarm": ("gateway.commission.plc_arm:disarm", "Take the arming back."),
    "loop": ("gateway.commission.plc_write:loop", "Loop tests of alarm bits and heartbeats; needs an arming."),
    "conformance": (
        "gateway.commission.plc_write:conformance",
        "Put the PLC's side of the contract through its suite.",
    ),
    "audit": ("gateway.commission.plc_arm:audit", "Show and verify the audit log."),
    "report": ("gateway.commission.plc_report:report", "Make or verify the site acceptance report: page, paper, JSON."),
    "replay": ("gateway.commission.plc_replay:replay", "Send a recording through the gateway, without a PLC."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def plc() -> None:
    """Commission a PLC: look, read, understand, bind, verify. Nothing is written unless armed.

    Every command appends what it did to a file of records, from which the acceptance report is made.

    Exit codes: 0 in order, 1 a check failed, 2 wrong usage or input, 3 cannot connect, 4 the device refused, 5 no
    reply in time, 6 not armed.
    """
