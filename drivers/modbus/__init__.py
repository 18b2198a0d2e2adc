"""Modbus over TCP, TLS and serial lines; opened by its name in `drivers.driver.DRIVERS`."""
