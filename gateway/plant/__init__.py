"""The gateway as a process: started, supervised, asked, logged, stopped."""

from gateway.plant.app import serve
from gateway.plant.device import link_driver, make_driver
from gateway.plant.log import open_log

__all__ = ["link_driver", "make_driver", "open_log", "serve"]
