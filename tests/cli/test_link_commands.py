"""The commands around links: certificates for commissioning, a check that reads every link, demos over each of them."""

import stat
import subprocess
from collections import Counter
from pathlib import Path

from drivers.modbus.tls import load_identity
from gateway.demo.links import LINKS
from gateway.entry.exits import Exit
from tests.cli.support import decanter, only_object, refused
from tests.gateway.support import MAP
from tests.plc.bench import running

TRIES = 10


def test_certificates_are_made_for_both_sides_and_keys_are_private(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    done = decanter("certificates", folder, "--host", "plc.example", "--host", "10.0.0.5", "--role", "Viewer")
    assert done.exit_code == 0 and "role Viewer, 825 days" in done.stdout
    assert load_identity(folder).role == "Viewer"
    for name in ("ca", "server", "client"):
        assert stat.S_IMODE((folder / f"{name}.key").stat().st_mode) == 0o600
    text = subprocess.run(
        ["openssl", "x509", "-in", folder / "server.pem", "-noout", "-ext", "subjectAltName,extendedKeyUsage"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert "DNS:plc.example" in text and "IP Address:10.0.0.5" in text and "Server Authentication" in text
    chain = ["openssl", "verify", "-CAfile", folder / "ca.pem", "-purpose", "sslclient", folder / "client.pem"]
    assert subprocess.run(chain, capture_output=True, check=False).returncode == 0


def test_an_authority_that_is_there_is_never_replaced(tmp_path: Path) -> None:
    decanter("certificates", tmp_path, "--host", "plc")
    before = (tmp_path / "ca.key").read_bytes()
    refused(decanter("certificates", tmp_path, "--host", "plc"), 2, "there is an authority already")
    assert (tmp_path / "ca.key").read_bytes() == before


def test_a_role_or_host_that_cannot_be_is_one_sentence(tmp_path: Path) -> None:
    refused(decanter("certificates", tmp_path / "a", "--host", "plc", "--role", "x" * 65), 2, "longer than 64 bytes")
    refused(decanter("certificates", tmp_path / "b", "--host", "two words"), 2, "neither a name nor an address")


def test_check_reads_every_link_and_names_the_one_that_fails(tmp_path: Path) -> None:
    with running("--rtu-tcp", "0") as plc:
        ports = (plc.port, plc.ready["faces"]["rtu-tcp"]["port"], 1)
        kinds = ("tcp", "rtu-tcp", "tcp")
        links = "".join(
            f'[[device.links]]\nname = "way {number}"\nfile = "{MAP}"\ntransport = "{kind}"\nhost = "127.0.0.1"\n'
            f"port = {port}\n"
            for number, (kind, port) in enumerate(zip(kinds, ports, strict=True))
        )
        path = tmp_path / "plant.toml"
        path.write_text(f"[device]\n{links}", encoding="utf-8")
        for _ in range(TRIES):
            done = decanter("plc", "check", "--config", path, "--json")
            data = only_object(done.stdout)
            if done.exit_code != Exit.TIMEOUT:  # a reply may come too late on a busy machine
                break
    assert done.exit_code == 1
    assert data["links"]["way 0"].startswith("modbus, host 127.0.0.1 port ") and not data["ok"]
    good = Counter(row["link"] for row in data["readings"] if row["quality"] == "GOOD")
    assert good["way 0"] > 10 and good["way 1"] == good["way 0"] and good["way 2"] == 0
    assert {row["quality"] for row in data["readings"] if row["link"] == "way 2"} == {"NOT_CONNECTED"}


def test_a_link_of_the_decanters_own_addresses_refuses_a_foreign_trace() -> None:
    own = [name for name, link in LINKS.items() if link.device]
    assert set(LINKS) - set(own) == {"modbus", "modbus-tls", "modbus-rtu", "modbus-rtu-tcp"}


def test_an_unknown_link_is_answered_by_the_known_ones() -> None:
    done = decanter("demo", "--link", "ethercat")
    assert done.exit_code == 2 and all(name in done.stderr for name in LINKS)
