"""A byte of a key's algorithm made it one that OpenSSL knows and our library does not, whose error nobody expected."""

import base64
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization

from gateway.network import certificates
from gateway.network.certificates import (
    OPC_UA_CERTIFICATE,
    OPC_UA_KEY,
    OPC_UA_TRUSTED,
    application_problem,
    make_application,
    trusted_certificates,
)
from gateway.store.signing import SigningKeyError, load_key, load_or_make_key, load_public_key, public_path
from tests.rig.memory import folder_in_memory

HEADER = range(28, 56)
"""Characters of the PEM that say which key it is: the same in each key."""


def test_a_key_of_another_algorithm_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with folder_in_memory(tmp_path) as folder:
        key, trial = folder / "audit.key", folder / "trial"
        load_or_make_key(key)
        for path, load in ((key, load_key), (public_path(key), load_public_key)):
            data = path.read_bytes()
            trial.write_bytes(data)
            trial.chmod(0o600)
            refused = 0
            for place in HEADER:
                for value in b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/=\n\0\xff":
                    trial.write_bytes(data[:place] + bytes([value]) + data[place + 1 :])
                    try:
                        load(trial)
                    except SigningKeyError as error:
                        refused += 1
                        assert "\n" not in str(error)
            assert refused > len(HEADER) * 30


@pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning")
def test_an_application_of_damaged_files_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with folder_in_memory(tmp_path) as folder:
        make_application(folder, hosts=["localhost"])
        assert application_problem(folder) is None
        key = serialization.load_pem_private_key((folder / OPC_UA_KEY).read_bytes(), None)
        # What takes long is not what is damaged here.
        monkeypatch.setattr(certificates.serialization, "load_pem_private_key", lambda *_: key)
        path, found = folder / OPC_UA_CERTIFICATE, set[bool]()
        whole = x509.load_pem_x509_certificate(path.read_bytes()).public_bytes(serialization.Encoding.DER)
        for place, byte in enumerate(whole):
            damaged = whole[:place] + bytes([byte ^ 1 << place % 8]) + whole[place + 1 :]
            text = base64.encodebytes(damaged).decode()
            path.write_text(f"-----BEGIN CERTIFICATE-----\n{text}-----END CERTIFICATE-----\n", encoding="ascii")
            problem = application_problem(folder)
            assert problem is None or "\n" not in problem
            found.add(problem is None)
            (folder / OPC_UA_TRUSTED / "peer.der").write_bytes(damaged)
            list(trusted_certificates(folder))
        assert found == {True, False}
