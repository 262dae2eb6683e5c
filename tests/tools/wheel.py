"""A package alone: install it in an empty environment outside the checkout, fly with it, compare with the checkout.

python tests/tools/wheel.py dist/*.whl
python tests/tools/wheel.py dist/*.tar.gz   the source package, which compiles first: minutes
"""

import json
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
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


def run(folder: Path, *command: str) -> str:
    """Run a command in a folder; return what it prints."""
    answer = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if answer.returncode:
        sys.exit(f"{' '.join(command)}\n{answer.stdout}{answer.stderr}")
    return answer.stdout


def main(package: str) -> None:
    """Check a wheel or a source package."""
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "env", with_pip=True)
        python, jax_aero = str(folder / "env/bin/python"), str(folder / "env/bin/jax-aero")
        # Without the cache: pip keeps there what it built of a source package, by the name of the file.
        options = ("--quiet", "--no-compile", "--no-cache-dir", "--disable-pip-version-check")
        pip = (python, "-m", "pip", "install", *options)
        run(folder, *pip, str(Path(package).resolve()))
        there, here = json.loads(run(folder, python, "-c", FLY)), json.loads(run(ROOT, sys.executable, "-c", FLY))
        assert there[0].startswith(name), there[0]
        assert here[0].startswith(str(ROOT)), here[0]
        assert there[1:] == here[1:], (there, here)
        assert there[4] == [], there[4]
        refused = subprocess.run([jax_aero, "fly", "test2"], cwd=folder, capture_output=True, text=True, check=False)
        assert refused.returncode == 2, refused
        assert "pip install 'jax-aero[figs]'" in refused.stderr, refused
        # What the extras bring is here already; the project itself comes from the new environment, which stands first.
        (site,) = (folder / "env/lib").glob("python*/site-packages")
        (site / "extras.pth").write_text(sysconfig.get_path("purelib"))
        flown = run(folder, jax_aero, "fly", "test2", "--set", "simulator.duration=1")
        assert "results/flight/test2--simulator.duration=1/run.nc" in flown, flown
        drawn = run(folder, jax_aero, "figures", "fig2", "supp_mesh")
        assert f"{folder.resolve()}/results/figures/fig2.pdf" in drawn, drawn
    print(f"{Path(package).name} flies test2 as the checkout does ({there[2]}); {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main(sys.argv[1])
