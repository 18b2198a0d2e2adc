"""The gateway as a process: started, supervised, asked, logged, stopped."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from gateway.plant.allocator import keep_freed_memory
    from gateway.plant.app import serve
    from gateway.plant.device import link_driver, make_driver
    from gateway.plant.log import open_log
else:
    __getattr__ = opened_at_use(__name__)

__all__ = ["keep_freed_memory", "link_driver", "make_driver", "open_log", "serve"]
