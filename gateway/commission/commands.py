"""The options of most commands of `plc` and their help; the work is loaded when it is asked for."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from gateway.commission.options import (
    DRY_RUN,
    HEARTBEAT,
    KEEP,
    ORDERS,
    TYPES,
    audit_option,
    bit_option,
    link_options,
    list_options,
    only_option,
    pairs,
    period_option,
    plant_options,
    record_options,
)
from gateway.commission.writeback.targets import TARGETS
from gateway.console import config_dir, json_option, renamed_option, socket_option

_PATH = click.Path(path_type=Path)


@click.command(short_help="Look at this machine before the plant: clock, network, ports, files.")
@link_options
def doctor(**options: Any) -> None:
    """Look at this machine before the plant: clock, network, serial ports, CAN, disk, files.

    With --config, --device or --host what they name is looked at too. Nothing is sent to any device.
    """
    from gateway.commission.doctor import doctor as work

    work(**options)


@click.command()
@click.option("--write", is_flag=True, help="Put the habits that are found into the device file (--device, --config).")
@click.option("--pin", is_flag=True, help="With --write: put who the device says it is there too, as its identity.")
@link_options
def probe(**options: Any) -> None:
    """Is the device there, does it speak, and who is it?

    Name, route, connection, first reply, identity, tables and round trip; for CAN the bus, its traffic and the node.
    Each step that fails has its own sentence. Nothing but reads is sent.
    """
    from gateway.commission.probe import probe as work

    work(**options)


@click.command(short_help="Find type, word order, scale and address from what the HMI shows.")
@click.argument("address")
@click.argument("reading", required=False)
@click.option("--fresh", is_flag=True, help="Forget the earlier readings of this address.")
@link_options
def guess(**options: Any) -> None:
    """Find type, word order, scale, offset and the right address from what the HMI shows.

    ADDRESS is where the value is said to be (holding:100 or 40101), READING what the HMI shows at this moment, with all
    its digits (72.4), or on and off. Neighbouring registers are tried too. A second call adds its reading to the first
    one's, from the records; on a terminal without READING it is asked for.
    """
    from gateway.commission.guess import guess as work

    work(**options)


@click.command(short_help="Check the files alone; nothing is asked of the device.")
@link_options
def check_files(**options: Any) -> None:
    """Check files, places, limits, models and write-back contract; nothing is asked of the device.

    Of a plant of several machines all are checked, one after another, where --machine names none.
    """
    from gateway.commission.check import check as work

    work(offline=True, **options)


@click.command(short_help="Check the configuration, and with the device every tag of it.")
@click.option("--offline", is_flag=True, hidden=True)
@link_options
def check(**options: Any) -> None:
    """Check files, places, limits, models and write-back contract; then read every tag, and see the heartbeat move.

    Of a plant of several machines all are checked, one after another, where --machine names none.
    """
    from gateway.commission.check import check as work

    work(**options)


@click.command(short_help="The requests of one scan, and their longest time; with --write what would be written.")
@period_option
@click.option("--write", is_flag=True, help="What the gateway would write instead, word by word, and what is missing.")
@audit_option
@link_options
def plan(**options: Any) -> None:
    """The requests of one scan, and the longest time that they can take against the period; nothing is sent.

    The worst case is every request answered only just within its deadline, and the write-back's own requests besides.
    With --write it shows what the gateway would write, and by which rules; that is not sent either.
    """
    from gateway.commission.plan import plan as work

    work(**options)


@click.command(short_help="Compare with the HMI: two values per analogue, both states per bool.")
@click.option("--against", "listed", type=_PATH, help="Readings of the HMI (CSV, XLSX): tag, value and, if any, time.")
@only_option
@click.option(
    "--readings",
    type=_PATH,
    help="For readings with times: what was recorded (decanter plc check soak --record, historian).",
)
@click.option("--within", type=click.FloatRange(0), default=2.0, show_default=True, help="Seconds around such a time.")
@click.option("--clock-offset", type=float, default=0.0, help="Seconds by which the HMI's clock is ahead.")
@click.option("--tolerance", "slack", type=click.FloatRange(0), default=0.0, help="Engineering units beside rounding.")
@click.option("--complete", is_flag=True, help="Fail as long as a tag is not proved.")
@click.option("--anew", is_flag=True, help="Do not count what earlier verifications proved.")
@link_options
def verify(**options: Any) -> None:
    """Compare with the HMI until each number was right at two distinct values, each flag in both states.

    A third value is asked for where a register may be a neighbour's: it held the same word at both.

    With --against the readings come from a list: one row a reading, or one column a tag. Without it each tag is asked
    for, round by round. What was proved before counts as long as the tag lies where it lay (see --anew).
    """
    from gateway.commission.verify import verify as work

    work(**options)


@click.command(short_help="Where peers find each tag, its quality and its age, if the gateway serves them.")
@click.option("--csv", "as_csv", is_flag=True, help="The table as CSV, for the peer's own import.")
@click.option(
    "--config", "path", type=click.Path(path_type=Path), help="The plant file.  [default: ./plant.toml, then ./config]"
)
@click.option("--machine", metavar="NAME", help="Which machine of a plant file that has several.")
@json_option
def served(**options: Any) -> None:
    """Where a peer of the gateway (a SCADA system, another PLC) finds each tag, its quality and its age.

    The gateway serves them where the plant file has a [serve] table with a port: Modbus TCP, functions 1 to 4, by PDU
    addresses from 0. Nothing is asked of the device or of a running gateway.
    """
    from gateway.commission.served import served as work

    work(**options)


@click.command(short_help="Read for a longer time: cycle times, losses, the period to be recommended.")
@click.option("--seconds", type=click.FloatRange(0.1), default=60.0, show_default=True, help="For how long.")
@period_option
@click.option("--record", type=click.Path(path_type=Path), help="Keep the readings in this CSV, one row a scan.")
@link_options
def soak(**options: Any) -> None:
    """Scan all tags for a while, as the gateway will: times of a scan, losses, and the period to be recommended.

    Fails if a tag was not good or a tick was missed. Ctrl-C ends it early with what there is.
    """
    from gateway.commission.soak import soak as work

    work(**options)


@click.command(short_help="Let blocks be written: by whom, why and for how many minutes.")
@click.option("--reason", required=True, help="Why blocks are to be written, for the audit log.")
@click.option("--minutes", type=float, required=True, help="For how long, 480 at most; then it ends by itself.")
@click.option(
    "--acknowledge-head",
    "acknowledged",
    multiple=True,
    metavar="HASH",
    help="Take note that the audit log's rows up to this head are lost; may be given several times.",
)
@audit_option
@link_options
def arm(**options: Any) -> None:
    """Let blocks be written for some minutes: by the loop tests, and by a gateway with mode 'shadow'.

    A gateway that runs is told so; one that starts meanwhile finds it in the audit log. Needs a name (--by).
    Nobody arms on an audit log whose chain is broken, nor on one that lacks a row whose head was signed.
    """
    from gateway.commission.writeback.arm import arm as work

    work(**options)


@click.command(short_help="Take the arming back.")
@click.option("--reason", default="by command", show_default=True, help="Why, for the audit log.")
@socket_option
@audit_option
@link_options
def disarm(**options: Any) -> None:
    """Take the arming back: at once, with a block of validity 0 if one can be written.

    It needs no plant file that can be used: the running gateway is asked at the socket that is named, or where as much
    of the file as can be read, or the default, has it; where none runs the audit log is.
    """
    from gateway.commission.writeback.arm import disarm as work

    work(**options)


@click.command(short_help="Show and verify the audit log.")
@click.option("--head", default="", metavar="HASH", help="A hash kept from before, which has to be in the log.")
@click.option("--last", type=click.IntRange(0), default=20, show_default=True, help="So many of the newest rows.")
@click.option("--kind", "kinds", multiple=True, help="Only rows of this kind, such as 'armed' or 'write refused'.")
@click.option(
    "--config",
    "plant",
    type=_PATH,
    help="The plant file whose audit log it is.  [default: plant.toml, config/plant.toml]",
)
@click.option("--machine", metavar="NAME", help="Only rows of this machine, of a gateway with several.")
@click.option("--public-key", type=_PATH, help="The gateway's public key; without it the key beside the log.")
@click.option("--heads", type=_PATH, help="A file of signed heads.  [default: the plant file's, or beside the log]")
@click.option("--historian", type=_PATH, help="A historian that holds a signed head.  [default: the plant file's]")
@click.option("--log", type=_PATH, help="A log that holds signed heads.  [default: the plant file's]")
@audit_option
@record_options
def audit(**options: Any) -> None:
    """Show and verify the audit log: every write, refusal and arming, each row bound to the one before.

    Its end is bound by signed heads, which the gateway gives to a file of heads, the historian and the log each hour,
    at each arming and at a stop: a log that was cut, emptied or computed anew lacks a row that was signed. Signatures
    are checked by the gateway's key, which others must not be able to read, or the public key alone (--public-key).
    """
    from gateway.commission.writeback.audit import audit as work

    work(**options)


@click.command(short_help="Make or verify the site acceptance report: page, paper, JSON.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/acceptance"),
    show_default=True,
    help="Folder of the report.",
)
@click.option("--site", default="", help="Name of the plant.  [default: where the device is]")
@click.option("--remark", "remarks", multiple=True, help="An open point of your own; may be given several times.")
@click.option(
    "--config",
    "plant",
    type=click.Path(path_type=Path),
    help="The plant file whose audit log it is.  [default: plant.toml, config/plant.toml]",
)
@click.option("--verify", "verifies", is_flag=True, help="Check the files of a report instead of making one.")
@click.option("--seal", default="", metavar="HASH", help="With --verify: the seal that was signed.")
@audit_option
@record_options
def report(**options: Any) -> None:
    """Make the site acceptance report: page, paper and JSON, hashed and sealed; --verify finds a changed byte.

    It holds every check with the hash of its raw frames, the configuration's hashes, versions, the clock's offset,
    names and what is open. Exit code 1 if a check failed or something is changed.
    """
    from gateway.commission.report import report as work

    work(**options)


@click.command(short_help="Send a recording through the gateway, without a PLC.")
@click.argument("recording", type=click.Path(path_type=Path))
@plant_options
def replay(**options: Any) -> None:
    """Send a RECORDING through the gateway as if it came from the PLC: events, predictions, alarms, blocks.

    It is a CSV (soak --record, or a trace) or a gateway's historian. Needs --config; the device is not asked, nothing
    is written, and the gateway's own records stay as they are.
    """
    from gateway.commission.replay import replay as work

    work(**options)


def _one_or_several(_: click.Context, __: click.Parameter, numbers: Sequence[float]) -> int | float | list[Any] | None:
    """A callback: the one number, a list of several, None for none; whole numbers as such."""
    whole = [int(number) if number.is_integer() else number for number in numbers]
    return whole if len(whole) > 1 else next(iter(whole), None)


@click.command(short_help="Bind a place in the device to a tag's name; TOML edits keep comments.")
@click.argument("name", required=False)
@click.argument("address", required=False)
@click.option("--type", "dtype", type=click.Choice(TYPES), help="What lies there (uint16).")
@click.option("--order", type=click.Choice(ORDERS), help="Byte and word order (ABCD).")
@click.option("--scale", type=float, help="Engineering units per count (1).")
@click.option("--offset", type=float, help="Engineering units at raw 0 (0).")
@bit_option
@click.option("--length", type=click.IntRange(1), help="Bytes of a string.")
@click.option("--guess", "rank", type=click.IntRange(1), help="Bind what the last guess found; 1 is its best.")
@click.option("--units", help="The engineering unit as text, such as degC.")
@click.option("--low", type=float, help="The lowest plausible value.")
@click.option("--high", type=float, help="The highest plausible value.")
@click.option(
    "--sentinel",
    multiple=True,
    type=float,
    callback=_one_or_several,
    help="A raw number that means 'not available'; may be given again.",
)
@click.option("--max-rate", type=float, help="The fastest believable change in units a second.")
@click.option("--label", "labels", multiple=True, metavar="RAW=TEXT", callback=pairs, help="A name of a raw number.")
@click.option("--block", metavar="ADDRESS", help="Where the write-back block begins.")
@click.option("--block-of", metavar="TAG", help="Of which temperature it speaks, where the device takes several.")
@click.option("--fields", help="Its fields, with commas between; as many as the PLC takes in one write by default.")
@click.option("--layout", type=click.IntRange(0, 65535), help="Its layout version (2).")
@click.option("--timer", type=float, help="The PLC's timer in seconds (5).")
@HEARTBEAT
@KEEP
@DRY_RUN
@link_options
def bind(**options: Any) -> None:
    """Bind a place in the device to a tag's NAME, in the device file: shown as a diff, checked, a backup kept.

    ADDRESS is a PDU address (holding:100), a number as HMIs show it (40101), or the link's own (0x2001:1). With --guess
    it is what the last guess found. Comments and order of the file stay. A file that is not there is made.
    Without NAME only --block, --heartbeat and --keep are put in. Several blocks have their fields, layout and timer in
    common.
    """
    from gateway.commission.bind import bind as work

    work(**options)


@click.command("import", short_help="Take the tags of an I/O list (CSV, XLSX) into the device file.")
@click.argument("path", type=click.Path(path_type=Path))
@click.option("--sheet", help="The sheet of a workbook; the first by default.")
@click.option("--column", "columns", multiple=True, metavar="WHAT=HEADER", callback=pairs, help="Say what a column is.")
@click.option(
    "--table",
    "registers",
    type=click.Choice(["holding", "input", "coil", "discrete"]),
    default="holding",
    show_default=True,
    help="The table of bare numbers.",
)
@click.option(
    "--repeat",
    multiple=True,
    metavar="GROUP=N",
    callback=pairs,
    help="How often a group of a SunSpec model is there; may be given again.",
)
@list_options
@only_option
@click.option("--without", multiple=True, metavar="TAG", help="Leave this tag out; may be given again.")
@click.option("--rename", multiple=True, metavar="OLD=NEW", callback=pairs, help="Give a tag of the list another name.")
@click.option("--skip-bad", is_flag=True, help="Leave out rows that cannot be used.")
@HEARTBEAT
@KEEP
@DRY_RUN
@link_options
def import_list(**options: Any) -> None:
    """Take the tags of an I/O list (PATH: CSV or XLSX) into the device file: shown as a diff, checked, a backup kept.

    A list may also be YAML with Home Assistant's modbus:, a meter template of evcc, or a SunSpec model (JSON).
    The columns are found by their headers, Italian or English; numbers may have a decimal comma. Each row that cannot
    be used is one sentence with its line, and then nothing is written (--skip-bad: nothing of that row). What the list
    does not say of a tag stays as it is in the file.
    """
    from gateway.commission.import_list import import_list as work

    work(**options)


@click.command(short_help="Look for units, nodes, CAN frames, or readable registers.")
@click.argument("what", type=click.Choice(("units", "nodes", "frames", "registers", "models")))
@click.argument("stretch", required=False, metavar="[RANGE]")
@click.option("--requests", type=click.IntRange(1), help="registers: the most requests to send.  [default: 3000]")
@click.option("--seconds", type=click.FloatRange(0.1, 3600), help="frames: how long to listen.  [default: 5]")
@click.option("--listen-only", is_flag=True, default=None, help="nodes: send nothing, only hear their heartbeats.")
@renamed_option("--units", "give them as RANGE, `decanter plc scan units 1-32`")
@renamed_option("--nodes", "give them as RANGE, `decanter plc scan nodes 1-32`")
@link_options
def scan(**options: Any) -> None:
    """Look for what is there: units, nodes, frames, registers or models, within RANGE. Nothing is written.

    units: which Modbus units answer behind this connection (1-247, without RANGE until twenty in a row are silent);
    each is asked for one register, twice at most, and the first one for 3 s if it is silent.
    nodes: which CANopen nodes are on this bus (1-127), by their heartbeats and by their answers to SDO requests.
    frames: which frames are on this CAN bus, how often, and what they may be; nothing is sent.
    registers: which of holding:0-999, or 40001-41000, can be read, and how many at once. Blocks are asked first,
    refused ones are cut in halves; what the bound on requests leaves unasked is said.
    models: which SunSpec models the device has, from holding:40000, 0 or 50000 on, or from RANGE; each with its import.
    """
    from gateway.commission.scan import scan as work

    work(**options)


@click.command(short_help="Read tags or bare addresses: raw words and values; --watch: as they change.")
@click.argument("what", nargs=-1)
@click.option("--type", "dtype", type=click.Choice(TYPES), help="What the addresses hold; plain registers without it.")
@click.option("--order", type=click.Choice(ORDERS), default="ABCD", show_default=True, help="Byte and word order.")
@click.option("--scale", type=float, default=1.0, help="Engineering units per count.")
@click.option("--offset", type=float, default=0.0, help="Engineering units at raw 0.")
@bit_option
@click.option("--length", type=click.IntRange(1), default=2, help="Bytes of a string.")
@click.option("--count", type=click.IntRange(1, 2000), default=1, help="So many values in a row.")
@click.option("--watch", "watches", is_flag=True, help="Read again and again; show what changes.")
@click.option("--period", type=click.FloatRange(0.02, 3600), default=1.0, show_default=True, help="With --watch: each.")
@click.option("--seconds", type=click.FloatRange(0.02), help="With --watch: stop after so long; else Ctrl-C ends it.")
@link_options
def read(**options: Any) -> None:
    """Read tags or bare addresses once: raw words and values side by side.

    WHAT are tags of the device file, or addresses: holding:100, 40101, holding:100-119, 0x2001:1, dbc:Message.Signal.
    Without WHAT all tags are read.

    With --watch they are read until Ctrl-C: value, quality, age, least and greatest, a sparkline. On a terminal the
    view is live, and Enter sets a mark: its time and all values are kept in the records. Elsewhere each change is a
    line.
    """
    from gateway.commission.read import read as work

    work(**options)


@click.command(short_help="Generate the PLC's side of the write-back as Structured Text.")
@click.option(
    "--device",
    type=click.Path(path_type=Path),
    default=lambda: config_dir() / "devices" / "decanter_plc.toml",
    show_default="config/devices/decanter_plc.toml",
    help="The device file (register map) with the [writeback] table.",
)
@click.option(
    "--target",
    type=click.Choice(list(TARGETS)),
    default="plain",
    show_default=True,
    help="The tool that the text goes into: its names, its places of registers, its spelling.",
)
@click.option("--out", type=click.Path(path_type=Path), help="File of the Structured Text.  [default: the screen]")
@click.option("--name", default="", help="Name of the function block.  [default: made from the device's name]")
@click.option("--program/--no-program", default=True, show_default=True, help="Also an example program that calls it.")
@click.option(
    "--location", default="", help="Where registers lie in the PLC: %MW, %QW or %IW.  [default: the target's]"
)
@click.option("--permit-at", default="", metavar="LOCATION", help="The bit of the permit's switch, such as %IX0.0.")
@click.option("--cycle", type=click.IntRange(1, 10_000), default=20, show_default=True, help="The task's cycle in ms.")
@click.option("--suite", type=click.Path(path_type=Path), help="Also write the conformance suite here (JSON).")
@json_option
def codegen(**options: Any) -> None:
    """Generate the function block that checks the gateway's blocks: plain IEC 61131-3, 2nd edition, from the map.

    It checks layout version, sequence copy, CRC, session and heartbeat, keeps a timer, and falls back to the PLC's own
    logic. What to paste where in OpenPLC, CODESYS and TIA Portal is in docs/plc_side.md.
    """
    from gateway.commission.writeback.codegen import codegen as work

    work(**options)


@click.command(short_help="Test the PLC's side: alarm bits, heartbeats, the contract; needs an arming.")
@click.argument("what", type=click.Choice(("alarms", "heartbeat", "conformance")))
@click.option("--ask", is_flag=True, default=None, help="alarms, conformance: put each question to the person here.")
@click.option("--watchdog/--no-watchdog", default=None, help="heartbeat: let the PLC's timer run out.  [default: yes]")
@audit_option
@link_options
def test(**options: Any) -> None:
    """Test the PLC's side of the write-back. It writes, so it needs an arming (decanter arm).

    alarms sets each alarm bit alone, then none: the PLC has to accept the block, and the HMI to show it (--ask).
    heartbeat moves and checks both heartbeats; the PLC's timer runs out when the blocks cease. Blocks of both have
    validity 0, but for one that starts the timer, with a probability of 0 and no other number in it.

    conformance puts the PLC's side through the suite of the contract: whole, torn, wrong and late blocks, for about
    five times the PLC's timer. With --ask a person gives and takes the permit when the suite wants it.
    """
    from gateway.commission.writeback.test import test as work

    work(**options)
