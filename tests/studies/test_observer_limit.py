"""The limit of the observer: the linearised loop, and flights on both sides of what it predicts."""

import numpy as np
import pytest

from experiments.studies.observer_limit import study as observer_limit
from jax_aero.base import places
from paper_figs.figures import FIGURES


@pytest.fixture(scope="module")
def config():
    return observer_limit.rust.load_config(observer_limit.EXPERIMENT, observer_limit.SETTINGS)


@pytest.mark.parametrize("inertia", [0.7, 3.0])
def test_without_an_observer_the_limit_is_the_stiffness_of_the_attitude_law(config, inertia, agree):
    """M67: e = (1 + I/c0) d, so that d = k_a e is held up to k_a = c0 / (c0 + I)."""
    found = observer_limit.predicted_limit(config, inertia, 0.0)
    agree("stiffness", found, 50.0 / (50.0 + inertia), 1e-3)


def test_an_observer_raises_it_the_faster_the_more(config):
    limits = [observer_limit.predicted_limit(config, 0.7, gain) for gain in (0.0, 1.0, 3.0, 10.0)]
    assert np.all(np.diff(limits) > 1.0)


@pytest.mark.parametrize("gain", [0.0, 3.0])
def test_a_flight_comes_back_below_the_limit_and_not_above(config, gain):
    """The predicted limit of yaw within 20 %."""
    axis = observer_limit.AXES["yaw"]
    limit = observer_limit.predicted_limit(config, observer_limit.hovering_inertia(config)[axis, axis], gain)
    assert observer_limit.comes_back(config, axis, gain, 0.8 * limit, 12.0)
    assert not observer_limit.comes_back(config, axis, gain, 1.2 * limit, 12.0)


def test_the_couple_is_one(config, agree, measured):
    tick = observer_limit.rust.Flight(config).try_tick()
    wanted = np.array([1.0, -2.0, 3.0])
    forces = observer_limit.couple(tick, wanted)
    measured("total force", np.abs(forces.sum(axis=0)).max(), 1e-12)
    arms = tick.link_arm_points - tick.com_position
    agree("moment", np.cross(arms, forces).sum(axis=0), wanted, 1e-12)


def test_the_result_and_the_figure(tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    document = observer_limit.STUDY.run("hover", {"gains": [3.0], "axes": ["yaw"], "duration": 0.05})
    assert set(document["summary"]) == {f"yaw, K_o 3: {key} [N m/rad]" for key in ("predicted", "flown")}
    name = "hover--axes=yaw--duration=0.05--gains=3.0"
    _, hashes = FIGURES["observer_limit"].draw_from_results(tmp_path / "flight", [name])
    assert hashes == {name: document["config_digest"]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("gains=[1.0, 1.0]", "`gains` is [1.0,1.0]; expected one value or more, each once"),
        ("duration=0.01", "`duration` is 0.01; expected a number ≥ 0.03"),
    ],
)
def test_what_it_cannot_be_made_of_is_named(change, words, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    assert observer_limit.main(["--set", change]) == 2
    assert words in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
