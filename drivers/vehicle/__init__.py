"""Vehicles: OBD-II, J1939, and recorded CAN logs of them."""
