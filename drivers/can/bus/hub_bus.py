"""The hub's side of a client: python-can's interface "hub", whose channel is the path of the hub's socket.

    can.Bus(interface="hub", channel="/run/decanter/can0")

It behaves as a controller would: after an error frame of the class "bus-off" it neither sends nor hears until one of
the class "restarted", or until it is opened anew.
"""

import select
import socket
import struct
import time
from collections import deque

import can
from can.typechecking import CanFilters

STAMP = struct.Struct("@ll")
"""Behind a frame that a hub passes on: struct timespec, seconds and nanoseconds UTC."""
_CLASSIC = struct.Struct("=IB3x8s")
_FD = struct.Struct("=IBB2x64s")
_EXTENDED, _REMOTE, _ERROR = 0x80000000, 0x40000000, 0x20000000
_BITRATE_SWITCH, _ERROR_STATE = 0x01, 0x02
# linux/can/error.h
_BUS_OFF, _RESTARTED = 0x40, 0x100
_SEND_TIMEOUT = 1.0


class HubBus(can.BusABC):
    """One client of a hub. Raises CanInitializationError where no hub listens at `channel`.

    `fd`: frames of up to 64 bytes may be sent (they are always received). `receive_own_messages`: what is sent here is
    heard here too. A bitrate may be given and means nothing. `shutdown` leaves the bus.
    """

    def __init__(
        self,
        channel: can.typechecking.Channel,
        can_filters: CanFilters | None = None,
        *,
        receive_own_messages: bool = False,
        fd: bool = False,
        **_ignored: object,
    ) -> None:
        self.channel_info = f"hub {channel}"
        self._own: deque[can.Message] = deque()
        self._receive_own = receive_own_messages
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._state = can.BusState.ACTIVE
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.connect(str(channel))
        except OSError as error:
            self._socket.close()
            raise can.CanInitializationError(f"no CAN hub at {channel}: {error.strerror or error}") from None
        self._socket.setblocking(False)
        self._readable, self._writable = select.poll(), select.poll()
        self._readable.register(self._socket, select.POLLIN)
        self._writable.register(self._socket, select.POLLOUT)
        super().__init__(channel, can_filters)

    @property
    def state(self) -> can.BusState:
        """ACTIVE, or ERROR while bus-off. Setting it to ACTIVE restarts the controller."""
        return self._state

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        if new_state is not can.BusState.ACTIVE:
            raise NotImplementedError("a hub's client can only be made active")
        self._state = new_state

    def fileno(self) -> int:
        """The socket's descriptor, readable when a frame (or the hub's end) has come."""
        return self._socket.fileno()

    def shutdown(self) -> None:
        """Leave the bus. May be called twice."""
        super().shutdown()
        self._socket.close()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put one frame on the bus.

        Raises CanOperationError while bus-off, after the hub is gone, for an FD frame on a bus without FD, and if the
        hub has not taken the frame within `timeout` (s, 1 by default).
        """
        if self._state is can.BusState.ERROR and not msg.is_error_frame:
            raise can.CanOperationError("the controller is bus-off")
        if msg.is_fd and self._can_protocol is not can.CanProtocol.CAN_FD:
            raise can.CanOperationError("an FD frame needs a bus opened with fd=True")
        packet, patience = pack(msg), _SEND_TIMEOUT if timeout is None else timeout
        try:
            try:
                self._socket.send(packet)
            except BlockingIOError:
                if not self._writable.poll(patience * 1000.0):
                    raise can.CanOperationError(f"the hub has not taken a frame for {patience:g} s") from None
                self._socket.send(packet)
        except OSError as error:
            raise _interface_error(error) from None
        if self._receive_own:
            self._own.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._own:
            return self._own.popleft(), False
        try:
            try:
                packet = self._socket.recv(128)  # without a look at the descriptor first: in a burst there is a frame
            except BlockingIOError:
                if timeout == 0.0 or not self._readable.poll(None if timeout is None else timeout * 1000.0):
                    return None, False
                packet = self._socket.recv(128)
        except OSError as error:
            raise _interface_error(error) from None
        if not packet:
            raise can.CanOperationError("the interface is down: the CAN hub is gone")
        return self._admit(unpack(packet)), False

    def _admit(self, message: can.Message) -> can.Message | None:
        """The frame, as far as the controller's state lets it through."""
        message.channel = self.channel_info
        if message.is_error_frame:
            if message.arbitration_id & _BUS_OFF:
                self._state = can.BusState.ERROR
            elif message.arbitration_id & _RESTARTED:
                self._state = can.BusState.ACTIVE
            return message
        return message if self._state is can.BusState.ACTIVE else None


def pack(message: can.Message) -> bytes:
    """Give a frame as the kernel's struct can_frame, or canfd_frame where it is one."""
    word = message.arbitration_id
    word |= _EXTENDED if message.is_extended_id and not message.is_error_frame else 0
    word |= _REMOTE if message.is_remote_frame else 0
    word |= _ERROR if message.is_error_frame else 0
    if not message.is_fd:
        return _CLASSIC.pack(word, message.dlc, bytes(message.data))
    flags = (_BITRATE_SWITCH if message.bitrate_switch else 0) | (_ERROR_STATE if message.error_state_indicator else 0)
    return _FD.pack(word, message.dlc, flags, bytes(message.data))


def unpack(packet: bytes) -> can.Message:
    """Give the frame of a packet, stamped (s UTC) by what stands behind it, or with now. A length beyond it is cut."""
    is_fd = len(packet) >= _FD.size
    flags = 0
    if is_fd:
        word, length, flags, payload = _FD.unpack_from(packet)
    else:
        word, length, payload = _CLASSIC.unpack_from(packet)
    stamp = packet[_FD.size if is_fd else _CLASSIC.size :]
    seconds, nanoseconds = STAMP.unpack(stamp) if stamp else (time.time(), 0)
    length = min(length, len(payload))
    remote, error = bool(word & _REMOTE), bool(word & _ERROR)
    extended = bool(word & _EXTENDED) or error
    return can.Message(
        timestamp=seconds + nanoseconds * 1e-9,
        arbitration_id=word & (0x1FFFFFFF if extended else 0x7FF),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=error,
        is_fd=is_fd,
        bitrate_switch=bool(flags & _BITRATE_SWITCH),
        error_state_indicator=bool(flags & _ERROR_STATE),
        dlc=length,
        data=None if remote else payload[:length],
    )


def _interface_error(error: OSError) -> can.CanOperationError:
    return can.CanOperationError(f"the interface is down: {error.strerror or error}")
