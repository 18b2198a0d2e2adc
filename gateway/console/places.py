"""Where files lie: those that are shipped with the program, and the plant file of the folder that one works in."""

import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

PLANT_FILES = (Path("plant.toml"), Path("config/plant.toml"))
"""Where a plant file is looked for when none is named, in this order, relative to the working folder."""
SERVICE_FOLDER = Path("/etc/decanter")
"""The folder of the plant that the installed service runs: looked in last, so that its commands work from anywhere."""
SERVICE_RECORDS, SERVICE_LOG = Path("/var/lib/decanter"), Path("/var/log/decanter")
"""Where the service's records and its log lie."""
_GROUP = re.compile(r"[A-Za-z0-9_.-]{1,100}")
"""A group's name: what systemd takes in a unit's name as it is (systemd.unit(5))."""


@dataclass(frozen=True, slots=True)
class ServicePlaces:
    """Of an installed service: the name of its unit, and the folders of its records and its log."""

    unit: str
    records: Path
    log: Path


def find_service(folder: Path) -> ServicePlaces | None:
    """The installed service that runs the plant of a folder; None where it is no service's.

    In a folder of SERVICE_FOLDER it is that of a group of machines: the unit `decanter@GROUP`.
    """
    folder = folder.absolute()
    if folder == SERVICE_FOLDER:
        return ServicePlaces("decanter", SERVICE_RECORDS, SERVICE_LOG)
    if folder.parent == SERVICE_FOLDER and _GROUP.fullmatch(group := folder.name):
        return ServicePlaces(f"decanter@{group}", SERVICE_RECORDS / group, SERVICE_LOG / group)
    return None


def plant_here() -> Path | None:
    """The plant file of the working folder, else that of the installed service, or None where there is none.

    Never one that was shipped: records and sockets lie beside what a plant file says, and those of a plant do not
    belong among the files of an installed program.
    """
    for path in (*PLANT_FILES, SERVICE_FOLDER / "plant.toml"):
        # A folder that this user may not look into has none for them.
        with suppress(PermissionError):
            if path.is_file():
                return path
    return None


def find_plant_file() -> Path:
    """The plant file (`plant_here`), for a command that cannot do without. Raises ValueError."""
    if (path := plant_here()) is not None:
        return path
    places = " nor ".join(f"./{name}" for name in PLANT_FILES)
    raise ValueError(
        f"there is no plant file: neither {places} is there; make one with `decanter init`, or name one with --config"
    )


def config_dir() -> Path:
    """The shipped folder with an example plant.toml, devices/ and traces/: to be read, never to be worked in."""
    packaged = Path(__file__).parent.parent / "_config"
    return packaged if packaged.is_dir() else Path(__file__).parent.parent.parent / "config"


def shipped_file(kind: str, name: str) -> Path:
    """The file called `name` (a path, or a bare name such as `skab`) of `config/<kind>/`; a path that exists wins."""
    path = Path(name)
    if path.exists() or path.suffix:
        return path
    return config_dir() / kind / f"{name}.toml"
