//! Flights that go on together, on as many threads as there are cores.

use crate::arrays::{Input, Output, array, entries, plain_error};
use crate::stepwise::Flight;
use flight_core::control::Given;
use flight_core::control::law::residual::Residual;
use flight_sim::with_each;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Fly one tick of each flight with its row of thrust rates (flights, jets) and joint velocities (flights, joints), which are
/// added to the answer of the law or replace it; return whether each goes on.
#[pyfunction]
pub fn step_flights(
    py: Python<'_>,
    mut flights: Vec<PyRefMut<'_, Flight>>,
    thrust_rate: Input<'_>,
    joint_velocity: Input<'_>,
    replaces: bool,
) -> PyResult<Vec<bool>> {
    let mut each: Vec<&mut flight_sim::Flight> = flights.iter_mut().map(|one| &mut one.flight).collect();
    let (count, [jets, joints]) = (each.len(), sizes(&each)?);
    let rates = entries("residual.thrust_rate", &thrust_rate, &[count, jets])?;
    let velocities = entries("residual.joint_velocity", &joint_velocity, &[count, joints])?;
    let step = |index: usize, flight: &mut flight_sim::Flight| {
        let residual = Residual {
            thrust_rate: &rates[index * jets..][..jets],
            joint_velocity: &velocities[index * joints..][..joints],
            replaces,
        };
        let goes_on = flight.step_with(&Given { residual: Some(&residual), ..Given::default() }, None);
        let goes_on = goes_on.map_err(|why| why.to_string())?;
        flight.refusal().map_or(Ok(goes_on), |why| Err(why.to_string()))
    };
    let answers = py.detach(|| with_each(&mut each, step));
    flights.iter().try_for_each(|one| one.check_world())?;
    answers.into_iter().collect::<Result<_, _>>().map_err(plain_error)
}

/// What is seen of the simulated robot at the next tick of each flight, and its set-point if asked for: names and arrays,
/// whose first axis is that of the flights.
#[pyfunction]
pub fn observe_flights<'py>(
    py: Python<'py>,
    mut flights: Vec<PyRefMut<'py, Flight>>,
    setpoint: bool,
) -> PyResult<Vec<(&'static str, Output<'py>)>> {
    let mut each: Vec<&mut flight_sim::Flight> = flights.iter_mut().map(|one| &mut one.flight).collect();
    let (count, [jets, joints]) = (each.len(), sizes(&each)?);
    let seen = py.detach(|| with_each(&mut each, |_, flight| observe(flight, setpoint)));
    flights.iter().try_for_each(|one| one.check_world())?;
    let rows = seen.into_iter().collect::<Result<Vec<Vec<f64>>, String>>().map_err(plain_error)?;
    let of_robot: [(&str, &[usize]); 6] = [
        ("base_rotation", &[3, 3]),
        ("velocity", &[6 + joints]),
        ("joint_position", &[joints]),
        ("thrust", &[jets]),
        ("com_position", &[3]),
        ("residual_wrench", &[6]),
    ];
    let of_setpoint: [(&str, &[usize]); 4] = [
        ("com_setpoint", &[3]),
        ("rotation_setpoint", &[3, 3]),
        ("com_velocity_setpoint", &[3]),
        ("angular_velocity_setpoint", &[3]),
    ];
    let mut start = 0;
    let mut take = |(name, shape): &(&'static str, &[usize])| {
        let width = shape.iter().product::<usize>();
        let values = rows.iter().flat_map(|row| row[start..start + width].iter().copied()).collect();
        start += width;
        Ok((*name, array(py, &[&[count], *shape].concat(), values)?))
    };
    of_robot.iter().chain(&of_setpoint[..if setpoint { 4 } else { 0 }]).map(&mut take).collect()
}

/// Numbers of jets and joints, which are those of one robot.
fn sizes(flights: &[&mut flight_sim::Flight]) -> PyResult<[usize; 2]> {
    let mut all = flights.iter().map(|one| [one.robot().jets.len(), one.robot().joints.len()]);
    let first = all.next().ok_or_else(|| PyValueError::new_err("there are no `flights`"))?;
    if all.any(|other| other != first) {
        return Err(PyValueError::new_err("`flights` are of several robots; expected one"));
    }
    Ok(first)
}

fn observe(flight: &mut flight_sim::Flight, setpoint: bool) -> Result<Vec<f64>, String> {
    let (plant, _) = flight.truth();
    let (state, mut row) = (plant.state(), Vec::new());
    row.extend(state.base.rotation.transpose().iter());
    row.extend(state.velocity.iter());
    row.extend(state.joint_position.iter());
    row.extend(plant.jets().thrust_feedback());
    row.extend(plant.kinematics().com.iter());
    let state = flight.controller_state();
    row.extend(
        state.map_or_else(Default::default, flight_core::control::ControllerState::residual_wrench).iter(),
    );
    if setpoint {
        flight.try_tick().map_err(|why| why.to_string())?;
        let aim = &flight.controller().terms().setpoint;
        row.extend(aim.com_position.iter());
        row.extend(aim.rotation.transpose().iter());
        row.extend(aim.com_velocity.iter());
        row.extend((aim.rotation * aim.angular_velocity_b).iter());
    }
    Ok(row)
}
