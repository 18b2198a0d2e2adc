"""The support bundle: what has to be in it, and that no secret of any kind is, wherever it was left."""

import asyncio
import base64
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

import pytest
from click.testing import CliRunner
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gateway.cli.keep.masking import bare_address, make_mask, mask_values, written_forms
from gateway.cli.main import main
from gateway.network.certificates import make_all
from gateway.outside.web.access import AccountRole, add_account
from gateway.plant.app import run
from gateway.plant.log import open_log
from tests.gateway.support import MAP, TEMPERATURE, Bench, PacedClock, load_config, plant_file

SMTP, TOKEN, HOOK = (
    'Geh=eim &7/"ß',
    "tok-9f8e7d6c5b4a",
    "https://hooks.example.com/services/T0AAAA/B0BBBB/xYzSecretPath42",
)
INLINE = "https://alarms.example.com/in?key=qSecretInQuery99&x=1"
PASSWORD, IN_COMMENT, IN_LOG = "correct horse battery", "oldPassw0rdInAComment", "pw-of-the-mail-server-in-a-log"
BROKER, INFLUX = "br0ker-pa55word", "influx-t0ken-abc"
NORTHBOUND = f"""\
passwords = {{ it = "{BROKER}" }}
tokens = {{ lab = "{INFLUX}" }}
"""
SECRETS = f"""\
smtp_password = {json.dumps(SMTP)}
webhooks = {{ chief = "{HOOK}" }}
tokens = {{ shift = "{TOKEN}" }}
"""
PLANT = f"""\
[historian]
path = "out/h.sqlite"
[log]
path = "out/log.jsonl"
[page]
certificates = "page"
[notify]
secrets = "notify.secrets.toml"   # was {IN_COMMENT} before
[notify.smtp]
host = "mail.example.com"
user = "gateway"
sender = "gateway@example.com"
[[notify.to]]
name = "shift"
webhook = "{INLINE}"
[[notify.to]]
name = "chief"
webhook = "secret"
[northbound]
secrets = "northbound.secrets.toml"
[[northbound.mqtt]]
name = "it"
host = "127.0.0.1"
port = 1
tls = false
user = "gateway"
[[northbound.influx]]
name = "lab"
url = "http://127.0.0.1:1"
bucket = "plant"
"""


def made(folder: Path, plant: str = PLANT) -> Path:
    """A plant with a secret of every kind."""
    make_all(folder / "tls", hosts=["127.0.0.1"])
    make_all(folder / "page", hosts=["127.0.0.1"])
    (folder / "notify.secrets.toml").write_text(SECRETS, encoding="utf-8")
    (folder / "notify.secrets.toml").chmod(0o600)
    (folder / "northbound.secrets.toml").write_text(NORTHBOUND, encoding="utf-8")
    (folder / "northbound.secrets.toml").chmod(0o600)
    device = folder / "device.toml"
    own = f'driver = "modbus"\ntransport = "tls"\ncertificates = "{folder}/tls"\n'
    device.write_text(MAP.read_text().replace('driver = "modbus"\n', own) + f"# {IN_COMMENT}\n")
    path = plant_file(folder, plant, device=device)
    (folder / "out").mkdir()
    add_account(folder / "out/users.json", "rossi", AccountRole.OPERATOR, PASSWORD)
    (folder / "out/audit.key").write_bytes((folder / "tls/ca.key").read_bytes())
    with open_log(folder / "out/log.jsonl") as log:
        account = json.loads((folder / "out/users.json").read_text())["accounts"]["rossi"]["password"]
        log.error("mail was refused", reason=f"535 login of gateway with {SMTP} failed", smtp_password=IN_LOG)
        log.error(
            "web hook was refused", reason=f"{HOOK}: 403; {INLINE}: 404", headers={"Authorization": f"Bearer {TOKEN}"}
        )
        log.error("odd", reason=f"password={IN_LOG} Basic {base64.b64encode(SMTP.encode()).decode()} {account}")
        log.error(
            "odd", reason=f"https://u:{quote(SMTP, safe='')}@h/p?token={quote(TOKEN)} xYzSecretPath42", account=account
        )
        log.error("a system cannot be told", reason=f"{BROKER} is refused; 401 for {INFLUX}")
        log.error("key", reason=(folder / "page/server.key").read_text(), other=(folder / "out/audit.key").read_text())
    return path


def planted(folder: Path) -> dict[str, str]:
    """All that must not be found, by what it is."""
    keys = [*folder.glob("tls/*.key"), *folder.glob("page/*.key"), folder / "out/audit.key"]
    lines = {
        f"{key}:{n}": line for key in keys for n, line in enumerate(key.read_text().splitlines()) if "-----" not in line
    }
    account = json.loads((folder / "out/users.json").read_text())["accounts"]["rossi"]["password"]
    salt, digest = account.split("$")[-2:]
    words = {
        "smtp": SMTP,
        "token": TOKEN,
        "hook": "xYzSecretPath42",
        "broker": BROKER,
        "influx": INFLUX,
        "hook part": "T0AAAA/B0BBBB",
        "query": "qSecretInQuery99",
    }
    words |= {"comment": IN_COMMENT, "log": IN_LOG, "salt": salt, "digest": digest, "password": PASSWORD}
    words |= {
        "quoted": quote(SMTP, safe=""),
        "base64": base64.b64encode(SMTP.encode()).decode(),
        "json": json.dumps(SMTP)[1:-1],
    }
    return words | lines


def bundle_of(path: Path) -> tuple[Mapping[str, str], str]:
    file = path.parent / "support.zip"
    done = CliRunner().invoke(main, ["keep", "support", str(file), "--config", str(path)])
    assert done.exit_code == 0, done.output
    assert file.stat().st_mode & 0o77 == 0
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}, done.output


async def test_of_a_gateway_that_runs_all_is_there_and_no_secret(tmp_path: Path) -> None:
    path = made(tmp_path)
    config = load_config(path)
    bench = Bench(config, PacedClock())
    work = asyncio.create_task(run(config, clock=bench.clock, stop=bench.stop, driver=bench))
    async with asyncio.timeout(120.0):
        while bench.reads < 20:
            await asyncio.sleep(0.01)
        members, _ = await asyncio.to_thread(bundle_of, path)
    bench.stop.set()
    await work
    for kind, secret in planted(tmp_path).items():
        for name, text in members.items():
            assert secret not in text, f"{kind} in {name}"
    status = json.loads(members["status.json"])["decanter"]
    assert status["status"]["values"][TEMPERATURE]["value"] == 25.0 and "findings" in status
    assert json.loads(members["records.json"])["historian"]["layout"] >= 3
    assert json.loads(members["box.json"])["disk"]["free"] > 0
    assert json.loads(members["versions.json"])["program"]
    assert json.loads(members["configuration/history.json"])[0]["note"] == "start"
    assert "mail was refused" in members["log.jsonl"] and "hooks.example.com" in members["log.jsonl"]
    assert 'host = "mail.example.com"' in members["configuration/plant.toml"]
    assert "https://alarms.example.com/(masked)" in members["configuration/plant.toml"]
    assert "holding:" in members["configuration/1-device.toml"]


def test_without_a_gateway_and_records_it_says_what_is_not_to_be_had(tmp_path: Path) -> None:
    members, _ = bundle_of(made(tmp_path))
    assert "no gateway answers" in members["status.json"] and "there is no historian" in members["records.json"]
    assert "there is no historian" in members["alarms.json"]


@pytest.mark.parametrize("broken", ['limit = "high"\n', "[device\n"])
def test_of_a_plant_file_that_cannot_be_used_there_is_the_reason(broken: str, tmp_path: Path) -> None:
    path = made(tmp_path)
    path.write_text(f'smtp_password = "{IN_LOG}"\n{broken}', encoding="utf-8")
    members, _ = bundle_of(path)
    assert members["problem.txt"] and not any(IN_LOG in text for text in members.values())


def test_a_bundle_that_is_there_is_not_replaced(tmp_path: Path) -> None:
    path = plant_file(tmp_path)
    (tmp_path / "support.zip").touch()
    done = CliRunner().invoke(main, ["keep", "support", str(tmp_path / "support.zip"), "--config", str(path)])
    assert done.exit_code == 2 and "is there already" in done.output


_AROUND = st.text(alphabet=" ,.\n0123456789")


@settings(max_examples=40, deadline=None)
@given(st.text(st.characters(exclude_characters=" ,.\n0123456789()", codec="utf-8"), min_size=4), _AROUND, _AROUND)
def test_a_known_value_is_never_left(secret: str, before: str, after: str) -> None:
    assume("masked".find(secret) < 0)
    left = make_mask([secret])(f"{before}{secret}{after} {json.dumps({'x': secret})} {quote(secret, safe='')}")
    assert not any(form in left for form in written_forms(secret))


@pytest.mark.parametrize(
    "text",
    [
        "password=hunter22", 'password: "hunter22 and more"', '"smtp_password": "hunter22"', "--password hunter22",
        "Authorization: Bearer hunter22", "api-key='hunter22'", "ftp://me:hunter22@host/", "https://host/hunter22",
        "https://host:8080?sig=hunter22", '{\\"token\\": \\"hunter22\\"}', "$argon2id$v=19$m=1,t=1,p=1$c2FsdA$hunter22",
        "-----BEGIN EC PRIVATE KEY-----\nhunter22\n-----END EC PRIVATE KEY-----",
        "-----BEGIN PRIVATE KEY-----\nhunter22",
        "Cookie: session=hunter22",
    ],
)  # fmt: skip
def test_what_looks_like_a_secret_is_masked_by_its_shape(text: str) -> None:
    assert "hunter22" not in make_mask(())(text), make_mask(())(text)


def test_what_is_no_secret_stays() -> None:
    text = "127.0.0.1:502 does not connect; see http://127.0.0.1:8080 and TCuscinettiRiduttore = 61.5"
    assert make_mask(())(text) == text
    assert bare_address("https://host.example:8443") == "https://host.example:8443"
    plain = {"limit": 80.0, "tokens": {"a": "x1"}, "tags": ["a"], "secrets": "notify.secrets.toml", "n": None}
    assert mask_values(plain, make_mask(())) == plain | {"tokens": {"a": "(masked)"}}
