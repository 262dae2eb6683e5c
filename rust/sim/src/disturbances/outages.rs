//! Outages of measurements: missing, frozen or wrong channels.
//!
//! Equation M104 of `docs/model`.

use flight_core::control::Measurement;
use flight_core::error::{BuildError, check, place_of};
use flight_core::kinematics::RobotState;
use flight_core::robot::Jet;
use flight_core::spatial::axis_angle;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::slice::from_mut;

/// A temporary failure of one channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Outage {
    /// Channel that fails.
    pub channel: OutageChannel,
    /// Name of the jet whose thrust fails; without it, all jets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jet: Option<String>,
    /// Start of the outage \[s\]; the first measurement of a flight can be wrong, but not missing or frozen.
    #[schemars(range(min = 0))]
    pub start: f64,
    /// Duration of the outage \[s\]; without it, to the end of the flight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub duration: Option<f64>,
    /// What is measured instead.
    pub kind: OutageKind,
    /// Error of a wrong value \[unit of the channel\]: added to every component; for a rotation, an angle
    /// about inertial x.
    #[serde(default = "default_one")]
    pub error: f64,
}

fn default_one() -> f64 {
    1.0
}

/// Channel that fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutageChannel {
    /// Velocity of the air.
    Wind,
    /// Thrust of one jet or of all.
    Thrust,
    /// Positions and velocities of all joints.
    Joints,
    /// Position of the base.
    BasePosition,
    /// Rotation of the base.
    BaseRotation,
    /// Velocity of the base, linear and angular.
    BaseVelocity,
    /// Height above the ground.
    Height,
    /// Wrenches on all feet.
    Feet,
}

/// What is measured during an outage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutageKind {
    /// Nothing: every component is NaN.
    Missing,
    /// The first component is NaN.
    Nan,
    /// The value at the start of the outage.
    Frozen,
    /// A value with the error `error`.
    Wrong,
}

impl Outage {
    /// Checks that times and names are valid for `jets`; `index` is the position of the outage in the list.
    ///
    /// # Errors
    /// [`BuildError`] naming the key, its value and what was expected.
    pub fn check(&self, index: usize, jets: &[Jet]) -> Result<(), BuildError> {
        let key = |name: &str| format!("disturbances.outages[{index}].{name}");
        flight_core::schema::check(self, &format!("disturbances.outages[{index}]"))?;
        if self.kind != OutageKind::Wrong {
            let expected = "seconds > 0: a flight begins with everything measured";
            check(&key("start"), self.start, |t| t > 0.0, expected)?;
            let expected = "none, but for the kind wrong";
            check(&key("error"), self.error, |error| error.total_cmp(&default_one()).is_eq(), expected)?;
        }
        if let Some(name) = &self.jet {
            if self.channel != OutageChannel::Thrust {
                return Err(BuildError::bad_value(key("jet"), name, "none, but for the channel thrust"));
            }
            place_of(key("jet"), name, jets.iter().map(|jet| &jet.name))?;
        }
        Ok(())
    }

    /// Whether the outage is active at `time` \[s\]. Half a microsecond absorbs the rounding of times.
    fn is_on(&self, time: f64) -> bool {
        let since = time - self.start + 5e-7;
        since >= 0.0 && self.duration.is_none_or(|duration| since < duration)
    }
}

/// State of all outages.
#[derive(Debug, Clone)]
pub struct Outages {
    /// Each with its jets, and the measurement at its start.
    outages: Vec<(Outage, Vec<usize>, Option<Measurement>)>,
}

impl Outages {
    /// Checks the outages and prepares them for a robot with these jets.
    ///
    /// # Errors
    /// As [`Outage::check`].
    pub fn new(outages: &[Outage], jets: &[Jet]) -> Result<Self, BuildError> {
        let place = |(index, outage): (usize, &Outage)| {
            outage.check(index, jets)?;
            let concerned = |name: &str| outage.jet.as_ref().is_none_or(|jet| jet == name);
            let of = jets.iter().enumerate().filter(|(_, jet)| concerned(&jet.name)).map(|(jet, _)| jet);
            Ok((outage.clone(), of.collect(), None))
        };
        Ok(Self { outages: outages.iter().enumerate().map(place).collect::<Result<_, _>>()? })
    }

    /// Applies the outages to the measurement at `time` \[s\].
    pub fn spoil(&mut self, time: f64, sample: &mut Measurement) {
        for (outage, jets, held) in &mut self.outages {
            if !outage.is_on(time) {
                continue;
            }
            let held = &*held.get_or_insert_with(|| sample.clone());
            let spoil = |numbers: &mut [f64], before: &[f64]| spoil(outage, numbers, before);
            match outage.channel {
                OutageChannel::Wind => spoil(sample.wind.as_mut_slice(), held.wind.as_slice()),
                OutageChannel::Thrust => {
                    for &jet in &*jets {
                        spoil(&mut sample.thrust[jet..=jet], &held.thrust[jet..=jet]);
                    }
                }
                OutageChannel::Joints => {
                    let RobotState { joint_position, velocity, .. } = &mut sample.state;
                    spoil(joint_position.as_mut_slice(), held.state.joint_position.as_slice());
                    spoil(&mut velocity.as_mut_slice()[6..], held.state.joint_velocity());
                }
                OutageChannel::BasePosition => {
                    let before = held.state.base.position;
                    spoil(sample.state.base.position.as_mut_slice(), before.as_slice());
                }
                OutageChannel::BaseRotation if outage.kind == OutageKind::Wrong => {
                    let turn = axis_angle(&Vector3::x(), outage.error);
                    sample.state.base.rotation = turn * sample.state.base.rotation;
                }
                OutageChannel::BaseRotation => {
                    let before = held.state.base.rotation;
                    spoil(sample.state.base.rotation.as_mut_slice(), before.as_slice());
                }
                OutageChannel::BaseVelocity => {
                    let before = &held.state.velocity.as_slice()[..6];
                    spoil(&mut sample.state.velocity.as_mut_slice()[..6], before);
                }
                OutageChannel::Feet => {
                    spoil(sample.foot_wrenches.as_mut_slice(), held.foot_wrenches.as_slice());
                }
                OutageChannel::Height => spoil(from_mut(&mut sample.height), &[held.height]),
            }
        }
    }
}

fn spoil(outage: &Outage, numbers: &mut [f64], before: &[f64]) {
    match outage.kind {
        OutageKind::Missing => numbers.fill(f64::NAN),
        OutageKind::Nan => numbers.iter_mut().take(1).for_each(|x| *x = f64::NAN),
        OutageKind::Frozen => numbers.copy_from_slice(before),
        OutageKind::Wrong => numbers.iter_mut().for_each(|x| *x += outage.error),
    }
}
