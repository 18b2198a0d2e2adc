"""Where a gateway runs for the same plant file: asking it instead of the device, which may serve one client only."""

from collections.abc import Sequence
from contextlib import closing
from typing import Any

from drivers.tag import Quality, Sample, Tag
from gateway.commission.session.site import Site
from gateway.commission.session.target import Target
from gateway.outside.status import ControlError, GatewayLine, connect


def running_gateway(target: Target) -> GatewayLine | None:
    """The gateway that runs with the target's plant file; None without a plant file, and where none runs."""
    if target.config is None:
        return None if target.places is None else connect(target.places.socket, machine=target.machine or None)
    return connect(target.config.control_socket, machine=target.config.machine)


def mention_gateway(site: Site) -> None:
    """Note a gateway that runs with the same plant file, for a command that speaks to the device beside it."""
    line = running_gateway(site.target)
    if line is None:
        return
    with closing(line):
        try:
            about = f"(pid {line.ask('status')['pid']}): the device has two clients meanwhile"
        except (OSError, ControlError):
            about = "and does not answer: the device may have two clients"
    site.notes.append(f"a gateway runs with this plant file {about}")


def read_samples(line: GatewayLine, tags: Sequence[Tag], known: Sequence[Tag]) -> tuple[dict[str, Any], list[Sample]]:
    """The samples of the gateway's last scan, or, where not all tags are its own, asked of the device by it.

    Gives the reply without its samples too. Raises ControlError or OSError.
    """
    names = [tag.name for tag in tags]
    if set(names) <= {tag.name for tag in known}:
        reply = line.ask("read", tags=names)
    else:
        reply = line.ask("read", addresses=[as_request(tag) for tag in tags])
    samples = {row["tag"]: parse_sample(row) for row in reply.pop("samples")}
    return reply, [samples[name] for name in names if name in samples]


def as_request(tag: Tag) -> dict[str, Any]:
    """A tag as the control socket takes bare addresses."""
    request: dict[str, Any] = {"address": tag.address, "dtype": tag.dtype.value, "order": tag.order.value}
    request |= {"scale": tag.scale, "offset": tag.offset, "length": tag.length}
    return request | ({"bit": tag.bit} if tag.bit is not None else {})


def parse_sample(plain: dict[str, Any]) -> Sample:
    """A sample from its JSON."""
    quality = Quality[plain["quality"]]
    return Sample(
        tag=plain["tag"],
        value=plain["value"],
        quality=quality,
        time=plain["time"],
        sent=plain["sent"],
        reason=plain["reason"],
    )
