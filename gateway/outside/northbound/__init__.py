"""Telling other systems what is on record: MQTT, PostgreSQL, InfluxDB, each fed from the historian; metrics, OPC UA."""

from gateway.outside.northbound.feed import SinkFeed
from gateway.outside.northbound.northbound import Northbound, check_northbound
from gateway.outside.northbound.sink import OutgoingRow, Present, RowsRefused, Sink, SinkUnreachable

__all__ = [
    "Northbound",
    "OutgoingRow",
    "Present",
    "RowsRefused",
    "Sink",
    "SinkFeed",
    "SinkUnreachable",
    "check_northbound",
]
