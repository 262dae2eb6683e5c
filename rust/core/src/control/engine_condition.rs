//! The condition of each engine: one table of transitions, which alone decides what detectors find of engines, and from
//! which the limits of the law, modes, thrusts and the descent follow.
//!
//! | state | finding | next state | reaches | sensor | thrust |
//! |---|---|---|---|---|---|
//! | works, limited | wrong sensor | the same | the same | not used | less its error |
//! | works, limited | out of reach | limited | up to this thrust, or from it on | the same | the same |
//! | works, limited | stopped unseen | unconfirmed | up to this thrust | the same | the same |
//! | works, limited | missing | stopped | nothing | not used | zero |
//! | unconfirmed | given | as before | as before | not used | with what was taken |
//! | unconfirmed | kept | limited | the same | the same | the same |
//! | stopped | given | as before | as before | as before | with what was taken |
//! | stopped | agreed | as before | as before | as before | that of the sensor |
//!
//! No other pair changes anything; a stopped engine keeps no thrust. Of two findings of a tick the stronger counts
//! ([`EngineFinding::or`]), so the order of detectors has no meaning. Equations M105, M106 and M177 of `docs/model`.

use super::detect::engines::DescentConfig;
use super::limits::Limits;
use super::modes::Modes;
use crate::robot::RobotModel;

/// What an engine that works reaches \[N\].
pub const EVERYTHING: (f64, f64) = (0.0, f64::INFINITY);

/// What the evidence of a tick says of one engine, from weak to strong.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum EngineFinding {
    /// Nothing.
    #[default]
    Nothing,
    /// Its thrust sensor is wrong by so much \[N\]: the momentum shows this error.
    WrongSensor {
        /// Measured less true thrust.
        error: f64,
    },
    /// It stays at this thrust \[N\], less or more than the commanded one, and the momentum does not show an error of the
    /// sensor; or the speed of its shaft shows it.
    OutOfReach {
        /// Its thrust.
        thrust: f64,
        /// Whether it is less than the commanded one.
        is_short: bool,
    },
    /// Its sensor alone shows that it has stopped, while no momentum is measured.
    StoppedUnseen {
        /// What the sensor says \[N\].
        thrust: f64,
        /// What is missing of the commanded thrust \[N\].
        lacks: f64,
    },
    /// The momentum does not show the thrust that is missing since an unseen stop.
    Kept,
    /// The momentum shows the thrust that was taken away.
    Given,
    /// The sensor of a stopped engine says this thrust again \[N\], and the momentum agrees.
    Agreed {
        /// What the sensor says.
        thrust: f64,
    },
    /// The momentum lacks its thrust, which no sensor measures.
    Missing,
}

impl EngineFinding {
    /// Its name in Python.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::WrongSensor { .. } => "wrong_sensor",
            Self::OutOfReach { .. } => "out_of_reach",
            Self::StoppedUnseen { .. } => "stopped_unseen",
            Self::Kept => "kept",
            Self::Given => "given",
            Self::Agreed { .. } => "agreed",
            Self::Missing => "missing",
        }
    }

    /// Place among the others, from weak to strong.
    fn strength(self) -> u8 {
        match self {
            Self::Nothing => 0,
            Self::WrongSensor { .. } => 1,
            Self::OutOfReach { .. } => 2,
            Self::StoppedUnseen { .. } => 3,
            Self::Kept => 4,
            Self::Given => 5,
            Self::Agreed { .. } => 6,
            Self::Missing => 7,
        }
    }

    /// The stronger one of two that two detectors found.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        if other.strength() > self.strength() { other } else { self }
    }
}

/// What an engine does with its commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EngineState {
    /// It follows them.
    #[default]
    Works,
    /// It does not reach the commanded thrust.
    Limited,
    /// It has stopped, as its thrust sensor alone says; momentum will confirm or revoke it.
    Unconfirmed,
    /// It has stopped, as the momentum alone shows.
    Stopped,
}

impl EngineState {
    /// Number in logs.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Works => 0,
            Self::Limited => 1,
            Self::Unconfirmed => 2,
            Self::Stopped => 3,
        }
    }
}

/// What a stop that can be revoked took away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Taken {
    /// Thrust \[N\].
    pub thrust: f64,
    /// What the engine reached before \[N\].
    pub reaches: (f64, f64),
    /// Whether its sensor was used before.
    pub is_sensor_used: bool,
}

/// What is known of one engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EngineCondition {
    /// What it does.
    pub state: EngineState,
    /// Least and greatest thrust that it has been found to reach \[N\].
    pub reaches: (f64, f64),
    /// Whether its thrust sensor is used.
    pub is_sensor_used: bool,
    /// The finding that changed this last.
    pub evidence: EngineFinding,
    /// Time with measured momentum since then \[s\].
    pub since: f64,
    /// What is given back where the stop is revoked.
    pub taken: Taken,
}

impl Default for EngineCondition {
    fn default() -> Self {
        Self {
            state: EngineState::Works,
            reaches: EVERYTHING,
            is_sensor_used: true,
            evidence: EngineFinding::Nothing,
            since: 0.0,
            taken: Taken { thrust: 0.0, reaches: EVERYTHING, is_sensor_used: true },
        }
    }
}

impl EngineCondition {
    /// Whether it reaches all thrusts of its jet.
    #[must_use]
    pub fn works(&self) -> bool {
        self.state == EngineState::Works
    }

    /// Whether it has been found to have stopped.
    #[must_use]
    pub fn has_stopped(&self) -> bool {
        matches!(self.state, EngineState::Unconfirmed | EngineState::Stopped)
    }

    /// Whether its range is too small for flight; `thrust_max` is the greatest thrust of the jet \[N\].
    #[must_use]
    pub fn is_lost(&self, descent: &DescentConfig, thrust_max: f64) -> bool {
        self.reaches.1 - self.reaches.0 < descent.range_fraction_min * thrust_max
    }

    /// The table of transitions. `thrust` \[N\] is the one that is used, `measured` \[s\] the time that a measured momentum of
    /// this tick covers. Returns by how much the used thrust is too large \[N\], where it is to be corrected.
    pub fn advance(&mut self, finding: EngineFinding, thrust: f64, measured: f64) -> Option<f64> {
        use EngineFinding as Found;
        use EngineState as State;
        self.since += measured;
        let (is_running, before) = (matches!(self.state, State::Works | State::Limited), *self);
        let taken = |thrust| Taken { thrust, reaches: before.reaches, is_sensor_used: before.is_sensor_used };
        let error = match (self.state, finding) {
            (_, Found::WrongSensor { error }) if is_running => {
                self.is_sensor_used = false;
                Some(error)
            }
            (_, Found::OutOfReach { thrust, is_short }) if is_running => {
                let (least, greatest) = self.reaches;
                self.reaches =
                    if is_short { (least.min(thrust), thrust) } else { (thrust, greatest.max(thrust)) };
                self.state = State::Limited;
                None
            }
            (_, Found::StoppedUnseen { thrust, lacks }) if is_running => {
                self.taken = taken(lacks);
                (self.state, self.reaches) = (State::Unconfirmed, (self.reaches.0.min(thrust), thrust));
                None
            }
            (_, Found::Missing) if is_running => {
                self.taken = taken(thrust);
                (self.state, self.reaches, self.is_sensor_used) = (State::Stopped, (0.0, 0.0), false);
                Some(thrust)
            }
            (State::Unconfirmed, Found::Kept) => {
                self.state = State::Limited;
                None
            }
            (State::Unconfirmed, Found::Given) => {
                self.give_back(false);
                Some(-self.taken.thrust)
            }
            (State::Stopped, Found::Given) => {
                self.give_back(self.taken.is_sensor_used);
                Some(thrust - self.taken.thrust)
            }
            (State::Stopped, Found::Agreed { thrust: measured }) => {
                self.give_back(self.taken.is_sensor_used);
                Some(thrust - measured)
            }
            (State::Stopped, _) => Some(thrust),
            _ => None,
        };
        let is_changed = (before.state, before.reaches, before.is_sensor_used)
            != (self.state, self.reaches, self.is_sensor_used);
        if is_changed {
            (self.evidence, self.since) = (finding, 0.0);
        }
        error
    }

    /// Revokes a stop.
    fn give_back(&mut self, is_sensor_used: bool) {
        self.reaches = self.taken.reaches;
        self.is_sensor_used = is_sensor_used;
        self.state = if self.reaches == EVERYTHING { EngineState::Works } else { EngineState::Limited };
    }
}

/// What follows from the conditions for the law.
#[derive(Debug, Clone)]
pub struct EngineLimits {
    /// Greatest thrust of each jet \[N\].
    thrust_max: Vec<f64>,
    /// Limits after the loss of an engine.
    descent: Option<(DescentConfig, Limits)>,
}

impl EngineLimits {
    /// Limits of `robot`, whose usual ones are these; without a `descent` the mission continues without an engine.
    #[must_use]
    pub fn new(descent: Option<DescentConfig>, usual: &Limits, robot: &RobotModel) -> Self {
        let joints = robot.joints.iter();
        let limits = |descent: &DescentConfig| Limits {
            gains: descent.momentum,
            holds_position: false,
            joint_velocity: joints.clone().map(|joint| descent.velocity_max(joint)).collect(),
            torque_rate: joints.clone().map(|joint| descent.torque_rate_max(joint)).collect(),
            ..usual.clone()
        };
        Self {
            thrust_max: usual.thrust.iter().map(|(_, most)| *most).collect(),
            descent: descent.map(|descent| (descent, limits(&descent))),
        }
    }

    /// Writes the limits of the law: of a limited engine the thrusts it reaches, so that the others take over its share;
    /// after the loss of an engine those of the descent, unless the robot is standing. Returns whether one is lost.
    pub fn limit(&self, engines: &[EngineCondition], is_standing: bool, limits: &mut Limits) -> bool {
        let of_jets = limits.thrust.iter_mut().zip(&mut limits.works);
        for (engine, (range, works)) in engines.iter().zip(of_jets) {
            *works &= engine.works();
            let greatest = engine.reaches.1.min(range.1);
            *range = (engine.reaches.0.max(range.0).min(greatest), greatest);
        }
        let Some((descent, of_descent)) = &self.descent else { return false };
        let is_lost =
            engines.iter().zip(&self.thrust_max).any(|(engine, most)| engine.is_lost(descent, *most));
        if is_lost && !is_standing {
            limits.descend(of_descent);
        }
        is_lost
    }
}

/// Modes of a tick with engines in these conditions.
#[must_use]
pub fn modes_of(engines: &[EngineCondition]) -> Modes {
    let mut modes = Modes::default();
    for engine in engines {
        match engine.state {
            EngineState::Works => (),
            EngineState::Limited | EngineState::Unconfirmed => modes.insert(Modes::ENGINE_LIMITED),
            EngineState::Stopped => modes.insert(Modes::ENGINE_STOPPED),
        }
    }
    modes
}
