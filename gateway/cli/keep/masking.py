"""Taking secrets out of what leaves the gateway: by their values where these are known, and by what they look like.

Either alone would miss some: a password in a log line looks like a word, and a token that somebody put into an
address is in no file of secrets.
"""

import base64
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any
from urllib.parse import quote, quote_plus, urlsplit

MASKED = "(masked)"
LEAST_LENGTH = 4
"""Characters of a value that is looked for everywhere; a shorter one is part of many words."""
_NAMES = r"passw(?:or)?d|passphrase|passwort|secret|token|credential|api[_-]?key|private[_-]?key|authorization|cookie"
_SECRET_KEY = re.compile(_NAMES, re.IGNORECASE)
_SHAPES: Sequence[tuple[re.Pattern[str], str]] = (
    (re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*PRIVATE KEY-----|\Z)", re.DOTALL), MASKED),
    (re.compile(r"\$argon2\w+\$[^\s\"']+"), MASKED),
    (re.compile(r"\b(bearer|basic|digest)\s+[A-Za-z0-9._~+/=-]{6,}", re.IGNORECASE), rf"\1 {MASKED}"),
    # name = value, name: "value", "name": "value", --name value; also as it stands escaped within JSON.
    (
        re.compile(
            rf"([\w.-]*(?:{_NAMES})[\w.-]*\\?[\"']?(?:\s*[:=]\s*|\s+))"
            r"(?!\(masked\))(\\?\"(?:[^\"\\]|\\(?!\").)*\\?\"|'[^']*'|[^\s,;&}\]\"']+)",
            re.IGNORECASE,
        ),
        rf"\1{MASKED}",
    ),
)
_ADDRESS = re.compile(r"\b[a-z][a-z0-9+.-]*://[^\s\"'<>\\]+", re.IGNORECASE)


def make_mask(known: Iterable[str]) -> Callable[[str], str]:
    """A function that takes these values, in any form in which they are usually written, and what looks like a secret
    out of a text."""
    forms = sorted({form for value in known for form in written_forms(value)}, key=len, reverse=True)
    values = re.compile("|".join(map(re.escape, forms))) if forms else None

    def mask(text: str) -> str:
        text = values.sub(MASKED, text) if values is not None else text
        text = _ADDRESS.sub(lambda found: bare_address(found[0]), text)
        for shape, instead in _SHAPES:
            text = shape.sub(instead, text)
        return text

    return mask


def written_forms(value: str) -> set[str]:
    """A secret as it may stand in a text: plain, in an address, in JSON, in Base64; none for one that is too short."""
    if len(value) < LEAST_LENGTH:
        return set()
    encoded = base64.b64encode(value.encode()).decode()
    return {value, quote(value, safe=""), quote_plus(value), json.dumps(value)[1:-1], encoded, encoded.rstrip("=")}


def bare_address(address: str) -> str:
    """An address without what may be a secret in it: who logs in, path, query."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or "", parts.port
    except ValueError:
        return MASKED
    rest = f"/{MASKED}" if parts.path.strip("/") or parts.query or parts.fragment else ""
    login = f"{MASKED}@" if parts.username is not None or parts.password is not None else ""
    return f"{parts.scheme}://{login}{host}{'' if port is None else f':{port}'}{rest}"


def mask_values(value: Any, mask: Callable[[str], str], key: str = "") -> Any:
    """Plain values, as of TOML or JSON, with `mask` applied to every text and what is a secret by its key masked."""
    # `secrets` is the path of their file.
    secret = _SECRET_KEY.search(key) is not None and key != "secrets"
    if isinstance(value, Mapping):
        return {name: mask_values(inner, mask, key if secret else str(name)) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [mask_values(inner, mask, key) for inner in value]
    if secret and value not in (None, "", True, False):
        return MASKED
    return mask(value) if isinstance(value, str) else value
