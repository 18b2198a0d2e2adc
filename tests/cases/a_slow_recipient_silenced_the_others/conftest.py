"""A plant's historian that fills, as the tests of northbound have it."""

from tests.northbound.conftest import plant

__all__ = ["plant"]
