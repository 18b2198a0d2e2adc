"""The page: what a browser shows of the gateway, served by the gateway itself in a thread and a loop of its own.

It is one more reader of the status and one more caller of what the control socket is asked; it owns nothing else.
Nothing here is imported unless the page is enabled.
"""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.outside.web.access import accounts_problem
    from gateway.outside.web.box import box_facts
    from gateway.outside.web.server import PageServer, check_page
    from gateway.outside.web.views import machine_view
else:
    __getattr__ = lazy_getattr(__name__)
