"""The real servers, as the tests of northbound have them."""

from tests.northbound.test_mqtt import broker
from tests.northbound.test_sinks import database, influx

__all__ = ["broker", "database", "influx"]
