"""Where the shipped data lie: the `config` folder of a checkout, or its copy inside an installed package."""

from pathlib import Path


def config_dir() -> Path:
    """The folder with plant.toml, devices/, traces/ and models/."""
    packaged = Path(__file__).parent.parent / "_config"
    return packaged if packaged.is_dir() else Path(__file__).parent.parent.parent / "config"


PLANT_FILES = (Path("plant.toml"), Path("config/plant.toml"))
"""Where a plant file is looked for when none is named, relative to the working folder."""


def plant_here() -> Path | None:
    """The plant file of the working folder, or None where there is none."""
    return next((path for path in PLANT_FILES if path.is_file()), None)


def shipped(kind: str, name: str) -> Path:
    """The file called `name` (a path, or a bare name such as `skab`) of `config/<kind>/`; a path that exists wins."""
    path = Path(name)
    if path.exists() or path.suffix:
        return path
    return config_dir() / kind / f"{name}.toml"
