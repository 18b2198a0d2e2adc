"""`make deb`: one Debian package with the program and an environment of its own, installed without a network.

The tree is /usr/lib/decanter (a virtual environment on Debian's own Python), its command in /usr/bin, the unit. The
packages are those of requirements.lock, by hash: with them all that a plant file can name. What only exports need is
large and a package beside it (ADDITIONS). Nothing in them is younger than the commit that they are built from.
"""

import argparse
import gzip
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from email.utils import formatdate
from pathlib import Path

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"
NAME, HOME, PYTHON = "decanter-gateway", "usr/lib/decanter", "python3.11"
DEPENDS = (
    PYTHON,
    "adduser",
    "init-system-helpers",
    "util-linux",
    "libc6 (>= 2.34)",
    "libstdc++6",
    "libgcc-s1",
    "zlib1g",
)
"""Of the packages' libraries what they do not bring along; `--libraries` prints what is linked to."""
MAINTAINER = "Decanter gateway <gateway@localhost>"
DESCRIPTION = """\
edge gateway that foresees bearing overheating of decanters
 Reads a PLC over Modbus, CAN or CANopen, follows the bearings' temperatures
 with a learned stochastic hybrid automaton, forecasts them, raises alarms and
 writes a prediction block back, where it is armed."""
ADDITIONS = {
    "parquet": """\
Parquet for the decanter gateway's exports
 Apache Arrow in the environment of decanter-gateway: with it records are
 exported as Parquet, and fleets are read from such files.""",
}
"""Packages decanter-gateway-NAME, by NAME, each with the locked packages of requirements-NAME.lock."""
UNITS = ("decanter.service", "decanter@.service", "system-decanter.slice")
"""The service, that of a group of machines, and what all groups share (systemd puts `decanter@` there by itself)."""
_START = """\
#!/{home}/bin/{python}
# -I: neither the working folder nor the environment of who calls it has a say in what is imported.
import sys

from decanter_gateway.start import main

if __name__ == "__main__":
    sys.exit(main())
"""


def version() -> str:
    """The program's version, which is the package's."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        found: str = tomllib.load(file)["project"]["version"]
    return found


def run(*command: str | Path, **more: str) -> str:
    """A command's standard output. Raises CalledProcessError."""
    done = subprocess.run(
        list(map(str, command)), cwd=ROOT, check=True, text=True, stdout=subprocess.PIPE, env=os.environ | more
    )
    return done.stdout.strip()


def source_date() -> int:
    """The moment of the commit that is built: no file of the package is younger (SOURCE_DATE_EPOCH)."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    return int(given or run("git", "log", "-1", "--format=%ct"))


def fill_environment(tree: Path, work: Path) -> None:
    """The virtual environment in the tree, as if it were made where it will lie."""
    home = tree / HOME
    run(f"/usr/bin/{PYTHON}", "-m", "venv", "--without-pip", "--symlinks", home)
    uv: tuple[str | Path, ...] = (Path(sys.executable).with_name("uv"), "pip", "install", "-q", "--link-mode", "copy")
    uv = (*uv, "--python", home / "bin" / PYTHON)
    run(*uv, "--require-hashes", "-r", ROOT / "requirements.lock")
    wheels = work / "wheel"
    run(
        Path(sys.executable).with_name("uv"),
        "build",
        "-q",
        "--wheel",
        "--no-build-isolation",
        "--python",
        sys.executable,
        "-o",
        wheels,
    )
    run(*uv, "--no-deps", next(wheels.glob("*.whl")))
    # What bears the name of the folder in which it was built, and what nobody calls by name.
    for file in (home / "bin").iterdir():
        if not re.fullmatch(r"python[\d.]*", file.name):
            file.unlink()
    (home / "pyvenv.cfg").write_text("home = /usr/bin\ninclude-system-site-packages = false\n", encoding="utf-8")
    packages = next(home.glob("lib/python*/site-packages"))
    tidy(packages)
    (home / "lib64").unlink(missing_ok=True)
    start = home / "bin/decanter"
    start.write_text(_START.format(home=HOME, python=f"{PYTHON} -I"), encoding="utf-8")
    start.chmod(0o755)
    compile_all(home / "bin" / PYTHON, tree, packages)


def fill_addition(tree: Path, main: Path, name: str) -> None:
    """What an addition brings into the environment of the `main` tree, which is there already."""
    python = main / HOME / "bin" / PYTHON
    packages = tree / HOME / f"lib/{PYTHON}/site-packages"
    uv: tuple[str | Path, ...] = (Path(sys.executable).with_name("uv"), "pip", "install", "-q", "--link-mode", "copy")
    lock = ROOT / f"requirements-{name}.lock"
    run(*uv, "--python", python, "--target", packages, "--no-deps", "--require-hashes", "-r", lock)
    shutil.rmtree(packages / "bin", ignore_errors=True)
    (packages / ".lock").unlink(missing_ok=True)
    tidy(packages)
    compile_all(python, tree, packages)


def tidy(packages: Path) -> None:
    """Take out of a folder of packages what bears the name of where it was built, and what nothing reads."""
    for file in [
        *packages.glob("*.dist-info/direct_url.json"),
        *packages.glob("*.dist-info/RECORD"),
        *packages.glob("*.dist-info/REQUESTED"),
        *packages.glob("*.dist-info/uv_cache.json"),
    ]:
        file.unlink()
    for folder in sorted(packages.rglob("tests")):
        # A third of the size; nothing but these packages' own test runs reads it.
        if folder.is_dir() and folder.relative_to(packages).parts[0] not in ("gateway", "sim", "drivers"):
            shutil.rmtree(folder)


def compile_all(python: Path, tree: Path, packages: Path) -> None:
    """Compile here, under the names that the files will have: nobody may write there once they are installed."""
    compiled = (
        "-m",
        "compileall",
        "-qq",
        "-j",
        "0",
        "--invalidation-mode",
        "unchecked-hash",
        "-s",
        str(tree),
        "-p",
        "/",
    )
    subprocess.run([python, *compiled, packages], check=False)  # some have files for other Pythons


def fill_rest(tree: Path, number: str, date: int) -> None:
    """What is not the environment: command, unit, documents."""
    for source, target, mode in (
        ("decanter.sh", "usr/bin/decanter", 0o755),
        *((unit, f"lib/systemd/system/{unit}", 0o644) for unit in UNITS),
        ("copyright", f"usr/share/doc/{NAME}/copyright", 0o644),
        ("../docs/operations.md", f"usr/share/doc/{NAME}/operations.md", 0o644),
    ):
        place = tree / target
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(DEPLOY / source, place)
        place.chmod(mode)
    entry = f"{NAME} ({number}) stable; urgency=medium\n\n  * See the program's own CHANGELOG.\n\n"
    entry += f" -- {MAINTAINER}  {formatdate(date)}\n"
    with (tree / f"usr/share/doc/{NAME}/changelog.gz").open("wb") as raw:
        raw.write(gzip.compress(entry.encode(), 9, mtime=0))


def control(tree: Path, number: str, addition: str = "") -> str:
    """The control file of the tree as it is; `number` is the package's version, `addition` one of ADDITIONS or ""."""
    size = sum(max(1, -(-file.lstat().st_size // 1024)) for file in tree.rglob("*"))
    name = f"{NAME}-{addition}" if addition else NAME
    needs = f"{NAME} (>= {number})" if addition else ", ".join(DEPENDS)
    wishes = "" if addition else "Recommends: systemd, systemd-timesyncd | time-daemon\n"
    wishes += "".join(f"Suggests: {NAME}-{other}\n" for other in ADDITIONS if not addition)
    return (
        f"Package: {name}\nVersion: {number}\nArchitecture: {architecture()}\n"
        f"Maintainer: {MAINTAINER}\nSection: misc\nPriority: optional\nInstalled-Size: {size}\n"
        f"Depends: {needs}\n{wishes}Description: {ADDITIONS.get(addition, DESCRIPTION)}\n"
    )


def settle(tree: Path, date: int) -> None:
    """Rights that do not depend on who builds, and no file younger than the commit."""
    for path in [tree, *tree.rglob("*")]:
        if not path.is_symlink():
            path.chmod(0o755 if path.is_dir() or path.stat().st_mode & 0o100 else 0o644)
        if path.lstat().st_mtime > date:
            os.utime(path, (date, date), follow_symlinks=False)


def build_addition(out: Path, number: str, name: str) -> Path:
    """Make one of ADDITIONS of this version in the folder `out`, after `build`; gives its file."""
    work, date = out / "work", source_date()
    tree = work / name
    shutil.rmtree(tree, ignore_errors=True)
    tree.mkdir(parents=True)
    fill_addition(tree, work / "tree", name)
    place = tree / f"usr/share/doc/{NAME}-{name}/copyright"
    place.parent.mkdir(parents=True)
    shutil.copyfile(DEPLOY / "copyright", place)
    return packed(tree, out / f"{NAME}-{name}_{number}_{architecture()}.deb", control(tree, number, name), date)


def build(out: Path, number: str) -> Path:
    """Make the program's package of this version in the folder `out`; gives its file."""
    work, date = out / "work", source_date()
    shutil.rmtree(work, ignore_errors=True)
    tree = work / "tree"
    tree.mkdir(parents=True)
    fill_environment(tree, work)
    fill_rest(tree, number, date)
    scripts = sorted((DEPLOY / "maintainer").iterdir())
    return packed(tree, out / f"{NAME}_{number}_{architecture()}.deb", control(tree, number), date, scripts)


def architecture() -> str:
    """Debian's name for this machine's."""
    return run("dpkg", "--print-architecture")


def packed(tree: Path, file: Path, text: str, date: int, scripts: Sequence[Path] = ()) -> Path:
    """The tree as a package with this control file and these maintainer scripts; gives its file."""
    meta = tree / "DEBIAN"
    meta.mkdir()
    (meta / "control").write_text(text, encoding="utf-8")
    for script in scripts:
        shutil.copyfile(script, meta / script.name)
        (meta / script.name).chmod(0o755)
    settle(tree, date)
    run("dpkg-deb", "--root-owner-group", "-Zzstd", "-z6", "--build", tree, file, SOURCE_DATE_EPOCH=str(date))
    return file


def libraries(tree: Path) -> set[str]:
    """The shared libraries that the tree's files need and do not bring along."""
    objects = [file for file in tree.rglob("*.so*") if file.is_file()]
    own = {file.name for file in objects}
    needed = set()
    for file in objects:
        needed |= set(re.findall(r"NEEDED\s+(\S+)", run("objdump", "-p", file)))
    return needed - own


def main(arguments: Sequence[str] | None = None) -> None:
    """Build all packages, or say what a built tree is linked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    parser.add_argument("--version", default=version(), help="of the package  [default: the program's]")
    parser.add_argument("--libraries", action="store_true", help="what the tree that was built last is linked to")
    given = parser.parse_args(arguments)
    if given.libraries:
        print("\n".join(sorted(libraries(given.out / "work/tree"))))
        return
    out = given.out.absolute()
    for file in (build(out, given.version), *(build_addition(out, given.version, name) for name in ADDITIONS)):
        print(f"{file}: {file.stat().st_size / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
