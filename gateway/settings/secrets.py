"""Files of secrets: TOML beside the plant file, readable by their owner alone, since plant files are mailed around."""

import stat
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from drivers.settings import ConfigError, Section, read_toml, validate_section

Secrets = TypeVar("Secrets", bound=Section)


def read_secrets(model: type[Secrets], path: Path, *, page: str) -> Secrets:
    """The checked content of a file of secrets; `page` of the documentation says what it may hold.

    Raises ConfigError for one that others may read, or that cannot be read. What it holds is in no sentence.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise ConfigError(
            [f"{path}: cannot be read ({error.strerror}); make the file of secrets, with mode 600"]
        ) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise ConfigError([f"{path}: others may read the secrets (mode {mode & 0o777:o}); chmod 600 {path}"])
    try:
        return validate_section(model, read_toml(path), path)
    except ConfigError as error:
        # A sentence quotes the value that is wrong: of a secret only the place is said.
        places = [problem.partition(", got ")[0].partition(" (at line")[0] for problem in error.problems]
        raise ConfigError([f"{place}; see {page} for what it may hold" for place in places]) from None


def token_problems(path: Path, tokens: Mapping[str, str]) -> list[str]:
    """A sentence for each token that no header of HTTP holds: what refuses it later would quote it."""
    # A line end at its end is soon made in TOML.
    return [
        f"{path}: tokens: that of {name!r} has a line end, a space at an end or what is no ASCII; take it away"
        for name, token in tokens.items()
        if not (token.isascii() and token.isprintable()) or token != token.strip()
    ]
