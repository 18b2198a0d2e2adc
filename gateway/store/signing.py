"""The key by which a gateway signs the heads of its audit log: Ed25519, made once, for its owner's eyes only.

Beside NAME.key lies NAME.pub, the public key: with that alone everything can be checked. Keep a copy of it elsewhere.
"""

import os
import stat
from contextlib import suppress
from pathlib import Path

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from drivers.errors import OneLineError
from gateway.network import NOT_A_KEY
from gateway.store.durable import write_durably

KEY_MODE, PUBLIC_MODE = 0o600, 0o644


class SigningKeyError(OneLineError, OSError):
    """A key file cannot be used; the message is one sentence that says why and what would be right."""


def public_path(key: Path) -> Path:
    """Where the public half of a key file lies."""
    return key.with_suffix(".pub")


def key_path(audit: Path) -> Path:
    """Where the key of an audit log lies where nothing else is said."""
    return audit.with_suffix(".key")


def load_or_make_key(path: Path) -> Ed25519PrivateKey:
    """The key at `path`, made with its public half if there is none. Raises SigningKeyError."""
    if not path.exists():
        key = Ed25519PrivateKey.generate()
        secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Of two processes that begin together one key stands: the other's attempt to put its own there fails.
            with suppress(FileExistsError):
                write_durably(path, secret, mode=KEY_MODE, replace=False)
        except OSError as error:
            raise SigningKeyError(
                f"{path}: no key can be made there ({error.strerror}); give a folder that this user may write"
            ) from None
    key = load_key(path)
    if not public_path(path).exists():
        public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
        # Whoever may not write it may still sign: the key can be taken from any signed head.
        with suppress(OSError):
            write_durably(public_path(path), public, mode=PUBLIC_MODE)
    return key


def load_key(path: Path) -> Ed25519PrivateKey:
    """The key at `path`. Raises SigningKeyError, also for one that others than this user could have used."""
    try:
        # Not blocking and not through a link: what is looked at is what is read.
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW)
        try:
            status = os.fstat(file)
            mode = stat.S_IMODE(status.st_mode)
            if not stat.S_ISREG(status.st_mode):
                raise SigningKeyError(f"{path}: is no regular file; give the key file that the gateway made")
            if mode & 0o077:
                raise SigningKeyError(
                    f"{path}: has mode {mode:04o}, so that others than its owner could have signed with it; make a new "
                    f"key, or if nobody else uses this machine: chmod 0600. To check with the public key alone give "
                    f"--public-key {public_path(path)}"
                )
            if status.st_uid != os.geteuid():
                raise SigningKeyError(
                    f"{path}: belongs to user {status.st_uid} and not to this one ({os.geteuid()}); run this as its "
                    f"owner, or check with the public key alone: --public-key {public_path(path)}"
                )
            data = os.read(file, 1 << 16)
        finally:
            os.close(file)
        key = load_pem_private_key(data, None)
    except SigningKeyError:
        raise
    except OSError as error:
        raise SigningKeyError(f"{path}: cannot be read ({error.strerror}); give a key file of this user") from None
    except NOT_A_KEY:
        raise SigningKeyError(f"{path}: holds no private key; restore it from a backup, or move it away") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise SigningKeyError(f"{path}: is no Ed25519 key; restore it from a backup, or move it away")
    return key


def load_public_key(path: Path) -> str:
    """The public key at `path` in 64 hexadecimal digits. Raises SigningKeyError."""
    try:
        key = load_pem_public_key(path.read_bytes()[: 1 << 16])
    except OSError as error:
        raise SigningKeyError(f"{path}: cannot be read ({error.strerror}); give the gateway's public key") from None
    except NOT_A_KEY:
        raise SigningKeyError(f"{path}: holds no public key; give the file NAME.pub beside the gateway's key") from None
    if not isinstance(key, Ed25519PublicKey):
        raise SigningKeyError(f"{path}: is no Ed25519 key; give the file NAME.pub beside the gateway's key")
    return public_digits(key)


def public_digits(key: Ed25519PublicKey) -> str:
    """A public key in 64 hexadecimal digits."""
    return key.public_bytes(Encoding.Raw, PublicFormat.Raw).hex()


def verify_signature(public: str, signature: str, data: bytes) -> bool:
    """True if the key of these hexadecimal digits has signed the data."""
    try:
        Ed25519PublicKey.from_public_bytes(bytes.fromhex(public)).verify(bytes.fromhex(signature), data)
    except (ValueError, InvalidSignature):
        return False
    return True
