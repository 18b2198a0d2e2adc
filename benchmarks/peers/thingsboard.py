"""The ThingsBoard IoT gateway as a contender: an environment of its own, its configuration, and the server it talks to.

The server is a stub: it accepts every MQTT connection, subscription and message (MQTT 3.1.1, OASIS 2014), and keeps
none. `python -m benchmarks.peers.thingsboard` serves it and prints its port; it ends with its standard input.
"""

import asyncio
import json
import subprocess
import sys
import threading
from pathlib import Path

import click

from benchmarks.peers import REGISTERS
from benchmarks.processes import BenchmarkError

VERSION, PYMODBUS = "3.8.5", "3.9.2"
"""The gateway, and the pymodbus that it would otherwise install for itself when it starts."""
PACKAGES = (f"thingsboard-gateway=={VERSION}", f"pymodbus=={PYMODBUS}", "pyserial", "pyserial-asyncio")
_LONGEST_S = 300.0
_CONNECT, _PUBLISH, _SUBSCRIBE, _UNSUBSCRIBE, _PING = 1, 3, 8, 10, 12


def environment(folder: Path, *, install: bool) -> Path:
    """The interpreter of the environment at `folder`, made if asked. Raises BenchmarkError with the reason if not."""
    python = folder / "bin" / "python"
    if not python.exists() and not install:
        raise BenchmarkError(f"the ThingsBoard gateway is not at {folder}; --install puts it there, from PyPI")
    if not python.exists():
        uv = str(Path(sys.executable).with_name("uv"))
        tool = [uv] if Path(uv).exists() else ["uv"]
        try:
            subprocess.run([*tool, "venv", "-q", str(folder)], check=True, timeout=_LONGEST_S)
            command = [*tool, "pip", "install", "-q", "-p", str(python), *PACKAGES]
            subprocess.run(command, check=True, timeout=_LONGEST_S)
        except (OSError, subprocess.SubprocessError) as error:
            raise BenchmarkError(f"the ThingsBoard gateway cannot be installed: {error}") from None
    found = subprocess.run([str(python), "-c", "import thingsboard_gateway"], capture_output=True, check=False)
    if found.returncode:
        raise BenchmarkError(f"{folder} has no thingsboard_gateway that can be imported; remove it, then --install")
    return python


def configure(folder: Path, *, broker: int, port: int, count: int, period: float) -> Path:
    """Write its configuration: every PLC with ten values, each of them a request, as it reads them; gives the folder.

    Rate limits are off, what it stores lies in memory, and it warns of errors alone.
    """
    config = folder / "config"
    config.mkdir(parents=True, exist_ok=True)
    (folder / "logs").mkdir(exist_ok=True)
    limits = ("rateLimits", "dpRateLimits", "messagesRateLimits", "deviceMessagesRateLimits", "deviceRateLimits")
    server = {
        "host": "127.0.0.1",
        "port": broker,
        "remoteConfiguration": False,
        "remoteShell": False,
        "statistics": {"enable": False},
        "minPackSendDelayMS": 50,
        "minPackSizeToSend": 500,
        "checkConnectorsConfigurationInSeconds": 3600,
        "security": {"type": "accessToken", "accessToken": "benchmark"},
        "qos": 1,
        **dict.fromkeys((*limits, "deviceDpRateLimits"), "0:0,"),
    }
    connectors = [{"type": "modbus", "name": "plcs", "configuration": "modbus.json"}]
    storage = {"type": "memory", "read_records_count": 1000, "max_records_count": 100_000}
    main = {"thingsboard": server, "storage": storage, "grpc": {"enabled": False}, "connectors": connectors}
    slaves = [
        {
            "host": "127.0.0.1",
            "port": port + number,
            "type": "tcp",
            "method": "socket",
            "unitId": 1,
            "deviceName": f"plc{number}",
            "deviceType": "default",
            "timeout": 1,
            "byteOrder": "BIG",
            "wordOrder": "BIG",
            "retries": 1,
            "pollPeriod": round(1000.0 * period),
            "connectAttemptTimeMs": 500,
            "connectAttemptCount": 5,
            "waitAfterFailedAttemptsMs": 1000,
            "attributes": [],
            "timeseries": [
                {"tag": f"r{tag}", "type": "16uint", "functionCode": 3, "objectsCount": 1, "address": tag}
                for tag in range(REGISTERS)
            ],
            "attributeUpdates": [],
            "rpc": [],
        }
        for number in range(count)
    ]
    logs = {"version": 1, "disable_existing_loggers": False, "handlers": {}, "root": {"level": "ERROR", "handlers": []}}
    for name, content in (("tb_gateway", main), ("modbus", {"master": {"slaves": slaves}}), ("logs", logs)):
        (config / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    return config


# ---------------------------------------------------------------- the server stub


async def _serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while True:
            kind, body = await _packet(reader)
            if kind >> 4 == _CONNECT:
                writer.write(b"\x20\x02\x00\x00")
            elif kind >> 4 == _PUBLISH and kind & 6:
                topic = int.from_bytes(body[:2], "big")
                writer.write(b"\x40\x02" + body[2 + topic : 4 + topic])
            elif kind >> 4 == _SUBSCRIBE:
                writer.write(b"\x90\x03" + body[:2] + b"\x00")
            elif kind >> 4 == _UNSUBSCRIBE:
                writer.write(b"\xb0\x02" + body[:2])
            elif kind >> 4 == _PING:
                writer.write(b"\xd0\x00")
    except (asyncio.IncompleteReadError, ConnectionError):
        writer.close()


async def _packet(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    """A packet's first byte and all that follows its length (2.2.3: seven bits a byte, the lowest first)."""
    kind, length, shift = (await reader.readexactly(1))[0], 0, 0
    while True:
        byte = (await reader.readexactly(1))[0]
        length |= (byte & 0x7F) << shift
        shift += 7
        if not byte & 0x80:
            return kind, await reader.readexactly(length)


async def _stub() -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), loop.call_soon_threadsafe(ended.set)), daemon=True).start()
    server = await asyncio.start_server(_serve, "127.0.0.1", 0)
    click.echo(server.sockets[0].getsockname()[1])
    await ended.wait()


if __name__ == "__main__":
    asyncio.run(_stub())
