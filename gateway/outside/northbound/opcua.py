"""The server of `[northbound.opcua]`: asyncua in a thread and a loop of its own, fed from the machines' pictures.

Clients read, browse, subscribe and read history; nothing that changes anything is served. With certificates whoever
opens a channel has to be known by his own certificate; without, the server is for this computer alone.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asyncua import Node, Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.crypto.permission_rules import USER_TYPES, PermissionRuleset, User, UserRole
from asyncua.crypto.security_policies import (
    SecurityPolicy,
    SecurityPolicyBasic256Sha256,
    SecurityPolicyFactory,
    SecurityPolicyNone,
)
from asyncua.crypto.validator import CertificateValidator
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from cryptography import x509

from drivers.tag import Quality
from gateway.network import OPC_UA_CERTIFICATE, OPC_UA_KEY, SharingListener, trusted_certificates
from gateway.outside.northbound.opcua_history import VARIANT_TYPES, HistorianHistory, data_value
from gateway.outside.northbound.opcua_points import OpcUaPoint, status_points
from gateway.outside.northbound.pictures import Pictures, ask_statuses
from gateway.settings import OpcUaSection

if TYPE_CHECKING:
    from drivers.tag import Tag
    from gateway.outside.status import GatewayStatus

NAMESPACE = "urn:decanter-gateway:machines"
LARGEST_MESSAGE = 1 << 20
"""Bytes of a request or an answer."""
SUBSCRIPTIONS_PER_CLIENT = 8
"""Subscriptions for each of the clients that there may be."""
ACTIVATION_SECONDS = 15.0
"""Seconds from a connection to the session that is activated on it: who does not come so far takes no place longer."""
LONGEST_QUEUE = 1_000
"""Values that wait for one client at one monitored item."""
MOST_WAITING = 50
"""Requests of one client that wait."""
MOST_UNSENT = 4 * LARGEST_MESSAGE
"""Bytes that wait for a client to take them; one that asks and reads nothing is left then."""
CHANNEL_BYTES = 65_535
_CLOSING_FACTOR = 2
_CHANGING = {ua.ObjectIds.WriteRequest_Encoding_DefaultBinary, ua.ObjectIds.CallRequest_Encoding_DefaultBinary}
_READING = {ua.NodeId(one) for one in USER_TYPES if one not in _CHANGING}


class ReadingOnly(PermissionRuleset):  # type: ignore[misc]
    """The services that only read, for sessions that are activated."""

    def check_validity(self, user: User, action_type: ua.NodeId, body: Any) -> bool:
        """Whether a request is served."""
        return user.role is UserRole.User and action_type in _READING


class Nothing(PermissionRuleset):  # type: ignore[misc]
    """For a channel that only asks which endpoints there are."""

    def check_validity(self, user: User, action_type: ua.NodeId, body: Any) -> bool:
        """No request is served."""
        return False


class EveryoneReads:
    """Whoever has a channel may read; nobody is an administrator."""

    def get_user(self, *_: Any, **__: Any) -> User:
        """The user of a session that is activated."""
        return User(role=UserRole.User)


class KnownClients(SecurityPolicyFactory):  # type: ignore[misc]
    """Channels for clients whose own certificate lies among the trusted ones, and is valid by its dates."""

    def __init__(self, *given: Any, trusted: Callable[[], Iterable[bytes]], **keys: Any) -> None:
        super().__init__(*given, **keys)
        self._trusted = trusted

    def create(self, peer_certificate: bytes | None) -> SecurityPolicy:
        """The policy of a new channel. Raises BadUserAccessDenied, by which the library closes the connection."""
        # A certificate may come with its chain behind it; DER says itself where it ends.
        peer = peer_certificate or b""
        known = next((one for one in self._trusted() if peer.startswith(one)), None)
        if known is None:
            raise ua.uaerrors.BadUserAccessDenied
        certificate, now = x509.load_der_x509_certificate(known), datetime.now(UTC)
        if not certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc:
            raise ua.uaerrors.BadUserAccessDenied
        return super().create(peer_certificate)


class NoTakeover(InternalServer):  # type: ignore[misc]
    """Sessions end with their connection.

    The library lets a new connection go on with the session whose number it names, and gives it that session's
    subscriptions before it has seen who asks; the numbers count up from one.
    """

    def lookup_external_session(self, auth_token: ua.NodeId) -> None:
        """No session is found."""
        return


class BoundedTransport:
    """A client's connection as the library writes to it, which never looks whether anybody takes what it writes."""

    def __init__(self, line: asyncio.Transport) -> None:
        self._line = line

    def get_extra_info(self, name: str) -> Any:
        """The connection's own."""
        return self._line.get_extra_info(name)

    def write(self, data: bytes) -> None:
        """Send, or leave the client; what is said to one that has gone is dropped without a word."""
        if self._line.is_closing():
            return
        if self._line.get_write_buffer_size() > MOST_UNSENT:
            self._line.abort()
            return
        self._line.write(data)

    def close(self) -> None:
        """Let the client go."""
        self._line.close()


class BoundedChannel(OPCUAProtocol):  # type: ignore[misc]
    """The library's protocol over such a connection."""

    def connection_made(self, transport: asyncio.Transport) -> None:
        super().connection_made(BoundedTransport(transport))


class BoundedServer(BinaryServer):  # type: ignore[misc]
    """The library's listener, whose clients have bounded connections, of which no address takes another's."""

    most_clients: int

    async def start(self) -> None:
        """Listen. Raises OSError."""
        # The library's own bound counts those too that have to go and are about to: it is for what is beyond them.
        self.iserver.max_connections = _CLOSING_FACTOR * self.most_clients
        listener = SharingListener(socket.AF_INET, socket.SOCK_STREAM)
        listener.limit_connections(self.most_clients)
        started = False
        try:
            listener.bind_address((self.hostname, self.port), self.most_clients)
            self._server = await asyncio.get_running_loop().create_server(self._make_protocol, sock=listener)
            started = True
        finally:
            if not started:
                listener.close()
        self.cleanup_task = asyncio.create_task(self._close_task_loop())

    def _make_protocol(self) -> BoundedChannel:
        return BoundedChannel(
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )


class GatewayServer(Server):  # type: ignore[misc]
    """The library's server with the gateway's own channels: with certificates for known clients alone."""

    def __init__(self, certificates: Path | None, most_clients: int) -> None:
        super().__init__(iserver=NoTakeover(user_manager=EveryoneReads()))
        self._certificates, self._most_clients = certificates, most_clients

    async def start(self) -> None:
        """Listen, as the library does, with connections that are bounded. Raises OSError."""
        await self._setup_server_nodes()
        await self.iserver.start()
        try:
            self.bserver = BoundedServer(self.iserver, *self._get_bind_socket_info(), self.limits)
            self.bserver.most_clients = self._most_clients
            self.bserver.set_policies(self._policies)
            await self.bserver.start()
        except BaseException:
            await self.iserver.stop()
            raise

    async def _setup_server_nodes(self) -> None:
        await super()._setup_server_nodes()
        folder = self._certificates
        if folder is None:
            return
        self._policies = [
            KnownClients(
                SecurityPolicyBasic256Sha256,
                mode,
                self.iserver.certificate,
                self.iserver.private_key,
                permission_ruleset=ReadingOnly(),
                trusted=lambda: trusted_certificates(folder),
            )
            for mode in (ua.MessageSecurityMode.SignAndEncrypt, ua.MessageSecurityMode.Sign)
        ]
        # Without security a client may ask for the endpoints. The library opens such a channel anyhow, and without this
        # row serves whatever a session on it asks for, also to write.
        no_mode = ua.MessageSecurityMode.None_
        self._policies.append(SecurityPolicyFactory(SecurityPolicyNone, no_mode, permission_ruleset=Nothing()))


class OpcUaServer:
    """Serves the machines from `run`, in a thread, until `close`. `port` is the one that is listened at.

    `tags` gives the machines' tags by name, `historian` is the file of the records. `loaded` is set when the address
    space of the standard is there, which takes some seconds.
    """

    def __init__(
        self,
        section: OpcUaSection,
        pictures: Pictures,
        *,
        tags: Callable[[], Mapping[str, Mapping[str, Tag]]],
        historian: Path,
    ) -> None:
        self._section, self._pictures, self._tags, self._historian = section, pictures, tags, historian
        self._gateway_loop = asyncio.get_running_loop()
        self.port = section.port or 0
        self.stop, self.loaded = threading.Event(), threading.Event()
        self._shown: dict[tuple[str, ...], OpcUaPoint] = {}
        self._nodes: dict[tuple[str, ...], Node] = {}
        self._places: dict[ua.NodeId, tuple[str, ...]] = {}
        self._namespace = 0

    def run(self) -> None:
        """Serve until `close`. Raises OSError, in one sentence, where the port cannot be had."""
        if self.stop.is_set():
            return
        section = self._section
        try:
            # Before some seconds are spent on a server that cannot listen.
            with socket.create_server((section.host, self.port)) as probe:
                self.port = probe.getsockname()[1]
        except OSError as error:
            self.loaded.set()
            reason = error.strerror or str(error)
            raise OSError(
                error.errno, f"[northbound.opcua] cannot listen at {section.host}:{section.port}: {reason.lower()}"
            ) from None
        # The library tells clients' mistakes and its own state to a log that nobody has set up.
        logging.getLogger("asyncua").setLevel(logging.CRITICAL + 1)
        self._shown, self._nodes, self._places = {}, {}, {}
        try:
            asyncio.run(self._serve())
        finally:
            self.loaded.set()

    def close(self) -> None:
        """End the server; its thread ends within a second or so."""
        self.stop.set()

    # ---------------------------------------------------------------- in the thread's loop

    async def _serve(self) -> None:
        server = await self._make_server()
        self.loaded.set()
        if self.stop.is_set():
            return
        async with server:
            while not self.stop.is_set():
                try:
                    statuses = await ask_statuses(self._pictures, self._gateway_loop)
                except (TimeoutError, RuntimeError):
                    await self._lose(list(self._shown))
                else:
                    await self._show(server, statuses)
                await asyncio.to_thread(self.stop.wait, self._section.period)

    async def _make_server(self) -> GatewayServer:
        section = self._section
        server = GatewayServer(section.certificates, section.most_clients)
        inner, most = server.iserver, section.most_clients
        inner.max_subscriptions = SUBSCRIPTIONS_PER_CLIENT * most
        inner.max_pending_messages_per_connection, inner.max_monitored_item_queue_size = MOST_WAITING, LONGEST_QUEUE
        inner.max_pending_activation_seconds = ACTIVATION_SECONDS
        inner.allow_remote_admin = False
        inner.history_manager.set_storage(HistorianHistory(self._historian, self._find_point))
        server.limits = TransportLimits(
            max_recv_buffer=CHANNEL_BYTES,
            max_send_buffer=CHANNEL_BYTES,
            max_chunk_count=LARGEST_MESSAGE // CHANNEL_BYTES + 1,
            max_message_size=LARGEST_MESSAGE,
        )
        server.name = "decanter gateway"
        server.product_uri, server.manufacturer_name = "urn:decanter-gateway", "decanter gateway"
        server.application_type = ua.ApplicationType.Server
        uri = "urn:localhost:decanter-gateway"
        policies = [ua.SecurityPolicyType.NoSecurity]
        if section.certificates is not None:
            await server.load_certificate(section.certificates / OPC_UA_CERTIFICATE)
            await server.load_private_key(section.certificates / OPC_UA_KEY, format="pem")
            names = server.iserver.certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
            uri = names.get_values_for_type(x509.UniformResourceIdentifier)[0]
            policies = [
                ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
                ua.SecurityPolicyType.Basic256Sha256_Sign,
            ]
            server.set_certificate_validator(CertificateValidator())
        server.set_security_policy(policies, permission_ruleset=ReadingOnly())
        server.set_identity_tokens([ua.AnonymousIdentityToken])
        server.set_endpoint(f"opc.tcp://{_in_address(section.host)}:{self.port}/decanter")
        server.socket_address = section.host, self.port
        await server.init()
        await server.set_application_uri(uri)
        self._namespace = await server.register_namespace(NAMESPACE)
        return server

    async def _show(self, server: GatewayServer, statuses: Mapping[str, GatewayStatus]) -> None:
        """Bring the address space to what the machines say now."""
        tags, given = self._tags(), set[tuple[str, ...]]()
        for machine in {path[0] for path in self._nodes} - set(statuses):
            await self._remove(server, (machine,))
        for name, status in statuses.items():
            for point in status_points(status, tags.get(name, {})):
                given.add(point.path)
                before = self._shown.get(point.path)
                if before is not None and before.kind != point.kind:
                    await self._remove(server, point.path)
                if point.path not in self._nodes:
                    await self._add(server, point)
                # What stands is dated by its change.
                if before is not None and point.standing:
                    changed = replace(point, time=before.time) != before
                else:
                    changed = point != before
                if changed:
                    await self._write(point)
            # Clients come in between.
            await asyncio.sleep(0)
        await self._lose([path for path in self._shown if path not in given], Quality.NO_DATA)

    async def _lose(self, paths: Iterable[tuple[str, ...]], quality: Quality = Quality.NO_COMMUNICATION) -> None:
        """What nobody says any more: the gateway does not answer, or the machine no longer has it."""
        for path in paths:
            point = self._shown[path]
            if point.quality != quality:
                lost = OpcUaPoint(path=path, kind=point.kind, value=None, quality=quality, time=point.time)
                await self._write(lost)

    async def _add(self, server: GatewayServer, point: OpcUaPoint) -> None:
        parent = server.nodes.objects
        for depth in range(1, len(point.path)):
            path = point.path[:depth]
            if path not in self._nodes:
                self._nodes[path] = await parent.add_object(self._id(path), self._browse_name(path[-1]))
            parent = self._nodes[path]
        kind = VARIANT_TYPES[point.kind]
        name = self._browse_name(point.path[-1])
        node = await parent.add_variable(self._id(point.path), name, None, datatype=ua.NodeId(kind.value))
        self._nodes[point.path] = node
        if point.unit:
            unit = ua.EUInformation(UnitId=-1, DisplayName=ua.LocalizedText(point.unit))
            place = self._id((*point.path, "EngineeringUnits"))
            await node.add_property(place, ua.QualifiedName("EngineeringUnits", 0), unit)
        if point.recorded:
            self._places[node.nodeid] = point.path
            await node.write_attribute(ua.AttributeIds.Historizing, ua.DataValue(True))
            for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
                await node.set_attr_bit(attribute, ua.AccessLevel.HistoryRead)

    async def _write(self, point: OpcUaPoint) -> None:
        self._shown[point.path] = point
        await self._nodes[point.path].write_attribute(ua.AttributeIds.Value, data_value(point))

    async def _remove(self, server: GatewayServer, path: tuple[str, ...]) -> None:
        # Who has subscribed to it hears of it by that: of a node that is deleted nothing comes any more.
        await self._lose([one for one in self._shown if one[: len(path)] == path], Quality.NO_DATA)
        await server.delete_nodes([self._nodes[path]], recursive=True)
        for gone in [one for one in self._nodes if one[: len(path)] == path]:
            self._places.pop(self._nodes.pop(gone).nodeid, None)
            self._shown.pop(gone, None)

    def _id(self, path: tuple[str, ...]) -> ua.NodeId:
        # A name may have a stroke in it.
        return ua.NodeId("/".join(name.replace("%", "%25").replace("/", "%2F") for name in path), self._namespace)

    def _browse_name(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self._namespace)

    def _find_point(self, node_id: ua.NodeId) -> OpcUaPoint | None:
        """What a node shows, if its past is on record."""
        path = self._places.get(node_id)
        return None if path is None else self._shown.get(path)


def _in_address(host: str) -> str:
    return f"[{host}]" if ":" in host else host
