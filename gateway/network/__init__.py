"""What stands between a process and the network: listeners with shares, waits that end, certificates and keys."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.network.certificates import (
        OPC_UA_CERTIFICATE,
        OPC_UA_KEY,
        application_problem,
        make_all,
        make_application,
        remaining_days,
        trusted_certificates,
    )
    from gateway.network.key_pair import NOT_A_KEY, load_pair
    from gateway.network.listener import SharingListener
    from gateway.network.shares import SharedPlaces, address_origin
    from gateway.network.timed_socket import TimedSocket, call_with_deadline, connect, remaining_seconds, resolve_host
    from gateway.network.timed_tls import TimedHttp, TimedTls, failure_reason, make_tls
else:
    __getattr__ = lazy_getattr(__name__)
