"""`plc import --config` asked which device was meant, though the plant file named it and only its file was to come."""

import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main

LIST = "Nome tag;Indirizzo;Tipo dato\nMarcia;40101.0;BOOL\nCorrente;40102;WORD\n"
PLANT = (
    '[device]\n{device}\n[model]\ntemperature = "Corrente"\n[alarms]\nlimit = 80.0\n[historian]\npath = "h.sqlite"\n'
)
DEVICES = {
    "a host": ('file = "devices/new.toml"\nhost = "127.0.0.1"', ()),
    "nothing but the file": ('file = "devices/new.toml"', ()),
    "a link by its name": ('[[device.links]]\nname = "a"\nfile = "devices/new.toml"\nhost = "h"', ("--link", "a")),
    "a serial line": ('[[device.links]]\nname = "s"\nfile = "devices/new.toml"\nserial = "/dev/ttyS9"', ()),
}


@pytest.mark.parametrize("device", DEVICES)
def test_the_list_makes_the_device_file_that_the_plant_file_names(tmp_path: Path, device: str) -> None:
    table, options = DEVICES[device]
    (tmp_path / "io.csv").write_text(LIST, encoding="utf-8")
    (tmp_path / "plant.toml").write_text(PLANT.format(device=table), encoding="utf-8")
    words = ["plc", "import", str(tmp_path / "io.csv"), "--config", str(tmp_path / "plant.toml"), *options]
    records = ["--records", str(tmp_path / "records.jsonl")]
    done = CliRunner().invoke(main, [*words, *records])
    assert done.exit_code == 0, done.stderr
    made = tomllib.loads((tmp_path / "devices" / "new.toml").read_text(encoding="utf-8"))
    assert made["device"]["driver"] == "modbus" and [tag["name"] for tag in made["tags"]] == ["Marcia", "Corrente"]
    assert not {"host", "serial"} & set(made["device"])  # where it is stays in the plant file
