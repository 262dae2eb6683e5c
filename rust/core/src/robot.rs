//! The robot: a tree of rigid bodies with named frames, checked when it is read and constant from then on.
//!
//! Body 0 is the floating base; joint `i` moves body `i + 1`. Every joint comes after its ancestors, so a loop over the
//! bodies proceeds from the base to the tips, and in reverse from the tips to the base. [`check`] has the conditions on
//! a robot's numbers.

pub mod check;

use crate::error::BuildError;
use crate::jets::{EngineModel, JetDynamics, JetModel, SecondOrder, Shaft, ShaftConfig};
use crate::spatial::Pose;
use nalgebra::{Matrix3, Unit, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A robot that has passed every check.
#[derive(Debug, Clone)]
pub struct RobotModel {
    /// Name of the robot.
    pub name: String,
    /// Forward direction in base axes, orthogonal to base z.
    pub forward_axis_b: Unit<Vector3<f64>>,
    /// Bodies; body 0 is the floating base, joint `i` moves body `i + 1`.
    pub bodies: Vec<Body>,
    /// Joints, in the order of every joint vector.
    pub joints: Vec<Joint>,
    /// Groups of joints; together they contain every joint once, in order.
    pub groups: Vec<JointGroup>,
    /// Links on which aerodynamic force acts, in the order of every aerodynamic table.
    pub aero_links: Vec<AeroLink>,
    /// Jet engines, in the order of every thrust vector.
    pub jets: Vec<Jet>,
    /// Feet on which a controller stands; those of a controller that cannot stand are none.
    pub feet: Vec<Foot>,
    /// All feet, as shapes.
    pub soles: Vec<Foot>,
    /// Engines by name, also those that no jet uses.
    pub engines: BTreeMap<String, SecondOrder>,
    /// Magnitude of gravity \[m/s²\]; it acts along −z of the inertial frame.
    pub gravity: f64,
}

impl RobotModel {
    /// Total mass \[kg\].
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.bodies.iter().map(|body| body.mass).sum()
    }

    /// Index of a joint in every joint vector.
    #[must_use]
    pub fn joint_index(&self, name: &str) -> Option<usize> {
        self.joints.iter().position(|joint| joint.name == name)
    }

    /// Names of the jets, in their order.
    pub fn jet_names(&self) -> impl Iterator<Item = &str> + Clone {
        self.jets.iter().map(|jet| jet.name.as_str())
    }

    /// The robot with engines of the shaft's speed, which at full speed give the greatest thrusts of its jets.
    ///
    /// # Errors
    /// As [`Shaft::new`].
    pub fn with_shafts(mut self, table: &'static str, config: &ShaftConfig) -> Result<Self, BuildError> {
        for jet in &mut self.jets {
            jet.engine = EngineModel::Shaft(Shaft::new(table, *config, jet.thrust_max)?);
        }
        Ok(self)
    }

    /// What a controller assumes of the jets.
    #[must_use]
    pub fn jet_models(&self, dynamics: JetDynamics) -> Vec<JetModel> {
        let engine = |jet: &Jet| (dynamics == JetDynamics::Throttled).then_some(jet.engine);
        self.jets.iter().map(|jet| JetModel { thrust_min: jet.thrust_min, engine: engine(jet) }).collect()
    }

    /// Values of a table in the order of the jets; zero for jets that it does not name.
    #[must_use]
    pub fn by_jet(&self, table: &BTreeMap<String, f64>) -> Vec<f64> {
        self.jet_names().map(|jet| table.get(jet).copied().unwrap_or(0.0)).collect()
    }

    /// Index of a body in [`RobotModel::bodies`].
    #[must_use]
    pub fn body_index(&self, name: &str) -> Option<usize> {
        self.bodies.iter().position(|body| body.name == name)
    }
}

/// A rigid body: all links that one joint moves, with fixed links merged.
#[derive(Debug, Clone)]
pub struct Body {
    /// Name of the link at the body's origin.
    pub name: String,
    /// Index of the parent body; `None` for the base.
    pub parent: Option<usize>,
    /// Mass \[kg\].
    pub mass: f64,
    /// Centre of mass in body axes \[m\].
    pub com_b: Vector3<f64>,
    /// Inertia about the centre of mass, body axes \[kg m²\].
    pub inertia_b: Matrix3<f64>,
}

/// Type of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Rotation about the axis; positions in rad, torques in N m.
    Revolute,
    /// Translation along the axis; positions in m, "torques" are forces in N.
    Prismatic,
}

/// A joint with one degree of freedom; its child frame is the frame of the body it moves.
///
/// Units below are those of a revolute joint; for a prismatic joint replace rad by m and N m by N.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Name.
    pub name: String,
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Pose of the child body in the parent body at joint position zero.
    pub parent_from_child: Pose,
    /// Axis of motion in child axes; at position zero it has the same direction in the parent body.
    pub axis_b: Unit<Vector3<f64>>,
    /// Limits that the controller observes, `(lower, upper)` \[rad\].
    pub limits: (f64, f64),
    /// Positions of the mechanical stops \[rad\]: the range of the URDF, widened to that of the controller; infinite if
    /// there are none.
    pub stops: (f64, f64),
    /// Greatest torque \[N m\].
    pub torque_max: f64,
    /// Greatest rate of the torque \[N m/s\]; infinite if there is no limit.
    pub torque_rate_max: f64,
    /// Greatest velocity \[rad/s\].
    pub velocity_max: f64,
    /// Rotor inertia of its drive, reflected to the joint \[kg m²\]; zero where the torque acts on the joint itself.
    pub rotor_inertia: f64,
}

/// A frame fixed to a body.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Name of the link.
    pub name: String,
    /// Index of the body that carries it.
    pub body: usize,
    /// Pose of the frame in the body.
    pub body_from_frame: Pose,
}

/// Coefficients of one axisymmetric link, all force areas \[m²\].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AxisymmetricCoefficients {
    /// `C_D A = w₀ + w₁ cos α + w₂ sin² α + w₃ sin³ α + w₄ cos³ α`.
    pub cda: [f64; 5],
    /// `C_N A = w₅ sin² α cos α`.
    pub cna: f64,
}

/// A link on which aerodynamic force acts.
#[derive(Debug, Clone)]
pub struct AeroLink {
    /// Name of the link, as in figures and tables.
    pub name: String,
    /// Its frame.
    pub frame: Frame,
    /// Symmetry axis in link axes.
    pub axis_l: Unit<Vector3<f64>>,
    /// Point where the force acts, in link axes \[m\].
    pub centre_l: Vector3<f64>,
    /// Diameter \[m\].
    pub diameter: f64,
    /// Length along the axis \[m\].
    pub length: f64,
    /// Whether the sphere and cylinder model treats the link as a sphere.
    pub is_sphere: bool,
    /// Coefficient sets by name (`published`, `corrected`, `signed`, `alternative`, ...).
    pub coefficients: BTreeMap<String, AxisymmetricCoefficients>,
}

/// A thruster, jet or rotor: a force along a fixed axis of a frame, and a moment about it.
#[derive(Debug, Clone)]
pub struct Jet {
    /// Name of the jet.
    pub name: String,
    /// Its frame; the thrust acts at the origin.
    pub frame: Frame,
    /// Direction of the force on the robot, in frame axes.
    pub axis_f: Unit<Vector3<f64>>,
    /// Moment on the robot about the axis per thrust \[m\]: the reaction torque of a rotor, 0 for a jet.
    pub torque_to_thrust: f64,
    /// Least thrust of its engine while it runs \[N\].
    pub thrust_min: f64,
    /// Greatest thrust \[N\].
    pub thrust_max: f64,
    /// Its engine.
    pub engine: EngineModel,
    /// Name of the engine in [`RobotModel::engines`].
    pub engine_name: String,
}

/// A foot: a sole frame and the corners that can touch the ground.
#[derive(Debug, Clone)]
pub struct Foot {
    /// Name of the foot.
    pub name: String,
    /// Sole frame.
    pub frame: Frame,
    /// Contact points in the sole frame \[m\].
    pub vertices_f: Vec<Vector3<f64>>,
}

impl Foot {
    /// Least and greatest x and y of the contact points \[m\].
    #[must_use]
    pub fn extent(&self) -> [[f64; 2]; 2] {
        [0, 1].map(|axis| {
            let along = || self.vertices_f.iter().map(|vertex| vertex[axis]);
            [along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max)]
        })
    }
}

/// Joints that are plotted together.
#[derive(Debug, Clone)]
pub struct JointGroup {
    /// Name of the group.
    pub name: String,
    /// Indices of its joints.
    pub joints: Vec<usize>,
}
