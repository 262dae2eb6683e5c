"""`make`, CI and metadata are consistent, and no file names a path of one machine."""

import os
import re
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

import yaml

import jax_aero

ROOT = Path(__file__).resolve().parents[2]


def make(*arguments: str, status: int = 0) -> str:
    """Return the output of a make that does not know of the one that runs the tests, and so prints no directory."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
    done = subprocess.run(
        ["make", *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == status
    return done.stdout


def test_make_alone_lists_targets_with_what_they_do_and_each_has_a_recipe():
    lines = [re.fullmatch(r"make ([\w-]+) +\S.*", line) for line in make().splitlines()]
    assert make("-n", *(line[1] for line in lines if line))
    assert lines
    assert all(lines)


def test_there_is_one_version():
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"]
    assert {cargo, str(citation)} == {jax_aero.__version__}
    assert metadata.version("jax-aero") == cargo


def test_the_recipe_for_conda_has_the_version_and_the_packages_of_the_project():
    recipe = yaml.safe_load((ROOT / ".ci/conda/recipe.yaml").read_text(encoding="utf-8"))
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = table["project"]
    assert recipe["context"]["version"] == jax_aero.__version__

    def separate_names(requirements):
        return {re.sub(r"^([\w-]+)(?=[<>=])", r"\1 ", one) for one in requirements}

    runs_with = separate_names([*project["dependencies"], f"python{project['requires-python']}"])
    assert set(recipe["requirements"]["run"]) == runs_with
    assert separate_names(table["build-system"]["requires"]) <= set(recipe["requirements"]["host"])
    assert recipe["about"]["license"] == project["license"]
    assert recipe["about"]["license_file"] == project["license-files"]
    assert recipe["about"]["summary"] == project["description"]


def test_every_requirement_is_pinned_by_version_alone():
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
    assert [line for line in lock if not re.fullmatch(r"[\w.-]+==[\w.!+]+", line)] == []
    pinned = {re.sub(r"[-_.]+", "-", line.split("==")[0]).lower() for line in lock}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    # The solvers of `bench` are not among the pinned packages.
    wanted = [*project["dependencies"], *(one for extra in extras.keys() - {"bench"} for one in extras[extra])]
    names = {re.split(r"[\[<>=!~ ]", requirement)[0].lower() for requirement in wanted} - {"jax-aero"}
    assert names <= pinned


def tracked_files() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def test_no_file_names_a_machine_a_package_host_or_a_folder_beside_the_project():
    folders = "|".join(("work", "root", "home", "Users", "opt", "mnt", "srv"))
    machine = re.compile(rf"(?<![\w.}}\])*-])/({folders})/\w")
    hosts = "|".join(("py" + r"pi\.", "python" + "hosted", "artifac" + "tory", "index" + "-url", "find" + "-links"))
    patterns = [machine, re.compile(hosts), re.compile(r"\.\./sha" + r"red|\"sha" + r"red\"")]
    found = []
    for path in tracked_files():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        # Cargo writes the name of the public registry into its lock; any other source would be a private one.
        if path.name == "Cargo.lock":
            sources = set(re.findall(r'source = "(.*)"', text))
            assert len(sources) == 1
            assert sources.pop().endswith("crates.io-index")
        matches = [pattern.search(text) for pattern in patterns]
        found += [f"{path.relative_to(ROOT)}: {match[0]}" for match in matches if match]
    assert found == []
