"""What a gateway goes without where a file of its own cannot be used: models, page, messages, what is told elsewhere.

Only the plant file and the device files keep a gateway from starting: the threshold alarm stands whatever else is
broken. What is missing then is an alarm, and said in the status and the log; `reload` says of a running gateway what
its next start would go without.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from drivers.settings import ConfigError
from gateway.settings import Config, NorthboundSecrets, load_secrets

if TYPE_CHECKING:
    from gateway.outside.notify import Notifier


PAGE, MESSAGES, NORTHBOUND = "page", "messages", "northbound"
"""What the parts of a plant are called that may be missing; that of a machine is `gateway.machine.MODEL_PART`."""


def check_page(config: Config) -> None:
    """Nothing where there is no page. Raises ConfigError where it cannot be served as it is configured."""
    if config.page.enabled:
        # Here and below: a gateway that does not serve the page, or tells nobody, loads nothing of it.
        from gateway.outside.web import check_page

        check_page(config)


def load_sink_secrets(config: Config) -> NorthboundSecrets | None:
    """The secrets for those who are told what is on record; None where nobody is. Raises ConfigError."""
    if not config.northbound.enabled:
        return None
    from gateway.outside.northbound import check_northbound

    return check_northbound(config)


def prepare_notifier(config: Config) -> Callable[..., Notifier] | None:
    """What makes the notifier, with all that can be refused read; None where nobody is told. Raises ConfigError."""
    secrets = load_secrets(config.notify)
    if not config.notify.to:
        return None
    from functools import partial

    from gateway.outside.notify import Notifier, make_senders

    try:
        return partial(Notifier, config.notify.to, make_senders(config.notify, secrets))
    except OSError as error:
        raise ConfigError([f"{config.path}: notify.smtp.ca: cannot be used ({error.strerror})"]) from None


def of_plant(config: Config) -> dict[str, str]:
    """What the whole gateway would go without if it started now, and why, by the parts' names."""
    checks: dict[str, Callable[[Config], Any]] = {
        PAGE: check_page,
        MESSAGES: prepare_notifier,
        NORTHBOUND: load_sink_secrets,
    }
    found = {}
    for part, check in checks.items():
        try:
            check(config)
        except ConfigError as error:
            found[part] = error.in_one_line
    return found
