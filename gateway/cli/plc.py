"""`decanter plc`: commissioning, one module a command; what they share is in `gateway.commission.session`."""

import click

from gateway.entry import LazyGroup, Table

COMMANDS: Table = {
    "doctor": (
        "gateway.commission.doctor:doctor",
        "Look at this machine before the plant: clock, network, ports, files.",
    ),
    "probe": ("gateway.commission.probe:probe", "Is the device there, does it speak, and who is it?"),
    "scan": ("gateway.commission.scan:scan", "Look for units, nodes, CAN frames, or readable registers."),
    "read": ("gateway.commission.read:read", "Read tags or bare addresses: raw words and values side by side."),
    "guess": (
        "gateway.commission.guess:guess",
        "Find type, word order, scale and address from what the HMI shows.",
    ),
    "watch": ("gateway.commission.watch:watch", "Watch tags as they change."),
    "bind": (
        "gateway.commission.bind:bind",
        "Bind a place in the device to a tag's name; TOML edits keep comments.",
    ),
    "import": (
        "gateway.commission.import_list:import_list",
        "Take the tags of an I/O list (CSV, XLSX) into the device file.",
    ),
    "check": ("gateway.commission.check:check", "Check the configuration, and with the device every tag of it."),
    "plan": (
        "gateway.commission.plan:plan",
        "The requests of one scan, and their longest time; with --write what would be written.",
    ),
    "verify": (
        "gateway.commission.verify:verify",
        "Compare with the HMI: two values per analogue, both states per bool.",
    ),
    "soak": (
        "gateway.commission.soak:soak",
        "Read for a longer time: cycle times, losses, the period to be recommended.",
    ),
    "codegen": (
        "gateway.commission.writeback.codegen:codegen",
        "Generate the PLC's side of the write-back as Structured Text.",
    ),
    "arm": ("gateway.commission.writeback.arm:arm", "Let blocks be written: by whom, why and for how many minutes."),
    "disarm": ("gateway.commission.writeback.arm:disarm", "Take the arming back."),
    "test": (
        "gateway.commission.writeback.test:test",
        "Test the PLC's side: alarm bits, heartbeats, the contract; needs an arming.",
    ),
    "audit": ("gateway.commission.writeback.audit:audit", "Show and verify the audit log."),
    "report": ("gateway.commission.report:report", "Make or verify the site acceptance report: page, paper, JSON."),
    "replay": ("gateway.commission.replay:replay", "Send a recording through the gateway, without a PLC."),
}


RENAMED = {
    "write": "`decanter plc plan --write`",
    "loop": "`decanter plc test alarms` and `decanter plc test heartbeat`",
    "conformance": "`decanter plc test conformance`",
}


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    renamed=RENAMED,
    short_help="Commission a PLC: probe, scan, read, guess, bind, verify, arm.",
)
def plc() -> None:
    """Commission a PLC: look, read, understand, bind, verify. Nothing is written unless armed.

    Every command appends what it did to a file of records, from which the acceptance report is made.

    Exit codes: 0 in order, 1 a check failed, 2 wrong usage or input, 3 cannot connect, 4 the device refused, 5 no
    reply in time, 6 not armed.
    """
