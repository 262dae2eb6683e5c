"""Margins: sizes and keys of errors, the bisection, what is said of it, and a run that goes on."""

import numpy as np
import pytest

from experiments.studies.margins import figure
from experiments.studies.margins import study as margins
from jax_aero import rust
from jax_aero.base import tables
from jax_aero.base.keys import parts
from jax_aero.base.terminal import ConfigError
from jax_aero.results.identity import Identity
from jax_aero.results.study import find
from jax_aero.results.work import Work
from jax_aero.sweep.perturbation import Perturbation

IN_SI = {"N m": 1.0, "s": 1.0, "times": 1.0, "%": 0.01, "°": np.pi / 180.0, "ms": 1e-3, "kg": 9.81}
"""What a key changes by for a change of the size by one unit; a payload's weight."""
SHIPPED = {name: tables.load(find("margins", name), margins.Margins) for name in ("flight", "take_off")}


def numbers(config):
    return {key: value for key, value in parts(config) if isinstance(value, float)}


@pytest.mark.parametrize("name", SHIPPED)
def test_an_error_begins_at_the_values_of_its_experiments(name):
    asked = SHIPPED[name]
    for flown in asked.flown:
        config = rust.load_config(flown.experiment)
        for error in asked.error:
            changed = numbers(rust.set_keys(config, error.keys(0.0)))
            assert {key: changed[key] for key in numbers(config)} == numbers(config)


@pytest.mark.parametrize("error", SHIPPED["flight"].error, ids=lambda error: error.name)
def test_the_size_of_an_error_is_that_of_its_keys(error):
    first, last = (numbers(error.keys(share)) for share in (0.25, 0.75))
    moved = {abs(last[key] - first[key]) for key in first if first[key] != last[key]}
    assert len(set(np.round(list(moved), 9))) == 1
    assert moved.pop() == pytest.approx((error.size(0.75) - error.size(0.25)) * IN_SI[error.unit], rel=1e-4)


@pytest.mark.parametrize("edge", [0.02, 0.3, 0.5, 0.77, 1.0])
def test_a_bisection_ends_near_the_edge(edge):
    flown = margins.bisected(lambda share: 1.0 if share >= edge else 0.4, 8, 0.125)
    above = min(share for share in flown if share >= edge)
    below = max((share for share in flown if share < edge), default=0.0)
    assert below < edge <= above
    assert above - below <= max(0.125 * above, 0.5**8)
    assert len(flown) == len(set(flown)) <= 9


def test_an_error_that_loses_less_than_half_has_no_edge():
    assert margins.bisected(lambda _: 0.49, 8, 0.125) == [1.0]


def test_keys_of_both_ends_are_the_same():
    with pytest.raises(ConfigError, match="most"):
        margins.Error(name="a", unit="s", sizes=tables.Interval(0.0, 1.0), none={"a": 0.0}, most={"b": 1.0})


def _flights(lost, count=4, before=0.5):
    """Flights of which so many fall at 5 s, some time after the tracking error begins."""
    outcome = ["fell"] * lost + ["completed"] * (count - lost)
    columns = margins.aggregate.populations.QUANTITIES
    falls = np.array(outcome) == "fell"
    values = {name: np.zeros(count) for name in columns} | {
        "outcome": outcome,
        "lost_time": np.where(falls, 5.0, np.nan),
        "warning_time": np.where(falls, before, 0.0),
        "degraded_time": np.where(falls, before, 0.0),
        "all_modes": np.where(falls, rust.MODES["tracking_error"], 0),
    }
    return {name: np.asarray(value).tolist() for name, value in values.items()}


ERROR = margins.Error(name="lag", unit="s", sizes=tables.Interval(0.0, 8.0), none={"lag": 0.0}, most={"lag": 8.0})


def test_an_edge_is_that_between_the_sizes_beside_it_and_losses_above_it_have_a_warning():
    flown = {1.0: _flights(4), 0.5: _flights(1), 0.75: _flights(3, before=0.2)}
    line = margins.found(ERROR, flown)
    assert line["half lost from"] == "4 to 6 s"
    assert (line["lost"], line["unwarned"], line["announced [s]"]) == ("3 of 4", 3, 0.2)
    assert line["modes"] == "tracking_error"
    assert margins.found(ERROR, {1.0: _flights(1)}) == {"half lost from": "> 8 s"}


def test_a_run_that_was_interrupted_flies_nothing_twice(monkeypatch, tmp_path):
    flown = []

    def fly(asked, config, changes):
        flown.append(share := changes.get("disturbances.jets.lag", 0.0) / 8.0)
        return _flights(4 if share > 0.3 else 0)

    monkeypatch.setattr(margins, "fly", fly)
    asked = margins.Margins(
        title="",
        flown=(margins.Flown(label="a", experiment="robot"),),
        error=(
            margins.Error(
                name="lag",
                unit="s",
                sizes=tables.Interval(0.0, 8.0),
                none={"disturbances.jets.lag": 0.0},
                most={"disturbances.jets.lag": 8.0},
            ),
        ),
        perturbation=Perturbation(),
        accuracy=0.25,
    )
    work = Work.on(tmp_path / "of", Identity.of({}, []))
    first = margins.compute("", asked, work)
    count = len(flown)
    again = margins.compute("", asked, work)
    assert flown[:count] == [0.0, 1.0, 0.5, 0.25, 0.375, 0.3125]
    assert len(flown) == count
    assert first.summary == again.summary
    sizes = first.dataset["size"].sel(flown="a", error="lag").values
    assert sizes[: count - 1].tolist() == [2.0, 2.5, 3.0, 4.0, 8.0]
    assert np.isnan(sizes[count - 1 :]).all()
    assert len(figure.draw(first.dataset, first.dataset.assign_coords(flown=["b"])).axes) == figure.COLUMNS


def test_robots_with_an_error_are_the_same_at_every_size_and_are_lost_where_it_is_great():
    asked = margins.Margins(**{key: getattr(SHIPPED["flight"], key) for key in ("title", "flown", "error")},
                            perturbation=SHIPPED["flight"].perturbation, robots=2)  # fmt: skip
    config = rust.load_config("robot", {"simulator.duration": 6.0})
    late = next(error for error in asked.error if error.name == "torques later than known")
    assert margins.share_lost(margins.fly(asked, config, late.keys(0.0))) == 0.0
    assert margins.share_lost(margins.fly(asked, config, late.keys(1.0))) == 1.0
