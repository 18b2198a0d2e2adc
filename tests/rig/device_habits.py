"""The habits of real devices as one table: `python -m tests.rig.device_habits` writes `docs/devices.md` of it.

A row says what people have met and where, how it is found, what the driver does and by which setting, and which test
shows it. `wire` makes the device of the tests have it, `needs` are the settings that it takes then; by them
`tests/drivers/test_modbus_habits.py` walks the table, each habit alone and several drawn together.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[2] / "docs" / "devices.md"
TCP, LINE, TLS, PTY = "tcp", "rtu-tcp", "tls", "rtu"
_HABITS, _DEVICES = "tests/drivers/test_modbus_habits.py", "tests/drivers/test_modbus_devices.py"


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceHabit:
    """One habit. `threads` are public ones, as OWNER/REPOSITORY#NUMBER; `test` a test's file and name.

    `over` are the links on which the tests' device can have it.
    """

    habit: str
    found: str
    done: str
    setting: str = ""
    threads: tuple[str, ...] = ()
    test: str = f"{_HABITS}::test_each_habit_is_read_alone"
    wire: Mapping[str, Any] = field(default_factory=dict)
    needs: Mapping[str, Any] = field(default_factory=dict)
    over: tuple[str, ...] = (TCP, LINE, TLS, PTY)


HABITS: tuple[DeviceHabit, ...] = (
    DeviceHabit(
        habit="answers nothing for a while after a connection was made",
        found="`probe`: over two connections the first answer takes long and no other one does",
        done="the pause before the first question grows with each connection in a row that brought no answer",
        setting="pause_after_connect",
        threads=(
            "home-assistant/core#50011", "home-assistant/core#32557", "home-assistant/core#148327",
            "openhab/openhab-core#2926", "openhab/openhab-addons#12641", "influxdata/telegraf#11919",
            "grid-x/modbus#44", "evcc-io/evcc#31996", "tiagocoutinho/modbus-proxy#5",
        ),
        wire={"quiet": 0.4},
    ),
    DeviceHabit(
        habit="is silent at registers, instead of refusing them",
        found="the device answers at another place while a block has no answer",
        done="silence is bisected as a refusal is, over several readings; what is silent while another place answers "
        "waits in quarantine",
        threads=("yaacov/node-modbus-serial#505",),
        wire={"silent_at": 5},
    ),
    DeviceHabit(
        habit="is slow",
        found="`probe` waits long for the first answer and proposes; a reply that came too late is named in the reason",
        done="a late answer to the same question of the same reading is its answer",
        setting="timeout",
        threads=("home-assistant/core#32557",),
        wire={"late": 0.05},
    ),
    DeviceHabit(
        habit="puts bytes before a frame on a serial line",
        found="what follows has the unit, function, length and CRC that were asked for",
        done="up to 8 bytes before the frame are passed over, and counted",
        threads=(
            "stephane/libmodbus#14", "pyhys/minimalmodbus#61", "slowtec/tokio-modbus#375", "eModbus/eModbus#40",
            "yaacov/node-modbus-serial#107", "4-20ma/ModbusMaster#98", "home-assistant/core#69742",
            "alejoseb/Modbus-STM32-HAL-FreeRTOS#21",
        ),
        wire={"lead": b"\0"},
        over=(LINE, PTY),
    ),
    DeviceHabit(
        habit="the adapter gives back what is sent",
        found="`probe`: what comes back is the request; it is tried with the setting",
        done="the request is taken away from what comes",
        setting="echo",
        test=f"{_HABITS}::test_each_habit_is_read_alone",
        wire={"echo": True},
        needs={"echo": True},
        over=(LINE, PTY),
    ),
    DeviceHabit(
        habit="says that it is busy (exceptions 5 and 6)",
        found="by the exception",
        done="a read is asked again within its time; a write answered 6, of which nothing was done, is sent again",
        threads=("home-assistant/core#50073", "home-assistant/core#54345", "pyhys/minimalmodbus#8"),
        wire={"busy": 1},
    ),
    DeviceHabit(
        habit="is behind a gateway that now and then has no answer of it (exceptions 10 and 11)",
        found="by the exception",
        done="a read of a unit that has answered is asked again as after silence; if it ends so, not until one is good",
        setting="attempts",
        test=f"{_HABITS}::test_a_gateways_word_that_its_unit_is_silent_is_no_answer",
    ),
    DeviceHabit(
        habit="shows late what was written to it",
        found="it reads back the former value first",
        done="read back again for as long as a reading lasts at most",
        wire={"stale": 1},
    ),
    DeviceHabit(
        habit="never shows what was written to it",
        found="each write reads back another value",
        done="with the setting its confirmation is all there is; what the PLC made of a block its status tags say",
        setting='read_back = "never"',
        wire={"hidden": True},
        needs={"read_back": "never"},
    ),
    DeviceHabit(
        habit="answers with another transaction id",
        found="`probe`: frames come and none has the id; it is tried with the setting",
        done="with the setting the connection is treated as a serial line: one question at a time",
        setting='transaction_id = "any"',
        threads=(
            "pymodbus-dev/pymodbus#2844", "pymodbus-dev/pymodbus#2709", "AndreasAmMueller/Modbus#18",
            "grid-x/modbus#26", "dresende/node-modbus-tcp#21",
        ),
        wire={"transaction": 0},
        needs={"transaction_id": "any"},
        over=(TCP,),
    ),
    DeviceHabit(
        habit="answers as another unit than the one that is asked",
        found="`probe`: the reply names its unit; it is tried with the setting",
        done="with the setting its answers are taken for the unit's; whose they are the transaction id shows",
        setting="answers_as",
        wire={"unit": 255},
        needs={"answers_as": 255},
        over=(TCP, TLS),
    ),
    DeviceHabit(
        habit="hands on what another unit of its line says, before the answer",
        found="the reply is of another unit, and the one that is asked answers behind it",
        done="behind another unit's frame the answer is waited for, 0.5 s at most",
        wire={"beside": 9},
        over=(TCP, TLS),
    ),
    DeviceHabit(
        habit="takes single registers or coils alone, or several alone",
        found="exception 1 to a write names the setting; `check` and `check plan --write` say the function beforehand",
        done="one request a register (function 6) or coil (5), in their order, sent once each",
        setting="write_with",
        threads=(
            "favalex/modbus-cli#6", "favalex/modbus-cli#22", "epsilonrt/mbpoll#32", "frangoteam/FUXA#1776",
            "edgexfoundry/device-modbus-go#60", "espressif/esp-idf#9463", "LinuxCNC/linuxcnc#487",
            "home-assistant/home-assistant.io#25750", "andig/gosunspec#13",
        ),
        wire={"single": True},
        needs={"write_with": 6},
    ),
    DeviceHabit(
        habit="hangs up after each answer, or when nothing is asked for a while",
        found="the connection ends between two questions",
        done="the next question, and reading back, wait for the next connection; a write is never sent twice",
        threads=(
            "alejoseb/Modbus-STM32-HAL-FreeRTOS#28", "yaacov/node-modbus-serial#535",
            "Cloud-Automation/node-modbus#121", "stephane/libmodbus#503",
        ),
        wire={"ends_connections": True},
        over=(TCP, TLS),
    ),
    DeviceHabit(
        habit="serves one client, and others need it between two scans",
        found="it refuses the second connection",
        done="with the setting the connection is closed after each scan and made for the next; without `identity` a "
        "tag's `period` is idle then, which `check` says, since another device may answer the next time",
        setting="close_between_scans",
        threads=("BiancoRoyal/node-red-contrib-modbus#538", "influxdata/telegraf#11919"),
        test=f"{_DEVICES}::test_a_connection_is_left_to_others_between_two_scans",
    ),
    DeviceHabit(
        habit="takes reads at even addresses and of even counts alone",
        found="`scan registers`: single addresses are refused and pairs are not",
        done="with the setting a read begins at a multiple of it and has as many registers",
        setting="aligned",
        wire={"even": True},
        needs={"aligned": 2},
    ),
    DeviceHabit(
        habit="counts a register of 32 bits as one address, as flow computers do (Enron, Daniel)",
        found="the reply has twice the bytes, and its reason names the setting",
        done="a number of 32 bits is one address there, no request has registers of both widths, nothing is written",
        setting="wide_registers",
        test=f"{_DEVICES}::test_registers_of_32_bits_are_one_address_each",
    ),
    DeviceHabit(
        habit="takes short requests alone",
        found="`scan registers` prints the largest block that is answered",
        done="reads are planned and writes are held within the limit",
        setting="max_registers, max_write_registers",
        wire={"most": 4},
        needs={"max_registers": 4, "max_write_registers": 8},
    ),
    DeviceHabit(
        habit="speaks Modbus ASCII, on a line or over TCP",
        found="nothing is answered to other frames; `--link modbus-ascii` or `modbus-ascii-tcp`",
        done="ASCII frames with their LRC, by the rules of a serial line",
        setting='transport = "ascii", "ascii-tcp"',
        threads=("stephane/libmodbus#576", "goburrow/modbus#42", "dog-gateway/jamod-rtu-over-tcp#3", "3cky/mbusd#18"),
        test=f"{_DEVICES}::test_ascii_frames_are_read_and_written",
    ),
    DeviceHabit(
        habit="speaks Modbus over UDP",
        found="`--link modbus-udp`",
        done="one question at a time, told from doubled and late datagrams by its transaction id",
        setting='transport = "udp"',
        threads=("nmakel/sdm_modbus#20", "BiancoRoyal/node-red-contrib-modbus#478"),
        test=f"{_DEVICES}::test_datagrams_that_are_lost_doubled_or_of_another_number_are_told_apart",
    ),
    DeviceHabit(
        habit="has several numbers for \"not available\"",
        found="its manual",
        done="each of them is no value; for floats too",
        setting="sentinel, a list",
        test="tests/drivers/test_codec.py::test_each_of_several_sentinels_is_no_value",
    ),
    DeviceHabit(
        habit="has the power of ten of its values in registers of their own, and changes it, as SunSpec's inverters",
        found="`scan models` finds SunSpec's models, and `import` reads their published files",
        done="value and factor of one reply belong together; of two the factor was the same before and after",
        setting='scale_from, of a tag',
        threads=(
            "VOLTTRON/volttron#1701", "DomoticX/domoticz-modbus#27", "abeggled/openbridgeserver#1255",
            "evcc-io/evcc#2162", "evcc-io/evcc#1267",
        ),
        test=f"{_DEVICES}::test_a_value_and_a_factor_of_two_replies_count_where_the_factor_did_not_change",
    ),
    DeviceHabit(
        habit="has values that change once an hour beside others that change at once",
        found="its manual",
        done="a tag is read when its period is over, and what was read stands meanwhile",
        setting="period, of a tag or of [[groups]]",
        threads=(
            "timlaing/modbus_local_gateway#63", "wills106/homeassistant-solax-modbus#384", "gavinying/modpoll#15",
        ),
        test=f"{_DEVICES}::test_a_tag_with_a_period_is_read_no_more_often_and_what_was_read_stands_meanwhile",
    ),
    DeviceHabit(
        habit="is another device than it was: a cable was put elsewhere, or a spare is in its place",
        found="at each connection, after each silence and every minute it says who it is",
        done="nothing of it is believed, and nothing written to it; reason, status and an alarm say who answers",
        setting="identity",
        test=f"{_DEVICES}::test_a_device_that_is_not_the_pinned_one_is_not_believed_and_not_written",
    ),
)  # fmt: skip


def page() -> str:
    """The page, in Markdown."""
    lines = ["| habit | how it is found | what is done | setting | threads | test |", "|---|---|---|---|---|---|"]
    for row in HABITS:
        setting = f"`{row.setting}`" if row.setting else ""
        threads, name = ", ".join(row.threads), row.test.partition("::")[2]
        lines.append(f"| {row.habit} | {row.found} | {row.done} | {setting} | {threads} | `{name}` |")
    return _HEAD + "\n".join(lines) + "\n" + _TAIL


_HEAD = """# Habits of real devices, and what is done about them

What people have met with real Modbus devices, how it is found here, and the setting of `[device]` where one is needed.
`decanter plc probe` says what it finds, and with `--write` puts it into the device file. The table is made by
`python -m tests.rig.device_habits`, and a test walks it: each habit alone and several drawn together, of which no
reading may be wrong and good.

"""
_TAIL = """
## Who the device is

Two devices of a kind answer the same questions at the same addresses. What one of them alone says is pinned in its
device file, or in the plant file's `[[device.links]]`:

```toml
[device.identity]
"product code" = "750-8212"        # function 43: vendor, product code, revision, vendor URL, product, ..., object N
"server id" = "PLC 1"              # function 17: text, or hexadecimal digits
"holding:300-307" = "SN-0001"      # registers: a text, a number, or a list of their words
```

Neither the revision, which an update changes, nor whether a device runs is who it is.
A CANopen node is pinned by the numbers of its object 0x1018: `identity = { vendor = 1, product = 2, serial = 3 }`.
`decanter plc probe` prints what a device says, and `--write --pin` puts it into the file. A device that does not say
what is pinned is not believed; a block is sent only over the connection on which it has said so, and after a silence
only when it has said so again. One that hangs up after each answer can be read so, and not written.

## Registers of 32 bits

```toml
[device]
wide_registers = ["holding:5001-5999", "holding:7001-7999"]   # PDU addresses, as they go on the wire
```

A tag in such a range is `int32`, `uint32` or `float32` at one address (`int64` and `float64` at two), in the order of
its own bytes. Addresses outside the ranges are registers of 16 bits as ever. Some of these devices put the number of
the manual on the wire (5001), others count from 0 (5000): `decanter plc read` shows which.

## Factors and periods of tags

```toml
[[tags]]
name = "PowerAC"
address = "holding:40083"
dtype = "int16"
scale_from = "holding:40084"       # a power of ten, -10 to 10; 0x8000: there is none, and no value
unit = "W"

[[groups]]
period = 3600                      # seconds; for those that have no period of their own
tags = ["Energy*", "SerialNumber"]
```

What was read before a write over it, or over a connection that has ended, is not kept: it is read again at once.
"""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
