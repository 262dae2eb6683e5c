"""Signals and figures are declared in the crate; what others write down of them is equal to the declaration."""

from __future__ import annotations

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.rust import MODES
from jax_aero.sim.batch import condense


@pytest.fixture(scope="module")
def flight():
    return rust.fly(rust.load_config("test2", {"simulator.duration": 4.0}))


def test_a_log_and_its_condensed_form_have_the_figures_of_the_flight(flight):
    """The same names in the same order, the same numbers but for the order of sums."""
    assert rust.summarise(flight.log, flight.joint_setpoint) == flight.summary
    found = rust.summarise(condense(flight.log, flight.joint_setpoint), [0.0])
    declared = [name for name, figure in rust.figures().items() if not figure.is_of_ground]
    assert list(found) == list(flight.summary) == declared
    for name, value in flight.summary.items():
        # Sums of 5000 squares, of 23 joints and of 13 links: some hundred roundings at most.
        assert found[name] == pytest.approx(value, rel=1e-13, abs=1e-15), name


@pytest.mark.parametrize("missing", sorted({*rust.summarised()} - {"time", "feet_carry", "foot_wrench"}))
def test_figures_of_a_log_that_lacks_a_signal_are_unknown(flight, missing):
    """Not a least thrust of 0 N: each figure is that of the whole log, or NaN, and some are NaN."""
    log = {name: values for name, values in flight.log.items() if name != missing}
    found = rust.summarise(log, flight.joint_setpoint)
    unknown = {name for name, value in found.items() if np.isnan(value)}
    assert unknown
    assert {name: found[name] for name in found if name not in unknown} == {
        name: value for name, value in flight.summary.items() if name not in unknown
    }
    expected = {"thrust": {"thrust_min", "thrust_max"}, "joint_torque": {"max_torque"}}
    assert unknown == expected.get(missing, unknown)


def test_a_log_without_times_is_refused(flight):
    log = {name: values for name, values in flight.log.items() if name != "time"}
    with pytest.raises(ValueError, match=r"has shape \[401.*\]; expected \[0"):
        rust.summarise(log, flight.joint_setpoint)


def test_batches_keep_every_signal_of_a_figure(flight):
    """Not by a list of their own: a signal that a new figure reads is kept too."""
    assert set(rust.summarised()) & {*flight.log} <= set(condense(flight.log, flight.joint_setpoint))


def test_a_warning_lasts_from_its_first_degraded_tick_on_but_for_gaps_of_a_second():
    """Of flights without wind for 0.1 s each time."""

    def summary_of(*outages):
        wind = [{"channel": "wind", "start": start, "duration": 0.1, "kind": "missing"} for start in outages]
        changes = {"simulator.duration": 4.0, "disturbances.outages": wind}
        return rust.fly(rust.load_config("test2", changes)).summary

    for outages, warning, nominal_until in (
        ((), 0.0, 4.0),
        ((0.5,), 0.0, 0.5),
        ((0.5, 3.1), 0.9, 0.5),
        ((1.0, 2.09, 3.18), 3.0, 1.0),
        ((1.0, 2.11, 3.2), 1.89, 1.0),
    ):
        summary = summary_of(*outages)
        assert summary["warning_time"] == pytest.approx(warning, abs=1e-9), outages
        assert summary["nominal_until"] == pytest.approx(nominal_until, abs=1e-9)
        assert summary["all_modes"] == (MODES["wind_held"] if outages else 0)


@pytest.mark.parametrize("signal", ["com_position", "rotation_error", "thrust", "joint_torque", "aero_force_sim"])
def test_figures_do_not_hide_what_is_no_number(flight, signal):
    log = {name: values.copy() for name, values in flight.log.items()}
    log[signal][350] = np.nan
    found = rust.summarise(condense(log, flight.joint_setpoint), [0.0])
    spoilt = {name for name, value in found.items() if np.isnan(value)}
    expected = {
        "com_position": {"max_com_error", "max_com_error_x", "max_com_error_y", "max_com_error_z", "rms_com_error"}
        | {"min_com_height"},
        "rotation_error": {"max_rotation_error", "rms_rotation_error", "time_above_45_deg"},
        "thrust": {"thrust_min", "thrust_max"},
        "joint_torque": {"max_torque"},
        "aero_force_sim": {"max_aero_force", "max_aero_force_difference"},
    }
    assert spoilt == expected[signal]
