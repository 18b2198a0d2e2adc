"""Faults by schedule: a table from a fault's name to the function that says what the PLC then does.

A function takes the seconds since its fault began and its own parameters, and gives an Effect; the effects of all
faults in force are merged. Times are wall seconds, as a network's are: `start` counts from the start of the replay
(in a command: from now). A fault ends after `duration` seconds or `count` requests, or when it is cleared.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from random import Random
from typing import TypeVar

from pydantic import ConfigDict, Field

from sim.plc.program.checks import (
    FileTable,
    InputError,
    checked_arguments,
    keyword_signature,
    list_words,
    validate_entry,
)
from sim.plc.program.disturbance import BusDisturbance, NodeDisturbance
from sim.plc.program.pdu import ModbusReply, ModbusRequest, exception
from sim.plc.program.registers import parse_address

Make = TypeVar("Make", bound=Callable[..., "FaultEffect"])
Alter = Callable[[ModbusRequest, ModbusReply, Random], ModbusReply]
ALL_TAGS = "*"


@dataclass(frozen=True, slots=True)
class FaultEffect:
    """What a fault does while it is in force; the defaults are a healthy PLC.

    `reset` and `deafen` happen once, when the fault begins: all connections are reset, or are left open and never
    served again. `refused` gives the exception code of an address. `answer` changes how and when an answer goes out
    at any face, `alter` what is in a Modbus frame. `can` disturbs frames, `node` a CANopen node; `abort` is the code
    by which SDO requests are aborted.
    """

    listen: bool = True
    run: bool = True
    store: bool = True
    reset: bool = False
    deafen: bool = False
    over: bool = False
    frozen: frozenset[str] = frozenset()
    swapped: frozenset[str] = frozenset()
    refused: tuple[tuple[str, int], ...] = ()
    code: int | None = None
    answer: Alter | None = None
    alter: Alter | None = None
    can: BusDisturbance | None = None
    node: NodeDisturbance | None = None
    abort: int | None = None

    @property
    def per_request(self) -> bool:
        """True if the fault strikes single requests, so that they can be counted, chosen and drawn."""
        altering = self.answer is not None or self.alter is not None
        return not self.store or bool(self.refused) or altering or {self.code, self.abort} != {None}


FAULTS: dict[str, Callable[..., FaultEffect]] = {}
"""Every fault by its name."""
FAULT_FACES: dict[str, tuple[str, ...]] = {}
"""The faults that only some faces can show, with those faces; all others strike any face."""


def fault(*, name: str = "", only_at: tuple[str, ...] = ()) -> Callable[[Make], Make]:
    """Enter a function into the table of faults, under its own name or another: that is all that a fault needs.

    Its docstring's first line and its keyword parameters, with their defaults, are what the documentation prints.
    """

    def enter(function: Make) -> Make:
        FAULTS[name or function.__name__] = function
        if only_at:
            FAULT_FACES[name or function.__name__] = only_at
        return function

    return enter


def face_shows(kind: str, face: str) -> bool:
    """True if the face can show this fault."""
    return face in FAULT_FACES.get(kind, (face,))


@fault()
def refuse(_: float, *, reset: bool = True) -> FaultEffect:
    """The listener is closed: connecting is refused. `reset`: open connections are reset too."""
    return FaultEffect(listen=False, reset=reset)


@fault()
def silent(_: float) -> FaultEffect:
    """Connections are accepted, requests are acted on, and no reply is sent."""
    return FaultEffect(answer=lambda request, reply, rng: replace(reply, sent=False))


@fault()
def half_open(_: float) -> FaultEffect:
    """Connections that are open when it begins stay open and are never served again; new ones are served."""
    return FaultEffect(deafen=True)


@fault()
def reset(_: float, *, after: int = -1) -> FaultEffect:
    """Sends the first `after` bytes of the reply (-1: drawn), then resets the connection."""

    def alter(_: ModbusRequest, reply: ModbusReply, rng: Random) -> ModbusReply:
        length = len(reply.frame())
        return replace(reply, cut=rng.randrange(1, length) if after < 0 else min(after, length))

    return FaultEffect(alter=alter)


@fault()
def late(_: float, *, delay_s: float = 1.0) -> FaultEffect:
    """The reply holds what was true when the request came, and is sent `delay_s` later."""
    return FaultEffect(answer=lambda request, reply, rng: replace(reply, delay_s=reply.delay_s + max(0.0, delay_s)))


@fault()
def duplicate(_: float, *, copies: int = 2) -> FaultEffect:
    """The reply is sent `copies` times."""
    return FaultEffect(answer=lambda request, reply, rng: replace(reply, copies=max(1, copies)))


@fault()
def split(_: float, *, piece: int = 1) -> FaultEffect:
    """The reply is sent in pieces of `piece` bytes, each in a segment of its own."""
    return FaultEffect(alter=lambda request, reply, rng: replace(reply, piece=max(1, piece)))


@fault(only_at=("tcp", "tls", "serial", "rtu-tcp"))
def cut_short(_: float, *, missing: int = 1) -> FaultEffect:
    """The last `missing` bytes of the reply are not sent, and the connection stays open."""

    def alter(_: ModbusRequest, reply: ModbusReply, __: Random) -> ModbusReply:
        frame = reply.frame()
        return replace(reply, raw=frame[: max(0, len(frame) - max(0, missing))], copies=1)

    return FaultEffect(alter=alter)


@fault()
def garbage(_: float, *, length: int = 16) -> FaultEffect:
    """Drawn bytes are sent instead of the reply."""
    return FaultEffect(answer=lambda request, reply, rng: replace(reply, raw=rng.randbytes(max(0, length))))


@fault()
def wrong_unit(_: float, *, unit: int = -1) -> FaultEffect:
    """The reply names another `unit` (-1: the next one)."""

    def alter(request: ModbusRequest, reply: ModbusReply, _: Random) -> ModbusReply:
        return replace(reply, unit=(request.unit + 1 if unit < 0 else unit) & 0xFF)

    return FaultEffect(alter=alter)


@fault()
def wrong_function(_: float, *, function: int = -1) -> FaultEffect:
    """The reply names another `function` (-1: 4 for 3, 3 for 4, else the next one)."""

    def alter(request: ModbusRequest, reply: ModbusReply, _: Random) -> ModbusReply:
        other = {3: 4, 4: 3}.get(request.function, request.function + 1) if function < 0 else function
        return replace(reply, pdu=bytes((other & 0xFF,)) + reply.pdu[1:])

    return FaultEffect(alter=alter)


@fault()
def wrong_count(_: float, *, delta: int = -1, honest: bool = True) -> FaultEffect:
    """The reply holds `delta` registers (or bytes of bits) more or fewer than asked; a write's echo has another count.

    `honest`: the byte count tells the truth about it; otherwise it still says what was asked for.
    """

    def alter(_: ModbusRequest, reply: ModbusReply, __: Random) -> ModbusReply:
        pdu = reply.pdu
        if pdu[0] in (15, 16):  # a write's echo: function, address, count
            count = int.from_bytes(pdu[3:5], "big") + delta
            return replace(reply, pdu=pdu[:3] + (count & 0xFFFF).to_bytes(2, "big"))
        if pdu[0] not in (1, 2, 3, 4, 23):
            return reply
        step = 1 if pdu[0] in (1, 2) else 2
        length = min(max(0, len(pdu) - 2 + delta * step), 250)
        payload = pdu[2 : 2 + length].ljust(length, b"\0")
        return replace(reply, pdu=pdu[:1] + bytes((length if honest else pdu[1],)) + payload)

    return FaultEffect(alter=alter)


@fault()
def wrong_transaction(_: float, *, offset: int = 1) -> FaultEffect:
    """The reply names another transaction, `offset` away from the request's."""
    return FaultEffect(
        alter=lambda request, reply, rng: replace(reply, transaction=(reply.transaction + offset) & 0xFFFF)
    )


@fault(name="exception")
def refuse_request(_: float, *, code: int = 4) -> FaultEffect:
    """Requests are answered with exception `code` (4 device failure, 6 busy, ...) and not acted on."""
    return FaultEffect(code=code & 0xFF)


@fault()
def illegal_register(_: float, *, registers: list[str], code: int = 2) -> FaultEffect:
    """Requests that touch one of `registers` (such as "holding:103") are answered with exception `code`."""
    return FaultEffect(refused=tuple((register, code & 0xFF) for register in registers))


@fault()
def frozen(_: float, *, tags: list[str] | None = None) -> FaultEffect:
    """The registers of `tags` stand still while the truth goes on; without `tags` all do, the heartbeat included."""
    return FaultEffect(frozen=frozenset(tags or [ALL_TAGS]))


@fault(only_at=("tcp", "tls", "serial", "rtu-tcp"))
def swapped_words(_: float, *, tags: list[str] | None = None) -> FaultEffect:
    """The words of the numbers in `tags`, without `tags` of all, come last to first, as after another download."""
    return FaultEffect(swapped=frozenset(tags or [ALL_TAGS]))


@fault()
def restart(elapsed_s: float, *, down_s: float = 1.0, zeros_s: float = 1.0) -> FaultEffect:
    """The PLC restarts: connections reset, nobody listens for `down_s`, then zeros for `zeros_s`, then it runs again.

    Until the program runs every register, the heartbeat too, reads 0; the counters of blocks begin anew.
    """
    return FaultEffect(listen=elapsed_s >= down_s, run=False, reset=True, over=elapsed_s >= down_s + zeros_s)


@fault()
def write_ignored(_: float) -> FaultEffect:
    """Writes are confirmed and not stored."""
    return FaultEffect(store=False)


@fault(only_at=("serial", "rtu-tcp"))
def wrong_checksum(_: float) -> FaultEffect:
    """The last byte of the reply is another one, so that its CRC does not fit; only where frames have one."""

    def alter(_: ModbusRequest, reply: ModbusReply, rng: Random) -> ModbusReply:
        frame = reply.frame()
        return replace(reply, raw=frame[:-1] + bytes((frame[-1] ^ 0xFF,))) if reply.rtu else reply

    return FaultEffect(alter=alter)


@fault(only_at=("can", "canopen"))
def frame_loss(_: float, *, share: float = 0.3, messages: list[str] | None = None) -> FaultEffect:
    """Of the CAN frames of `messages` (of all without it) a `share` in 0..1 is lost, as drawn."""
    return FaultEffect(can=BusDisturbance(messages=frozenset(messages or ()), loss=min(max(share, 0.0), 1.0)))


@fault(only_at=("can",))
def short_frame(_: float, *, cut: int = 1, messages: list[str] | None = None) -> FaultEffect:
    """The CAN frames of `messages` have `cut` bytes fewer."""
    return FaultEffect(can=BusDisturbance(messages=frozenset(messages or ()), cut=max(1, cut)))


@fault(only_at=("can",))
def stale_message(_: float, *, messages: list[str] | None = None) -> FaultEffect:
    """The CAN frames of `messages` are repeated as they were, with counter and checksum, while the truth goes on."""
    return FaultEffect(can=BusDisturbance(messages=frozenset(messages or ()), stale=True))


@fault(only_at=("can",))
def corrupt_frame(_: float, *, messages: list[str] | None = None) -> FaultEffect:
    """In each CAN frame of `messages` one drawn bit is another one."""
    return FaultEffect(can=BusDisturbance(messages=frozenset(messages or ()), corrupt=True))


@fault(only_at=("can", "canopen"))
def babbling_node(_: float, *, rate: float = 2000.0, known: bool = False) -> FaultEffect:
    """A strange CAN node sends `rate` random frames a second, with random ids or (`known`) with the PLC's own."""
    return FaultEffect(can=BusDisturbance(babble=min(max(rate, 0.0), 20_000.0), known=known))


@fault(only_at=("can", "canopen"))
def bus_off(_: float) -> FaultEffect:
    """Every controller on the CAN bus is bus-off: nothing is sent and nothing heard."""
    return FaultEffect(can=BusDisturbance(bus_off=True))


@fault(only_at=("canopen",))
def missing_heartbeat(_: float) -> FaultEffect:
    """The CANopen node sends no heartbeat, and everything else as before."""
    return FaultEffect(node=NodeDisturbance(no_heartbeat=True))


@fault(only_at=("canopen",))
def short_pdo(_: float, *, pdo: int = 0, cut: int = 1) -> FaultEffect:
    """TPDO number `pdo` (0: every one) has `cut` bytes fewer than are mapped."""
    return FaultEffect(node=NodeDisturbance(pdo=pdo, length=-max(1, cut)))


@fault(only_at=("canopen",))
def long_pdo(_: float, *, pdo: int = 0, extra: int = 1) -> FaultEffect:
    """TPDO number `pdo` (0: every one) has `extra` bytes more than are mapped, as far as 8 bytes allow."""
    return FaultEffect(node=NodeDisturbance(pdo=pdo, length=max(1, extra)))


@fault(only_at=("canopen",))
def emcy(_: float, *, code: int = 0x5000, register: int = 1) -> FaultEffect:
    """The CANopen node announces error `code` with this error register, and takes it back at the end."""
    return FaultEffect(node=NodeDisturbance(emergency=(code & 0xFFFF, register & 0xFF)))


@fault(only_at=("canopen",))
def sdo_abort(_: float, *, code: int = 0x08000000) -> FaultEffect:
    """The CANopen node aborts SDO requests with this abort code and does not act on them."""
    return FaultEffect(abort=code & 0xFFFFFFFF)


@fault(only_at=("canopen",))
def sdo_late(_: float, *, delay_s: float = 1.0) -> FaultEffect:
    """Each SDO answer holds what was true when the request came, and is sent `delay_s` later, in its turn."""
    return late(_, delay_s=delay_s)


@fault(only_at=("canopen",))
def node_reset(_: float) -> FaultEffect:
    """The CANopen node boots: the EDS's parameters, pre-operational, no PDO until a master starts it."""
    return FaultEffect(node=NodeDisturbance(reset=True), over=True)


def describe() -> str:
    """Every fault with its parameters and what it does, as the documentation prints them (Markdown)."""
    rows = [
        f"| `{name}` | {list_words(keyword_signature(function))} | {(function.__doc__ or '').splitlines()[0]} |"
        for name, function in FAULTS.items()
    ]
    return "\n".join(("| fault | parameters | what the PLC does |", "|---|---|---|", *rows))


class _FaultEntry(FileTable):
    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)
    kind: str = Field(strict=True, description=f"one of {list_words(tuple(FAULTS))}")
    start: float = Field(0.0, strict=True, ge=0, description="seconds since the replay's start")
    duration: float | None = Field(None, strict=True, gt=0, description="seconds, more than 0")
    count: int | None = Field(None, strict=True, ge=1, description="how many requests it strikes, 1 or more")
    probability: float = Field(1.0, strict=True, ge=0, le=1, description="a number in 0..1")
    functions: tuple[int, ...] = Field((), description="a list of function codes, such as [3, 16]")
    face: str = Field("", strict=True, description="the face that it strikes, such as 'tcp'; without it all of them")


@dataclass(frozen=True, slots=True)
class OrderedFault:
    """One entry of a schedule. `functions`, `face` empty: all of them; `probability` is drawn for each request."""

    kind: str
    effect: Callable[[float], FaultEffect]
    start: float = 0.0
    duration: float | None = None
    count: int | None = None
    probability: float = 1.0
    functions: tuple[int, ...] = ()
    face: str = ""


def parse_fault(data: object, where: str) -> OrderedFault:
    """A fault from a table of TOML or JSON. Raises InputError naming the key, the reason and what would be right."""
    entry = validate_entry(_FaultEntry, data, where)
    function = FAULTS.get(entry.kind)
    if function is None:
        raise InputError(f"{where}: kind: there is no fault {entry.kind!r}; known are {list_words(tuple(FAULTS))}")
    parameters = checked_arguments(function, entry.model_extra or {}, f"{where} ({entry.kind})")
    effect = partial(function, **parameters)
    picky = entry.count is not None or entry.probability < 1 or entry.functions
    if picky and not effect(0.0).per_request:
        raise InputError(f"{where} ({entry.kind}): count, probability and functions are of faults that strike requests")
    for register, _ in effect(0.0).refused:
        parse_address(register, f"{where} ({entry.kind}): registers")
    if entry.face and (not effect(0.0).run or effect(0.0).frozen or effect(0.0).swapped):
        raise InputError(f"{where} ({entry.kind}): face: it strikes the program behind all faces; leave it out")
    return OrderedFault(
        kind=entry.kind,
        effect=effect,
        start=entry.start,
        duration=entry.duration,
        count=entry.count,
        probability=entry.probability,
        functions=entry.functions,
        face=entry.face,
    )


def merge_effects(effects: Iterable[FaultEffect]) -> FaultEffect:
    """The effects of several faults as one; of several exception codes the first wins."""
    whole = FaultEffect()
    for effect in effects:
        whole = FaultEffect(
            listen=whole.listen and effect.listen,
            run=whole.run and effect.run,
            store=whole.store and effect.store,
            frozen=whole.frozen | effect.frozen,
            swapped=whole.swapped | effect.swapped,
            refused=whole.refused + effect.refused,
            code=effect.code if whole.code is None else whole.code,
            abort=effect.abort if whole.abort is None else whole.abort,
        )
    return whole


def refusal(effect: FaultEffect, request: ModbusRequest, touched: Sequence[tuple[str, range]]) -> bytes | None:
    """The exception PDU by which the faults refuse a request, if they do."""
    if effect.code is not None:
        return exception(request.function, effect.code)
    for register, code in effect.refused:
        table, _, number = register.partition(":")
        if any(table == other and int(number) in addresses for other, addresses in touched):
            return exception(request.function, code)
    return None
