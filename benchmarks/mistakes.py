"""Seventy mistakes of a first hour: what was typed, what `decanter` answered, and its exit code.

Each is answered by one sentence that says what is wrong and what would be right: no traceback, nothing on standard
output, nothing written. `python -m benchmarks.mistakes` prints the table, `--write` puts it into docs/commissioning.md;
tests/cli/test_mistakes.py runs each of them and holds the page to it.
"""

import os
import shlex
import tempfile
from contextlib import chdir
from pathlib import Path

import click
from click.testing import CliRunner, Result

from benchmarks.unknown_plc import write_examples
from gateway.cli.main import main as decanter
from gateway.console import config_dir

MISTAKES: tuple[tuple[str, int, str], ...] = (
    # A word that is no command, an option that is none, a value that is none.
    ("deamon", 2, "did you mean 'demo'"),
    ("plc prob --host 127.0.0.1", 2, "did you mean 'probe'"),
    ("trace shwo day.csv", 2, "did you mean 'show'"),
    ("model lern --traces day.csv --out m", 2, "did you mean 'learn'"),
    ("check", 2, "`decanter check` has another name now:"),
    ("plc write plan", 2, "what would be written; no command writes a register"),
    ("plc loop alarms", 2, "`decanter plc loop` has another name now:"),
    ("plc conformance", 2, "`decanter plc conformance` has another name"),
    ("model verify m", 2, "`decanter model verify` has another name"),
    ("run --confg plant.toml", 2, "No such option '--confg'. Did you mean"),
    ("plc probe --host 127.0.0.1:99999", 2, "has port 99999; give one from 1 to 65535"),
    ("plc probe --host 127.0.0.1:http", 3, "'127.0.0.1:http' is no address,"),
    ("plc probe --host 127.0.0.1 --unit 300", 2, "300 is not in the range 0<=x<=255"),
    ("plc probe --host 127.0.0.1 --set timeout=0", 2, "0.0 is not in the range 0.001<=x<=60"),
    ("run --clock noon", 2, "there is no plant file: neither"),
    ("docs toturial", 2, "did you mean 'tutorial'"),
    ("docs 9999", 2, "'9999': there is no such page"),
    # No device, two of them, one that is not there.
    ("plc probe", 2, "which device? Give --host HOST, or --serial"),
    ("plc read 40101", 2, "which device? Give --host HOST, or --serial"),
    ("plc probe --channel can0", 2, "--channel is a CAN bus: say --link canopen"),
    ("plc probe --link profibus --host 127.0.0.1", 2, "--link: 'profibus' is no link"),
    ("plc probe --host 127.0.0.1:1", 3, "127.0.0.1 is there and refuses port 1:"),
    ("plc probe --host no.such.host.invalid", 3, "'no.such.host.invalid' is no address, and"),
    ("plc probe --serial /dev/ttyNONE", 3, "/dev/ttyNONE cannot be opened: no such file"),
    ("plc check --config good.toml --device unknown_plc.toml", 2, "--config and --device exclude each other: a"),
    ("plc check --config good.toml", 3, "127.0.0.1:1 does not connect: Connection refused"),
    ("plc read TBearing --config good.toml", 2, "'TBearing' is no register"),
    ("plc read holding:70000 --host 127.0.0.1", 2, "'holding:70000' is beyond the addresses,"),
    ("plc read xyz --host 127.0.0.1", 2, "'xyz' is no register"),
    ("plc guess 40107 warm --host 127.0.0.1", 2, "'warm' is no reading"),
    ("plc scan registers holding:200-100 --host 127.0.0.1", 2, "'holding:200-100' is no stretch of one table"),
    # Plant files and device files.
    ("run", 2, "there is no plant file: neither"),
    ("top --once", 2, "there is no plant file: neither"),
    ("run --config none.toml", 2, "none.toml: there is no such file"),
    ("run --config empty", 2, "empty: device: is missing"),
    ("run --config garbage", 2, "garbage: byte 0 is not UTF-8"),
    ("run --config folder", 2, "folder: cannot be read"),
    ("run --config typo.toml", 2, "did you mean 'temperature'"),
    ("run --config no_tag.toml", 2, "no_tag.toml: model.temperature: 'TBearing'"),
    ("run --config no_model.toml", 2, "no_model.toml: model.path: there is nothing"),
    ("run --config no_map.toml", 2, "nothing.toml: there is no such file"),
    ("run --config half_armed.toml", 2, "half_armed.toml: writeback: mode 'armed'"),
    ("run --config text_as_number.toml", 2, "text_as_number.toml: device.port: must be a"),
    ("run --config not_toml.toml", 2, "not_toml.toml: is not TOML: Expected ']' at"),
    ("top --once --config good.toml", 3, "no gateway runs"),
    ("arm --config good.toml --reason test --minutes 5", 2, "good_device.toml: has no [writeback] table"),
    (
        "arm --by Ada --config good.toml --reason test --minutes 5000",
        2,
        "good_device.toml: has no [writeback] table",
    ),
    ("plc bind T 40101 --config good.toml --type float", 2, "'float' is not one of 'bool', 'int8',"),
    ("plc bind --config good.toml", 2, "what is to be bound? Give NAME and ADDRESS,"),
    ("plc bind T --guess 1 --config good.toml", 2, "--guess: the last guess found nothing"),
    ("plc codegen --device good_device.toml --out x.st", 2, "good_device.toml: has no [writeback] table"),
    # I/O lists and a first folder.
    ("plc import none.csv --device d.toml --host 127.0.0.1", 2, "none.csv: cannot be read"),
    ("plc import hmi1.csv --device d.toml --host 127.0.0.1", 2, "hmi1.csv: no header was recognised in the"),
    ("plc import bad_list.csv --device d.toml --host 127.0.0.1", 1, "1 rows cannot be used, nothing was written:"),
    (
        "plc import io_list.csv --device d.toml --host 127.0.0.1 --shift -1 --only Nobody",
        2,
        "'Nobody': the list has no usable row of",
    ),
    ("init new", 2, "I/O list"),
    ("init new --list io_list.csv", 2, "address of the PLC"),
    ("init new --host 127.0.0.1 --list io_list.csv", 2, "temperature to be predicted is not said:"),
    (
        "init new --host 127.0.0.1 --list io_list.csv --temperature TBearing",
        2,
        "--temperature TBearing: is no number of the",
    ),
    ("init new --host 127.0.0.1 --list bad_list.csv", 2, "bad_list.csv: line 3, 'address': 'twelve'"),
    (
        "init new --host 127.0.0.1 --list io_list.csv --device unknown_plc.toml",
        2,
        "--list and --device exclude each other:",
    ),
    ("init . --host 127.0.0.1 --list one_tag.csv", 2, "README.md: is there already"),
    ("init new --host 127.0.0.1 --list one_tag.csv --trace empty", 2, "empty: the file is empty"),
    ("init empty --host 127.0.0.1 --list one_tag.csv", 2, "empty: no folder can be made there"),
    # Traces and column maps.
    ("trace show none.csv", 2, "none.csv: it cannot be read: No such file"),
    ("trace show empty", 2, "empty: the file is empty"),
    ("trace show garbage", 2, "garbage: line 1: there is no column 'time',"),
    ("trace show folder", 2, "folder: there is no CSV file there"),
    ("trace show day.csv --map nomap", 2, "there is no such column map"),
    ("trace show day.csv --map typo_map.toml", 2, "did you mean 'temperature'"),
    ("trace show no_temperature.csv", 2, "no_temperature.csv: line 1: there is no"),
    ("trace show day.csv --picture day.docx", 2, "'day.docx' is no picture"),
    ("trace map none.csv", 2, "none.csv: no such file or directory"),
    ("trace map words.csv", 2, "words.csv: no row with a time stands under"),
    ("trace map day.csv -o typo_map.toml", 2, "typo_map.toml: is there already"),
    ("trace synth cd99 --out t", 2, "unknown scenario 'cd99': known are cd1,"),
    # Models.
    ("model learn --out m", 2, "Missing option '--traces'"),
    ("model learn --traces none.csv --out m", 2, "none.csv: it cannot be read: No such file"),
    ("model learn --traces day.csv --out m --delta 0.1", 2, "--delta belongs to --method lsha"),
    ("model show none", 2, "none: there is no model directory, store,"),
    ("model show garbage", 2, "garbage: byte 0 is not UTF-8"),
    ("model simulate none --trace day.csv", 2, "none: there is no model directory, store,"),
    ("model check none 'Pr[<=60](<> Temp > 80)'", 2, "none: there is no model directory, store,"),
    ("model version promote none v1", 2, "none: is no model store"),
)
"""What is typed after `decanter`, the exit code, and words of the answer."""


def answered(words: str, folder: Path) -> Result:
    """What one of them is answered in a folder that `prepare` has made."""
    with chdir(folder):
        return CliRunner(env={"DECANTER_RECORDS": "out/records.jsonl", "DECANTER_BY": ""}).invoke(
            decanter, shlex.split(words)
        )


_DEVICE = '[device]\nname = "d"\ndriver = "modbus"\n[[tags]]\nname = "T"\naddress = "holding:0"\nunit = "degC"\n'
_PLANT = """\
[device]
file = "{map}"
host = "127.0.0.1"
port = 1
[model]
{model}
[historian]
path = "out/historian.sqlite"
[writeback]
{writeback}
"""


def prepare(folder: Path) -> None:
    """The files that the mistakes are made with."""
    write_examples(folder)
    (folder / "empty").touch()
    (folder / "garbage").write_bytes(b"\xff\xfe\x00\x80" * 500)
    (folder / "folder").mkdir()
    (folder / "folder" / "note.txt").write_text("hello", encoding="utf-8")
    texts = {
        "good_device.toml": _DEVICE,
        "typo.toml": _PLANT.format(map="good_device.toml", model='temprature = "T"', writeback=""),
        "no_tag.toml": _PLANT.format(map="good_device.toml", model='temperature = "TBearing"', writeback=""),
        "no_model.toml": _PLANT.format(map="good_device.toml", model='temperature = "T"\npath = "m"', writeback=""),
        "no_map.toml": _PLANT.format(map="nothing.toml", model='temperature = "T"', writeback=""),
        "good.toml": _PLANT.format(map="good_device.toml", model='temperature = "T"', writeback=""),
        "half_armed.toml": _PLANT.format(map="unknown_plc.toml", model="", writeback='mode = "armed"'),
        "text_as_number.toml": _PLANT.format(map="good_device.toml", model="", writeback="").replace(
            "port = 1", 'port = "502"'
        ),
        "not_toml.toml": "[device\nfile = x\n",
        "one_tag.csv": "name;address;type;unit\nT;40101;INT;degC\n",
        "bad_list.csv": "name;address;type;unit\nT;40101;INT;degC\nU;twelve;INT;A\n",
        "day.csv": "time,MarciaDecanter,Assorbimento,TCuscinettiRiduttore\n"
        + "".join(f"{t},1,120,{20 + t / 10}\n" for t in range(60)),
        "no_temperature.csv": "time,MarciaDecanter,Assorbimento\n0,1,10\n1,1,12\n",
        "words.csv": "who,what\nAda,hello\nBob,bye\n",
        "typo_map.toml": 'format = "wide"\ntemprature = "T"\n[clock]\ncolumn = "time"\n[signals]\nT = {}\n',
        "README.md": "mine\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


PAGE = Path(__file__).parent.parent / "docs" / "commissioning.md"
"""Where the table stands, between two marks."""
BEGIN, END = "<!-- made: mistakes -->\n", "<!-- end -->"


def row(words: str, result: Result, folder: Path) -> str:
    """The table's row: what was typed, the answer without what differs from machine to machine, the exit code."""
    said = (
        result.stderr.strip()
        .removeprefix("decanter: ")
        .replace(f"{folder}{os.sep}", "")
        .replace(f"{config_dir().parent}{os.sep}", "")
        .replace("|", "\\|")
        .replace("`", "'")
    )
    return f"| `{words}` | `{said}` | {result.exit_code} |".replace("\n", " ")


@click.command(help=__doc__)
@click.option("--write", is_flag=True, help="Put the table into docs/commissioning.md.")
def main(write: bool) -> None:
    lines = ["| typed after `decanter` | answer | exit code |", "|---|---|---|"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        lines += [row(words, answered(words, folder), folder) for words, _, _ in MISTAKES]
    table = "\n".join(lines) + "\n"
    if not write:
        click.echo(table)
        return
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(before + BEGIN + table + END + rest.partition(END)[2], encoding="utf-8")


if __name__ == "__main__":
    main()
