"""Machines on one connection: what failed there was said to the machine that was made last, and to no other."""

from drivers.connections import Connections
from drivers.driver import Supervised, open_driver
from drivers.supervision import Supervisor


def test_each_machine_hears_what_fails_on_the_connection_that_it_shares() -> None:
    connections = Connections()
    gateway = Supervisor()
    heard: list[str] = []
    gateway.say = lambda part, error: heard.append(f"{part}: {error}")
    machines = {}
    for name, unit in (("north", 1), ("south", 2), ("west", 3)):
        settings = {"host": "127.0.0.1", "port": 1, "unit": unit}
        driver = open_driver("modbus", settings, clock=lambda: 0.0, connections=connections)
        assert isinstance(driver, Supervised)
        machines[name] = Supervisor()
        machines[name].include("device", driver.supervisor)
        gateway.include(name, machines[name])
        shared = driver.supervisor
    shared.failed("link", RuntimeError("no way"))
    assert heard == [f"{name}: device: link: no way" for name in machines]
    assert all("device: link" in machine.complaints for machine in machines.values())
    # One that is stopped lets go of it, and the others go on hearing.
    machines["south"].exclude("device")
    gateway.exclude("south")
    heard.clear()
    shared.failed("reader", RuntimeError("gone"))
    assert heard == ["north: device: reader: gone", "west: device: reader: gone"]
