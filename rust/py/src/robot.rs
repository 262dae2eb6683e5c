//! The robot and its rigid-body dynamics.

use crate::arrays::{Input, Output, entries, matrix, matrix3, value_error, vector, vector3, vectors};
use crate::flight::warn;
use crate::robot_files::{PoseOutput, pose_arrays, robot_arrays, shape_dicts};
use flight_core::aero::{LinkConventions, LinkForces, LinksInAir};
use flight_core::control::mpc::clearance::Clearance;
use flight_core::dynamics::{Dynamics, MassFactor};
use flight_core::kinematics::{Kinematics, RobotState};
use flight_core::robot::{Foot, Frame};
use flight_core::spatial::{Pose, is_rotation, orthonormality_error};
use flight_core::{BuildError, RobotModel};
use flight_io::{AeroConfig, LoadedRobot, RobotFiles, from_json, load_aero};
use nalgebra::{DVector, Matrix3, Vector3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A robot, read from its TOML file and the URDF that it names.
#[pyclass(frozen, module = "jax_aero._core")]
pub struct Robot {
    files: RobotFiles,
    model: RobotModel,
    links: BTreeMap<String, (usize, Pose)>,
    held: BTreeMap<String, f64>,
}

/// Bodies, starts, ways and radii of capsules, and pairs of them.
type ClearanceOutput<'py> = (Vec<usize>, Output<'py>, Output<'py>, Output<'py>, Vec<(usize, usize)>);

/// Arguments that are a state: base position (3), rotation (3, 3), joints (n), mixed velocity (6 + n).
pub type StateInput<'py> = (Input<'py>, Input<'py>, Input<'py>, Input<'py>);
/// The same as a result.
pub type StateOutput<'py> = (Output<'py>, Output<'py>, Output<'py>, Output<'py>);

/// State of a robot from arrays.
fn state(joints: usize, arrays: &StateInput<'_>) -> PyResult<RobotState> {
    rotation("base_rotation", &arrays.1)?;
    measured_state(joints, arrays)
}

/// Arrays of a state.
pub fn state_arrays<'py>(py: Python<'py>, state: &RobotState) -> PyResult<StateOutput<'py>> {
    Ok((
        vector(py, state.base.position.as_slice())?,
        matrix(py, &state.base.rotation)?,
        vector(py, state.joint_position.as_slice())?,
        vector(py, state.velocity.as_slice())?,
    ))
}

/// Converts to a rotation; it must be one to 1e-6.
pub fn rotation(name: &str, array: &Input<'_>) -> PyResult<Matrix3<f64>> {
    let rotation = matrix3(name, array)?;
    if is_rotation(&rotation) {
        return Ok(rotation);
    }
    Err(PyValueError::new_err(format!(
        "`{name}` deviates from a rotation by {:e} (determinant {}); expected one to 1e-6",
        orthonormality_error(&rotation),
        rotation.determinant()
    )))
}

/// As `state`, without checks of the values, which the controller judges.
pub fn measured_state(
    joints: usize,
    (base_position, base_rotation, joint_position, velocity): &StateInput<'_>,
) -> PyResult<RobotState> {
    let rotation = matrix3("base_rotation", base_rotation)?;
    Ok(RobotState {
        base: Pose { rotation, position: vector3("base_position", base_position)? },
        joint_position: DVector::from_vec(entries("joint_position", joint_position, &[joints])?),
        velocity: DVector::from_vec(entries("velocity", velocity, &[6 + joints])?),
    })
}

#[pymethods]
impl Robot {
    /// `texts` are those of its TOML file, with its base files, and of its URDF file, in place of what they hold now.
    #[new]
    #[pyo3(signature = (path, texts = None))]
    fn new(py: Python<'_>, path: PathBuf, texts: Option<(String, String)>) -> PyResult<Self> {
        let is_read = texts.is_none();
        let files = match texts {
            Some((toml, urdf)) => Ok(RobotFiles { toml, urdf, origin: path.display().to_string() }),
            None => RobotFiles::read(&path),
        };
        let files = files.map_err(value_error)?;
        let LoadedRobot { model, links, held, warnings } = files.load().map_err(value_error)?;
        if is_read {
            warn(py, warnings)?;
        }
        Ok(Self { files, model, links, held })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyType>, (String, (String, String))) {
        let RobotFiles { toml, urdf, origin } = slf.get().files.clone();
        (slf.get_type(), (origin, (toml, urdf)))
    }

    fn __repr__(&self) -> String {
        let RobotModel { name, joints, jets, .. } = &self.model;
        let jets: Vec<_> = jets.iter().map(|jet| jet.name.as_str()).collect();
        format!("<Robot {name}: {:.2} kg, {} joints, jets {}>", self.mass(), joints.len(), jets.join(", "))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.model.name
    }

    /// Total mass [kg].
    #[getter]
    fn mass(&self) -> f64 {
        self.model.mass()
    }

    /// Gravity [m/s²].
    #[getter]
    fn gravity(&self) -> f64 {
        self.model.gravity
    }

    #[getter]
    fn joint_names(&self) -> Vec<String> {
        self.model.joints.iter().map(|joint| joint.name.clone()).collect()
    }

    /// Limits that the controller observes [rad], a (lower, upper) pair for each joint.
    #[getter]
    fn joint_limits(&self) -> Vec<(f64, f64)> {
        self.model.joints.iter().map(|joint| joint.limits).collect()
    }

    /// Lower and upper stop of every joint [rad, m].
    #[getter]
    fn joint_stops(&self) -> Vec<(f64, f64)> {
        self.model.joints.iter().map(|joint| joint.stops).collect()
    }

    /// Names of the joints in each group.
    #[getter]
    fn joint_groups(&self) -> BTreeMap<String, Vec<String>> {
        let names =
            |joints: &[usize]| joints.iter().map(|&joint| self.model.joints[joint].name.clone()).collect();
        self.model.groups.iter().map(|group| (group.name.clone(), names(&group.joints))).collect()
    }

    #[getter]
    fn body_names(&self) -> Vec<String> {
        self.model.bodies.iter().map(|body| body.name.clone()).collect()
    }

    #[getter]
    fn aero_link_names(&self) -> Vec<String> {
        self.model.aero_links.iter().map(|link| link.name.clone()).collect()
    }

    #[getter]
    fn jet_names(&self) -> Vec<String> {
        self.model.jets.iter().map(|jet| jet.name.clone()).collect()
    }

    /// Name of the link that each aerodynamic link is.
    #[getter]
    fn aero_link_frames(&self) -> Vec<String> {
        self.model.aero_links.iter().map(|link| link.frame.name.clone()).collect()
    }

    /// Name of the link that carries each jet.
    #[getter]
    fn jet_frames(&self) -> Vec<String> {
        self.model.jets.iter().map(|jet| jet.frame.name.clone()).collect()
    }

    /// Least thrust of every jet [N].
    #[getter]
    fn thrust_min(&self) -> Vec<f64> {
        self.model.jets.iter().map(|jet| jet.thrust_min).collect()
    }

    /// Greatest thrust of every jet [N].
    #[getter]
    fn thrust_max(&self) -> Vec<f64> {
        self.model.jets.iter().map(|jet| jet.thrust_max).collect()
    }

    #[getter]
    fn foot_names(&self) -> Vec<String> {
        self.model.feet.iter().map(|foot| foot.name.clone()).collect()
    }

    /// Contact points (k, 3) of every foot in the axes of its sole [m], by frame of the sole.
    fn soles<'py>(&self, py: Python<'py>) -> PyResult<BTreeMap<String, Output<'py>>> {
        let sole = |foot: &Foot| Ok((foot.frame.name.clone(), vectors(py, &foot.vertices_f)?));
        self.model.feet.iter().map(sole).collect()
    }

    /// Text of the TOML file.
    #[getter]
    fn toml_text(&self) -> &str {
        &self.files.toml
    }

    /// Text of the URDF file.
    #[getter]
    fn urdf_text(&self) -> &str {
        &self.files.urdf
    }

    /// Positions of the joints that could move but are held [rad, m]: locked ones, and mimics of such.
    #[getter]
    fn held_joints(&self) -> BTreeMap<String, f64> {
        self.held.clone()
    }

    /// Every number of the robot, by the names of `jax_aero.body.robot.RobotModel`.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        robot_arrays(py, &self.model)
    }

    /// Place of every link of the URDF: its body, and its rotation and position in it.
    fn links<'py>(&self, py: Python<'py>) -> PyResult<BTreeMap<String, (usize, PoseOutput<'py>)>> {
        let place = |(name, (body, pose)): (&String, &(usize, Pose))| {
            Ok((name.clone(), (*body, pose_arrays(py, pose)?)))
        };
        self.links.iter().map(place).collect()
    }

    /// Geometry of the URDF's links, as `read_urdf`.
    fn shapes<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        shape_dicts(py, &self.files.shapes().map_err(value_error)?)
    }

    /// Capsules that a plan keeps apart, by the table `controller.mpc.clearance` as JSON: the body (c) of each, start and
    /// way (c, 3) of its segment in body axes [m], its radius (c) [m], and pairs of them.
    fn clearance<'py>(&self, py: Python<'py>, config_json: &str) -> PyResult<ClearanceOutput<'py>> {
        let config = from_json(config_json, "clearance").map_err(value_error)?;
        let Clearance { capsules, pairs, .. } =
            Clearance::new(Some(&config), &self.model, 0).map_err(value_error)?;
        let starts: Vec<Vector3<f64>> = capsules.iter().map(|capsule| capsule.start_b).collect();
        let ways: Vec<Vector3<f64>> = capsules.iter().map(|capsule| capsule.way_b).collect();
        let radii: Vec<f64> = capsules.iter().map(|capsule| capsule.radius).collect();
        let bodies = capsules.iter().map(|capsule| capsule.body).collect();
        Ok((bodies, vectors(py, &starts)?, vectors(py, &ways)?, vector(py, &radii)?, pairs))
    }

    /// Kinematics and dynamics of one state, by name; see `jax_aero.rust.Robot`.
    fn dynamics<'py>(&self, py: Python<'py>, state: StateInput<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (kinematics, dynamics) = self.evaluate(&state)?;
        let out = PyDict::new(py);
        let positions: Vec<Vector3<f64>> =
            kinematics.bodies.iter().map(|body| body.i_from_b.position).collect();
        let rotations: Vec<f64> = kinematics
            .bodies
            .iter()
            .flat_map(|body| body.i_from_b.rotation.transpose().iter().copied().collect::<Vec<_>>())
            .collect();
        out.set_item("body_positions", vectors(py, &positions)?)?;
        out.set_item("body_rotations", crate::arrays::array(py, &[positions.len(), 3, 3], rotations)?)?;
        out.set_item("com_position", vector(py, kinematics.com.as_slice())?)?;
        out.set_item("mass_matrix", matrix(py, &dynamics.mass_matrix)?)?;
        out.set_item("bias", vector(py, dynamics.bias.as_slice())?)?;
        out.set_item("momentum_matrix", matrix(py, &dynamics.momentum_matrix)?)?;
        out.set_item("momentum", vector(py, dynamics.momentum.as_slice())?)?;
        out.set_item("centroidal_inertia", matrix(py, &dynamics.centroidal_inertia)?)?;
        Ok(out)
    }

    /// Linear and angular Jacobian (3, 6 + n) of the origin of a frame: a body, jet, aerodynamic link or foot.
    fn frame_jacobian<'py>(
        &self,
        py: Python<'py>,
        frame: &str,
        state: StateInput<'py>,
    ) -> PyResult<(Output<'py>, Output<'py>)> {
        let frame = self.frame(frame)?;
        let (kinematics, _) = self.evaluate(&state)?;
        let point = kinematics.frame_pose(&frame).position;
        let (linear, angular) = kinematics.jacobian(frame.body, &point);
        Ok((matrix(py, &linear)?, matrix(py, &angular)?))
    }

    /// Acceleration ν̇ (6 + n) under a generalised force (6 + n): M ν̇ + h = force.
    fn forward_dynamics<'py>(
        &self,
        py: Python<'py>,
        state: StateInput<'py>,
        force: Input<'py>,
    ) -> PyResult<Output<'py>> {
        let (_, dynamics) = self.evaluate(&state)?;
        let n = dynamics.bias.len();
        let mut acceleration = DVector::from_vec(entries("force", &force, &[n])?) - &dynamics.bias;
        let mut factor = MassFactor::new(n);
        if !factor.factorise(&dynamics.mass_matrix) {
            return Err(PyValueError::new_err("the mass matrix of this state is not positive definite"));
        }
        factor.solve_in_place(&mut acceleration);
        vector(py, acceleration.as_slice())
    }
}

impl Robot {
    pub(crate) fn model(&self) -> &RobotModel {
        &self.model
    }

    fn evaluate(&self, arrays: &StateInput<'_>) -> PyResult<(Kinematics, Dynamics)> {
        let state = state(self.model.joints.len(), arrays)?;
        let mut kinematics = Kinematics::new(&self.model);
        let mut dynamics = Dynamics::new(&self.model);
        kinematics.update(&self.model, &state);
        dynamics.update(&self.model, &state, &kinematics);
        Ok((kinematics, dynamics))
    }

    fn frame(&self, name: &str) -> PyResult<Frame> {
        let model = &self.model;
        let jets = model.jets.iter().map(|jet| &jet.frame);
        let links = model.aero_links.iter().map(|link| &link.frame);
        let feet = model.feet.iter().map(|foot| &foot.frame);
        let body = model.body_index(name).map(|body| Frame {
            name: name.to_owned(),
            body,
            body_from_frame: Pose::identity(),
        });
        let frames: Vec<&Frame> = jets.chain(links).chain(feet).collect();
        body.or_else(|| frames.iter().find(|frame| frame.name == name).map(|frame| (*frame).clone()))
            .ok_or_else(|| {
                let bodies = model.bodies.iter().map(|body| body.name.as_str());
                let known = bodies.chain(frames.iter().map(|frame| frame.name.as_str()));
                value_error(BuildError::unknown_name("frame", name, known))
            })
    }
}

/// Forces (links, 3) [N] of an aerodynamic model, given as JSON, on a robot's links, from unit vectors of
/// their axes and relative air velocities (links, 3), inertial axes.
#[pyfunction]
pub fn aero_forces<'py>(
    py: Python<'py>,
    robot: &Robot,
    aero_json: &str,
    axes: Input<'py>,
    v_air: Input<'py>,
) -> PyResult<Output<'py>> {
    let links = robot.model.aero_links.len();
    let config: AeroConfig = from_json(aero_json, "aero").map_err(value_error)?;
    if matches!(config, AeroConfig::Network(_)) {
        let expected = "a model of single links; `link_forces` evaluates a network";
        return Err(value_error(BuildError::bad_value("aero.model", "network", expected)));
    }
    let mut model = load_aero(&config, &robot.model).map_err(value_error)?;
    let rows = |name: &str, input: &Input<'_>| -> PyResult<Vec<Vector3<f64>>> {
        Ok(entries(name, input, &[links, 3])?.chunks_exact(3).map(Vector3::from_column_slice).collect())
    };
    let mut forces = vec![Vector3::zeros(); links];
    let links = LinksInAir {
        robot: &robot.model,
        kinematics: &Kinematics::new(&robot.model),
        axes_i: &rows("axes", &axes)?,
        v_air_i: &rows("v_air", &v_air)?,
        wind_i: &Vector3::zeros(),
    };
    model.link_forces(&links, &mut forces);
    vectors(py, &forces)
}

/// Forces (links, 3) [N] of an aerodynamic model, given as JSON, on a robot in a state and in a wind [m/s],
/// inertial axes.
#[pyfunction]
pub fn link_forces<'py>(
    py: Python<'py>,
    robot: &Robot,
    aero_json: &str,
    state: StateInput<'py>,
    wind: Input<'py>,
) -> PyResult<Output<'py>> {
    let config: AeroConfig = from_json(aero_json, "aero").map_err(value_error)?;
    let mut model = load_aero(&config, &robot.model).map_err(value_error)?;
    let (kinematics, _) = robot.evaluate(&state)?;
    let mut forces = LinkForces::new(&robot.model);
    let wind = vector3("wind", &wind)?;
    forces.update(&robot.model, &kinematics, LinkConventions::default(), &mut model, &wind);
    vectors(py, &forces.forces_i)
}
