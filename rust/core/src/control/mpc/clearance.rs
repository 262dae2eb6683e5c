//! Distances that a plan keeps: exhausts and links from other links, as capsules.
//!
//! Equation M126 of `docs/model`. The trims compute the same distances, in `jax_aero/symbolic/clearance.py`.

use crate::error::{BuildError, place_of};
use crate::kinematics::Kinematics;
use crate::robot::{AeroLink, Foot, Frame, Jet, RobotModel};
use crate::spatial::Pose;
use nalgebra::{DMatrix, Vector3};
use serde::{Deserialize, Serialize};

/// Keeps quotients finite if a segment is a point or two segments are parallel \[m², m⁴\].
const TINY: f64 = 1e-12;

/// Least distance of the surfaces; an exhaust is its axis \[m\].
pub(super) const LEAST: f64 = 0.03;

/// Weight of a distance below the least one \[1/m²\].
pub(super) const WEIGHT: f64 = 5e3;

/// What the plan keeps apart: every exhaust and `links` from each of `apart_from`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ClearanceConfig {
    /// Length of an exhaust's axis from the nozzle \[m\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub exhaust: f64,
    /// Aerodynamic links that move beside the exhausts, such as turbines.
    pub links: Vec<String>,
    /// Aerodynamic links, and frames of soles, of which they keep clear.
    pub apart_from: Vec<String>,
}

/// All points within a radius of a segment that moves with a body.
#[derive(Debug, Clone)]
pub struct Capsule {
    /// Index of the body that carries it.
    pub body: usize,
    /// Start of the segment, body axes \[m\].
    pub start_b: Vector3<f64>,
    /// From its start to its end, body axes \[m\].
    pub way_b: Vector3<f64>,
    /// \[m\]; zero for an exhaust.
    pub radius: f64,
}

impl Capsule {
    fn new(frame: &Frame, start_f: Vector3<f64>, way_f: Vector3<f64>, radius: f64) -> Self {
        let Pose { rotation, .. } = frame.body_from_frame;
        let start_b = frame.body_from_frame.transform_point(&start_f);
        Self { body: frame.body, start_b, way_b: rotation * way_f, radius }
    }

    /// The exhaust of a jet, of a length \[m\] from the nozzle.
    fn of_exhaust(jet: &Jet, length: f64) -> Self {
        Self::new(&jet.frame, Vector3::zeros(), jet.axis_f.into_inner() * -length, 0.0)
    }

    /// The capsule along the axis of a link.
    fn of_link(link: &AeroLink) -> Self {
        let half = if link.is_sphere { 0.0 } else { 0.5 * link.length };
        let half = link.axis_l.into_inner() * half;
        Self::new(&link.frame, link.centre_l - half, half * 2.0, 0.5 * link.diameter)
    }

    /// The capsule along the rectangle around the contact points of a foot, as wide as the rectangle.
    fn of_sole(foot: &Foot) -> Self {
        let [[x_least, x_greatest], [y_least, y_greatest]] = foot.extent();
        let middle = Vector3::new(x_least + x_greatest, y_least + y_greatest, 0.0) * 0.5;
        let (along_x, along_y) =
            (Vector3::x() * (0.5 * (x_greatest - x_least)), Vector3::y() * (0.5 * (y_greatest - y_least)));
        let (long, short) = if along_x.x >= along_y.y { (along_x, along_y) } else { (along_y, along_x) };
        Self::new(&foot.frame, middle - long, long * 2.0, short.norm())
    }
}

/// Distances of pairs of capsules and their derivatives by the moved joints; preallocated.
#[derive(Debug, Clone)]
pub struct Clearance {
    /// The exhausts of all jets, `links`, then `apart_from`.
    pub capsules: Vec<Capsule>,
    /// Capsules that keep clear of each other.
    pub pairs: Vec<(usize, usize)>,
    /// Start and way of every capsule, inertial axes \[m\].
    segments: Vec<Segment>,
    /// Distance between the surfaces of each pair \[m\]; negative if one enters the other.
    pub distance: Vec<f64>,
    /// By the moved joints \[m/rad\]: one column for each pair.
    pub by_joint: DMatrix<f64>,
}

/// Start and way of a segment \[m\].
type Segment = (Vector3<f64>, Vector3<f64>);

impl Clearance {
    /// The pairs of `config` for a law that moves some `joints`, without those that share a body.
    ///
    /// # Errors
    /// [`BuildError::UnknownName`] for a link or sole that the robot does not have.
    pub fn new(
        config: Option<&ClearanceConfig>,
        robot: &RobotModel,
        joints: usize,
    ) -> Result<Self, BuildError> {
        let (mut capsules, mut pairs) = (Vec::new(), Vec::new());
        if let Some(config) = config {
            let named = |key: &str, names: &[String]| -> Result<Vec<Capsule>, BuildError> {
                let links = robot.aero_links.iter().map(|link| (link.name.as_str(), Capsule::of_link(link)));
                let soles = robot.soles.iter().map(|foot| (foot.frame.name.as_str(), Capsule::of_sole(foot)));
                let (known, capsules): (Vec<&str>, Vec<Capsule>) = links.chain(soles).unzip();
                let place =
                    |name| place_of(format!("controller.mpc.clearance.{key}"), name, known.iter().copied());
                names.iter().map(|name| Ok(capsules[place(name)?].clone())).collect()
            };
            capsules.extend(robot.jets.iter().map(|jet| Capsule::of_exhaust(jet, config.exhaust)));
            capsules.extend(named("links", &config.links)?);
            let first = capsules.len();
            capsules.extend(named("apart_from", &config.apart_from)?);
            let all = (0..first).flat_map(|one| (first..capsules.len()).map(move |other| (one, other)));
            pairs.extend(all.filter(|(one, other)| capsules[*one].body != capsules[*other].body));
        }
        Ok(Self {
            segments: vec![(Vector3::zeros(), Vector3::zeros()); capsules.len()],
            distance: vec![0.0; pairs.len()],
            by_joint: DMatrix::zeros(joints, pairs.len()),
            capsules,
            pairs,
        })
    }

    /// Number of pairs.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether nothing is kept apart.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Recomputes distances and derivatives by `joints`.
    pub fn update(&mut self, kinematics: &Kinematics, joints: &[usize]) {
        self.update_below(f64::INFINITY, kinematics, joints);
    }

    /// Recomputes distances, and derivatives of those below `least` \[m\].
    pub(super) fn update_below(&mut self, least: f64, kinematics: &Kinematics, joints: &[usize]) {
        for (segment, capsule) in self.segments.iter_mut().zip(&self.capsules) {
            let pose = kinematics.bodies[capsule.body].i_from_b;
            *segment = (pose.transform_point(&capsule.start_b), pose.rotation * capsule.way_b);
        }
        for (index, &(one, other)) in self.pairs.iter().enumerate() {
            let points = nearest_points(&self.segments[one], &self.segments[other]);
            let capsules = [&self.capsules[one], &self.capsules[other]];
            let gap = points[0] - points[1];
            let length = gap.norm();
            self.distance[index] = length - capsules[0].radius - capsules[1].radius;
            if self.distance[index] >= least {
                continue;
            }
            let away = gap / length.max(TINY);
            for (place, joint) in joints.iter().enumerate() {
                let moves = |side: usize| {
                    let is_moved = kinematics.chain(capsules[side].body).contains(joint);
                    let motion = &kinematics.bodies[joint + 1];
                    if is_moved { away.dot(&motion.joint_velocity_at(&points[side])) } else { 0.0 }
                };
                self.by_joint[(place, index)] = moves(0) - moves(1);
            }
        }
    }
}

/// The points of two segments that are nearest to each other: those of two lines with parameters clamped in turn
/// (Ericson, Real-Time Collision Detection, 2005, section 5.1.9).
fn nearest_points((start_1, way_1): &Segment, (start_2, way_2): &Segment) -> [Vector3<f64>; 2] {
    let between = start_1 - start_2;
    let (a, b, e) = (way_1.norm_squared() + TINY, way_1.dot(way_2), way_2.norm_squared() + TINY);
    let (c, f) = (way_1.dot(&between), way_2.dot(&between));
    let on_first = ((b * f - c * e) / (a * e - b * b + TINY)).clamp(0.0, 1.0);
    let on_second = ((b * on_first + f) / e).clamp(0.0, 1.0);
    let on_first = ((b * on_second - c) / a).clamp(0.0, 1.0);
    [start_1 + way_1 * on_first, start_2 + way_2 * on_second]
}
