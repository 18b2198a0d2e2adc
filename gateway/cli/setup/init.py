"""`decanter init`: from nothing to a folder that runs, by questions on a terminal or by options."""

import re
import sys
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import Any

import click

from drivers.driver import capabilities
from drivers.settings import ConfigError, with_place
from gateway.commission.files import (
    FileChange,
    FirstFolder,
    IoList,
    Reading,
    find_files,
    plant_findings,
    read_io_list,
    template,
)
from gateway.commission.import_list import bindings, make_reading
from gateway.commission.options import SharedOptions
from gateway.console import CommandResult, Line, Part, conclude, find_service, make_folder, shipped_file
from gateway.entry import sentences
from gateway.settings import load_device

_LIST_ENDINGS = (".csv", ".xlsx", ".txt", ".tsv")
_NO_NUMBERS = ("bool", "string")
_HEARTBEAT = re.compile("heart ?beat|life ?(bit|counter|word)|watchdog|contatore ?vita|lebens", re.IGNORECASE)


def init(given: SharedOptions, folder: Path, **options: Any) -> None:
    """The work of `init`."""
    with sentences():
        asked = _Prompt(terminal())
        how = make_reading(options)
        described = _describe_tags(given.device, options["list_path"], how, asked, skip=options["skip_bad"])
        described = _drop_tags(described, options["without"])
        device, io_list, known = described.device, described.io_list, described.names
        given = _complete_place(given, described.device, asked)
        files = find_files(folder / ".init" / "plant.toml", device, given.link, given.settings)
        trace = options["trace"]
        if trace is None and asked.here:
            answer = asked.text("a recorded trace (CSV), or none", "--trace FILE", default="none")
            trace = None if answer == "none" else Path(answer)
        temperatures = _temperatures(described, options["temperatures"], asked)
        heartbeat = options["heartbeat"] or (_heartbeat(known) if device is None else None)
        map_text, open_points, derived = "", list[str](), dict[str, dict[str, Any]]()
        if trace is not None:
            map_text, open_points = _column_map(trace, described, temperatures[0], options["rename"], asked)
            derived = _derived(map_text, known)
        wanted = FirstFolder(
            folder=folder,
            files=files,
            change=FileChange(
                tags=bindings(io_list) if io_list is not None else (),
                derived=derived,
                heartbeat=heartbeat,
                plant={
                    "model.temperature": temperatures[0],
                    # A second one makes tables of them.
                    **{f"temperature.{tag}.tag": tag for tag in temperatures[1:]},
                    "alarms.tags": list(temperatures),
                    **_of_service(folder),
                },
            ),
            template=template(),
            device=device,
            map_text=map_text,
            place=" ".join(
                str(files.place[key]) for key in ("host", "port", "serial", "channel") if key in files.place
            ),
        )
        if wanted.existing_files and not options["overwrite"]:
            there = ", ".join(map(str, wanted.existing_files))
            raise ValueError(f"{there}: is there already; give another folder, or --overwrite")
        make_folder(folder)
        made = wanted.write()
    warnings = list(open_points)
    if heartbeat is None and device is None:
        warnings.append("no heartbeat is known: a PLC that stands still would look alive; give --heartbeat TAG")
    if io_list is not None:
        warnings += [f"left out: {problem}" for problem in io_list.problems]
        warnings += [tag.unread for tag in io_list.tags if tag.unread]
    warnings += plant_findings(folder / "plant.toml")
    following = _next(folder, trace, temperatures)

    def show() -> Iterator[Part]:
        predicted = f"temperature{'s' if len(temperatures) > 1 else ''} {', '.join(temperatures)}"
        yield "\n".join([*(f"made {path}" for path in made), f"{len(known)} tags, {predicted}"])
        for sentence in warnings:
            yield Line(sentence, "yellow", aside=True)
        yield "next:\n" + "\n".join(f"  {line}" for line in following)

    data = {"files": list(map(str, made)), "tags": len(known), "temperature": temperatures[0], "heartbeat": heartbeat}
    data |= {"temperatures": list(temperatures), "warnings": warnings, "next": following}
    conclude(CommandResult(data), lambda _: show(), as_json=given.as_json)


def terminal() -> bool:
    """Whether a person is there to be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


class _Prompt:
    """A person who is asked, if one is there (`here`); else what is missing is refused with its option."""

    def __init__(self, here: bool) -> None:
        self.here = here

    def text(self, question: str, option: str, *, default: str | None = None, choices: Sequence[str] = ()) -> str:
        """The answer. Raises ConfigError where nobody is there."""
        if not self.here:
            among = f": {', '.join(choices)}" if choices else ""
            raise ConfigError([f"{question} is not said{among}; give {option}, or call `decanter init` on a terminal"])
        kind = click.Choice(list(choices)) if choices else None
        return str(click.prompt(question, default=default, type=kind))


def _complete_place(given: SharedOptions, device: Path | None, asked: _Prompt) -> SharedOptions:
    """The options with where the PLC is, asked for where neither they nor the device file say it."""
    there = load_device(device) if device is not None else None
    settings = {**(there.settings if there is not None else {}), **given.settings}
    if {"host", "serial", "channel"} & set(settings) or not (there is None or capabilities(there.driver).networked):
        return given
    answer = asked.text("address of the PLC (host, host:port, or a serial port)", "--host HOST or --serial PATH")
    if answer.startswith(("/", "COM")):
        return replace(given, settings={**given.settings, "serial": answer})
    return replace(given, settings=with_place({**given.settings, "host": answer}))


@dataclass(frozen=True, slots=True)
class _Described:
    """Where the tags lie: a device file or an I/O list; the tags' names, and the units of those that are numbers.

    `blocks` are the temperatures that the device takes blocks of.
    """

    device: Path | None
    io_list: IoList | None
    names: Sequence[str]
    numbers: Mapping[str, str]
    blocks: tuple[str, ...] = ()


def _describe_tags(
    device: Path | None, list_path: Path | None, how: Reading, asked: _Prompt, *, skip: bool
) -> _Described:
    """The tags, asked for where neither is given.

    Raises ConfigError or ListError; of a list with a sentence for each row that cannot be used, unless `skip`.
    """
    if device is None and list_path is None:
        path = Path(asked.text("I/O list (CSV, XLSX) or device file (TOML)", "--list FILE or --device FILE"))
        device, list_path = (None, path) if path.suffix.lower() in _LIST_ENDINGS else (path, None)
    if list_path is None:
        device = shipped_file("devices", str(device))
        there = load_device(device)
        numbers = {tag.name: tag.unit for tag in there.tags if tag.dtype not in _NO_NUMBERS}
        blocks = tuple(layout.temperature for layout in there.writebacks if layout.temperature in numbers)
        return _Described(device, None, [tag.name for tag in there.tags], numbers, blocks)
    if device is not None:
        raise ValueError("--list and --device exclude each other: `decanter plc import` adds a list to a device file")
    io_list = read_io_list(list_path, how)
    if io_list.problems and not skip:
        count = len(io_list.problems)
        raise ConfigError(
            [
                *io_list.problems,
                f"{list_path}: {count} to be corrected, or left out with --skip-bad; nothing was written",
            ]
        )
    numbers = {tag.name: str(tag.keys["unit"] or "") for tag in io_list.tags if tag.keys["dtype"] not in _NO_NUMBERS}
    return _Described(None, io_list, [tag.name for tag in io_list.tags], numbers)


def _drop_tags(described: _Described, names: Sequence[str]) -> _Described:
    """The tags but for these. Raises ConfigError for one that no list has."""
    listed = described.io_list
    if strange := [name for name in names if listed is None or name not in described.names]:
        known = ", ".join(described.names)
        raise ConfigError([f"--without {strange[0]}: is no tag of the list" + (f"; it has {known}" if listed else "")])
    return replace(
        described,
        io_list=listed and replace(listed, tags=tuple(tag for tag in listed.tags if tag.name not in names)),
        names=[name for name in described.names if name not in names],
        numbers={name: unit for name, unit in described.numbers.items() if name not in names},
    )


def _temperatures(described: _Described, wanted: Sequence[str], asked: _Prompt) -> tuple[str, ...]:
    """The tags that are predicted: those named, those of the device's blocks, the only one in degC, or the answer.

    Raises ConfigError.
    """
    numbers = described.numbers
    degrees = [name for name, unit in numbers.items() if unit in ("degC", "°C", "C")]
    if strange := [tag for tag in wanted if tag not in numbers]:
        known = ", ".join(degrees or numbers)
        raise ConfigError([f"--temperature {strange[0]}: is no number of the device; give one of {known}"])
    if wanted:
        return tuple(dict.fromkeys(wanted))
    if described.blocks:
        return described.blocks
    if len(degrees) == 1:
        return (degrees[0],)
    if not numbers:
        raise ConfigError(["no tag is a number, so that there is nothing to predict; complete the list or the file"])
    return (asked.text("temperature to be predicted", "--temperature TAG", choices=degrees or list(numbers)),)


def _heartbeat(tags: Sequence[str]) -> str | None:
    """The tag that is called a heartbeat, if one is."""
    named = [tag for tag in tags if _HEARTBEAT.search(tag.replace("_", " "))]
    return named[0] if len(named) == 1 else None


def _column_map(
    trace: Path, described: _Described, temperature: str, rename: Mapping[str, str], asked: _Prompt
) -> tuple[str, list[str]]:
    """The column map of a trace, its signals called as the tags are; and what of it a person should look at.

    Raises TraceError, or ConfigError for a tag of `rename` that is not there.
    """
    # What reads a recording loads NumPy, and most folders are made without one.
    from gateway.lab.traces.map import ask_map
    from sim.lab.recordings import parse_map
    from sim.lab.recordings.mapping import RUNNING_SIGNAL, Answers, Undecided

    known = described.names
    if strange := [tag for tag in rename.values() if tag not in known]:
        raise ConfigError([f"--rename: {strange[0]!r} is no tag of the device; it has {', '.join(known)}"])
    answers = Answers()
    while True:
        try:
            first = ask_map(trace, answers)
            break
        except Undecided as open_point:
            # Which temperature the model is to predict was said already.
            choices = _named_columns(open_point.choices, known, _of_columns(rename, open_point.columns))
            mine = [choice for choice in open_point.choices if choices.get(choice) == temperature]
            if open_point.field == "temperature" and len(mine) == 1 and not answers.temperature:
                answers = answers.with_answer("temperature", mine[0])
                continue
            # A gateway follows what it reads: of several switches that one is meant which is a tag.
            tags = [choice for choice in open_point.choices if choice in choices]
            if open_point.field == "running" and len(tags) == 1 and not answers.running:
                answers = answers.with_answer("running", tags[0])
                continue
            if open_point.field == "temperature" and not mine:
                raise ValueError(
                    f"{trace}: none of its columns is called as {temperature} is; say which one it is: "
                    + " or ".join(f"--rename {choice!r}={temperature}" for choice in open_point.choices)
                ) from None
            if open_point.field == "running" and not tags:
                raise ValueError(
                    f"{trace}: none of its columns that may be the running is called as a tag is; say which one is: "
                    + " or ".join(f"--rename {choice!r}=TAG" for choice in open_point.choices)
                    + f"; none: decide in `decanter trace map {trace} -o {trace.stem}.toml`; no --trace here"
                ) from None
            raise ValueError(
                f"{open_point}: to `decanter trace map {trace} -o {trace.stem}.toml`, and leave --trace out here"
            ) from None
    drafted = parse_map(first.text, str(trace))
    units = {drafted.signal_names(name)[0]: signal.unit for name, signal in drafted.signals.items()}
    names = _named_columns(list(units), known, _of_columns(rename, units))
    if temperature in names.values():
        answers = answers.with_answer("temperature", temperature)
    else:
        names[first.temperature] = temperature
    # The events come from the other two parts: those must be tags, or a gateway has no events.
    open_points = []
    if answers.running:
        open_points.append(
            f"{answers.running!r} of the trace is taken for the switch, the only one of several that is a tag"
        )
        answers = answers.with_answer("running", names.get(answers.running, answers.running))
    for part, header in {"load": first.current, "switch": first.running or RUNNING_SIGNAL}.items():
        if not header or header in names:
            continue
        left = [name for name in known if name not in names.values()]
        tag = rename.get(header, "")
        only = _only_tag(part, units[header], left, described.numbers) if header in units and not tag else ""
        if not tag and asked.here:
            question = {"load": "the motor's current", "switch": "whether the machine runs"}[part]
            question = f"the tag of {question} ({header!r} in the trace)"
            answer = asked.text(question, "--rename", default=only or None, choices=[*left, "none"])
            tag = "" if answer == "none" else answer
        elif only:
            tag = only
            open_points.append(
                f"{header!r} of the trace is taken for {tag}, the only {part} among the tags that are left; where it "
                f"is another: --overwrite --rename {header!r}=TAG"
            )
        if tag:
            names[header] = tag
    final = ask_map(trace, answers, names)
    made = parse_map(final.text, str(trace))
    # With the tags' names another column may be the current than before: what is said is of the map that is written.
    of_parts = [name for name in made.signals if made.signal_names(name)[0] in (final.current, final.running)]
    for signal in dict.fromkeys([made.temperature, *of_parts, *(each.signal for each in made.alphabet.channels)]):
        if signal not in known and signal not in made.derived:
            header = made.signal_names(signal)[0]
            open_points.append(
                f"{header!r} of the trace is no tag of the device: a model learned with it cannot run here; "
                f"say which tag it is: --overwrite --rename {header!r}=TAG"
            )
    return final.text, open_points


def _only_tag(part: str, unit: str, tags: Sequence[str], numbers: Mapping[str, str]) -> str:
    """The one of `tags` that says running, or that loads the machine in the column's `unit`; "" for none or several.

    `numbers` are the units of the tags that are numbers.
    """
    from sim.lab.recordings import known_unit  # as above
    from sim.lab.recordings.mapping import current_score, load_score, running_score

    if part == "switch":
        fitting = [tag for tag in tags if tag not in numbers and running_score(tag)]
    else:
        fitting = [
            tag
            for tag in tags
            if tag in numbers
            and (current_score(tag, numbers[tag]) or load_score(tag, numbers[tag]))
            and (not unit or not numbers[tag] or unit == known_unit(numbers[tag]))
        ]
    return fitting[0] if len(fitting) == 1 else ""


def _derived(map_text: str, known: Sequence[str]) -> dict[str, dict[str, Any]]:
    """The signals that the map makes of others which are tags: the gateway makes them by the same law."""
    from sim.lab.recordings import parse_map  # as above

    laws = parse_map(map_text, "the trace's column map").derived
    return {
        name: law.model_dump(mode="json", exclude_defaults=True)
        for name, law in laws.items()
        if name not in known and set(law.sources) <= set(known)
    }


def _named_columns(headers: Sequence[str], tags: Sequence[str], rename: Mapping[str, str]) -> dict[str, str]:
    """header -> tag: those of `rename`, and of what these leave over those that are called alike."""
    left = [header for header in headers if header not in rename]
    return match_columns(left, [tag for tag in tags if tag not in rename.values()]) | dict(rename)


def _of_columns(rename: Mapping[str, str], columns: Iterable[str]) -> dict[str, str]:
    """What `rename` says of columns that are there: one that is not must not keep its tag from another."""
    return {header: rename[header] for header in columns if header in rename}


def match_columns(headers: Sequence[str], tags: Sequence[str]) -> dict[str, str]:
    """header -> tag, of those that are called alike.

    That is the longest tag whose letters and digits the header's contain, else the only one each of whose words begins
    one of the header's: PumpRun is "Pump 3 running". Of several headers of one tag it is the one that is exactly it, or
    none; a limit, an alarm, a total or a count is no tag that does not say so.
    """
    from sim.lab.recordings.mapping import named_otherwise, split_unit  # as above

    choices = {
        header: [tag for tag in tags if not named_otherwise(_parted(header), _parted(tag))] for header in headers
    }
    claims = {header: tag for header in headers if (tag := _tag_within(header, choices[header]))}
    left = set(tags) - set(claims.values())
    for header in headers:
        fitting = [tag for tag in choices[header] if tag in left and _begin_alike(_words(tag), _words(header))]
        if header not in claims and len(fitting) == 1:
            claims[header] = fitting[0]
    exact = {header: tag for header, tag in claims.items() if _letters(split_unit(header)[0]) == _letters(tag)}
    counts, exact_counts = Counter(claims.values()), Counter(exact.values())
    return {
        header: tag
        for header, tag in claims.items()
        if counts[tag] == 1 or (header in exact and exact_counts[tag] == 1)
    }


def _parted(name: str) -> str:
    """The name, and its words apart: Temp_SP says SP."""
    return f"{name} {' '.join(_words(name))}"


def _tag_within(header: str, tags: Sequence[str]) -> str:
    """The longest tag whose letters and digits the header's contain from the beginning of a word on; "" for none.

    DE_Temp is in "DE temperature", and not in "NDE temperature"; Temp1 is not in "Temp 10".
    """
    words = _words(header)

    def holds(letters: str) -> bool:
        for place in range(len(words)):
            rest = "".join(words[place:])
            ends = set(accumulate(map(len, words[place:])))
            if rest.startswith(letters) and (len(letters) in ends or not rest[len(letters)].isdigit()):
                return True
        return False

    return max((tag for tag in tags if len(_letters(tag)) > 2 and holds(_letters(tag))), key=len, default="")


def _begin_alike(words: Sequence[str], header: Sequence[str]) -> bool:
    """Whether there are two words at least besides letters, and each begins one of the header's, or is its number."""
    words = [word for word in words if len(word) > 1 or word.isdigit()]
    return len(words) > 1 and all(
        word in header if word.isdigit() else any(other.startswith(word) for other in header) for word in words
    )


def _words(text: str) -> list[str]:
    """The words of a name in lower case: they end where the case changes or no letter or digit stands."""
    found = re.findall(
        r"[^\W\d_]?[^\W\d_A-ZÄÖÜÉÈÀ]+|[A-ZÄÖÜÉÈÀ]+(?![a-zäöüéèà])|\d+", unicodedata.normalize("NFC", text)
    )
    return [_letters(word) for word in found]


_SPELLED = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue"})
"""As a tag's name spells them, which has no umlauts; casefold has made ss of the sharp s."""


def _letters(text: str) -> str:
    plain = unicodedata.normalize("NFKD", text.casefold().translate(_SPELLED))
    return "".join(letter for letter in plain if letter.isalnum())


def _of_service(folder: Path) -> dict[str, object]:
    """What is other in the folder of an installed service, which may write nothing beside its plant file."""
    if (service := find_service(folder)) is None:
        return {}
    places = {
        "historian.path": str(service.records / "historian.sqlite"),
        "log.path": str(service.log / "gateway.log.jsonl"),
    }
    # Of several services only one has the page's usual port.
    return {**places, "page.enabled": True} if service.unit == "decanter" else {**places}


def _plain_name(folder: Path) -> str:
    """The folder's name as one that a model's files can have."""
    return re.sub(r"[^\w-]+", "_", folder.resolve().name).strip("_-") or "plant"


def _next(folder: Path, trace: Path | None, temperatures: Sequence[str]) -> list[str]:
    """What to type next; the trace's column map speaks of the first temperature."""
    begin = "decanter run            # and `decanter top` in another terminal"
    if (service := find_service(folder)) is not None:
        begin = f"systemctl enable --now {service.unit}"
        if service.unit == "decanter":
            begin = "systemctl restart decanter   # and the page: http://127.0.0.1:8080"
    lines = [] if folder.resolve() == Path.cwd() else [f"cd {folder}"]
    lines += ["decanter plc check      # every tag, read once", begin]
    if trace is not None:
        path = trace.absolute() if lines[0].startswith("cd ") else trace
        key = "model.path" if len(temperatures) == 1 else f"temperature.{temperatures[0]}.model"
        lines += [
            f"decanter model learn --traces {path} --map columns.toml --out models/first --name {_plain_name(folder)}",
            f"decanter plc bind --keep {key}=models/first",
        ]
    return lines
