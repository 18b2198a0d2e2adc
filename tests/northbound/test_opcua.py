"""A running gateway read by OPC UA clients: what the machines say, its past, and what is refused."""

import asyncio
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.crypto.uacrypto import CertProperties

from drivers.settings import ConfigError
from drivers.tag import Quality
from gateway.machine.reading import plant_clock
from gateway.network.certificates import make_all, make_application
from gateway.outside.northbound import check_northbound, northbound
from gateway.outside.northbound.opcua import GatewayServer, Nothing, OpcUaServer, ReadingOnly
from gateway.outside.northbound.opcua_history import HistorianHistory, recorded_points
from gateway.outside.northbound.opcua_points import OpcUaPoint, status_points
from gateway.outside.status import read_status
from gateway.plant.app import run
from gateway.settings import OpcUaSection, load_config
from gateway.store import samples
from tests.cli.support import decanter, refused
from tests.gateway.status_picture import picture, tag
from tests.gateway.support import CURRENT, RUNNING, TEMPERATURE, Bench, config_in, plant_file, two_modes
from tests.northbound import rig
from tests.northbound.rig import Plant
from tests.rig.servers import answers, free_port


async def client_of(url: str, own: Path, server: Path) -> Client:
    """A client with the certificate in `own`, which knows the server's."""
    client = Client(url, timeout=60.0)
    client.application_uri = "urn:127.0.0.1:decanter-gateway"
    await client.set_security(
        SecurityPolicyBasic256Sha256,
        own / "opcua.pem",
        CertProperties(own / "opcua.key", "pem"),
        server_certificate=server / "opcua.pem",
    )
    return client


class Changes:
    """The values that a subscription has brought."""

    def __init__(self) -> None:
        self.values: list[Any] = []

    def datachange_notification(self, _node: Any, value: Any, _data: Any) -> None:
        self.values.append(value)


async def look(url: str, machine: str, folder: Path) -> dict[str, Any]:
    """All that a plant's system does, in a thread and a loop of its own."""
    seen: dict[str, Any] = {}
    client = await client_of(url, folder / "historian", folder / "gateway")
    async with client:
        space = await client.get_namespace_index("urn:decanter-gateway:machines")

        def node(path: str) -> Any:
            return client.get_node(ua.NodeId(f"{machine}/{path}", space))

        async def value(path: str) -> ua.DataValue:
            return await node(path).read_data_value(raise_on_bad_status=False)

        reading = node(f"Measured/{TEMPERATURE}")
        changes = Changes()
        async with asyncio.timeout(200.0):
            # The machine's objects come with its first picture, what is foreseen with its first forecast.
            while True:
                with suppress(ua.UaError):
                    if (await value(f"Forecast/{TEMPERATURE}/60 s/q50")).Value.Value is not None:
                        break
                await asyncio.sleep(0.05)
            subscription = await client.create_subscription(50, changes)
            await subscription.subscribe_data_change(reading)
            while (
                len(set(changes.values)) < 2
                or (await value(f"Alarm/over limit {TEMPERATURE}/active")).Value.Value is not True
            ):
                await asyncio.sleep(0.05)
            # All of one look: a scan that came too late has no reading, and then nothing is predicted for a moment.
            paths = (
                f"Measured/{TEMPERATURE}",
                f"Measured/{RUNNING}",
                f"Predicted/{TEMPERATURE}/mean",
                f"Predicted/{TEMPERATURE}/zone",
                f"Forecast/{TEMPERATURE}/60 s/q50",
                f"Forecast/{TEMPERATURE}/minutes_median",
                f"Forecast/{TEMPERATURE}/usable",
                f"Alarm/over limit {TEMPERATURE}/state",
            )
            while not seen or any(seen[path].Value.Value in (None, "none") for path in paths):
                seen = {path: await value(path) for path in paths}
        seen["machines"] = [
            (await one.read_browse_name()).Name
            for one in await client.nodes.objects.get_children()
            if one.nodeid.NamespaceIndex == space
        ]
        unit = await node(f"Measured/{TEMPERATURE}/EngineeringUnits").read_value()
        seen["unit"] = unit.DisplayName.Text
        now = seen[f"Measured/{TEMPERATURE}"].SourceTimestamp
        # What is measured is on record within a second, where the machine has nothing else to do.
        async with asyncio.timeout(60.0):
            while not (kept := await reading.read_raw_history(None, now, 1)) or kept[0].SourceTimestamp < now:
                await asyncio.sleep(0.05)
        # A client's own paging, by the continuation points that the server gives.
        seen["history"] = await reading.read_raw_history(now - timedelta(hours=1), now)
        seen["first"] = await reading.read_raw_history(now - timedelta(hours=1), None, 3)
        seen["last"] = await reading.read_raw_history(None, now, 3)
        seen["predicted"] = await node(f"Predicted/{TEMPERATURE}/mean").read_raw_history(now - timedelta(hours=1), now)
        seen["running"] = await node(f"Measured/{RUNNING}").read_raw_history(now - timedelta(hours=1), now, 3)
        for name, attempt in {
            "write": lambda: reading.write_value(1.0),
            "method": lambda: client.nodes.server.call_method("0:GetMonitoredItems", 1),
            "delete": lambda: client.delete_nodes([reading]),
        }.items():
            with pytest.raises(ua.UaStatusCodeError) as error:
                await attempt()
            seen[name] = type(error.value).__name__
    return seen


async def refusals(url: str, machine: str, folder: Path) -> list[str]:
    """What comes of a client that nobody knows, and of one that asks without security."""
    found = []
    stranger = await client_of(url, folder / "stranger", folder / "gateway")
    for client in (stranger, Client(url, timeout=60.0)):
        try:
            async with client:
                found.append("connected")
        except (ua.UaError, OSError, TimeoutError) as error:
            found.append(type(error).__name__)
    # The endpoints may be asked for without security; the library would serve sessions on such a channel too.
    bare = Client(url, timeout=60.0)
    await bare.connect_socket()
    try:
        await bare.send_hello()
        await bare.open_secure_channel()
        found.append(str({one.SecurityPolicyUri.rpartition("#")[2] for one in await bare.get_endpoints()}))
        with suppress(ua.UaError):  # raised by the client, when the server has made the session
            await bare.create_session()
        await bare.activate_session()
        node = bare.get_node(ua.NodeId(f"{machine}/Measured/{TEMPERATURE}", 2))
        with pytest.raises(ua.UaStatusCodeError) as error:
            await node.read_value()
        found.append(type(error.value).__name__)
    finally:
        bare.disconnect_socket()
    return found


PAST_SAMPLES = 10
"""Readings at least that a client is given of the past."""


async def test_a_plants_system_reads_a_machine_and_changes_nothing(tmp_path: Path) -> None:
    """In real time, five times as fast: a bearing that is over its limit."""
    for name in ("gateway", "historian", "stranger"):
        make_application(tmp_path / name, hosts=["127.0.0.1"])
    trusted = tmp_path / "gateway/trusted"
    (trusted / "historian.pem").write_bytes((tmp_path / "historian/opcua.pem").read_bytes())
    (trusted / "none.pem").write_text("no certificate", encoding="utf-8")
    port = free_port()
    section = (
        f"[alarms]\nlimit = 45.0\n[northbound.opcua]\nport = {port}\ncertificates = 'gateway'\nperiod = 0.2\n"
        f"[forecast]\nperiod = 5.0\nruns = 50\nhorizons = [10.0, 60.0]\n"
    )
    config = config_in(tmp_path, section, model=two_modes())
    clock = plant_clock(5.0)
    bench = Bench(config, clock)  # type: ignore[arg-type]
    for read in range(5, 10_000):
        bench.plan[read] = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: 60.0 + read % 2}
    url = f"opc.tcp://127.0.0.1:{port}/decanter"
    gateway = asyncio.create_task(run(config, clock=clock, stop=bench.stop, driver=bench))
    try:
        async with asyncio.timeout(200.0):
            while not await asyncio.to_thread(answers, port):
                assert not gateway.done() or gateway.result() is None
                await asyncio.sleep(0.1)
            # A past to look at, however busy the machine is.
            while len(list(samples(config.historian.path, TEMPERATURE, machine=config.machine))) <= PAST_SAMPLES:
                assert not gateway.done() or gateway.result() is None
                await asyncio.sleep(0.1)
        seen = await asyncio.to_thread(lambda: asyncio.run(look(url, config.machine, tmp_path)))
        refused_ = await asyncio.to_thread(lambda: asyncio.run(refusals(url, config.machine, tmp_path)))
    finally:
        bench.stop.set()
        await gateway
    assert seen["machines"] == [config.machine] and seen["unit"] == "degC"
    reading = seen[f"Measured/{TEMPERATURE}"]
    assert reading.Value.Value in (60.0, 61.0) and reading.StatusCode.value == Quality.GOOD
    assert reading.Value.VariantType is ua.VariantType.Double and seen[f"Measured/{RUNNING}"].Value.Value is True
    # The values' own times, which are the plant's: it runs ahead of the clock on the wall.
    assert datetime.now(UTC) < reading.SourceTimestamp < datetime.now(UTC) + timedelta(minutes=30)
    mean, median = seen[f"Predicted/{TEMPERATURE}/mean"], seen[f"Forecast/{TEMPERATURE}/60 s/q50"]
    assert 20.0 < mean.Value.Value < 200.0 and 20.0 < median.Value.Value < 200.0
    assert seen[f"Predicted/{TEMPERATURE}/zone"].Value.Value in ("green", "yellow", "red")
    assert seen[f"Forecast/{TEMPERATURE}/minutes_median"].Value.Value == 0.0  # it is over its limit
    assert seen[f"Forecast/{TEMPERATURE}/usable"].Value.VariantType is ua.VariantType.Boolean
    assert seen[f"Alarm/over limit {TEMPERATURE}/state"].Value.Value == "unacknowledged"

    # What the client was given of the past is what is on record, to the microsecond that a record has in OPC UA.
    stored = list(samples(config.historian.path, TEMPERATURE, machine=config.machine))
    given = [(one.Value.Value, one.StatusCode.value, one.SourceTimestamp.timestamp()) for one in seen["history"]]
    assert len(given) > PAST_SAMPLES
    for (value, status, time), one in zip(given, stored, strict=False):
        assert (value, status) == (one.value, one.quality) and abs(time - one.time) < 2e-6
    times = [time for _, _, time in given]
    assert times == sorted(times)
    assert [one.SourceTimestamp.timestamp() for one in seen["first"]] == times[:3]
    assert [one.SourceTimestamp.timestamp() for one in seen["last"]] == times[:-4:-1]
    # Before its state is known a model predicts nothing, and the status says so.
    predicted = [(one.Value.Value, one.StatusCode.value) for one in seen["predicted"]]
    assert len(predicted) > 10 and predicted[-1][1] == Quality.GOOD
    assert all((value is None) == (status == Quality.NO_DATA) for value, status in predicted)
    assert {one.Value.VariantType for one in seen["running"]} == {ua.VariantType.Boolean}

    assert [seen[name] for name in ("write", "method", "delete")] == ["BadUserAccessDenied"] * 3
    stranger, unprotected, policies, bare = refused_
    assert "connected" not in (stranger, unprotected)
    assert (policies, bare) == ("{'Basic256Sha256'}", "BadUserAccessDenied")


async def test_without_certificates_there_is_one_endpoint_and_only_reading_is_served() -> None:
    server = GatewayServer(None, 16)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity], permission_ruleset=ReadingOnly())
    await server._setup_server_nodes()
    (endpoint,) = server.iserver.endpoints
    assert endpoint.SecurityMode is ua.MessageSecurityMode.None_
    (policy,) = server._policies
    for role, service, served in (
        (UserRole.User, "ReadRequest", True),
        (UserRole.User, "HistoryReadRequest", True),
        (UserRole.User, "CreateMonitoredItemsRequest", True),
        (UserRole.User, "WriteRequest", False),
        (UserRole.User, "CallRequest", False),
        (UserRole.User, "AddNodesRequest", False),
        (UserRole.User, "HistoryUpdateRequest", False),
        (UserRole.User, "RegisterServerRequest", False),
        (UserRole.Anonymous, "ReadRequest", False),
    ):
        asked = ua.NodeId(getattr(ua.ObjectIds, f"{service}_Encoding_DefaultBinary"))
        assert policy.permission_ruleset.check_validity(User(role=role), asked, None) is served
        assert Nothing().check_validity(User(role=role), asked, None) is False
    # A session cannot be taken over by whoever names its number.
    assert server.iserver.lookup_external_session(ua.NodeId(1)) is None


def hold_little(server: GatewayServer) -> None:
    """Give it the few nodes of the standard by which others are added and found: all of them take seconds to load."""
    ids = ua.ObjectIds
    nodes = [
        ua.AddNodesItem(
            RequestedNewNodeId=ua.NodeId(one),
            BrowseName=ua.QualifiedName(str(one)),
            NodeClass=ua.NodeClass.Object,
            NodeAttributes=ua.ObjectAttributes(),
        )
        for one in (
            *(ids.ObjectsFolder, ids.BaseObjectType, ids.BaseDataVariableType, ids.PropertyType),
            *(
                ids.HierarchicalReferences,
                ids.HasChild,
                ids.Aggregates,
                ids.Organizes,
                ids.HasComponent,
                ids.HasProperty,
            ),
        )
    ]
    assert list(server.iserver.node_mgt_service.try_add_nodes(nodes, check=False)) == []
    subtypes = [
        ua.AddReferencesItem(
            SourceNodeId=ua.NodeId(of),
            ReferenceTypeId=ua.NodeId(ids.HasSubtype),
            IsForward=True,
            TargetNodeId=ua.NodeId(sub),
            TargetNodeClass=ua.NodeClass.ReferenceType,
        )
        for of, sub in (
            (ids.HierarchicalReferences, ids.HasChild),
            (ids.HierarchicalReferences, ids.Organizes),
            (ids.HasChild, ids.Aggregates),
            (ids.Aggregates, ids.HasComponent),
            (ids.Aggregates, ids.HasProperty),
        )
    ]
    assert list(server.iserver.node_mgt_service.try_add_references(subtypes)) == []


async def test_what_is_gone_goes_and_what_is_missed_says_so() -> None:
    server = GatewayServer(None, 16)
    hold_little(server)
    shown = OpcUaServer(OpcUaSection(port=0), dict, tags=dict, historian=Path("none"))
    north, south = read_status(picture(machine="north")), read_status(picture(machine="south"))
    await shown._show(server, {"north": north, "south": south})

    async def value(*path: str) -> ua.DataValue:
        return await server.get_node(shown._id(path)).read_data_value(raise_on_bad_status=False)

    measured = await value("south", "Measured", TEMPERATURE)
    assert (measured.Value.Value, measured.StatusCode.value) == (45.678, Quality.GOOD)
    assert measured.SourceTimestamp.timestamp() == pytest.approx(south.values[TEMPERATURE].time, abs=2e-6)
    limit = await value("south", "Forecast", TEMPERATURE, "limit")

    # Some time later: a machine is gone, a tag too, another is a text now.
    values = {"Assorbimento": tag(0.0) | {"value": "none"}}
    later = read_status(picture(machine="south", time=south.time + 10.0, values=values))
    await shown._show(server, {"south": later})
    with pytest.raises(ua.UaStatusCodeError):
        await server.get_node(shown._id(("north",))).read_browse_name()
    children = await server.get_node(ua.NodeId(ua.ObjectIds.ObjectsFolder)).get_children()
    assert [child.nodeid for child in children] == [shown._id(("south",))]
    missed, text = await value("south", "Measured", TEMPERATURE), await value("south", "Measured", "Assorbimento")
    assert (missed.Value.Value, missed.StatusCode.value) == (None, Quality.NO_DATA)
    assert (text.Value.Value, text.Value.VariantType) == ("none", ua.VariantType.String)
    # What stands bears the time since when it does.
    assert (await value("south", "Forecast", TEMPERATURE, "limit")).SourceTimestamp == limit.SourceTimestamp

    await shown._lose(list(shown._shown))
    assert (await value("south", "Measured", "Assorbimento")).StatusCode.value == Quality.NO_COMMUNICATION
    await shown._show(server, {"south": later})
    assert (await value("south", "Measured", "Assorbimento")).Value.Value == "none"


def test_what_has_no_value_says_so_by_its_status() -> None:
    status = read_status(picture(prediction=None, forecast=None))
    points = {point.path[1:]: point for point in status_points(status, {})}
    assert all(point.value is not None or point.quality.is_bad for point in points.values())
    waiting = {
        name for (folder, *_, name), point in points.items() if point.quality is Quality.WAITING_FOR_INITIAL_DATA
    }
    assert {"mean", "low", "high", "zone", "usable", "minutes_median"} <= waiting


def test_the_past_is_read_piece_by_piece_over_a_gap_both_ways(plant: Plant) -> None:
    plant.scan(30)
    plant.scans += 100_000
    plant.scan(300)
    path = ("one", "Measured", "T")
    point = OpcUaPoint(path=path, kind="double", value=0.0, quality=Quality.GOOD, time=0.0, recorded=True)
    stored = [(one.time, one.value, one.quality) for one in samples(plant.store.path, "T", machine="one")]
    assert len(stored) > 300

    def given(low: float | None, high: float | None, *, backwards: bool = False) -> list[Any]:
        found = recorded_points(plant.store.path, point, low, high, backwards=backwards)
        return [(one.time, one.value, one.quality) for one in found]

    assert given(None, None) == stored == given(None, None, backwards=True)[::-1]
    # Both ends are part of what is asked for.
    assert given(stored[5][0], stored[310][0]) == stored[5:311]


@pytest.mark.parametrize("fraction", [0.1234563, 0.1234567])
async def test_a_reading_is_found_by_the_time_that_a_client_was_given(
    fraction: float, plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The client's time is a whole microsecond, which lies before or behind the recorded one."""
    monkeypatch.setattr(rig, "EPOCH", rig.EPOCH + fraction)
    plant.scan(30)
    point = OpcUaPoint(
        path=("one", "Measured", "T"), kind="double", value=0.0, quality=Quality.GOOD, time=0.0, recorded=True
    )
    history, node = HistorianHistory(plant.store.path, lambda _: point), ua.NodeId("one/Measured/T", 2)
    every = [value.SourceTimestamp for value in (await history.read_node_history(node, None, None, 0))[0]]
    for time in every[:5]:
        for start, end in ((time, None), (None, time), (time, time)):
            (found, *_), _next = await history.read_node_history(node, start, end, 1)
            assert found.SourceTimestamp == time
    # Page by page, as the continuation points say: none twice, none left out.
    paged, start = [], every[0]
    while start is not None:
        rows, start = await history.read_node_history(node, start, every[-1], 7)
        paged += [row.SourceTimestamp for row in rows]
    assert len(every) > 10 and paged == every


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("port = 4840\nhost = '0.0.0.0'", "can be reached from other machines"),
        ("port = 4840\nperiod = 0.0", "seconds between two looks"),
        ("port = 70000", "a TCP port"),
    ],
)
def test_what_cannot_be_served_is_refused_in_a_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        load_config(plant_file(tmp_path, f"[northbound.opcua]\n{text}"))


def test_a_missing_extra_and_wrong_certificates_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config(plant_file(tmp_path, "[northbound.opcua]\nport = 0\ncertificates = 'ua'"))
    with pytest.raises(ConfigError, match=r"opcua.pem: cannot be read \(no such file"):
        check_northbound(config)
    made = decanter("certificates", tmp_path / "ua", "--opcua", "--host", "127.0.0.1")
    assert made.exit_code == 0 and "opcua.pem" in made.output
    check_northbound(config)
    refused(decanter("certificates", tmp_path / "ua", "--opcua", "--host", "127.0.0.1"), 2, "is there already")
    # A key of another kind, as Modbus/TCP Security has it.
    make_all(tmp_path / "other", hosts=["127.0.0.1"])
    (tmp_path / "ua/opcua.key").write_bytes((tmp_path / "other/server.key").read_bytes())
    with pytest.raises(ConfigError, match="is not the RSA key"):
        check_northbound(config)

    def absent(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(northbound, "import_module", absent)
    with pytest.raises(ConfigError) as missing:
        check_northbound(config)
    assert str(missing.value) == (
        f"{config.path}: northbound.opcua: needs asyncua, which is not installed; pip install "
        "'decanter-gateway[opcua]', or on Debian install the package decanter-gateway"
    )
