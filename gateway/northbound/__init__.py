"""Telling other systems what is on record: MQTT, PostgreSQL, InfluxDB, each fed from the historian; metrics, OPC UA."""

from gateway.northbound.feed import SinkFeed
from gateway.northbound.northbound import Northbound, check_northbound
from gateway.northbound.sink import OutgoingRow, Present, RowsRefused, Sink, SinkUnreachable

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
