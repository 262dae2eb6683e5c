//! What the controller is given of the simulated robot: sensors, errors of the measured wind, outages.
//!
//! ```text
//! truth ──► sensors ──► outages ──► Measurement ──► controller
//! wind ──► errors of the measured wind ──┘
//! ```

use crate::config::ScenarioConfig;
use crate::disturbances::{Outage, OutageChannel, Outages, WindEstimator};
use crate::foot_sensors::FootSensors;
use crate::sensors::Sensors;
use crate::wind::Wind;
use flight_core::control::{JointMeasurement, Measurement, Preview};
use flight_core::error::BuildError;
use flight_core::jets::Shaft;
use flight_core::kinematics::RobotState;
use flight_core::robot::RobotModel;
use nalgebra::{Vector3, Vector6};

/// What stands between the simulated robot and its controller, and the measurement of a tick.
#[derive(Debug)]
pub struct Measuring {
    /// Sensors of the robot's state; `None` if they are exact.
    sensors: Option<Sensors>,
    /// Wind that the controller receives in place of the simulated one.
    controller_wind: Option<Wind>,
    /// Sensors of the feet; `None` where they are exact.
    foot_sensors: Option<FootSensors>,
    /// Errors of the measured wind; `None` without errors.
    wind_estimator: Option<WindEstimator>,
    outages: Outages,
    /// Engines whose speed is measured in place of the thrust; empty for none.
    shafts: Vec<Shaft>,
    /// Height of the base origin at which the robot stands on the ground of its landing \[m\].
    standing: f64,
    /// Thrusts of the last tick \[N\], which an outage that begins after it freezes.
    thrust: Vec<f64>,
    /// Measurement of the tick.
    sample: Measurement,
}

impl Measuring {
    /// Measures `robot` as configured, and the speeds of these `shafts`; `wind` is the simulated one, `feet` the number of
    /// feet of the controller.
    ///
    /// # Errors
    /// [`BuildError`] naming the invalid part of the configuration.
    pub fn new(
        config: &ScenarioConfig,
        robot: &RobotModel,
        shafts: Vec<Shaft>,
        wind: &Wind,
        feet: usize,
    ) -> Result<Self, BuildError> {
        let (joints, jets) = (robot.joints.len(), robot.jets.len());
        let (disturbances, simulator) = (&config.disturbances, &config.simulator);
        let (time_step, n_ticks) = (config.controller.law.time_step, config.n_ticks());
        let controller_wind = disturbances.controller_wind.as_ref();
        let controller_wind =
            controller_wind.map(|wind| Wind::from_table(wind, "disturbances.controller_wind")).transpose()?;
        let given = controller_wind.as_ref().unwrap_or(wind);
        let estimator = |estimate| {
            let times = (0..=n_ticks).map(|tick| tick as f64 * time_step);
            let sum: Vector3<f64> = times.map(|time| given.velocity(time)).sum();
            WindEstimator::new(estimate, time_step, sum / (n_ticks + 1) as f64)
        };
        let sensors = simulator.sensors.as_ref();
        let is_of_height = |outage: &Outage| outage.channel == OutageChannel::Height;
        let measures_height = sensors.is_some_and(|sensors| sensors.height.is_some());
        if let Some(place) = disturbances.outages.iter().position(is_of_height).filter(|_| !measures_height) {
            let key = format!("disturbances.outages[{place}].channel");
            let expected = "one that is measured: simulator.sensors.height is absent";
            return Err(BuildError::bad_value(key, "height", expected));
        }
        let of_feet = sensors.and_then(|sensors| sensors.feet.as_ref().map(|feet| (feet, sensors.seed)));
        let is_of_feet = |outage: &Outage| outage.channel == OutageChannel::Feet;
        let expected = "none: the controller has no feet";
        if feet == 0 && of_feet.is_some() {
            return Err(BuildError::bad_value("simulator.sensors.feet", "a table", expected));
        }
        if let Some(place) = disturbances.outages.iter().position(is_of_feet).filter(|_| feet == 0) {
            return Err(BuildError::bad_value(
                format!("disturbances.outages[{place}].channel"),
                "feet",
                expected,
            ));
        }
        Ok(Self {
            foot_sensors: of_feet.map(|(config, seed)| FootSensors::new(config, seed, time_step, feet)),
            sensors: sensors.map(|sensors| Sensors::new(sensors, time_step, joints, jets)).transpose()?,
            wind_estimator: disturbances.wind_estimate.as_ref().map(estimator).transpose()?,
            controller_wind,
            outages: Outages::new(&disturbances.outages, &robot.jets)?,
            shafts,
            standing: simulator.initial.base_position[2] + simulator.ground_height.unwrap_or(0.0),
            thrust: vec![0.0; jets],
            sample: Measurement::zero(joints, jets, feet),
        })
    }

    /// Measures a robot in this state, with these thrusts \[N\] and wrenches of the controller's feet \[N, N m\], in a wind
    /// \[m/s\], at `time` \[s\]. Once per tick.
    pub fn measure(
        &mut self,
        time: f64,
        (state, thrust): (&RobotState, &[f64]),
        foot_wrenches: impl IntoIterator<Item = (usize, Vector6<f64>)>,
        wind: &Vector3<f64>,
    ) {
        self.sample.time = time;
        for (foot, wrench) in foot_wrenches {
            self.sample.foot_wrenches.fixed_rows_mut::<6>(6 * foot).copy_from(&wrench);
        }
        let given = self.controller_wind.as_ref().map_or(*wind, |wind| wind.velocity(time));
        self.sample.wind = self.wind_estimator.as_mut().map_or(given, |estimator| estimator.update(&given));
        self.sample.state.copy_from(state);
        self.sample.thrust.copy_from_slice(thrust);
        if let Some(sensors) = &mut self.sensors {
            self.sample.height = state.base.position.z - self.standing;
            sensors.read(&mut self.sample);
        }
        if let Some(sensors) = &mut self.foot_sensors {
            let turn = self.sample.state.base.rotation * state.base.rotation.transpose();
            sensors.read(&turn, &mut self.sample.foot_wrenches);
        }
        self.outages.spoil(time, &mut self.sample);
        self.thrust.copy_from_slice(&self.sample.thrust);
        self.measure_shafts();
    }

    /// Replaces thrusts by the speeds of shafts, where those are measured.
    fn measure_shafts(&mut self) {
        let Measurement { thrust, shaft_speed, .. } = &mut self.sample;
        for ((thrust, speed), shaft) in thrust.iter_mut().zip(shaft_speed).zip(&self.shafts) {
            *speed = if thrust.is_finite() { shaft.speed(*thrust) } else { f64::NAN };
            *thrust = f64::NAN;
        }
    }

    /// Measures the joints of a robot `after` the tick at `time` \[s\].
    pub fn measure_joints(&mut self, time: f64, after: f64, robot: &RobotState) -> JointMeasurement<'_> {
        let truth = (robot.joint_position.as_slice(), robot.joint_velocity());
        let (position, velocity) =
            self.sensors.as_mut().map_or(truth, |sensors| sensors.read_joints(robot, after));
        let state = &mut self.sample.state;
        state.joint_position.as_mut_slice().copy_from_slice(position);
        state.velocity.as_mut_slice()[6..].copy_from_slice(velocity);
        self.sample.thrust.copy_from_slice(&self.thrust);
        self.outages.spoil(time + after, &mut self.sample);
        self.measure_shafts();
        let state = &self.sample.state;
        JointMeasurement { position: state.joint_position.as_slice(), velocity: state.joint_velocity() }
    }

    /// The measurement of the tick, with what is known of the wind ahead.
    pub fn look_ahead(&mut self, wind: &Wind) -> (&Measurement, Preview<'_>) {
        let time = self.sample.time;
        let ahead = self.sensors.as_mut().map_or(&[][..], |sensors| sensors.look_ahead(wind, time));
        (&self.sample, Preview { wind: ahead, ..Preview::default() })
    }

    /// The measurement of the tick.
    #[must_use]
    pub fn sample(&self) -> &Measurement {
        &self.sample
    }

    /// The same, to be changed.
    pub fn sample_mut(&mut self) -> &mut Measurement {
        &mut self.sample
    }
}
