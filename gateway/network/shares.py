"""Places for clients of the gateway's servers, of which no address takes those that another wants.

While there is room anybody may have any of them. Who comes when there is none gets one from the address that has most,
unless that would have no more than he himself: so one address cannot keep others out, and several share alike.
"""

from collections import Counter
from collections.abc import Callable
from ipaddress import IPv4Address, IPv6Address, ip_address, ip_network
from typing import Generic, TypeVar

PREFIX_OF_ONE = 64
"""Bits of an IPv6 address that one client does not choose: it has all addresses of its network (RFC 4291)."""

P = TypeVar("P")


def address_origin(address: str) -> str:
    """Whom an address belongs to, as far as it can be told: an IPv4 address, an IPv6 network, other text as it is."""
    try:
        parsed: IPv4Address | IPv6Address = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(parsed, IPv4Address) or parsed.is_loopback:
        return str(parsed)
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return str(ip_network((parsed, PREFIX_OF_ONE), strict=False))


class SharedPlaces(Generic[P]):
    """At most `most` holders at a time. `end` is told the holder that has to go for another one."""

    def __init__(self, most: int, end: Callable[[P], None]) -> None:
        self._most, self._end = most, end
        self._origins: dict[P, str] = {}

    def __len__(self) -> int:
        return len(self._origins)

    @property
    def holders(self) -> tuple[P, ...]:
        """Those who have a place, in the order in which they came."""
        return tuple(self._origins)

    def take(self, holder: P, address: str) -> bool:
        """Give a place to a holder that comes from an address; False where there is none for it."""
        origin = address_origin(address)
        if len(self._origins) >= self._most:
            counts = Counter(self._origins.values())
            greediest, count = counts.most_common(1)[0]
            if count <= counts[origin] + 1:
                return False
            last = next(one for one in reversed(self._origins) if self._origins[one] == greediest)
            del self._origins[last]
            self._end(last)
        self._origins[holder] = origin
        return True

    def release(self, holder: P) -> None:
        """A holder has gone, or has none."""
        self._origins.pop(holder, None)
