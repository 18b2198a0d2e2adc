"""The software PLC as a process; its first line on stdout says where it listens."""

import asyncio
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import click

from sim.plc.control import listen_on_loopback, listen_to_stdin, say
from sim.plc.faces import Face, face_options, make_faces
from sim.plc.machines import machine_options
from sim.plc.modbus import BehindFace, ModbusServer, UnitsBehind
from sim.plc.program import (
    EmulatorClock,
    InputError,
    OrderedFault,
    Place,
    Plc,
    PlcSettings,
    TraceReplay,
    live_plant,
    parse_address,
    parse_fault,
    read_map,
    read_text,
    read_toml,
    read_trace,
    record_nothing,
)
from sim.plc.record import PlcRecorder

UNUSABLE_INPUT = 2
CANNOT_LISTEN = 3


@dataclass(frozen=True, slots=True)
class EmulatorOptions:
    """The command line, or one machine's part of it."""

    name: str
    map_path: Path | None
    unit: int | None
    behind: str | None
    trace: Path | None
    plant: str | None
    trip: float
    reduced_feed: float
    host: str
    port: int
    speed: float
    epoch: float | None
    monotonic: float | None
    offset: float
    loop: bool
    hold: bool
    cycle: float
    faults: Path | None
    record: Path | None
    seed: int
    permit: bool
    challenge: int | None
    unknown_unit: str
    max_clients: int
    max_registers: int | None
    writable: tuple[str, ...]
    stdin: bool
    control_port: int | None
    faces: Mapping[str, Any]


def complain(sentence: str) -> None:
    """One line on stderr."""
    click.echo(f"plc: {sentence}", err=True)


def emulate(context: click.Context, options: Mapping[str, Any]) -> NoReturn:
    """The work of `python -m sim.plc`; leaves with its exit code."""
    try:
        several = machine_options(context)
        sys.exit(run([_emulator_options(own) for own in several or [{"name": "", **options}]]))
    except InputError as error:
        complain(str(error))
        sys.exit(UNUSABLE_INPUT)


def _emulator_options(given: Mapping[str, Any]) -> EmulatorOptions:
    """One machine's options. Raises InputError without a register map."""
    if given["map_path"] is None and not given["name"]:
        raise click.MissingParameter(param_type="option", param_hint="'--device'")
    if given["map_path"] is None:
        raise InputError(f"machine {given['name']}: key 'device': is missing; give the path of its register map")
    faces = face_options(given)
    own = {name: value for name, value in given.items() if name not in (*faces, "plant_file", "machine")}
    return EmulatorOptions(**own, faces=faces)


@dataclass(slots=True)
class EmulatedMachine:
    """One machine of the process: its program, what serves it, and where its name begins a complaint."""

    options: EmulatorOptions
    plc: Plc
    recorder: PlcRecorder | None
    complain: Callable[[str], None]
    faces: list[Face] = field(default_factory=list)
    closed: bool = False


def run(machines: Sequence[EmulatorOptions]) -> int:
    """Build the PLCs and run them to their end; gives the exit code. Raises InputError for what cannot be used."""
    options = machines[0]
    if not 0 < options.speed < float("inf"):
        raise InputError(f"--speed: {options.speed} is not positive; give plant seconds per second, such as 1 or 60")
    start = time.monotonic()
    origin = start if options.monotonic is None else options.monotonic
    epoch = time.time() if options.epoch is None else options.epoch
    clock = EmulatorClock(epoch, origin, options.speed)
    records = [other.record for other in machines if other.record is not None]
    if shared := next((path for path in records if records.count(path) > 1), None):
        raise InputError(f"--record: {shared} is given to several machines; give each a file of its own")
    built: list[EmulatedMachine] = []
    try:
        for own in machines:
            built.append(_build_machine(own, clock))
        return asyncio.run(_live(built))
    finally:
        for machine in built:
            if machine.recorder is not None:
                machine.recorder.close()


def _build_machine(options: EmulatorOptions, clock: EmulatorClock) -> EmulatedMachine:
    """One machine, not yet begun. Raises InputError."""

    def say_whose(sentence: str) -> None:
        complain(f"{options.name}: {sentence}" if options.name else sentence)

    if options.map_path is None:
        raise InputError("--device: is missing; give the path of a register map")
    registers = read_map(options.map_path)
    if options.unit is not None:
        registers = replace(registers, unit=options.unit)
    table = plant = None
    if options.plant is not None:
        if options.trace is not None or options.loop:
            raise InputError("--plant: a live plant has no trace and no loop; leave --trace and --loop out")
        plant = live_plant(options.plant, options.seed, options.trip)
        table = plant.table
    elif options.trace is not None:
        table = read_trace(options.trace)
    replay = None
    if table is not None:
        now = clock.monotonic()
        replay = TraceReplay(table, now, rate=options.speed, held=True, loop=options.loop)
        replay = replay.seek(now, options.offset)
    faults = read_faults(options.faults) if options.faults else ()
    settings = PlcSettings(
        permit=options.permit,
        answer_unknown_unit=options.unknown_unit == "exception",
        max_registers=options.max_registers,
        writable=[parse_stretch(text) for text in options.writable],
        seed=options.seed,
        # In quarters of a second: a run that begins later begins with a challenge that no earlier one has reached.
        challenge=options.challenge or int(4 * time.time()) % 0xFFFF + 1,
        reduced_feed=options.reduced_feed,
    )
    recorder = PlcRecorder(options.record, say_whose) if options.record else None
    plc = Plc(
        registers,
        clock,
        replay,
        settings,
        plant=plant,
        faults=faults,
        record=recorder or record_nothing,
        complain=say_whose,
    )
    return EmulatedMachine(options, plc, recorder, say_whose)


def read_faults(path: Path) -> list[OrderedFault]:
    """The faults in a TOML file ([[fault]] tables) or a JSON file (a list of objects). Raises InputError."""
    if path.suffix == ".json":
        try:
            entries = json.loads(read_text(path, "a schedule of faults"))
        except (json.JSONDecodeError, RecursionError) as error:
            raise InputError(f"{path}: is not JSON: {error}; correct that place") from None
    else:
        data = read_toml(path, "a schedule of faults")
        if unknown := sorted(set(data) - {"fault"}):
            raise InputError(f"{path}: key {unknown[0]!r}: is not known; give [[fault]] tables")
        entries = data.get("fault", [])
    if not isinstance(entries, list):
        raise InputError(f"{path}: holds no list of faults; give [[fault]] tables, or in JSON a list of objects")
    return [parse_fault(entry, f"{path}: fault {number}") for number, entry in enumerate(entries, start=1)]


def parse_stretch(text: str) -> Place:
    """`holding:300-310` or `coil:5` as a place. Raises InputError."""
    first, _, last = text.partition("-")
    table, address = parse_address(first, "--writable")
    _, end = parse_address(f"{table}:{last}" if last else first, "--writable")
    if table not in ("holding", "coil") or end < address:
        raise InputError(f"--writable: {text!r} cannot be written; give 'holding:N-M' or 'coil:N-M' with N <= M")
    return Place(table, address, end - address + 1)


def _give_faces(machines: Sequence[EmulatedMachine]) -> None:
    """Make every machine's faces; those that tell units apart are made once for all behind them. Raises InputError."""
    behind: dict[str, tuple[UnitsBehind, ModbusServer]] = {}
    for machine in sorted(machines, key=lambda machine: machine.options.behind is not None):
        options, plc, said = machine.options, machine.plc, machine.complain
        settings = {**options.faces, "host": options.host, "max_clients": options.max_clients}
        where = f"machine {options.name}: key 'behind'"
        ports = {(other.host, other.port): units for units, other in behind.values() if other.port}
        taken = ports.get((options.host, options.port)) if options.behind is None else None
        if options.behind is None and taken is None:
            units = UnitsBehind(plc)
            server = ModbusServer(units, options.host, options.port, options.max_clients, said)
            behind[options.name] = (units, server)
            machine.faces = [server, *make_faces(plc, settings, said, units)]
            continue
        front = options.behind or next(name for name, (units, _) in behind.items() if units is taken)
        if front not in behind:
            known = ", ".join(behind) or "none"
            raise InputError(f"{where}: {front!r} is no machine with a port of its own; known are {known}")
        units, server = behind[front]
        if not units.add(plc):
            raise InputError(
                f"machine {options.name}: key 'unit': {plc.registers.unit} is taken behind {front}; give it another one"
            )
        machine.faces = [BehindFace(plc, units, server.ready), *make_faces(plc, settings, said, None)]


async def _live(machines: Sequence[EmulatedMachine]) -> int:
    loop = asyncio.get_running_loop()
    options, clock = machines[0].options, machines[0].plc.clock
    programs = {machine.options.name: machine.plc for machine in machines}
    _give_faces(machines)
    lines = [machine.plc.begin(clock.monotonic(), hold=options.hold) for machine in machines]
    try:
        for machine in machines:
            for face in machine.faces:
                await face.open()
        control = None if options.control_port is None else await listen_on_loopback(programs, options.control_port)
    except OSError as error:
        complain(f"cannot listen ({error.strerror or error}); choose another --host, --port or --control-port")
        return CANNOT_LISTEN

    def stop() -> None:
        for plc in programs.values():
            plc.stopping = True

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop)
    # Before the ready line: whoever reads that may connect at once, and finds the faces as the first cycle has them.
    for machine, line in zip(machines, lines, strict=True):
        if ignored := machine.plc.ignored_signals():
            path = machine.options.map_path
            machine.complain(f"the trace's signals {', '.join(ignored)} have no register in {path} and are ignored")
        for face in machine.faces:
            await face.apply(line.face_faults(face.name))
    say(_ready(machines, control))
    if options.stdin:
        listen_to_stdin(programs, loop)
    # Cycles on absolute deadlines until all PLCs are to stop; a missed cycle is skipped, never made up for.
    due = clock.monotonic()
    while not all(machine.closed for machine in machines):
        for machine in machines:
            if machine.plc.stopping and not machine.closed:
                await _close(machine)
            elif not machine.closed:
                await _cycle(machine)
        due = max(due + options.cycle, clock.monotonic())
        await asyncio.sleep(due - clock.monotonic())
    if control is not None:
        control.close()
    say({"event": "stopped", "lost_rows": sum(machine.recorder.lost for machine in machines if machine.recorder)})
    return 0


async def _cycle(machine: EmulatedMachine) -> None:
    """One cycle of a machine's program, and what it makes of its faces."""
    plc = machine.plc
    now = plc.clock.monotonic()
    line = plc.cycle(now)
    for face in machine.faces:
        await face.apply(line.face_faults(face.name))
    if plc.replay is not None and not plc.ended and not plc.replay.held and plc.replay.at_end(now):
        plc.ended = True
        plc.event("end of trace", now)
        whose = {"machine": machine.options.name} if machine.options.name else {}
        place = {"position": plc.replay.row_position(now), "plant_time": plc.clock.plant_time(now)}
        say({"event": "end_of_trace", **place, **whose})


async def _close(machine: EmulatedMachine) -> None:
    """The end of one machine."""
    machine.plc.event("stopped", machine.plc.clock.monotonic())
    for face in machine.faces:
        await face.close()
    machine.closed = True


def _ready(machines: Sequence[EmulatedMachine], control: asyncio.Server | None) -> dict[str, object]:
    clock = machines[0].plc.clock
    ports: Sequence[Any] = () if control is None else control.sockets
    told = {"epoch": clock.epoch, "monotonic": clock.start, "speed": clock.speed}
    process = {"pid": os.getpid(), **told, "control_port": ports[0].getsockname()[1] if ports else None}
    if not machines[0].options.name:
        return {"event": "ready", **process, **_place(machines[0])}
    return {"event": "ready", **process, "machines": {machine.options.name: _place(machine) for machine in machines}}


def _place(machine: EmulatedMachine) -> dict[str, object]:
    """Where a machine serves, and what it replays."""
    plc, faces = machine.plc, machine.faces
    replay: dict[str, object] | None = None
    if plc.replay is not None:
        table, since = plc.replay.table, plc.clock.plant_time(plc.replay.since)
        rows = {"rows": len(table.times), "duration": table.duration, "ignored": plc.ignored_signals()}
        replay = {**rows, "held": plc.replay.held, "position": plc.replay.position, "plant_time": since}
    record = None if machine.options.record is None else str(machine.options.record)
    return {
        **faces[0].ready(),
        "unit": plc.registers.unit,
        "faces": {face.name: face.ready() for face in faces},
        "replay": replay,
        "record": record,
    }
