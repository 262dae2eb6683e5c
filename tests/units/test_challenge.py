"""The challenge: a controller is given what is measured alone, and one that does nothing or fails has no score."""

import gc
import hashlib
import json

import pytest
from msgspec import structs

from jax_aero import own, rust
from jax_aero.base.terminal import Refused
from jax_aero.commands import challenge
from jax_aero.stored import kept
from jax_aero.sweep import table
from jax_aero.sweep.design import Design
from jax_aero.sweep.spec import Level

OWN = """
import gc, sys
import numpy as np

def nothing(seen):
    return [0.0] * 4, [0.0] * len(seen.state.joint_position)

def raises(seen):
    return nothing(seen) if seen.time < 0.05 else None

def shows(seen):
    return [*seen.state.base_position, 0.0], nothing(seen)[1]

def peeks(seen):
    frame, found = sys._getframe(), [one for one in gc.get_objects() if type(one).__name__ == "Flight"]
    while frame:
        found += [one for one in frame.f_locals.values() if hasattr(one, "truth")]
        frame = frame.f_back
    if found:
        raise RuntimeError(f"the true height is {found[0].truth.state.base_position[2]}")
    return nothing(seen)
"""


@pytest.fixture
def tasks(tmp_path):
    """The tasks of a sweep that a controller of the file above flies once, but for those without some words."""
    file = tmp_path / "own.py"
    file.write_text(OWN, encoding="utf-8")

    def make(name, *words, robot="mk1"):
        (found,) = challenge.specs(robot, challenge.level_of(f"{file}:{name}", name))
        axis = found.axis[1]
        chosen = tuple(level for level in axis.levels if not words or any(word in level.label for word in words))
        axis = structs.replace(axis, level=chosen)
        return structs.replace(found, axis=(found.axis[0], axis), repeats=1)

    return make


def digest(tasks):
    """Of all that flies and acts in the flights of tasks, in nine digits, since sines differ between machines."""

    def rounded(value):
        if isinstance(value, dict):
            return {key: rounded(inner) for key, inner in value.items()}
        return (
            [*map(rounded, value)] if isinstance(value, list) else (f"{value:.9g}" if type(value) is float else value)
        )

    design = Design(tasks)
    flown = [rounded(design.row_config(row)) for row in sorted(range(design.n_rows), key=design.place)]
    hashes = [table.config_hash({key: config[key] for key in config.keys() - OF_CONTROLLER}) for config in flown]
    return hashlib.sha256(" ".join(hashes).encode()).hexdigest()[:16]


OF_CONTROLLER = {"controller", "own_controller"}


@pytest.mark.parametrize(("robot", "frozen"), [("mk1", "dfad751afb6783da"), ("mk3", "a6193870d00c1f83")])
def test_the_tasks_of_this_version_are_frozen(robot, frozen):
    """What changes a flight makes it wind-humanoid-2; a new key that changes none, another digest here."""
    published, other = challenge.specs(robot, Level(label="any"), seed=7)
    assert digest(published) == frozen
    assert digest(other) != frozen


@pytest.mark.parametrize("robot", challenge.TASKS)
def test_what_is_drawn_and_what_acts_is_not_given(tasks, robot):
    """All flights of a task are given the same, and tasks differ by engines and the length of the flight alone."""
    whole = structs.replace(tasks("nothing", robot=robot), repeats=3)
    design, of_engines = Design(whole), {}
    flying = rust.Robot(design.row_config(0)["robot"])
    for cell in range(len(design.cells)):
        given = [own.view(design.row_config(repeat * len(design.cells) + cell), flying) for repeat in range(3)]
        assert given[1:] == given[:-1]
        given[0]["simulator"].pop("duration")
        assert of_engines.setdefault(given[0]["simulator"]["jets"]["dynamics"], given[0]) == given[0]
    assert len({rust.config_digest(design.row_config(row)) for row in range(design.n_rows)}) == design.n_rows


def test_what_is_given_suffices_for_a_controller_of_ours(tasks):
    config = Design(tasks("nothing")).row_config(0)
    rust.Controller(own.view(config, rust.Robot(config["robot"])))


def test_a_controller_sees_what_is_measured(tasks):
    config = Design(tasks("shows", "turbulence")).row_config(0)
    flown = rust.fly(config)
    assert (flown["thrust_rate"][:, :3] == flown["raw_base_position"]).all()
    assert (flown["raw_base_position"] != flown["base_position"]).any(axis=1).all()


def test_a_controller_cannot_reach_the_simulator(tasks):
    """In the simulator's own process the same controller does."""
    config = Design(tasks("peeks", "turbulence")).row_config(0)
    rust.fly(config)
    scope: dict = {}
    exec(OWN, scope)
    with pytest.raises(RuntimeError, match="the true height is"):
        rust.Flight(config, controller=scope["peeks"]).run()
    gc.collect()


def test_a_controller_that_does_nothing_completes_nothing(tasks, tmp_path):
    document = challenge.fly(tasks("nothing"), 1, tmp_path)
    assert len(document.outcomes) > 1
    assert sum(document.outcomes[end] for end in ("completed", "landed")) == 0


def test_a_controller_that_fails_has_no_score(tasks, tmp_path):
    found = tasks("raises")
    with pytest.raises(Refused, match=r"the first flight could not be flown, so .* no score: own controller at 0.05 s"):
        challenge.fly(found, 1, tmp_path)
    assert not (tmp_path / found.name).exists()


def test_other_seeds_are_other_flights(tasks):
    published = tasks("nothing", "turbulence")
    first, other = challenge.specs("mk1", published.axis[0].levels[0], seed=7)
    assert (first.seed, other.seed, other.axis[0].levels[0].label) == (published.seed, 7, "nothing, seed 7")
    assert Design(first).row_config(0) != Design(other).row_config(0)


def test_a_configuration_flies_the_robot_that_it_is_for():
    (mk1, mk3), own_mk3 = (
        [challenge.level_of(name, name, robot) for robot in challenge.TASKS] for name in ("robot", "baseline")
    )
    assert mk1.set["controller"] == rust.load_controller("robot")
    assert mk3.set["controller"] == rust.load_controller("mk3_robot")
    assert own_mk3[1] is None
    assert challenge.level_of("mk3_robot", "mine") is None


def test_results_are_shown_beside_the_shipped_ones(tasks, tmp_path, monkeypatch):
    mine = challenge.fly(tasks("nothing", "push"), 1, tmp_path)
    axes = [structs.replace(mine.axes[0], levels=["shipped"]), mine.axes[1]]
    shipped = structs.replace(mine, axes=axes, rows=[["shipped", *row[1:]] for row in mine.rows])
    monkeypatch.setattr(kept, "read", lambda _: shipped)
    both = challenge.beside("mine", {"wind_humanoid_1": [mine]}, {})
    headings, rows = kept.page_table(both)
    assert [row[0] for row in rows] == ["shipped", "nothing"]
    assert [row[headings.index("share completed + landed")] for row in rows] == ["0 % (0 to 79)"] * 2


SMALL = """
title = "small"
base = "robot"
drawing = "levels"
panels = "controller"
set = { "simulator.duration" = 0.1 }
axis = [{ name = "controller", level = [{ label = "ours" }] }, { name = "task", level = [{ label = "hover" }] }]
"""


def test_the_command_prints_a_table_and_writes_picture_and_figures(tasks, tmp_path, monkeypatch, capsys):
    (tmp_path / "small.toml").write_text(SMALL, encoding="utf-8")
    monkeypatch.setattr(challenge, "TASKS", {"mk1": str(tmp_path / "small.toml")})
    monkeypatch.setattr(challenge, "TIMED", 0.1)
    none = structs.replace(kept.read("wind_humanoid_1"), rows=[])
    monkeypatch.setattr(kept, "read", lambda _: none)
    for controller, name in ((f"{tmp_path / 'own.py'}:nothing", "nothing"), ("observer", "mine")):
        words = [controller, "--seed", "7", "--out", str(tmp_path), "--workers", "1", "--name", name]
        assert challenge.main(words) == 0
        said = capsys.readouterr().out
        assert [f"{name}, seed 7" in said, "100 % (21 to 100)" in said] == [True, True]
        found = json.loads((tmp_path / name / f"{name}.json").read_text(encoding="utf-8"))
        assert list(found["summary"]) == ["ours", name]
        assert (found["seed"], found["command"]) == (7, f"jax-aero challenge {controller} --seed 7")
        assert 0.0 < found["summary"][name]["time of a tick, median [ms]"] < 1e3
        assert (tmp_path / name / f"{name}.webp").read_bytes().startswith(b"RIFF")
