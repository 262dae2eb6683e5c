"""Every file that is shipped with everything that can be done with it, found from folders and from the command line.

A file of `configs`, a study or a command that is added enters by itself. A kind of file without an action fails.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from experiments.tools import schema
from jax_aero import cli, rust
from jax_aero.base import places, tables
from jax_aero.base.typed_config import scenario_config
from jax_aero.figures.catalogue import FIGURES
from jax_aero.identify import samples
from jax_aero.refusals import refused
from jax_aero.sweep import spec
from jax_aero.sweep.design import Design
from jax_aero.verify import library

SHORT = 0.2
"""Duration of a flight without a fault [s]."""
AFTER = 0.5
"""How long a flight goes on after its last fault has begun [s]."""
BEGINS = {"time", "start"}
"""Keys of `disturbances` that say when a fault begins."""


@dataclass(frozen=True)
class Answer:
    """Exit status of a command, and what it printed."""

    words: tuple[str, ...]
    status: int
    text: str


@dataclass(frozen=True)
class Pair:
    """A shipped file and what is done with it."""

    kind: str
    name: str
    action: str

    def __str__(self) -> str:
        return f"{self.kind}/{self.name}: {self.action}"


class Refused(Exception):
    """A command was refused by a sentence."""


def run(*words: object) -> Answer:
    """Run a command of `jax-aero` in this process; a traceback is raised."""
    texts = tuple(map(str, words))
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            status = cli.main(texts)
        except SystemExit as end:
            status = int(end.code or 0)
    return Answer(texts, status, out.getvalue() + errors.getvalue())


def do(*words: object, table: bool = False) -> Answer:
    """Run a command that works, or with `table` ends with status 1 and a table.

    Raises
    ------
    Refused
        If it was refused by a sentence.
    AssertionError
        If it ended in any other way, or printed a traceback.
    """
    answer = run(*words)
    assert "Traceback" not in answer.text, answer
    if answer.status == cli.REFUSED:
        # Whole sentences that name what is wrong, in backquotes, as KEY is VALUE, or with an expectation.
        assert re.search(r"`[^`]+`|expected| is | has ", answer.text), answer
        raise Refused(answer.text.strip())
    assert answer.status == 0 or (table and answer.status == 1 and answer.text.count("\n") > 1), answer
    return answer


def shortest(config: Mapping[str, Any]) -> float:
    """Return how long a flight takes to show itself [s]: until its last fault has lasted for `AFTER`, or `SHORT`."""

    def begins(value: Any, key: str = "") -> Iterator[float]:
        if isinstance(value, Mapping):
            for name, entry in value.items():
                yield from begins(entry, name)
        elif isinstance(value, list):
            for entry in value:
                yield from begins(entry, key)
        elif key in BEGINS and isinstance(value, (int, float)):
            yield float(value)

    last = max(begins(config["disturbances"]), default=None)
    wished = SHORT if last is None else last + AFTER
    return min(wished, float(config["simulator"]["duration"]))


def check_figures(folder: Path) -> None:
    """No figure of merit of a flight is NaN, unless the flight does not have it."""
    document = json.loads((folder / places.MANIFEST_FILE).read_text())
    for name, value in document["summary"].items():
        assert not (isinstance(value, float) and math.isnan(value)), f"{folder.name}: {name} is {value}"


class Flights:
    """Flights that several actions use, each flown once into a folder of this process."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.flown: dict[str, Path | Refused] = {}

    def flight(self, name: str, *more: object, least: float = 0.0) -> Path:
        """Return the result of a short flight of an experiment, of some seconds at least."""
        key = " ".join(map(str, (name, *more, *([least] if least else []))))
        if key not in self.flown:
            out = self.place / "flight" / places.addition(places.file_name(key))
            duration = max(least, shortest(rust.load_config(name if not name.endswith(".toml") else Path(name))))
            words = ("fly", name, "--set", f"simulator.duration={duration}", "--name", "run", "--out", out, *more)
            try:
                do(*words)
                check_figures(out / "run")
                self.flown[key] = out / "run"
            except Refused as refusal:
                self.flown[key] = refusal
        found = self.flown[key]
        if isinstance(found, Refused):
            raise found
        return found

    def path(self, pair: str, name: str) -> Path:
        """Return a path that no other action uses."""
        folder = self.place / places.file_name(pair)
        folder.mkdir(exist_ok=True, parents=True)
        return folder / name


Action = Callable[[Flights, str], object]
ACTIONS: dict[str, dict[str, Action]] = {}
"""What can be done with a file, by the folder of `configs` that it is in, and name."""
NIGHTLY: set[str] = set()
"""Actions that compile JAX programs."""


def action(*kinds: str, jax: bool = False) -> Callable[[Action], Action]:
    """Enter a function as an action on kinds of files; its name is that of the action."""

    def enter(function: Action) -> Action:
        for kind in kinds:
            ACTIONS.setdefault(kind, {})[function.__name__] = function
        if jax:
            NIGHTLY.add(function.__name__)
        return function

    return enter


@action("experiments")
def fly(flights: Flights, name: str) -> None:
    """Fly it with its own back end."""
    flights.flight(name)


@action("verify")
def fly_file(flights: Flights, name: str) -> None:
    """Fly what `jax-aero verify` compares beside every flight."""
    flights.flight(str(places.CONFIGS / "verify" / f"{name}.toml"))


@action("experiments")
def replay(flights: Flights, name: str) -> None:
    """Replay its own log to the last bit."""
    answer = do("replay", flights.flight(name))
    assert "equal to the last bit" in answer.text, answer


def exported(flights: Flights, name: str, suffix: str, *words: str) -> Path:
    """Return a flight in another format."""
    path = flights.path(f"{name}{suffix}", f"flight{suffix}")
    if not path.exists():
        do("export", flights.flight(name), *words, "--out", path)
    return path


@action("experiments")
def export_html(flights: Flights, name: str) -> None:
    """Export it as a page."""
    exported(flights, name, ".html", "--html")


@action("experiments")
def export_ros2(flights: Flights, name: str) -> None:
    """Export it as messages of ROS 2."""
    exported(flights, name, ".ros2.mcap", "--mcap", "--profile", "ros2")


@action("experiments")
def export_mcap(flights: Flights, name: str) -> None:
    """Export it as MCAP, and replay that."""
    replayed(flights, name, ".mcap", "--mcap")


@action("experiments")
def export_csv(flights: Flights, name: str) -> None:
    """Export it as CSV, and replay that."""
    replayed(flights, name, ".csv", "--csv")


@action("experiments")
def export_mat(flights: Flights, name: str) -> None:
    """Export it for MATLAB, and replay that."""
    replayed(flights, name, ".mat", "--mat")


def replayed(flights: Flights, name: str, suffix: str, *words: str) -> None:
    path = exported(flights, name, suffix, *words)
    changes = ("--set", f"simulator.duration={shortest(rust.load_config(name))}")
    do("replay", path, "--experiment", name, *changes, table=True)


@action("experiments")
def export_config(flights: Flights, name: str) -> None:
    """Export all files that it needs, and fly from there."""
    out = flights.path(f"{name} folder", "files")
    do("export", name, "--config", "--out", out)
    (file,) = [path for path in out.rglob(f"{name}.toml") if path.parent.name == "experiments" or path.parent == out]
    flights.flight(str(file))


@action("experiments")
def compare(flights: Flights, name: str) -> None:
    """Draw it."""
    do("figures", "compare", "--runs", flights.flight(name), "--out", flights.path(f"{name} figure", "figures"))


@action("experiments")
def snapshot(flights: Flights, name: str) -> None:
    """Draw its robot."""
    out = flights.path(f"{name} snapshot", "flight.png")
    words = ["--renderer", "pillow", "--size", "160x120", "--at", "0.1", "--out"]
    do("view", "snapshot", flights.flight(name), *words, out)


@action("experiments", jax=True)
def identify(flights: Flights, name: str) -> None:
    """Find numbers in a log as short as it may be; the missions of those on the ground lift off within five seconds."""
    is_on_ground = bool(rust.load_config(name)["simulator"].get("ground"))
    flight = flights.flight(name, least=2.0 * samples.SETTLING + samples.LEAST + 0.1 + 5.0 * is_on_ground)
    do("identify", flight, "--out", flights.path(f"{name} identified", "numbers"), table=True)


@action("experiments", jax=True)
def fly_jax(flights: Flights, name: str) -> None:
    """Fly it with JAX."""
    flights.flight(name, "--backend", "jax")


@action("experiments", jax=True)
def verify(flights: Flights, name: str) -> None:
    """Compare the crate with JAX in it."""
    few = ("--set", f"simulator.duration={shortest(rust.load_config(name))}", "--states", "3")
    do("verify", "--config", name, *few, "--out", flights.path(f"{name} verified", "verify"))


@action("experiments")
def embed(flights: Flights, name: str) -> None:
    """Let the C library compute its commands."""
    del flights
    config = rust.load_config(name)
    config = rust.set_keys(config, {"simulator.duration": shortest(config)})
    if (path := library.find()) is None:
        pytest.skip(f"libflight is missing: {library.BUILD}")
    assert all(row.agrees for row in library.verify_library(config, path)), name


@action("control")
def replay_with(flights: Flights, name: str) -> None:
    """Let a controller replay a log of a robot that it fits."""
    robot = "mk3_hover" if name.startswith("mk3") else "platform_hover" if name.startswith("platform") else "test2"
    do("replay", flights.flight(robot), "--controller", name, table=True)


@action("robot")
def air(flights: Flights, name: str) -> None:
    """Compute the force of the air on a robot."""
    do("air", "--robot", name, "--posture", "zero", "--out", flights.path(f"{name} air", "air"))


@action("networks")
def fly_network(flights: Flights, name: str) -> None:
    """Fly TEST2 in the air of a network, which is the controller's model too."""
    card, model = NETWORKS / f"{name}.json", places.find("aero", "network")
    flights.flight("test2", *(word for part in AIRS for word in ("--set", f'{part}={{base="{model}",card="{card}"}}')))


@action("figures")
def draw(flights: Flights, name: str) -> None:
    """Draw a figure, or say which results it lacks."""
    out = flights.path(f"{name} figures", "out")
    named = ("--runs", flights.flight("test2")) if FIGURES[name].is_of_any else ()
    answer = run("figures", name, *named, "--results", out, "--out", out)
    lacks = answer.status == 1 and re.search(r"no \w+ `.+` in .+ with: ", answer.text)
    assert answer.status == 0 or lacks, answer


NETWORKS = places.CONFIGS / "aero" / "networks"
AIRS = ("simulator.aero", "controller.aero")


@action("mission", "wind")
def fly_in(flights: Flights, name: str) -> None:
    """Fly TEST2 with another mission or wind."""
    kind = "mission" if name in places.names("mission") else "wind"
    robot = "mk3_min_jerk" if name.startswith("mk3") else "test2"
    flights.flight(robot, "--set", f'{kind}={{base="{places.find(kind, name)}"}}')


@action("aero")
def fly_with(flights: Flights, name: str) -> None:
    """Fly TEST2 in the air of another model."""
    flights.flight("test2", "--set", f'simulator.aero={{base="{places.find("aero", name)}"}}')


@action("sweeps")
def fly_row(flights: Flights, name: str) -> None:
    """Fly the first row of a sweep."""
    out = flights.path(f"{name} row", "row")
    duration = shortest(Design(spec.load(name)).row_config(0))
    do("fly", "--row", name, "0", "--set", f"simulator.duration={duration}", "--out", out, "--name", "run")
    check_figures(out / "run")


@action("waypoints")
def waypoints(flights: Flights, name: str) -> None:
    """Make a mission of waypoints, and fly it."""
    out = flights.path(f"{name} waypoints", "mission")
    do("robot", "waypoints", name, "--out", out)
    flights.flight(str(next(out.rglob(f"{name}.toml"))))


@action("studies")
def help_of(flights: Flights, name: str) -> None:
    """Say what a study does."""
    del flights
    do("study", name, "--help")


@action("onboard")
def export_onboard(flights: Flights, name: str) -> None:
    """Export what runs on board, and read it as a controller does."""
    out = flights.path(f"{name} onboard", "files")
    do("export", name, "--config", "--out", out)


@action("commands")
def explain(flights: Flights, name: str) -> None:
    """Say what a command does."""
    del flights
    do(*name.split(), "--help")


def reading(kind: str) -> Action:
    """Return the action that reads a file as its command does."""

    def read(flights: Flights, name: str) -> None:
        del flights
        tables.load(places.find(kind, name), schema.TYPES[kind])

    return read


for of_python in ("cfd", "cfd_flow", "perturbation", "training", "training_flights", "training_search"):
    action(of_python)(reading(of_python))


@action("simulator", "law", "engines", "tables")
def belong(flights: Flights, name: str) -> None:
    """A part of a configuration is named by a file that is flown or by a command."""
    del flights
    sources = [path for top in USERS for path in top.rglob("*") if path.suffix in {".toml", ".py"}]
    assert any(re.search(rf"\b{name}\b", path.read_text()) for path in sources if path.stem != name)


USERS = (places.CONFIGS, places.HOME / "jax_aero", places.HOME / "experiments")


@cache
def shipped() -> dict[str, list[str]]:
    """Return the names of all that is shipped, by kind."""
    kinds = {path.name: places.names(path.name) for path in sorted(places.CONFIGS.iterdir()) if path.is_dir()}
    kinds = {kind: names for kind, names in kinds.items() if names}
    cards = [path.relative_to(NETWORKS).with_suffix("") for path in NETWORKS.rglob("*.json")]
    return {
        **kinds,
        "commands": sorted(cli.COMMANDS),
        "figures": sorted(FIGURES),
        "networks": sorted(str(path) for path in cards if path.name != "ensemble"),
        "studies": sorted(path.parent.name for path in places.STUDIES.glob("*/study.py")),
    }


def first() -> list[Pair]:
    """Return one pair of each file and each command."""
    return [Pair(kind, name, next(iter(ACTIONS[kind]))) for kind, names in shipped().items() for name in names]


def others() -> list[Pair]:
    """Return all other pairs."""
    return [
        Pair(kind, name, done)
        for kind, names in shipped().items()
        for name in names
        for done in list(ACTIONS[kind])[1:]
    ]


def refused_keys(pair: Pair) -> list[str]:
    """Return the keys by which a pair is to be refused: those of `jax_aero.refusals`."""
    if pair.action not in {"fly_jax", "verify"}:
        return []
    config = scenario_config(rust.load_config(pair.name))
    # Of what JAX does not fly, `verify` compares the law alone, if it has that.
    is_refused = refused(config, of_law=pair.action == "verify")
    return [refusal.key for refusal in refused(config)] if is_refused else []


def check(flights: Flights, pair: Pair) -> None:
    """Do it; a pair is refused exactly if it is listed, by a key that is responsible."""
    keys, said = refused_keys(pair), ""
    try:
        ACTIONS[pair.kind][pair.action](flights, pair.name)
    except Refused as refusal:
        said = str(refusal)
    assert bool(said) == bool(keys), said or f"{pair} works, though {keys} are listed"
    assert not said or any(key in said for key in keys), said
