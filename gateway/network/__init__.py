"""What stands between a process and the network: listeners with shares, waits that end, certificates and keys."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from gateway.network.certificates import (
        OPC_UA_CERTIFICATE,
        OPC_UA_KEY,
        application_problem,
        days_left,
        make_all,
        make_application,
        trusted_certificates,
    )
    from gateway.network.key_pair import NOT_A_KEY, load_pair
    from gateway.network.listener import SharingListener
    from gateway.network.shares import SharedPlaces, origin_of
    from gateway.network.timed_socket import TimedSocket, addresses_of, answer_by, connect, seconds_left
    from gateway.network.timed_tls import TimedHttp, TimedTls, make_tls, reason_of
else:
    __getattr__ = opened_at_use(__name__)
