"""A package alone: install it in an empty environment outside the checkout, fly with it, compare with the checkout.

A wheel is installed and flown without a compiler. Of a wheel for another machine, size, files and the kind of its
library are checked.

python tests/tools/wheel.py dist/*.whl
python tests/tools/wheel.py dist/*.tar.gz   the source package, which compiles first: minutes
"""

import json
import os
import platform
import re
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

FLY = """
import json, sys
import jax_aero
from jax_aero import rust
config = rust.load_config("test2")
flight = rust.fly(config)
loaded = sorted(name for name in sys.modules if name in ("jax", "scipy", "xarray", "mujoco"))
print(json.dumps([jax_aero.__file__, rust.config_digest(config), flight.outcome, flight.summary, loaded]))
"""
LARGEST = 10e6
"""Size of a wheel [bytes]: 5.2 MB, and 3.9 MB of the standing robot's records, which do not compress further."""
LIBRARIES = ("jax_aero/_core.abi3.so", "jax_aero/_core.pyd")
"""The compiled module, elsewhere and for Windows."""
KINDS = {"x86_64": b"\x7fELF\x02\x01", "aarch64": b"\x7fELF\x02\x01", "win_amd64": b"MZ", "arm64": b"\xcf\xfa\xed\xfe"}
"""First bytes of the library, by the end of the wheel's name."""
PARTS = {"jax_aero/_core.pyi", "jax_aero/py.typed", "jax_aero/configs/experiments/test2.toml"}
# Those that `make lab` has built.
PARTS |= {str(part.relative_to(ROOT)) for part in (ROOT / "jax_aero/view").glob("*.html")}
PARTS |= {str(part.relative_to(ROOT)) for part in (ROOT / "jax_aero/view").glob("*.xz")}


def check_contents(wheel: Path) -> dict[str, int]:
    """Return the checksums of a wheel's files, by name, without library and metadata."""
    size = wheel.stat().st_size
    assert size <= LARGEST, f"{wheel.name} has {size / 1e6:.1f} MB; expected at most {LARGEST / 1e6:.0f} MB"
    with zipfile.ZipFile(wheel) as archive:
        files = {entry.filename: entry.CRC for entry in archive.infolist()}
        (name,) = files.keys() & LIBRARIES
        module = archive.read(name)
    assert files.keys() >= PARTS, PARTS - files.keys()
    assert {file.partition("/")[0].partition("-")[0] for file in files} == {"jax_aero"}, "other packages"
    (kind,) = [first for end, first in KINDS.items() if wheel.stem.endswith(end)]
    assert module.startswith(kind), f"{wheel.name} has a library for another system"
    assert name.endswith("pyd") == wheel.stem.endswith("win_amd64"), f"{wheel.name} has {name}"
    assert b"PyInit__core" in module, f"{wheel.name} has no module of Python"
    return {file: checksum for file, checksum in files.items() if file != name and ".dist-info/" not in file}


def run(folder: Path, *command: str, path: str = os.environ["PATH"]) -> str:
    """Run a command in a folder; return what it prints."""
    environment = os.environ | {"PATH": path}
    answer = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if answer.returncode:
        sys.exit(f"{' '.join(command)}\n{answer.stdout}{answer.stderr}")
    return answer.stdout


def main(packages: list[Path]) -> None:
    """Check a source package, or wheels, which have the same files."""
    wheels = [package for package in packages if package.suffix == ".whl"]
    assert len({tuple(sorted(check_contents(wheel).items())) for wheel in wheels}) <= 1, "other files"
    for package in packages:
        if package in wheels and not re.search(rf"linux.*{platform.machine()}$", package.stem):
            print(f"{package.name} is for another machine; {package.stat().st_size / 1e6:.1f} MB")
        else:
            fly(package)


def fly(package: Path) -> None:
    """Install a package in an empty environment and fly with it."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "env", with_pip=True)
        python, jax_aero = str(folder / "env/bin/python"), str(folder / "env/bin/jax-aero")
        # Without the cache: pip keeps there what it built of a source package, by the name of the file.
        options = ("--quiet", "--no-compile", "--no-cache-dir", "--disable-pip-version-check")
        pip = (python, "-m", "pip", "install", *options)
        # The source package is compiled.
        path = os.environ["PATH"] if package.suffix == ".gz" else str(Path(python).parent)
        run(folder, *pip, str(package.resolve()), path=path)
        there, here = json.loads(run(folder, python, "-c", FLY)), json.loads(run(ROOT, sys.executable, "-c", FLY))
        assert there[0].startswith(name), there[0]
        assert here[0].startswith(str(ROOT)), here[0]
        assert there[1:] == here[1:], (there, here)
        assert there[4] == [], there[4]
        refused = subprocess.run([jax_aero, "fly", "test2"], cwd=folder, capture_output=True, text=True, check=False)
        assert refused.returncode == 2, refused
        assert "of the extra `figs`: " in refused.stderr, refused
        # What the extras bring is here already; the project itself comes from the new environment, which stands first.
        (site,) = (folder / "env/lib").glob("python*/site-packages")
        (site / "extras.pth").write_text(sysconfig.get_path("purelib"))
        flown = run(folder, jax_aero, "fly", "test2", "--set", "simulator.duration=1")
        assert "results/flight/test2--simulator.duration=1/run.nc" in flown, flown
        drawn = run(folder, jax_aero, "figures", "compare", "--runs", "test2--simulator.duration=1")
        assert f"{folder.resolve()}/results/figures/compare--test2" in drawn, drawn
        for own in ("experiments", "paper_figs"):
            (folder / own).mkdir()
            (folder / own / "__init__.py").write_text("raise ImportError('of a user')")
        assert "test2" in run(folder, python, "-m", "jax_aero", "fly", "--list")
        refused = subprocess.run([jax_aero, "study"], cwd=folder, capture_output=True, text=True, check=False)
        assert refused.returncode == 2, refused
        assert "needs a checkout of the repository" in refused.stderr, refused
    print(f"{package.name} flies test2 as the checkout does ({there[2]}); {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
