//! Faults of joints: stuck, weak, free.
//!
//! Equation M142 of `docs/model`.

use flight_core::error::{BuildError, place_of};
use flight_core::robot::Joint;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Share of the torque that acts at a weak joint.
const HALF: f64 = 0.5;

/// A joint that no longer follows its torque.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointFault {
    /// Name of the joint.
    pub joint: String,
    /// Kind of the fault.
    pub kind: JointFaultKind,
    /// Time from which it acts \[s\].
    #[schemars(range(min = 0))]
    pub start: f64,
}

/// Kind of a joint's fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum JointFaultKind {
    /// The joint keeps its position.
    Stuck,
    /// Half of the torque acts.
    Weak,
    /// No torque acts.
    Free,
}

impl JointFault {
    /// Checks name and time for `joints`; `index` is the position of the fault in the list. Returns the index of
    /// the joint.
    ///
    /// # Errors
    /// [`BuildError`] naming the key, its value and what was expected.
    fn check(&self, index: usize, joints: &[Joint]) -> Result<usize, BuildError> {
        let table = format!("disturbances.joints[{index}]");
        flight_core::schema::check(self, &table)?;
        place_of(format!("{table}.joint"), &self.joint, joints.iter().map(|joint| &joint.name))
    }
}

#[derive(Debug, Clone)]
struct Fault {
    joint: usize,
    /// Share of the torque that acts.
    share: f64,
    is_stuck: bool,
    /// Time until the onset \[s\].
    left: f64,
    /// Position at the onset \[rad, m\]; `None` before.
    onset: Option<f64>,
}

/// State of the faults.
#[derive(Debug, Clone)]
pub struct JointFaults {
    faults: Vec<Fault>,
    /// Torques that act \[N m, N\].
    torque: Vec<f64>,
}

impl JointFaults {
    /// Checks the faults and prepares them for `joints`.
    ///
    /// # Errors
    /// [`BuildError`] naming the key, its value and what was expected; for two faults of one joint.
    pub fn new(configs: &[JointFault], joints: &[Joint]) -> Result<Self, BuildError> {
        let mut faults: Vec<Fault> = Vec::with_capacity(configs.len());
        for (index, config) in configs.iter().enumerate() {
            let joint = config.check(index, joints)?;
            if faults.iter().any(|other| other.joint == joint) {
                let key = format!("disturbances.joints[{index}].joint");
                return Err(BuildError::bad_value(key, &config.joint, "a joint without another fault"));
            }
            let share = match config.kind {
                JointFaultKind::Stuck => 1.0,
                JointFaultKind::Weak => HALF,
                JointFaultKind::Free => 0.0,
            };
            let is_stuck = config.kind == JointFaultKind::Stuck;
            faults.push(Fault { joint, share, is_stuck, left: config.start, onset: None });
        }
        Ok(Self { faults, torque: vec![0.0; joints.len()] })
    }

    /// Begins a tick of `dt` \[s\] in these joint positions: faults whose time has come act from here on.
    pub fn begin_tick(&mut self, dt: f64, joint_position: &[f64]) {
        for fault in &mut self.faults {
            // Half a tick absorbs rounding in the sum of the ticks.
            if fault.left < 0.5 * dt {
                fault.onset.get_or_insert(joint_position[fault.joint]);
            }
            fault.left -= dt;
        }
    }

    /// Torques that act where these are commanded \[N m, N\].
    pub fn reduce(&mut self, torque: &[f64]) -> &[f64] {
        self.torque.copy_from_slice(torque);
        for fault in self.faults.iter().filter(|fault| fault.onset.is_some()) {
            self.torque[fault.joint] *= fault.share;
        }
        &self.torque
    }

    /// Stuck joints, and the positions that they keep \[rad, m\].
    pub fn stuck(&self) -> impl Iterator<Item = (usize, f64)> {
        let stuck = self.faults.iter().filter(|fault| fault.is_stuck);
        stuck.filter_map(|fault| fault.onset.map(|position| (fault.joint, position)))
    }
}
