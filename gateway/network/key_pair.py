"""A certificate and its key, as files that whoever has them in hand is given or refused for one true reason."""

import ssl
from pathlib import Path
from stat import S_IMODE

from cryptography.exceptions import InternalError, UnsupportedAlgorithm

from drivers.errors import OneLineError

NOT_A_KEY = (ValueError, TypeError, UnsupportedAlgorithm, InternalError)
"""What `cryptography` raises for bytes that hold no key that it knows; InternalError where OpenSSL alone knows it."""


def key_problem(key: Path) -> str | None:
    """That others may read a key, in a sentence; None if they may not. Raises OSError.

    As PostgreSQL's: a key of root's may be read by the group that it is for (0640).
    """
    status = key.stat()
    mode = S_IMODE(status.st_mode)
    if mode & (0o037 if status.st_uid == 0 else 0o077):
        return f"{key}: others may read the key (mode {mode:o}); chmod 600 {key}"
    return None


def load_pair(context: ssl.SSLContext, certificate: Path, key: Path) -> None:
    """Have a context show a certificate. Raises OSError, in one sentence, where the two files are not what they should.

    A context that has another pair may have lost it then.
    """
    for path in (certificate, key):
        try:
            path.open("rb").close()
        except OSError as error:
            raise OSError(f"{path}: cannot be read ({(error.strerror or str(error)).lower()})") from None
    if (problem := key_problem(key)) is not None:
        raise OSError(problem)
    try:
        context.load_cert_chain(certificate, key, _refuse_password)
    except ssl.SSLError as error:
        if error.reason == "KEY_VALUES_MISMATCH":
            raise OSError(f"{key}: is not the key of {certificate}; give the one that belongs to it") from None
        said = f" ({error.reason.replace('_', ' ').lower()})" if error.reason else ""
        raise OSError(f"{certificate} and {key} are no certificate and its key in PEM{said}") from None
    except _EncryptedError:
        raise OSError(f"{key}: asks for a password, and nobody is there to give it; give a key without") from None


class _EncryptedError(OneLineError):
    pass


def _refuse_password() -> str:
    # OpenSSL would ask at the terminal, and the gateway's start would wait for it.
    raise _EncryptedError
