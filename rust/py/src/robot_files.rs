//! What the files of a robot contain, as arrays.

use crate::arrays::{Output, array, matrix, value_error, vector, vectors};
use flight_core::RobotModel;
use flight_core::jets::EngineCoefficients;
use flight_core::robot::{Frame, JointKind};
use flight_core::spatial::Pose;
use flight_io::robot::{Inertial, Joint, Shape};
use nalgebra::{Matrix3, Vector3};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::path::PathBuf;

/// Rotation (3, 3) and position (3) of a frame in another.
pub type PoseOutput<'py> = (Output<'py>, Output<'py>);

/// Arrays of a pose.
pub fn pose_arrays<'py>(py: Python<'py>, pose: &Pose) -> PyResult<PoseOutput<'py>> {
    Ok((matrix(py, &pose.rotation)?, vector(py, pose.position.as_slice())?))
}

/// Links, joints, shapes and unused tags of a URDF; `jax_aero.body.urdf` has their meaning.
#[pyfunction]
pub fn read_urdf(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyDict>> {
    let (urdf, shapes) = flight_io::read_urdf(&path).map_err(value_error)?;
    let out = PyDict::new(py);
    out.set_item("name", urdf.name)?;
    out.set_item("links", urdf.links.iter().map(|link| &link.name).collect::<Vec<_>>())?;
    let inertials = PyDict::new(py);
    for link in &urdf.links {
        if let Some(Inertial { origin: Pose { rotation, position }, mass, inertia }) = &link.inertial {
            let inertia_l = rotation * inertia * rotation.transpose();
            let entry = (*mass, vector(py, position.as_slice())?, matrix(py, &inertia_l)?);
            inertials.set_item(&link.name, entry)?;
        }
    }
    out.set_item("inertials", inertials)?;
    let joints = urdf.joints.iter().map(|joint| joint_dict(py, joint));
    out.set_item("joints", joints.collect::<PyResult<Vec<_>>>()?)?;
    out.set_item("shapes", shape_dicts(py, &shapes)?)?;
    out.set_item("unused", urdf.unused)?;
    Ok(out)
}

fn joint_dict<'py>(py: Python<'py>, joint: &Joint) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("name", &joint.name)?;
    out.set_item("parent", &joint.parent)?;
    out.set_item("child", &joint.child)?;
    out.set_item("origin", pose_arrays(py, &joint.origin)?)?;
    let motion = joint.motion.as_ref();
    out.set_item("moves", motion.is_some())?;
    out.set_item("is_prismatic", motion.is_some_and(|motion| motion.kind == JointKind::Prismatic))?;
    out.set_item("axis", motion.map(|motion| vector(py, motion.axis.as_slice())).transpose()?)?;
    out.set_item("limits", motion.and_then(|motion| motion.limits))?;
    out.set_item("effort", motion.map_or(0.0, |motion| motion.effort))?;
    out.set_item("velocity", motion.map_or(0.0, |motion| motion.velocity))?;
    out.set_item("mimics", motion.and_then(|motion| motion.mimic.as_ref()).map(|mimic| &mimic.joint))?;
    Ok(out)
}

/// Each shape by name of its fields; see `read_urdf`.
pub fn shape_dicts<'py>(py: Python<'py>, shapes: &[Shape]) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let dict = |shape: &Shape| {
        let out = PyDict::new(py);
        out.set_item("link", &shape.link)?;
        out.set_item("origin", pose_arrays(py, &shape.origin)?)?;
        out.set_item("kind", shape.kind)?;
        out.set_item("size", shape.size)?;
        out.set_item("file", shape.file.as_ref())?;
        Ok(out)
    };
    shapes.iter().map(dict).collect()
}

/// Every number of a robot, by the names of `jax_aero.body.robot.RobotModel`.
pub fn robot_arrays<'py>(py: Python<'py>, model: &RobotModel) -> PyResult<Bound<'py, PyDict>> {
    let (bodies, joints) = (&model.bodies, &model.joints);
    let out = PyDict::new(py);
    out.set_item("name", &model.name)?;
    let parents = bodies.iter().map(|body| body.parent.map_or(-1, usize::cast_signed));
    out.set_item("parent", tuple(py, parents)?)?;
    out.set_item("body_names", tuple(py, bodies.iter().map(|body| &body.name))?)?;
    out.set_item("joint_names", tuple(py, joints.iter().map(|joint| &joint.name))?)?;
    let prismatic = joints.iter().map(|joint| joint.kind == JointKind::Prismatic);
    out.set_item("joint_is_prismatic", tuple(py, prismatic)?)?;
    let groups = model.groups.iter().map(|group| Ok((&group.name, tuple(py, group.joints.iter())?)));
    out.set_item("joint_groups", tuple(py, groups.collect::<PyResult<Vec<_>>>()?)?)?;
    out.set_item("masses", numbers(py, bodies.iter().map(|body| body.mass))?)?;
    out.set_item("coms", rows(py, bodies.iter().map(|body| body.com_b))?)?;
    out.set_item("inertias", matrices(py, bodies.iter().map(|body| body.inertia_b))?)?;
    let poses = || joints.iter().map(|joint| joint.parent_from_child);
    out.set_item("joint_rotations", matrices(py, poses().map(|pose| pose.rotation))?)?;
    out.set_item("joint_positions", rows(py, poses().map(|pose| pose.position))?)?;
    out.set_item("joint_axes", rows(py, joints.iter().map(|joint| joint.axis_b.into_inner()))?)?;
    let pairs = |pairs: Vec<(f64, f64)>| {
        array(py, &[pairs.len(), 2], pairs.into_iter().flat_map(|(lower, upper)| [lower, upper]).collect())
    };
    out.set_item("joint_limits", pairs(joints.iter().map(|joint| joint.limits).collect())?)?;
    out.set_item("joint_stops", pairs(joints.iter().map(|joint| joint.stops).collect())?)?;
    out.set_item("joint_torque_max", numbers(py, joints.iter().map(|joint| joint.torque_max))?)?;
    out.set_item("joint_torque_rate_max", numbers(py, joints.iter().map(|joint| joint.torque_rate_max))?)?;
    out.set_item("joint_velocity_max", numbers(py, joints.iter().map(|joint| joint.velocity_max))?)?;
    out.set_item("forward_axis", vector(py, model.forward_axis_b.as_slice())?)?;
    out.set_item("gravity", array(py, &[], vec![model.gravity])?)?;
    out.set_item("jets", jets(py, model)?)?;
    out.set_item("aero_links", aero_links(py, model)?)?;
    let engines = PyDict::new(py);
    for (name, engine) in &model.engines {
        engines.set_item(name, vector(py, &engine_numbers(engine.coefficients()))?)?;
    }
    out.set_item("engines", engines)?;
    Ok(out)
}

fn jets<'py>(py: Python<'py>, model: &RobotModel) -> PyResult<Bound<'py, PyDict>> {
    let jets = &model.jets;
    let out = PyDict::new(py);
    out.set_item("names", tuple(py, jets.iter().map(|jet| &jet.name))?)?;
    set_frames(py, &out, jets.iter().map(|jet| &jet.frame).collect())?;
    out.set_item("engines", tuple(py, jets.iter().map(|jet| &jet.engine_name))?)?;
    out.set_item("axes", rows(py, jets.iter().map(|jet| jet.axis_f.into_inner()))?)?;
    out.set_item("torque_to_thrust", numbers(py, jets.iter().map(|jet| jet.torque_to_thrust))?)?;
    out.set_item("thrust_min", numbers(py, jets.iter().map(|jet| jet.thrust_min))?)?;
    out.set_item("thrust_max", numbers(py, jets.iter().map(|jet| jet.thrust_max))?)?;
    Ok(out)
}

fn aero_links<'py>(py: Python<'py>, model: &RobotModel) -> PyResult<Bound<'py, PyDict>> {
    let links = &model.aero_links;
    let out = PyDict::new(py);
    out.set_item("names", tuple(py, links.iter().map(|link| &link.name))?)?;
    set_frames(py, &out, links.iter().map(|link| &link.frame).collect())?;
    out.set_item("is_sphere", tuple(py, links.iter().map(|link| link.is_sphere))?)?;
    out.set_item("axes", rows(py, links.iter().map(|link| link.axis_l.into_inner()))?)?;
    out.set_item("centres", rows(py, links.iter().map(|link| link.centre_l))?)?;
    out.set_item("diameters", numbers(py, links.iter().map(|link| link.diameter))?)?;
    out.set_item("lengths", numbers(py, links.iter().map(|link| link.length))?)?;
    let sets = PyDict::new(py);
    // Every link has the same sets.
    for name in links.first().map(|link| link.coefficients.keys()).into_iter().flatten() {
        let of = |link: &flight_core::robot::AeroLink| {
            let found = link.coefficients[name];
            found.cda.into_iter().chain([found.cna])
        };
        sets.set_item(name, array(py, &[links.len(), 6], links.iter().flat_map(of).collect())?)?;
    }
    out.set_item("coefficients", sets)?;
    Ok(out)
}

/// In the order of `jax_aero.body.robot.ENGINE_KEYS`.
fn engine_numbers(e: &EngineCoefficients) -> [f64; 12] {
    [e.k_t, e.k_tt, e.k_d, e.k_dd, e.k_td, e.b_u, e.b_t, e.b_d, e.b_uu, e.c, e.throttle_min, e.throttle_max]
}

fn set_frames(py: Python<'_>, out: &Bound<'_, PyDict>, frames: Vec<&Frame>) -> PyResult<()> {
    out.set_item("bodies", tuple(py, frames.iter().map(|frame| frame.body))?)?;
    let poses = || frames.iter().map(|frame| frame.body_from_frame);
    out.set_item("rotations", matrices(py, poses().map(|pose| pose.rotation))?)?;
    out.set_item("positions", rows(py, poses().map(|pose| pose.position))?)
}

fn tuple<'py, T: IntoPyObject<'py>>(
    py: Python<'py>,
    values: impl IntoIterator<Item = T>,
) -> PyResult<Bound<'py, PyTuple>> {
    PyTuple::new(py, values.into_iter().collect::<Vec<_>>())
}

fn numbers(py: Python<'_>, values: impl Iterator<Item = f64>) -> PyResult<Output<'_>> {
    vector(py, &values.collect::<Vec<_>>())
}

fn rows(py: Python<'_>, values: impl Iterator<Item = Vector3<f64>>) -> PyResult<Output<'_>> {
    vectors(py, &values.collect::<Vec<_>>())
}

fn matrices(py: Python<'_>, values: impl Iterator<Item = Matrix3<f64>>) -> PyResult<Output<'_>> {
    let entries: Vec<f64> = values.flat_map(|matrix| matrix.transpose().data.0).flatten().collect();
    array(py, &[entries.len() / 9, 3, 3], entries)
}
