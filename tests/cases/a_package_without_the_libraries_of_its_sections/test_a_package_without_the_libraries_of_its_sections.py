"""The Debian package had none of the libraries for MQTT, OPC UA, PostgreSQL, Prometheus and Parquet: whoever wrote such
a section on a box without a network was told to call pip.

It named no part of it that is under the LGPL either, and the project had no LICENSE.
"""

import re
import shutil
import subprocess
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any

import pytest

from deploy import build_deb
from gateway.extras import DEBIAN_PACKAGES
from gateway.outside.northbound import northbound
from tests.cli.support import decanter
from tests.gateway.support import plant_file

ROOT = Path(__file__).parents[3]
LABORATORY = {"tune", "cluster", "bench", "dev", "mutants"}
"""Extras that no box needs: nothing in a plant file asks for them."""


def project() -> Any:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def locked(name: str) -> set[str]:
    """The packages of a lock."""
    text = (ROOT / name).read_text(encoding="utf-8")
    return set(re.findall(r"^([a-z0-9-]+)==", text, re.M))


def packages_built() -> dict[str, set[str]]:
    """The Debian packages that `make deb` builds, each with the packages that it has."""
    built = {build_deb.NAME: locked("requirements.lock")}
    return built | {f"{build_deb.NAME}-{name}": locked(f"requirements-{name}.lock") for name in build_deb.ADDITIONS}


def test_what_a_plant_file_or_an_export_can_ask_for_is_in_a_debian_package() -> None:
    extras, built = project()["optional-dependencies"], packages_built()
    assert set(extras) - LABORATORY == set(DEBIAN_PACKAGES)
    for extra, package in DEBIAN_PACKAGES.items():
        for requirement in extras[extra]:
            name, parts = re.findall(r"^([\w-]+)(?:\[(\w+)\])?", requirement)[0]
            names = {name, f"{name}-{parts}"} if parts else {name}
            assert names <= built[package], f"{extra}: {names - built[package]} not in {package}"


@pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="needs dpkg-deb (apt-get install dpkg)")
def test_make_deb_makes_the_additions_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def main_tree(tree: Path, _work: Path) -> None:
        (tree / build_deb.HOME / "bin").mkdir(parents=True)

    def addition(tree: Path, main: Path, name: str) -> None:
        assert (main / build_deb.HOME).is_dir()
        (tree / build_deb.HOME / name).mkdir(parents=True)

    monkeypatch.setattr(build_deb, "fill_environment", main_tree)
    monkeypatch.setattr(build_deb, "fill_addition", addition)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    build_deb.main(["--out", str(tmp_path), "--version", "1.2.3"])
    files = [line.partition(": ")[0] for line in capsys.readouterr().out.splitlines()]
    assert {Path(file).name.partition("_")[0] for file in files} == set(packages_built())
    for file in files:
        said = subprocess.run(["dpkg-deb", "-f", file], capture_output=True, text=True, check=True).stdout
        there = subprocess.run(["dpkg-deb", "-c", file], capture_output=True, text=True, check=True).stdout
        name = Path(file).name.partition("_")[0]
        assert f"Package: {name}\n" in said and f"/doc/{name}/copyright" in there
        assert name == build_deb.NAME or "Depends: decanter-gateway (>= 1.2.3)\n" in said


def test_every_section_without_its_library_is_said_by_check_with_the_packages_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = """
[[northbound.mqtt]]
name = "a"
host = "127.0.0.1"
group = "g"
node = "n"
[[northbound.postgres]]
name = "b"
host = "127.0.0.1"
database = "d"
user = "u"
[northbound.metrics]
port = 9100
[northbound.opcua]
port = 4840
"""
    path = plant_file(tmp_path, text)

    def absent(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name.partition(".")[0])

    monkeypatch.setattr(northbound, "import_module", absent)
    done = decanter("plc", "check", "--offline", "--config", path)
    assert done.exit_code == 1, done.output
    for section in ("mqtt", "postgres", "metrics", "opcua"):
        assert f"northbound.{section}: needs " in done.output, done.output
    assert done.output.count("install the package decanter-gateway") >= 4


def test_what_is_under_a_licence_that_asks_for_it_is_named() -> None:
    copyright_file = (ROOT / "deploy/copyright").read_text(encoding="utf-8")
    found = set()
    for name in sorted(set().union(*packages_built().values())):
        try:
            told = metadata(name)
        except PackageNotFoundError:
            continue
        words = [told.get("License-Expression") or "", (told.get("License") or "")[:200]]
        words += [row for row in told.get_all("Classifier") or [] if "License" in row]
        # Whoever may choose another one need not take this.
        if re.search(r"GPL|GNU|MPL|Mozilla", " ".join(words)) and " OR " not in words[0]:
            found.add(name)
            assert re.search(rf"^Copyright: .*\b{re.escape(name)}\b", copyright_file, re.M), name
    assert {"python-can", "fpdf2", "psycopg"} <= found
    used, explained = (
        set(re.findall(pattern, copyright_file, re.M)) for pattern in (r"^License: (\S+)", r"^License: (\S+)\n ")
    )
    assert used == explained


def test_the_licence_that_the_project_states_is_explained_at_its_top() -> None:
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert project()["license"] in text and "All rights reserved" in text
