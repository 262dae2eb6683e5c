//! Distances that a plan keeps: exhausts and links from other links, as capsules.
//!
//! Equation M125 of `docs/model.md`. The trims compute the same distances, in `jax_aero/symbolic/clearance.py`.

use super::config::ClearanceConfig;
use crate::error::{BuildError, place_of};
use crate::kinematics::Kinematics;
use crate::robot::{AeroLink, Frame, RobotModel};
use nalgebra::{DMatrix, Vector3};

/// Keeps quotients finite if a segment is a point or two segments are parallel \[m², m⁴\].
const TINY: f64 = 1e-12;

/// A segment that moves with a body, and the distance of its surface.
#[derive(Debug, Clone)]
struct Capsule {
    frame: Frame,
    /// Start of the segment and the way to its end, in axes of the frame \[m\].
    start_f: Vector3<f64>,
    way_f: Vector3<f64>,
    radius: f64,
}

impl Capsule {
    /// The capsule along the axis of a link.
    fn of_link(link: &AeroLink) -> Self {
        let half = if link.is_sphere { 0.0 } else { 0.5 * link.length };
        let half = link.axis_l.into_inner() * half;
        Self {
            frame: link.frame.clone(),
            start_f: link.centre_l - half,
            way_f: half * 2.0,
            radius: 0.5 * link.diameter,
        }
    }
}

/// Distances of pairs of capsules and their derivatives by the moved joints; preallocated.
#[derive(Debug, Clone)]
pub struct Clearance {
    capsules: Vec<Capsule>,
    /// Start and way of every capsule, inertial axes \[m\].
    segments: Vec<Segment>,
    pairs: Vec<(usize, usize)>,
    /// Distance between the surfaces of each pair \[m\]; negative if one enters the other.
    pub distance: Vec<f64>,
    /// By the moved joints \[m/rad\]: one column for each pair.
    pub by_joint: DMatrix<f64>,
}

/// Start and way of a segment \[m\].
type Segment = (Vector3<f64>, Vector3<f64>);

impl Clearance {
    /// The pairs of `config`, without those that no joint moves relative to each other.
    ///
    /// # Errors
    /// [`BuildError::UnknownName`] for a link that the robot does not have.
    pub fn new(
        config: Option<&ClearanceConfig>,
        robot: &RobotModel,
        joints: usize,
    ) -> Result<Self, BuildError> {
        let (mut capsules, mut pairs) = (Vec::new(), Vec::new());
        if let Some(config) = config {
            let links = |key: &str, names: &[String]| -> Result<Vec<Capsule>, BuildError> {
                let find = |name: &String| {
                    let known = robot.aero_links.iter().map(|link| link.name.as_str());
                    let place = place_of(format!("controller.mpc.clearance.{key}"), name, known)?;
                    Ok(Capsule::of_link(&robot.aero_links[place]))
                };
                names.iter().map(find).collect()
            };
            let exhausts = robot.jets.iter().map(|jet| Capsule {
                frame: jet.frame.clone(),
                start_f: Vector3::zeros(),
                way_f: jet.axis_f.into_inner() * -config.exhaust,
                radius: 0.0,
            });
            capsules.extend(exhausts.chain(links("links", &config.links)?));
            let first = capsules.len();
            capsules.extend(links("apart_from", &config.apart_from)?);
            let all = (0..first).flat_map(|one| (first..capsules.len()).map(move |other| (one, other)));
            pairs.extend(all.filter(|(one, other)| capsules[*one].frame.body != capsules[*other].frame.body));
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
        for (segment, capsule) in self.segments.iter_mut().zip(&self.capsules) {
            let pose = kinematics.frame_pose(&capsule.frame);
            *segment = (pose.transform_point(&capsule.start_f), pose.rotation * capsule.way_f);
        }
        for (index, &(one, other)) in self.pairs.iter().enumerate() {
            let points = nearest_points(&self.segments[one], &self.segments[other]);
            let capsules = [&self.capsules[one], &self.capsules[other]];
            let gap = points[0] - points[1];
            let length = gap.norm();
            self.distance[index] = length - capsules[0].radius - capsules[1].radius;
            let away = gap / length.max(TINY);
            for (place, joint) in joints.iter().enumerate() {
                let moves = |side: usize| {
                    let is_moved = kinematics.chain(capsules[side].frame.body).contains(joint);
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
