"""Telling other systems what is on record: MQTT, PostgreSQL, InfluxDB, each fed from the historian; metrics, OPC UA."""

from gateway.outside.northbound.feed import SinkFeed
from gateway.outside.northbound.northbound import Northbound, check_northbound
from gateway.outside.northbound.sink import OutgoingRow, Present, Sink, SinkUnreachable
