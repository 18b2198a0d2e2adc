"""`max_registers = 16` with a longer block: nothing said so, and every block failed at run time."""

from pathlib import Path

import pytest

from drivers.driver import open_driver
from drivers.errors import DriverError
from drivers.settings import ConfigError
from gateway.plant.device import make_driver
from gateway.settings.config import load_config
from gateway.settings.devices import load_device
from tests.gateway.support import MAP, JumpClock, plant_file


@pytest.mark.parametrize("mode", ["shadow", "armed"])
@pytest.mark.parametrize("limit", ["max_registers = 16", "max_registers = 125\nmax_write_registers = 16"])
def test_a_gateway_that_could_never_write_does_not_start_and_says_the_remedy(
    tmp_path: Path, limit: str, mode: str
) -> None:
    device = tmp_path / "small.toml"
    device.write_text(MAP.read_text().replace("max_registers = 125     # a request's limit", limit))
    signed = {"writeback.armed_by": "Ada", "writeback.reason": "test", "writeback.minutes": 5.0}
    overrides = {"writeback.mode": mode, **(signed if mode == "armed" else {})}
    config = load_config(plant_file(tmp_path, device=device), overrides)
    with pytest.raises(ConfigError, match=r"26 words and the device takes 16 in one write.*bind --block"):
        make_driver(config, JumpClock())


def test_a_limit_of_its_own_for_writes_may_be_larger(tmp_path: Path) -> None:
    layout = load_device(MAP).writeback
    assert layout is not None
    larger = {"host": "127.0.0.1", "max_registers": 16, "max_write_registers": 100}
    open_driver("modbus", larger, clock=lambda: 0.0, write_map=layout.words)
    with pytest.raises(DriverError, match="in one write"):
        open_driver("modbus", {"host": "127.0.0.1", "max_registers": 16}, clock=lambda: 0.0, write_map=layout.words)
