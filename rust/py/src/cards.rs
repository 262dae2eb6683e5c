//! What the cards of networks and policies contain, and their weights.

use crate::arrays::{array, value_error};
use flight_core::aero::network::{Card, Weights};
use flight_core::control::law::residual::{PolicyCard, PolicyWeights};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use serde_json::{Value, json};
use std::path::PathBuf;

/// An array in the precision of weights.
type Single<'py> = Bound<'py, PyArrayDyn<f32>>;

/// Card and weights of a network by the names of `jax_aero.aero.network.Network`, `mirror` as a flag; checked against
/// the joints and aerodynamic links of a robot.
#[pyfunction]
pub fn read_network(
    py: Python<'_>,
    path: PathBuf,
    joints: Vec<String>,
    links: Vec<String>,
) -> PyResult<Bound<'_, PyDict>> {
    let (card, weights) =
        flight_io::read_network(&path, &borrow(&joints), &borrow(&links)).map_err(value_error)?;
    let widths = card.widths();
    let baseline = card.baseline_coefficients().map(|rows| {
        let numbers = rows.iter().flat_map(|row| row.cda.into_iter().chain([row.cna])).collect();
        array(py, &[rows.len(), 6], numbers)
    });
    let Card { inputs, output, architecture, .. } = card;
    let Weights { members, scale, offset } = weights;
    let layers = widths.windows(2).enumerate().map(|(index, width)| {
        let layer = || members.iter().map(|layers| &layers[index]);
        let weights = layer().flat_map(|(weights, _)| weights).copied().collect();
        let biases = layer().flat_map(|(_, biases)| biases).copied().collect();
        Ok((
            array(py, &[members.len(), width[1], width[0]], weights)?,
            array(py, &[members.len(), width[1]], biases)?,
        ))
    });
    let layers = layers.collect::<PyResult<Vec<(Single<'_>, Single<'_>)>>>()?;
    let out = PyDict::new(py);
    out.set_item("blocks", names(py, &json!(inputs.features))?)?;
    out.set_item("frame", json!(output.frame).as_str())?;
    out.set_item("layout", json!(output.layout).as_str())?;
    out.set_item("activation", json!(architecture.activation).as_str())?;
    let indices = inputs.joints.iter().filter_map(|name| joints.iter().position(|joint| joint == name));
    out.set_item("joints", PyTuple::new(py, indices.collect::<Vec<_>>())?)?;
    out.set_item("layers", layers)?;
    out.set_item("scale", array(py, &[scale.len()], scale)?)?;
    out.set_item("offset", array(py, &[offset.len()], offset)?)?;
    out.set_item("mirror", architecture.mirror)?;
    out.set_item("baseline", baseline.transpose()?)?;
    Ok(out)
}

/// Card and weights of a policy, layer by layer; checked against the jets and joints of a robot.
#[pyfunction]
pub fn read_policy(
    py: Python<'_>,
    path: PathBuf,
    jets: Vec<String>,
    joints: Vec<String>,
) -> PyResult<Bound<'_, PyDict>> {
    let (card, weights) =
        flight_io::read_policy(&path, &borrow(&jets), &borrow(&joints)).map_err(value_error)?;
    let widths = card.widths();
    let PolicyCard { inputs: card_inputs, output, .. } = card;
    let PolicyWeights { hidden, output: last, direct } = weights;
    let mut inputs = widths.iter();
    let mut layer = |(weights, bias): (Vec<f32>, Vec<f32>)| -> PyResult<(Single<'_>, Single<'_>)> {
        let (from, to) = (*inputs.next().unwrap_or(&0), bias.len());
        Ok((array(py, &[to, from], weights)?, array(py, &[to], bias)?))
    };
    let layers = hidden.into_iter().map(&mut layer).collect::<PyResult<Vec<_>>>()?;
    let actions = last.1.len();
    let out = PyDict::new(py);
    out.set_item("hidden", layers)?;
    out.set_item("output", layer(last)?)?;
    out.set_item("direct", array(py, &[actions, widths[0]], direct)?)?;
    out.set_item("features", names(py, &json!(card_inputs.features))?)?;
    out.set_item("scale", array(py, &[card_inputs.scale.len()], card_inputs.scale)?)?;
    out.set_item("thrust_rate", output.thrust_rate)?;
    out.set_item("joint_velocity", output.joint_velocity)?;
    out.set_item("replaces", output.replaces)?;
    Ok(out)
}

fn borrow(names: &[String]) -> Vec<&str> {
    names.iter().map(String::as_str).collect()
}

/// Names of alternatives, as on a card.
fn names<'py>(py: Python<'py>, alternatives: &Value) -> PyResult<Bound<'py, PyTuple>> {
    PyTuple::new(
        py,
        alternatives.as_array().into_iter().flatten().filter_map(Value::as_str).collect::<Vec<_>>(),
    )
}
