//! The simulated flying robot: rigid bodies, thrusts and wind.
//!
//! ```text
//! M(q) ν̇ = S τ + Σ Jᵀ T a + w_aero + w_push − h(q, ν)
//! ```
//!
//! Without ground; joint stops act unless they are disabled, and drives if they are configured. Another [`World`] can move
//! the bodies instead.
//!
//! Equations M78, M79, M87, M140, M142 and M153 to M155 of `docs/model`; what a step adds to the momentum is M85.

use crate::actuation::Actuation;
use crate::config::{AeroKinematics, DynamicsBackend, Integrator, SimulatorConfig};
use crate::disturbances::{Disturbances, JointFaults, Pushes};
use crate::fuel::Fuel;
use crate::jets::Jets;
use crate::motors::Motors;
use crate::world::{Seen, World};
use flight_core::aero::{AeroModel, LinkConventions, LinkForces};
use flight_core::control::config::ControllerConfig;
use flight_core::dynamics::{Dynamics, MassFactor};
use flight_core::error::BuildError;
use flight_core::kinematics::{Kinematics, RobotState};
use flight_core::robot::RobotModel;
use flight_io::load_aero;
use nalgebra::{DMatrix, DVector, Vector3};

/// Stiffness of a joint stop, and of what holds a stuck joint \[N m/rad, N/m\]: 50 N m deflect it by half a milliradian.
const STOP_STIFFNESS: f64 = 1e5;

/// Damping of both \[N m s/rad, N s/m\]: its time constant with the stiffness is 2 ms, so that a limb
/// of 0.1 kg m² stops without bouncing at any step.
const STOP_DAMPING: f64 = 200.0;

/// The simulated robot in the wind.
#[derive(Debug, Clone)]
pub struct Plant {
    robot: RobotModel,
    aero: AeroModel,
    conventions: LinkConventions,
    integrator: Integrator,
    has_stops: bool,
    substeps: u32,
    /// Times that torques are commanded in a tick.
    torque_steps: u32,
    /// Torques that are commanded \[N m, N\].
    torque: Vec<f64>,
    /// Those of every physics step between two of these commands, which a world receives.
    torques: Vec<f64>,
    state: RobotState,
    jets: Jets,
    /// Commands on their way; `None` if they act at once.
    actuation: Option<Actuation>,
    joint_faults: JointFaults,
    pushes: Pushes,
    /// `None` if torques act on the joints themselves.
    motors: Option<Motors>,
    /// `None` if the mass is constant.
    fuel: Option<Fuel>,
    kinematics: Kinematics,
    dynamics: Dynamics,
    link_forces: LinkForces,
    /// Forces that replace those of the model, inertial axes \[N\].
    given_forces: Option<Vec<Vector3<f64>>>,
    /// First-tick pose with current velocities, if the aerodynamic kinematics are frozen.
    frozen: Option<(RobotState, Kinematics)>,
    mass_factor: MassFactor,
    /// Generalised force minus the bias.
    force: DVector<f64>,
    acceleration: DVector<f64>,
}

impl Plant {
    /// Builds a robot in its initial state, with the errors that `disturbances` gives the plant and for commands in the
    /// ticks of `law`, and checks the configuration.
    ///
    /// # Errors
    /// [`BuildError`] naming the item that is invalid.
    pub fn new(
        robot: RobotModel,
        config: &SimulatorConfig,
        disturbances: &Disturbances,
        law: &ControllerConfig,
    ) -> Result<Self, BuildError> {
        let (time_step, torque_steps) = (law.time_step, law.torque.steps);
        let robot = disturbances.simulated_robot(robot)?;
        config.check(&robot, time_step)?;
        if torque_steps == 0 || !config.substeps.is_multiple_of(torque_steps) {
            let expected = format!("a multiple of controller.torque.steps, {torque_steps}");
            return Err(BuildError::bad_value("simulator.substeps", config.substeps, expected));
        }
        if config.ground.is_some() {
            let expected = "none: this back end has no ground; backend = \"mujoco\" does";
            return Err(BuildError::bad_value("simulator.ground", "given", expected));
        }
        if config.motors.is_some() && config.integrator == Integrator::ExplicitEuler {
            let expected = "semi_implicit_euler, with simulator.motors";
            return Err(BuildError::bad_value("simulator.integrator", "explicit_euler", expected));
        }
        if config.dynamics != DynamicsBackend::Tree {
            let expected = "tree; backend = \"jax\" has mjx too";
            return Err(BuildError::bad_value("simulator.dynamics", "mjx", expected));
        }
        let (joints, n_jets) = (robot.joints.len(), robot.jets.len());
        let n = 6 + joints;
        let actuation = config.actuation.as_ref();
        let actuation = actuation
            .map(|way| {
                Actuation::new(
                    way,
                    config.physics_step(time_step),
                    config.substeps,
                    torque_steps,
                    joints,
                    n_jets,
                )
            })
            .transpose()?;
        let state = config.initial.state();
        let motors = config.motors.as_ref().map(|motors| {
            let (position, velocity) = (state.joint_position.as_slice(), state.joint_velocity());
            Motors::new(motors, &robot, position, velocity)
        });
        let mut plant = Self {
            motors,
            fuel: config.fuel.as_ref().map(|fuel| Fuel::new(fuel, &robot)).transpose()?,
            aero: load_aero(&config.aero, &robot)?.weight_forces(
                &disturbances.aero,
                &robot,
                "disturbances.aero",
            )?,
            conventions: LinkConventions { lever_arm: config.lever_arm, ..LinkConventions::default() },
            integrator: config.integrator,
            has_stops: config.joint_stops,
            substeps: config.substeps,
            torque_steps,
            torque: vec![0.0; joints],
            torques: vec![0.0; joints * (config.substeps / torque_steps) as usize],
            state,
            jets: Jets::new(&config.jets, &robot.jets, &robot.engines, &config.initial.thrust)?
                .with_faults(&disturbances.jets, &robot.jets)?,
            actuation,
            joint_faults: JointFaults::new(&disturbances.joints, &robot.joints)?,
            pushes: Pushes::new(&disturbances.pushes, &robot)?,
            kinematics: Kinematics::new(&robot),
            dynamics: Dynamics::new(&robot),
            link_forces: LinkForces::new(&robot),
            given_forces: None,
            frozen: None,
            mass_factor: MassFactor::new(n),
            force: DVector::zeros(n),
            acceleration: DVector::zeros(n),
            robot,
        };
        if config.initial.free_fall_tick {
            plant.fall_freely(time_step);
        }
        if config.kinematics == AeroKinematics::Frozen {
            plant.frozen = Some((plant.state.clone(), Kinematics::new(&plant.robot)));
        }
        Ok(plant)
    }

    /// The simulated robot.
    #[must_use]
    pub fn robot(&self) -> &RobotModel {
        &self.robot
    }

    /// Times that torques are commanded in a tick.
    #[must_use]
    pub fn torque_steps(&self) -> u32 {
        self.torque_steps
    }

    /// State of the robot.
    #[must_use]
    pub fn state(&self) -> &RobotState {
        &self.state
    }

    /// The engines.
    #[must_use]
    pub fn jets(&self) -> &Jets {
        &self.jets
    }

    /// Poses and centre of mass of the last [`Self::observe`].
    #[must_use]
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// Momentum and mass matrix of the last [`Self::observe`]; [`Self::advance`] adds active joint stops to
    /// the mass matrix.
    #[must_use]
    pub fn dynamics(&self) -> &Dynamics {
        &self.dynamics
    }

    /// Aerodynamic forces of the last [`Self::observe`].
    #[must_use]
    pub fn link_forces(&self) -> &LinkForces {
        &self.link_forces
    }

    /// Places the robot where a world shows it.
    pub fn place(&mut self, state: &RobotState) {
        self.state.copy_from(state);
    }

    /// Evaluates all quantities that depend on the state, in the given wind \[m/s\].
    pub fn observe(&mut self, wind_i: &Vector3<f64>) {
        self.kinematics.update(&self.robot, &self.state);
        self.dynamics.update(&self.robot, &self.state, &self.kinematics);
        let placed = match &mut self.frozen {
            None => &self.kinematics,
            Some((first, kinematics)) => {
                first.velocity.copy_from(&self.state.velocity);
                kinematics.update(&self.robot, first);
                kinematics
            }
        };
        self.link_forces.update(&self.robot, placed, self.conventions, &mut self.aero, wind_i);
        if let Some(given) = &self.given_forces {
            self.link_forces.forces_i.copy_from_slice(given);
        }
    }

    /// Replaces the aerodynamic forces by `forces_i` \[N, inertial axes\], one for each link, from now on; `None` returns
    /// to the model at the next [`Self::observe`].
    ///
    /// # Errors
    /// [`BuildError::BadValue`] if the number of forces is not that of the links.
    pub fn replace_link_forces(&mut self, forces_i: Option<Vec<Vector3<f64>>>) -> Result<(), BuildError> {
        let links = self.robot.aero_links.len();
        if let Some(forces) = &forces_i {
            if forces.len() != links {
                let expected = format!("{links}, one for each aerodynamic link");
                return Err(BuildError::bad_value("number of link forces", forces.len(), expected));
            }
            self.link_forces.forces_i.copy_from_slice(forces);
        }
        self.given_forces = forces_i;
        Ok(())
    }

    /// Advances by one tick of `time_step` \[s\] in which these torques \[N m, N\] and thrust rates \[N/s\] are commanded:
    /// they act throughout, or as `simulator.actuation` lets them arrive (M140). The forces of the first sub-step are
    /// those of the last [`Self::observe`].
    pub fn advance(
        &mut self,
        torque: &[f64],
        thrust_rate_command: &[f64],
        wind_i: &Vector3<f64>,
        time_step: f64,
    ) {
        self.advance_in_steps(thrust_rate_command, wind_i, time_step, |_, _, commanded| {
            commanded.copy_from_slice(torque);
        });
    }

    /// Advances by one tick in which torques are commanded at the beginning of each of its `torque_steps` parts:
    /// `command` receives the number of the part, from zero, and the robot's state then, and writes them \[N m, N\].
    pub fn advance_in_steps(
        &mut self,
        thrust_rate_command: &[f64],
        wind_i: &Vector3<f64>,
        time_step: f64,
        mut command: impl FnMut(u32, &RobotState, &mut [f64]),
    ) {
        let step = time_step / f64::from(self.substeps);
        let every = self.substeps / self.torque_steps;
        let (mut actuation, mut torque) = (self.actuation.take(), std::mem::take(&mut self.torque));
        self.joint_faults.begin_tick(time_step, self.state.joint_position.as_slice());
        for substep in 0..self.substeps {
            if substep > 0 {
                self.observe(wind_i);
            }
            let (part, within) = (substep / every, substep % every);
            if within == 0 {
                command(part, &self.state, &mut torque);
                match &mut actuation {
                    Some(way) if part == 0 => way.send(&torque, thrust_rate_command),
                    Some(way) => way.send_torque(&torque),
                    None => {}
                }
            }
            self.gather_forces(actuation.as_mut().map_or(&torque, |way| way.torque(within)), step);
            self.integrate(step);
        }
        self.torque = torque;
        self.actuation = actuation;
        self.advance_jets(thrust_rate_command, time_step);
    }

    /// As [`Self::advance_in_steps`], with the bodies in `world`, under the forces of the last [`Self::observe`] throughout.
    /// Drives, joint stops and fuel are the world's.
    pub fn advance_in(
        &mut self,
        (world, seen): (&mut dyn World, &mut Seen),
        thrust_rate_command: &[f64],
        time_step: f64,
        mut command: impl FnMut(u32, &RobotState, &mut [f64]),
    ) {
        let steps = self.substeps / self.torque_steps;
        self.joint_faults.begin_tick(time_step, self.state.joint_position.as_slice());
        self.force.fill(0.0);
        self.gather_external_forces(time_step);
        for part in 0..self.torque_steps {
            if part > 0 {
                world.observe(seen);
                self.state.copy_from(&seen.state);
            }
            command(part, &self.state, &mut self.torque);
            match &mut self.actuation {
                Some(way) if part == 0 => way.send(&self.torque, thrust_rate_command),
                Some(way) => way.send_torque(&self.torque),
                None => {}
            }
            for within in 0..steps {
                let torque = self.actuation.as_mut().map_or(&self.torque[..], |way| way.torque(within));
                let acting = self.joint_faults.reduce(torque);
                let row = within as usize * acting.len();
                self.torques[row..row + acting.len()].copy_from_slice(acting);
            }
            world.advance(steps, &self.torques, self.force.as_slice());
        }
        self.advance_jets(thrust_rate_command, time_step);
    }

    /// Advances the engines by one tick \[s\], and what they burn.
    fn advance_jets(&mut self, thrust_rate_command: &[f64], time_step: f64) {
        let thrust_rate = self.actuation.as_mut().map_or(thrust_rate_command, Actuation::thrust_rate);
        if let Some(fuel) = &mut self.fuel {
            fuel.burn(self.jets.thrust(), time_step, &mut self.robot);
        }
        self.jets.advance(thrust_rate, time_step);
    }

    /// `S τ + Σ Jᵀ T a + w_aero + w_push − h`
    fn gather_forces(&mut self, torque: &[f64], step: f64) {
        let force = &mut self.force;
        force.copy_from(&self.dynamics.bias);
        force.neg_mut();
        if let Some(motors) = &mut self.motors {
            let torque = self.joint_faults.reduce(motors.lag(torque, step));
            motors.receive(torque);
        } else {
            for (joint, torque) in self.joint_faults.reduce(torque).iter().enumerate() {
                force[6 + joint] += torque;
            }
        }
        self.gather_external_forces(step);
    }

    /// `Σ Jᵀ T a + w_aero + w_push`, added to the force.
    fn gather_external_forces(&mut self, step: f64) {
        let force = &mut self.force;
        let thrusts = (0..self.robot.jets.len()).map(|jet| self.jets.force(jet));
        self.kinematics.add_thrusts(&self.robot, thrusts, force);
        self.pushes.add(&self.robot, &self.kinematics, step, force);
        let placed = self.frozen.as_ref().map_or(&self.kinematics, |(_, kinematics)| kinematics);
        for (index, link) in self.robot.aero_links.iter().enumerate() {
            // Moment and Jacobian use the same point, which is exact for a rigid body.
            let point = &self.link_forces.arm_points_i[index];
            placed.add_generalised_force(link.frame.body, point, &self.link_forces.forces_i[index], force);
        }
    }

    /// First step of the published model, with gravity only (M79).
    fn fall_freely(&mut self, time_step: f64) {
        self.kinematics.update(&self.robot, &self.state);
        self.dynamics.update(&self.robot, &self.state, &self.kinematics);
        self.force.copy_from(&self.dynamics.bias);
        self.force.neg_mut();
        self.integrate(time_step);
    }

    /// Adds what keeps stuck joints at their positions (M142).
    fn hold_stuck(&mut self, step: f64) {
        let Self { joint_faults, force, dynamics, .. } = self;
        for (joint, held) in joint_faults.stuck() {
            let (position, velocity) = position_ahead(&self.state, self.integrator, joint, step);
            add_spring(force, &mut dynamics.mass_matrix, 6 + joint, (position, velocity), held, step);
        }
    }

    /// Adds the stops of joints that this acceleration takes out of their range (M87). Returns whether a stop is active.
    fn add_stops(&mut self, step: f64) -> bool {
        let mut is_stopped = false;
        for (index, joint) in self.robot.joints.iter().enumerate() {
            let place = 6 + index;
            let (position, velocity) = position_ahead(&self.state, self.integrator, index, step);
            let ahead = position + step * (velocity + step * self.acceleration[place]);
            let (lower, upper) = joint.stops;
            let stop = if ahead > upper {
                upper
            } else if ahead < lower {
                lower
            } else {
                continue;
            };
            let mass_matrix = &mut self.dynamics.mass_matrix;
            add_spring(&mut self.force, mass_matrix, place, (position, velocity), stop, step);
            is_stopped = true;
        }
        is_stopped
    }

    /// `ν̇ = M⁻¹ force`
    fn accelerate(&mut self) {
        solve(&mut self.mass_factor, &self.force, &self.dynamics.mass_matrix, &mut self.acceleration);
    }

    /// The same with the drives (M153), which `force` and mass matrix then contain.
    fn accelerate_with_drives(&mut self, step: f64) {
        let Self { motors, force, dynamics, acceleration, state, mass_factor, .. } = self;
        let joints = (state.joint_position.as_slice(), &state.velocity.as_slice()[6..]);
        let solve = |force: &_, mass_matrix: &_, to: &mut _| solve(mass_factor, force, mass_matrix, to);
        match motors {
            Some(motors) => {
                motors.accelerate(force, &mut dynamics.mass_matrix, acceleration, joints, step, solve);
            }
            None => self.accelerate(),
        }
    }

    /// Converts the gathered forces to accelerations and takes one Euler step.
    fn integrate(&mut self, step: f64) {
        self.hold_stuck(step);
        self.accelerate_with_drives(step);
        if self.has_stops && self.add_stops(step) {
            self.accelerate();
        }
        if self.integrator == Integrator::SemiImplicitEuler {
            self.state.velocity.axpy(step, &self.acceleration, 1.0);
        }
        self.state.advance_pose(step);
        if let Some(motors) = &mut self.motors {
            let (position, velocity) = (&self.state.joint_position, self.state.velocity.as_slice());
            motors.advance(position.as_slice(), &velocity[6..], step);
        }
        if self.integrator == Integrator::ExplicitEuler {
            self.state.velocity.axpy(step, &self.acceleration, 1.0);
        }
    }
}

/// `ν̇ = M⁻¹ force`
fn solve(factor: &mut MassFactor, force: &DVector<f64>, mass_matrix: &DMatrix<f64>, to: &mut DVector<f64>) {
    to.copy_from(force);
    if factor.factorise(mass_matrix) {
        factor.solve_in_place(to);
    } else {
        // Only for a state that is not finite; the flight ends with it.
        to.fill(f64::NAN);
    }
}

/// Velocity of a joint, and the position that its velocity after the step is added to: with explicit Euler, that at the
/// end of the step.
fn position_ahead(state: &RobotState, integrator: Integrator, joint: usize, step: f64) -> (f64, f64) {
    let velocity = state.velocity[6 + joint];
    let moved = if integrator == Integrator::ExplicitEuler { step * velocity } else { 0.0 };
    (state.joint_position[joint] + moved, velocity)
}

/// Adds a spring, at rest in the position `rest`, and a damper to a joint; implicit in the velocity after the step, so
/// that they are stable at every step.
fn add_spring(
    force: &mut DVector<f64>,
    mass_matrix: &mut DMatrix<f64>,
    place: usize,
    (position, velocity): (f64, f64),
    rest: f64,
    step: f64,
) {
    force[place] -= STOP_STIFFNESS * (position + step * velocity - rest) + STOP_DAMPING * velocity;
    mass_matrix[(place, place)] += step * (step * STOP_STIFFNESS + STOP_DAMPING);
}
