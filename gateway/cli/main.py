"""The command `decanter`: sub-commands are imported when they are called, so that help answers at once."""

import click

from gateway.cli.alarm import alarm
from gateway.cli.former import FORMER
from gateway.cli.historian import historian
from gateway.cli.machine import machine
from gateway.cli.model import model
from gateway.cli.plc import plc
from gateway.cli.trace import trace
from gateway.cli.user import user
from gateway.entry import LazyGroup, Table

COMMANDS: Table = {
    "init": ("gateway.cli.setup.commands:init", "Make a folder that runs, from an address and an I/O list."),
    "demo": (
        "gateway.demo.command:demo",
        "Run the main job on this computer, with a picture.",
    ),
    "run": ("gateway.cli.plant.commands:run", "Run the gateway with a configuration file."),
    "top": ("gateway.cli.plant.commands:top", "Watch a running gateway; --once: one look, and an exit code."),
    "reload": ("gateway.cli.plant.commands:reload", "Let a running gateway read its plant file anew."),
    "arm": ("gateway.commission.commands:arm", "Let blocks be written: by whom, why and for how many minutes."),
    "disarm": ("gateway.commission.commands:disarm", "Take the arming back."),
    "audit": ("gateway.commission.commands:audit", "Show and verify the audit log."),
    "emulate": (
        "gateway.cli.setup.commands:emulate",
        "Start the software PLC, which replays a trace.",
    ),
    "keep": ("gateway.cli.kept:keep", "Keep it: backup, restore, support, history, diff, rollback."),
    "certificates": (
        "gateway.cli.setup.commands:certificates",
        "Make certificates and keys for Modbus/TCP Security or OPC UA.",
    ),
    "diagnose": (
        "gateway.lab.gap.commands:diagnose",
        "Find where model and traces disagree; name what is missing.",
    ),
    "docs": ("gateway.cli.setup.docs:docs", "Print a page of the documentation, or the list of pages."),
    "completion": ("gateway.cli.setup.completion:completion", "Print what makes a shell complete, or install it."),
}
EXAMPLES = {
    "init": "init plant2 --host 192.168.1.10 --list io_list.csv --temperature TCuscinettiRiduttore --trace export.csv",
    "demo": "demo --seconds 40 --out out/demo",
    "run": "run --config plant.toml",
    "top": "top --config plant.toml",
    "reload": "reload --config plant.toml",
    "arm": "arm --by 'A. Rossi' --reason 'loop test' --minutes 30",
    "disarm": "disarm --reason 'tests are done'",
    "audit": "audit",
    "emulate": "emulate --device config/devices/decanter_plc.toml --trace out/traces/cd8.csv --port 15020",
    "keep": "keep backup /media/usb/gateway-2026-05-04 --config plant.toml",
    "certificates": "certificates out/certificates --host 192.168.1.10",
    "diagnose": "diagnose --model out/model --traces out/traces --out out/diagnosis",
    "docs": "docs commissioning",
    "machine": "machine --config plant.toml",
    "alarm": "alarm --all",
    "historian": "historian",
    "user": "user --config plant.toml",
    "completion": "completion bash --install",
}


ELSEWHERE = {
    "check": "`decanter plc check files` for the files alone, `decanter plc check` for the PLC too",
    "ingest": "`decanter trace ingest`",
    "regress": "`decanter model judge regression`",
}


@click.group(
    "decanter",
    cls=LazyGroup,
    table=COMMANDS,
    examples=EXAMPLES,
    elsewhere=ELSEWHERE,
    former=FORMER,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="decanter-gateway")
@click.option("--traceback", is_flag=True, help="Show where in the program an error arose.")
def main(traceback: bool) -> None:
    """\b
    Decanter gateway: foresees the bearing temperature of a decanter centrifuge.
    Try it    decanter demo
    My PLC    decanter init plant --host ADDRESS --list io_list.csv
    My data   decanter trace map export.csv, then decanter model learn
    Run it    decanter run, and decanter top in another terminal
    """


for group in (plc, machine, alarm, historian, user, trace, model):
    main.add_command(group)

if __name__ == "__main__":
    main()
