"""A restored gateway is never armed: of several machines neither the plant file's tables nor the armings in the log.

`decanter keep restore` took the arming out of the top of the plant file and out of the log of a gateway with one
machine; [machine.writeback] tables, and armings under a machine's name, came back as they were.
"""

import time
from pathlib import Path

from click.testing import CliRunner

from gateway.cli.main import main
from gateway.settings import load_plant
from gateway.store import ARMED, DISARMED, AuditEntry, armed_subjects, given_words, load_or_make_key, open_audit
from tests.gateway.support import MAP

PLANT = f"""\
[device]
file = "{MAP}"
[historian]
path = "h.sqlite"
[[machine]]
name = "north"
device = {{ port = 1502 }}
[machine.writeback]
mode = "armed"
armed_by = "Ada"
reason = "test"
minutes = 60
[[machine]]
name = "south"
device = {{ port = 1503 }}
[machine.writeback]
mode = "shadow"
"""


def test_nothing_of_it_is_armed(tmp_path: Path) -> None:
    home = tmp_path / "plant"
    home.mkdir()
    (home / "plant.toml").write_text(PLANT, encoding="utf-8")
    config = load_plant(home / "plant.toml")[0]
    audit = open_audit(config.audit)
    for name in ("north", "south"):
        detail = {"until": time.time() + 3600.0, "minutes": 60.0}
        assert audit.record(AuditEntry(time.time(), ARMED, "Ada", "test", detail).with_subject(name))
    audit.close()
    load_or_make_key(config.audit_key)
    runner, kept, elsewhere = CliRunner(), tmp_path / "backup", tmp_path / "elsewhere"
    backed = runner.invoke(main, ["keep", "backup", str(kept), "--config", str(home / "plant.toml")])
    assert backed.exit_code == 0, backed.output
    restored = runner.invoke(main, ["keep", "restore", str(kept), "--into", str(elsewhere), "--by", "Bea"])
    assert restored.exit_code == 0, restored.output
    assert "'shadow' (it was 'armed')" in restored.output
    plant = elsewhere / (home / "plant.toml").relative_to("/")
    assert [one.writeback.mode for one in load_plant(plant)] == ["shadow", "shadow"]
    log = elsewhere / config.audit.relative_to("/")
    assert armed_subjects(log)[:2] == ["north", "south"]
    for name in ("north", "south"):
        assert given_words(log, subject=name)[0].entry.kind == DISARMED
