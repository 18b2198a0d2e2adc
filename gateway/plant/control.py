"""The running gateway's local socket: one line of JSON a request, one a reply, for programs of the same user.

So a commissioning tool sees what the gateway sees, and a device that serves one client only is not asked by two. A
request is `{"command": "read", ...}` with a key of COMMANDS; a reply has `ok`, and `reason` where it is false. Nothing
here writes to the device: `arm` lets the gateway write its block, `disarm` takes that back.
"""

import asyncio
import os
import socket
import struct
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, TypeVar

from pydantic import Field, ValidationError

from drivers import json_lines
from drivers.device_file import TagTable
from drivers.json_lines import NoObject
from drivers.settings import Line, Section, sentences
from drivers.tag import Sample
from gateway.machine import Machine
from gateway.machine.alarms import BY_PERSONS, AlarmError, Change
from gateway.machine.reading import Redundant
from gateway.machine.writing import ArmingError
from gateway.outside.status import ControlError, GatewayStatus, short
from gateway.plant.status import alarm_statuses
from sim.strict_json import strict

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


SOCKET_MODE = 0o600
MAX_REQUEST_BYTES = 1 << 20
MOST_ROWS = 10_000
LOOK_SECONDS, RETRY_SECONDS = 1.0, 5.0
"""How often it is looked whether the socket is still there, and tried to make one where none can be made."""
_CREDENTIALS = struct.Struct("3i")


Snapshot = Callable[[Machine], GatewayStatus]
Command = Callable[["ControlScope", Mapping[str, Any]], Awaitable[dict[str, Any]]]


class Reload(Protocol):
    """Reads the plant file anew and gives what it changes; takes it over unless told not to. Raises ControlError."""

    async def __call__(self, *, apply: bool) -> dict[str, Any]: ...


def listening_socket(path: Path) -> socket.socket:
    """A socket at `path` that only this user may join. Raises OSError, also where a living gateway has it already."""
    path.parent.mkdir(parents=True, exist_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with short(path) as name:
            if path.is_socket() and not _is_alive(name):
                path.unlink()
            listener.bind(name)
        path.chmod(SOCKET_MODE)
        listener.listen(8)
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        raise OSError(error.errno, f"no control socket at {path}: {error.strerror or error}") from None
    return listener


def _is_alive(name: str) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(name)
        except ConnectionRefusedError:  # a file that nobody listens at: its gateway was killed
            return False
    return True


@dataclass(frozen=True, slots=True)
class ControlScope:
    """What can be asked of a gateway: its machines by name, their status, and, where it can, to read its file anew.

    Machines that are `changing` are those that a reload has stopped and is about to begin.
    """

    machines: Mapping[str, Machine]
    snapshot: Snapshot
    reload: Reload | None = None
    changing: Collection[str] = ()

    def one(self, request: "ControlRequest") -> Machine:
        """The machine that a request names, or the only one. Raises ControlError."""
        name, names = request.machine, list(self.machines)
        if (name in self.changing and name not in self.machines) or not self.machines:
            changing = name or ", ".join(self.changing)
            raise ControlError(f"machine {changing!r} is being taken over; ask again in a moment")
        if name is None and len(names) > 1:
            raise ControlError(f"which machine? Name one of {', '.join(names)} (--machine NAME)")
        if name is not None and name not in names:
            raise ControlError(f"there is no machine {name[:60]!r}; this gateway has {', '.join(names)}")
        return self.machines[names[0] if name is None else name]

    async def answer(self, line: bytes) -> dict[str, Any]:
        """The reply to one request."""
        return await answer(self, line)


class Answering(Protocol):
    """Who answers for a gateway: its machines as they are then (`ControlScope`), or the fleet of them."""

    async def answer(self, line: bytes) -> dict[str, Any]: ...


class Control:
    """The socket of one gateway, from `open` to `close`."""

    def __init__(self, scope: Answering, path: Path, log: "FilteringBoundLogger") -> None:
        self._scope, self.path, self._log = scope, path, log
        self._server: asyncio.Server | None = None
        self._bound = (0, 0)
        self._tasks: set[asyncio.Task[Any]] = set()

    async def open(self) -> None:
        """Begin to serve. Raises OSError."""
        self._server = await asyncio.start_unix_server(
            self._serve, sock=listening_socket(self.path), limit=MAX_REQUEST_BYTES
        )
        there = self.path.stat()
        self._bound = (there.st_dev, there.st_ino)

    async def serve(self) -> None:
        """Serve until cancelled; a socket that cannot be made, or that somebody took away, is made anew.

        It is a convenience: a gateway that cannot have one runs without it, and says so.
        """
        said = ""
        while True:
            if not self._is_there():
                self._leave()
                try:
                    await self.open()
                    said = ""
                except OSError as error:
                    reason = error.strerror or str(error)
                    if reason != said:
                        self._log.warning("other programs cannot ask this gateway", reason=reason)
                    said = reason
            await asyncio.sleep(RETRY_SECONDS if said else LOOK_SECONDS)

    def _is_there(self) -> bool:
        """Whether the socket at the path is this one's: it may be removed, and another gateway's put in its place."""
        try:
            there = self.path.stat()
        except OSError:
            return False
        return self._server is not None and (there.st_dev, there.st_ino) == self._bound

    def _leave(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.close()

    async def close(self) -> None:
        """Stop serving; requests under way are given up."""
        if self._is_there():
            self.path.unlink(missing_ok=True)
        self._leave()
        # A copy: each task takes itself out of the set as it ends.
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        if task is not None:
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

        async def reply(line: bytes) -> dict[str, Any]:
            plain: dict[str, Any] = strict(await self._scope.answer(_with_peer(line, pid, user)))
            return plain

        pid, user = _peer(writer)
        # Of this user or of the superuser, whatever the file's mode has become.
        await json_lines.serve(reader, writer, reply, admitted=lambda: user in (0, os.geteuid()))


def _peer(writer: asyncio.StreamWriter) -> tuple[int, int]:
    """Process and user of who has connected, as the kernel says."""
    sock: socket.socket = writer.get_extra_info("socket")
    pid, user, _ = _CREDENTIALS.unpack(sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
    return pid, user


def _with_peer(line: bytes, pid: int, user: int) -> bytes:
    """A request with who asks; what is none is left as it is, for the refusal."""
    try:
        return json_lines.format_object({**json_lines.parse_object(line), "peer": {"uid": user, "pid": pid}})
    except NoObject:
        return line


async def answer(scope: ControlScope, line: bytes) -> dict[str, Any]:
    """The reply to one request."""
    try:
        request = json_lines.parse_object(line)
        if not isinstance(request.get("command"), str):
            raise ControlError('a request is a JSON object such as {"command": "status"}')
        act = COMMANDS.get(request["command"])
        if act is None:
            raise ControlError(f"there is no command {request['command'][:60]!r}; known are {', '.join(COMMANDS)}")
        return {"ok": True, **await act(scope, request)}
    except (NoObject, ControlError) as error:
        return {"ok": False, "reason": str(error)}


# ---------------------------------------------------------------- what a request may hold


class PeerProcess(Section):
    """The process that asks over the socket, as the kernel says."""

    uid: int
    pid: int


class ControlRequest(Section):
    """One request; its other keys are those of its command. Without `machine` the gateway's only one is meant.

    `peer` is written into it by the socket, whatever a client has put there.
    """

    command: str
    machine: str | None = Field(None, description="a machine's name as text")
    peer: PeerProcess | None = Field(None, description="nothing: the gateway fills it in")

    @property
    def process(self) -> Mapping[str, int]:
        """Who asks, for records; empty for the gateway's own parts, which name who asked them."""
        return {} if self.peer is None else {"uid": self.peer.uid, "pid": self.peer.pid}


class _ReadTags(ControlRequest):
    tags: Annotated[list[str], Field(max_length=MOST_ROWS)] | None = Field(
        None, description=f"a list of at most {MOST_ROWS} tags' names"
    )


class _AddressRow(TagTable):
    """A tag as in a device file; its name is its address where it has none."""

    name: str = ""
    writable: Literal[False] = Field(False, description="an address without it, as nothing is written here")


class _ReadAddresses(ControlRequest):
    addresses: list[_AddressRow] = Field(
        max_length=MOST_ROWS, description='a list such as [{"address": "holding:100", "dtype": "uint16"}]'
    )


class _Arm(ControlRequest):
    # What a name and a reason may be is said where the arming is signed.
    by: str = Field(description="the person's name as text, one line")
    reason: str = Field(description="the reason as text, one line")
    minutes: float = Field(description="minutes as a number")
    acknowledge: list[Line] = Field([], description="heads of lost rows, each as text")


class _ReloadRequest(ControlRequest):
    dry_run: bool = Field(False, description="true: only say what would change")


class _ChangeAlarms(ControlRequest):
    # What a name and a reason may be is said where the change is signed.
    by: str = Field(description="the person's name as text, one line")
    reason: str = Field("", description="the reason as text, one line; an acknowledgement needs none")
    alarm: str | None = Field(None, description="an alarm's name as text")
    alarms: Annotated[list[str], Field(max_length=MOST_ROWS)] = Field(
        [], description="a list of alarms' names; without any, acknowledge means all that wait for it"
    )
    minutes: float | None = Field(None, description="minutes as a number, of a shelving")


class _Disarm(ControlRequest):
    by: Line = Field(description="the person's name as text, one line")
    reason: Line = Field(description="the reason as text, one line")


R = TypeVar("R", bound=ControlRequest)


def _parse_request(kind: type[R], request: Mapping[str, Any]) -> R:
    """The request as its command has it. Raises ControlError about the first thing that is wrong."""
    try:
        return kind.model_validate(request)
    except ValidationError as error:
        raise ControlError(sentences(kind, error, str(request["command"]))[0]) from None


# ---------------------------------------------------------------- commands


async def _status(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
    """How one machine is."""
    machine = scope.one(_parse_request(ControlRequest, request))
    return {"pid": os.getpid(), "config": str(machine.config.path), "status": scope.snapshot(machine)}


async def _plant(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
    """How all machines are, by their names."""
    _parse_request(ControlRequest, request)
    statuses = {name: scope.snapshot(machine) for name, machine in scope.machines.items()}
    return {"pid": os.getpid(), "statuses": statuses}


async def _model(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
    """The models that run on a machine, by temperature: their automaton and where they come from."""
    machine = scope.one(_parse_request(ControlRequest, request))
    plain = {one.tag: None if one.model is None else one.model.description() for one in machine.followed}
    return {"pid": os.getpid(), "temperatures": plain}


async def _reload(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
    """Read the plant file anew: what it changes, or why it is refused."""
    given = _parse_request(_ReloadRequest, request)
    if scope.reload is None:
        raise ControlError("this gateway cannot read its file anew; stop it and start it")
    return {"pid": os.getpid(), **await scope.reload(apply=not given.dry_run)}


async def _read(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
    """The samples of the last scan: of the `tags` named, or of all; or of `addresses`, asked of the device now."""
    if "addresses" in request:
        # By way of the gateway's own connection, so that a device of one client can be asked.
        asked = _parse_request(_ReadAddresses, request)
        rows, machine = asked.addresses, scope.one(asked)
        if isinstance(machine.driver, Redundant):
            raise ControlError("bare addresses differ from link to link, and this machine has several; name tags")
        samples = await machine.driver.read([replace(row.tag(), name=row.name or row.address) for row in rows])
        answers = [plain(sample) for sample in samples]
        return {"pid": os.getpid(), "time": machine.clock.now(), "samples": answers}
    given = _parse_request(_ReadTags, request)
    machine, names = scope.one(given), given.tags
    known = machine.config.map.by_name
    names = list(known) if names is None else names
    if strange := [name for name in names if name not in known]:
        raise ControlError(f"{strange[0][:60]!r} is no tag of {machine.config.map.path}; known are {', '.join(known)}")
    last = machine.last
    if last is None:
        raise ControlError("the gateway has not read anything yet")
    return {
        "pid": os.getpid(),
        "time": machine.clock.now(),
        "period": machine.config.scan.period,
        "samples": [plain(last.samples[name]) for name in names if name in last.samples],
    }


def plain(sample: Sample) -> dict[str, Any]:
    """A sample as JSON."""
    return {
        "tag": sample.tag,
        "value": sample.value,
        "quality": sample.quality.name,
        "time": sample.time,
        "sent": sample.sent,
        "reason": sample.reason,
    }


async def _arm(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
    """Let blocks be written from the next scan on: `by`, `reason`, `minutes`."""
    given = _parse_request(_Arm, request)
    machine = scope.one(given)
    if machine.config.machine in scope.changing:
        raise ControlError(f"machine {machine.config.machine!r} is being taken over; ask again in a moment")
    try:
        arming = await machine.arm(given.by, given.reason, given.minutes, given.acknowledge, process=given.process)
    except ArmingError as error:
        raise ControlError(str(error)) from None
    return {"pid": os.getpid(), "by": arming.by, "reason": arming.reason, "until": arming.until}


async def _disarm(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
    """Take everything back and write no more: `by`, `reason`."""
    given = _parse_request(_Disarm, request)
    return {
        "pid": os.getpid(),
        "was_armed": await scope.one(given).disarm(given.by, given.reason, process=given.process),
    }


async def _alarms(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
    """Every alarm of one machine, whatever its state."""
    machine = scope.one(_parse_request(ControlRequest, request))
    return {"pid": os.getpid(), "time": machine.clock.now(), "alarms": alarm_statuses(machine.alarms)}


def _alarm_command(change: Change) -> Command:
    """The command by which a person changes alarms: `by`, `reason`, `alarm` or `alarms`, `minutes` of a shelving.

    The reply has the state of each as it is by then, and that of the one that was named.
    """

    async def change_alarms(scope: ControlScope, request: Mapping[str, Any]) -> dict[str, Any]:
        given = _parse_request(_ChangeAlarms, request)
        machine = scope.one(given)
        names = [*filter(None, (given.alarm,)), *given.alarms]
        try:
            changed = await machine.desk.change(
                change, names, by=given.by, reason=given.reason, minutes=given.minutes, process=given.process
            )
        except AlarmError as error:
            raise ControlError(str(error)) from None
        states = {name: alarm.state.value for name, alarm in changed.items()}
        named = {} if given.alarm is None else {"alarm": given.alarm, "state": states[given.alarm]}
        return {"pid": os.getpid(), **named, "alarms": states}

    return change_alarms


COMMANDS: dict[str, Command] = {
    "status": _status,
    "plant": _plant,
    "read": _read,
    "model": _model,
    "arm": _arm,
    "disarm": _disarm,
    "reload": _reload,
    "alarms": _alarms,
    # By the table's own words: "acknowledge", "shelve", "remove from service", ...
    **{change.value: _alarm_command(change) for change in BY_PERSONS},
}
"""Everything that can be asked of a running gateway; a new one is a row here."""
