//! The set-point generator: the published table, its closed forms, and its filters computed another way.

#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]
#![allow(clippy::approx_constant, reason = "-3.14 is an angle in a table")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::common::{TIME_STEP, assert_within, configs, experiment, random_vector, rng, tick_at};
use flight_core::control::Preview;
use flight_core::control::law::minimum_jerk::{FilterState, MinimumJerkFilter};
use flight_core::control::law::mission::{Commands, Mission};
use flight_core::control::law::recorded::RecordedMotion;
use flight_core::control::law::setpoint::{RawSetpoint, Setpoint, SetpointConfig, SetpointGenerator};
use flight_core::spatial::{
    axis_angle, exp_so3, log_so3, orthonormality_error, rotation_from_rpy, rpy_from_rotation,
};
use flight_io::load_robot;
use flight_sim::Plant;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{PI, TAU};

fn config() -> SetpointConfig {
    experiment("test2").controller.law.setpoint
}

fn commands(name: &str) -> Commands {
    let file = configs("mission").join(name).with_extension("toml");
    flight_io::load(&file).unwrap()
}

/// Centre of mass at the first tick of the published flight.
fn first_com() -> Vector3<f64> {
    let config = experiment("test2_published");
    let robot = load_robot(&config.robot).unwrap();
    let mut plant =
        Plant::new(robot, &config.simulator, &config.disturbances, &config.controller.law).unwrap();
    plant.observe(&Vector3::zeros());
    plant.kinematics().com
}

/// Forward axis of iRonCub-Mk1 in base axes.
const BACKWARDS: Vector3<f64> = Vector3::new(-1.0, 0.0, 0.0);

/// Raw and smoothed set-point of every tick from 0 to `duration` \[s\], of a robot that faces +x.
fn fly(
    mission: Commands,
    forward: &Vector3<f64>,
    time_step: f64,
    duration: f64,
) -> Vec<(RawSetpoint, Setpoint)> {
    let generator =
        SetpointGenerator::new(&config(), Mission::Commands(mission), forward, time_step).unwrap();
    let yaw = -forward.y.atan2(forward.x);
    let mut state = generator.start(first_com(), &rotation_from_rpy(&Vector3::new(0.0, 0.0, yaw)));
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a few thousand, at least zero"
    )]
    let ticks = (duration / time_step).round() as usize;
    (0..=ticks)
        .map(|tick| {
            let setpoint = generator.update(&mut state, tick as f64 * time_step);
            (*state.raw(), setpoint)
        })
        .collect()
}

/// The flight of a mission file at the published tick.
fn generate(name: &str, duration: f64) -> Vec<(RawSetpoint, Setpoint)> {
    fly(commands(name), &BACKWARDS, TIME_STEP, duration)
}

/// Time, then raw x, z, pitch \[deg\], then smoothed x, z, vx, vz, pitch \[deg\].
///
/// As printed, except the pitch at 44 s: it is -0.4247 deg in every discretisation we tried; the printed
/// -0.43 must have been rounded twice.
#[rustfmt::skip]
const TABLE: [[f64; 9]; 27] = [
    [10.0, -0.0037, 0.7519,   0.0, -0.0037, 0.7519, 0.0,    0.0,      0.0],
    [10.5, -0.0037, 1.1269,   0.0, -0.0037, 0.7840, 0.0,    0.1968,   0.0],
    [11.0, -0.0037, 1.5019,   0.0, -0.0037, 0.9675, 0.0,    0.5160,   0.0],
    [12.0, -0.0037, 2.2519,   0.0, -0.0037, 1.6252, 0.0,    0.7293,   0.0],
    [14.0, -0.0037, 3.7519,   0.0, -0.0037, 3.1178, 0.0,    0.7499,   0.0],
    [17.0, -0.0037, 5.9944,   0.0, -0.0037, 5.3678, 0.0,    0.7500,   0.0],
    [18.0, -0.0037, 5.9944,   0.0, -0.0037, 5.8970, 0.0,    0.2292,   0.0],
    [20.0, -0.0037, 5.9944,   0.0, -0.0037, 5.9940, 0.0,    0.0012,   0.0],
    [20.5,  0.5626, 5.9944, -15.0,  0.0364, 5.9943, 0.2630, 0.0,     -3.14],
    [21.0,  1.5039, 5.9944, -30.0,  0.3321, 5.9944, 0.9523, 0.0,    -10.89],
    [22.0,  4.5114, 5.9944, -30.0,  2.0516, 5.9944, 2.4832, 0.0,    -22.95],
    [23.0,  9.0188, 5.9944, -30.0,  5.2887, 5.9944, 3.9888, 0.0,    -27.42],
    [24.0, 15.0263, 5.9944, -30.0, 10.0278, 5.9944, 5.4892, 0.0,    -29.05],
    [25.0, 22.3426, 5.9944, -30.0, 16.2591, 5.9944, 6.9231, 0.0,    -29.65],
    [26.0, 29.8426, 5.9944, -30.0, 23.5221, 5.9944, 7.4434, 0.0,    -29.87],
    [28.0, 44.8426, 5.9944, -30.0, 38.5014, 5.9944, 7.4998, 0.0,    -29.98],
    [30.0, 59.8425, 5.9944, -30.0, 53.5014, 5.9944, 7.5000, 0.0,    -30.00],
    [32.0, 71.7975, 5.9944, -30.0, 67.3018, 5.9944, 5.7315, 0.0,    -30.00],
    [34.0, 77.7525, 5.9944, -30.0, 75.7884, 5.9944, 2.7457, 0.0,    -30.00],
    [35.0, 78.2964, 5.9944, -30.0, 77.7586, 5.9944, 1.1121, 0.0,    -30.00],
    [36.0, 78.2964, 5.9944, -30.0, 78.2482, 5.9944, 0.1283, 0.0,    -30.00],
    [38.0, 78.2964, 5.9944, -30.0, 78.2962, 5.9944, 0.0004, 0.0,    -30.00],
    [39.0, 78.2964, 5.9944,  -0.3, 78.2963, 5.9944, 0.0,    0.0,    -19.11],
    [40.0, 78.2964, 5.9944,  -0.3, 78.2963, 5.9944, 0.0,    0.0,     -7.24],
    [41.0, 78.2964, 5.2444,  -0.3, 78.2963, 5.7788, 0.0,   -0.5160,  -2.84],
    [44.0, 78.2964, 2.9944,  -0.3, 78.2964, 3.6285, 0.0,   -0.7499,  -0.42],
    [47.0, 78.2964, 0.7519,  -0.3, 78.2964, 1.3785, 0.0,   -0.7500,  -0.31],
];
const LAST_ROW: [f64; 9] = [50.0, 78.2964, 0.7519, -0.3, 78.2964, 0.7523, 0.0, -0.0012, -0.30];

/// Every number of the table of the in-line flight, to the last printed digit.
#[test]
fn the_in_line_reference_is_the_published_one() {
    let flight = generate("in_line", 50.0);
    for row in TABLE.iter().chain([&LAST_ROW]) {
        let (raw, smooth) = &flight[tick_at(row[0])];
        let lengths = [
            (raw.position.x, row[1]),
            (raw.position.z, row[2]),
            (smooth.com_position.x, row[4]),
            (smooth.com_position.z, row[5]),
            (smooth.com_velocity.x, row[6]),
            (smooth.com_velocity.z, row[7]),
        ];
        for (found, printed) in lengths {
            // A speed that is printed as a bare 0 is one below half a mm/s.
            let tolerance = if printed == 0.0 { 0.5e-3 } else { 0.51e-4 };
            assert_within!((found - printed).abs(), tolerance, because "the published figure is rounded to the digits it has", "{} s: {found} m, printed {printed}", row[0]);
        }
        let pitch = rpy_from_rotation(&smooth.rotation).y;
        for (found, printed) in [(-raw.rpy.y, row[3]), (pitch, row[8])] {
            let found = found.to_degrees();
            assert_within!((found - printed).abs(), 0.51e-2, because "the published figure is rounded to the digits it has", "{} s: {found} deg, printed {printed}", row[0]);
        }
        assert_within!((raw.position.y - 0.00041).abs(), 1e-5);
        assert_within!((smooth.com_position.y - 0.00041).abs(), 1e-5);
    }
}

/// 699 ticks of climb and of descent at 0.75 m/s; forwards 450 ticks that get faster by 0.015 m/s each,
/// 549 at 7.5 m/s, 450 that get slower, 78.300 m in all.
#[test]
fn the_in_line_reference_has_the_published_ticks() {
    let flight = generate("in_line", 50.0);
    let steps: Vec<Vector3<f64>> =
        flight.windows(2).map(|pair| pair[1].0.position - pair[0].0.position).collect();
    let count = |moves: &dyn Fn(&Vector3<f64>) -> bool| steps.iter().filter(|step| moves(step)).count();
    assert_eq!(count(&|step| step.z > 0.007_499 && step.z < 0.007_501), 699);
    assert_eq!(count(&|step| step.z < -0.007_499 && step.z > -0.007_501), 699);
    assert_eq!(count(&|step| step.z.abs() > 1e-9), 2 * 699);

    let forwards: Vec<f64> = steps.iter().map(|step| step.x).filter(|x| x.abs() > 1e-9).collect();
    assert_eq!(forwards.len(), 450 + 549 + 450);
    for (k, step) in forwards.iter().enumerate() {
        let boost = match k {
            0..450 => k + 1,
            450..999 => 450,
            _ => 1448 - k,
        };
        let expected = 0.0075 * (1.0 + 0.02 * boost as f64);
        assert_within!((step - expected).abs(), 1e-12, "step {k}: {step} m, expected {expected}");
    }
    // A step between rows k and k + 1 belongs to tick k + 1: the first turbo tick is 20.01 s.
    let moving: Vec<usize> = (0..steps.len()).filter(|&k| steps[k].x.abs() > 1e-9).collect();
    assert_eq!((moving[0] + 1, moving[moving.len() - 1] + 1), (2001, 3449));
    let total: f64 = forwards.iter().sum();
    assert_within!((total - 78.3).abs(), 1e-10);
    let pitches: Vec<f64> = flight.iter().map(|(raw, _)| raw.rpy.y.to_degrees()).collect();
    assert_eq!(pitches.windows(2).filter(|pair| pair[1] < pair[0] - 0.1).count(), 99);
    assert_within!((pitches[5000] - 0.3).abs(), 1e-9);
}

/// An interval is open at both ends, also where k · 0.01 is rounded.
#[test]
fn intervals_are_open() {
    let commands = commands("in_line");
    for (tick, vertical) in [(1000, 0), (1001, 1), (1699, 1), (1700, 0), (4000, 0), (4001, -1), (4700, 0)] {
        assert_eq!(commands.command(f64::from(tick) * TIME_STEP).vertical, vertical, "tick {tick}");
    }
    let both = Commands { up: vec![(1.0, 2.0)], down: vec![(1.5, 3.0)], ..Commands::default() };
    assert_eq!([1.2, 1.7, 2.5].map(|time| both.command(time).vertical), [1, 0, -1]);
}

/// A landing descends like any descent, and below 2.5 m above the ground, the start's until one is measured, at 0.2 m/s; a
/// descent does not slow down, and a vertical speed that is less stays.
#[test]
fn a_landing_is_slow_near_the_ground() {
    let start = first_com();
    let way = |name: &str, speed: f64| {
        let mut mission = Commands { up: vec![(0.0, 5.0)], ..Commands::default() };
        let after = if name == "land" { &mut mission.land } else { &mut mission.down };
        after.push((5.0, 30.0));
        let config = SetpointConfig { speed: [0.75, speed], ..config() };
        let generator =
            SetpointGenerator::new(&config, Mission::Commands(mission), &BACKWARDS, TIME_STEP).unwrap();
        let mut state = generator.start(start, &Matrix3::identity());
        let mut height = 0.0;
        (0..1500)
            .map(|tick| {
                let before = height;
                let _ = generator.update(&mut state, f64::from(tick) * TIME_STEP);
                height = state.raw().position.z - start.z;
                (before, (height - before) / TIME_STEP)
            })
            .skip(501)
            .collect::<Vec<_>>()
    };
    let landing = way("land", 0.75);
    for (height, speed) in &landing {
        let expected = if *height < 2.5 { -0.2 } else { -0.75 };
        assert_within!((speed - expected).abs(), 1e-12, "{height} m");
    }
    assert!(landing[0].0 > 3.7 && landing.last().unwrap().0 < 1.5);
    for (name, speed) in [("down", 0.75), ("land", 0.1)] {
        assert!(way(name, speed).iter().all(|(_, found)| (found + speed).abs() < 1e-12), "{name}");
    }
}

/// Boost, and what is left of it, overrides every other command and lowers the nose.
#[test]
fn boost_overrides_other_commands() {
    // Two ticks of boost among all other commands, which go on.
    let all = vec![(0.0, 1.0)];
    let mission = Commands {
        up: all.clone(),
        pitch_up: all.clone(),
        yaw_left: all,
        forward_turbo: vec![(0.0, 2.5 * TIME_STEP)],
        ..Commands::default()
    };
    let flight = fly(mission, &BACKWARDS, TIME_STEP, 5.0 * TIME_STEP);
    let start = first_com();
    // Left-over boost: 2 ticks up, so 2 ticks down, the last at the plain speed.
    let (raw, _) = flight[4];
    assert_within!((raw.position.z - start.z).abs(), 1e-15, "{raw:?}");
    assert_within!(raw.rpy.z.abs(), 1e-15, because "a few units in the last place of numbers of order one", "{raw:?}");
    assert_within!((raw.rpy.y.to_degrees() - 4.0 * 0.3).abs(), 1e-12, "{raw:?}");
    let forward = 0.0075 * (4.0 + 0.02 * (1.0 + 2.0 + 1.0));
    assert_within!((raw.position.x - start.x - forward).abs(), 1e-15, "{raw:?}");
    let (raw, _) = flight[5];
    assert!(raw.position.z > start.z + 0.007 && raw.rpy.z > 0.004, "{raw:?}");
}

/// The raw pitch stays within its limits.
#[test]
fn raw_pitch_is_clamped() {
    let up = Commands { pitch_up: vec![(0.0, 9.0)], ..Commands::default() };
    assert!(fly(up, &BACKWARDS, TIME_STEP, 3.0).iter().all(|(raw, _)| raw.rpy.y == 0.0));
    let boost = Commands { forward_turbo: vec![(0.0, 9.0)], ..Commands::default() };
    let (raw, _) = fly(boost, &BACKWARDS, TIME_STEP, 3.0)[300];
    assert_within!((raw.rpy.y.to_degrees() - 30.0).abs(), 1e-12);
}

/// A robot whose forward axis is another flies the same way through space and lowers its own nose.
#[test]
fn any_forward_axis_flies_the_same_way() {
    let published = generate("in_line", 50.0);
    for forward in [Vector3::x(), Vector3::y(), Vector3::new(0.6, -0.8, 0.0)] {
        let flight = fly(commands("in_line"), &forward, TIME_STEP, 50.0);
        for ((_, a), (_, b)) in flight.iter().zip(&published).step_by(50) {
            assert_within!((a.com_position - b.com_position).amax(), 1e-9);
            let (nose_a, nose_b) = (a.rotation * forward, b.rotation * BACKWARDS);
            assert_within!((nose_a - nose_b).amax(), 1e-9);
        }
    }
}

/// Where a closed circuit ends: four legs, each turned by 299 ticks of 0.3 deg against the one before.
fn circuit_end(leg: f64) -> Vector3<f64> {
    let legs = (0..4).map(|k| exp_so3(&(Vector3::z() * (f64::from(k) * 89.7_f64).to_radians())));
    legs.map(|turn| turn * Vector3::x() * leg).sum()
}

/// With turbo a leg is 450 faster, 249 full and 450 slower steps.
#[test]
fn the_closed_circuit_ends_where_it_should() {
    let flight = generate("closed_circuit", 140.0);
    let (raw, smooth) = flight.last().unwrap();
    let faster: f64 = (1..=450).map(|k| 0.0075 * (1.0 + 0.02 * f64::from(k))).sum();
    let slower: f64 = (0..450).map(|k| 0.0075 * (1.0 + 0.02 * f64::from(k))).sum();
    let leg = faster + 249.0 * 0.075 + slower;
    let end = first_com() + circuit_end(leg);
    assert_within!((raw.position - end).amax(), 1e-9, "{} instead of {end}", raw.position);
    assert_within!((smooth.com_position - end).amax(), 1e-6, "{}", smooth.com_position);
    assert_within!((raw.rpy.z - (4.0 * 89.7_f64).to_radians()).abs(), 1e-9);
    assert_within!((raw.rpy.y.to_degrees() - 0.3).abs(), 1e-9);
    assert_within!(smooth.com_velocity.amax(), 1e-9);
    assert_within!(smooth.angular_velocity_b.amax(), 1e-6);
    // Farthest from the start: two legs forwards and sideways.
    let far = flight.iter().map(|(raw, _)| raw.position.y).fold(f64::MIN, f64::max);
    assert_within!((far - leg).abs(), 0.02 * leg, because "sizes of paths that are compared with the table, not rounding", "{far} m to the side, legs of {leg} m");
}

/// The smoothed attitude is a rotation at every tick of every mission.
#[test]
fn the_smoothed_attitude_is_a_rotation() {
    for (name, duration) in [("in_line", 50.0), ("closed_circuit", 135.0), ("closed_circuit_no_turbo", 112.0)]
    {
        for (_, reference) in generate(name, duration) {
            assert_within!(orthonormality_error(&reference.rotation), 1e-14);
            assert!(reference.rotation.determinant() > 0.0);
        }
    }
}

/// In pure pitch the smoothed angle follows `θ̇ = −sin(θ − θ_ref)`.
#[test]
fn the_smoothed_pitch_follows_the_sine_of_its_error() {
    let mut theta = 0.0_f64;
    for (raw, reference) in generate("in_line", 50.0) {
        let pitch = rpy_from_rotation(&reference.rotation).y;
        assert_within!((pitch - theta).abs(), 1e-5, "{pitch} instead of {theta}");
        // Forward Euler: what is handed out is the angle before the step.
        theta -= TIME_STEP * (theta + raw.rpy.y).sin();
    }
}

/// References are derivatives of one another: velocity is the rate of position, and so on.
#[test]
fn references_are_derivatives_of_one_another() {
    let flight = generate("closed_circuit", 135.0);
    for window in flight.windows(2) {
        let (_, before) = &window[0];
        let (_, now) = &window[1];
        // The trapezoidal rule of the filter is exact between its own states.
        let mean = (before.com_velocity + now.com_velocity) * 0.5;
        assert_within!((now.com_position - before.com_position - mean * TIME_STEP).amax(), 1e-12);
        let mean = (before.com_acceleration + now.com_acceleration) * 0.5;
        assert_within!((now.com_velocity - before.com_velocity - mean * TIME_STEP).amax(), 1e-12);
        let mean = (before.angular_acceleration_b + now.angular_acceleration_b) * 0.5;
        assert_within!((now.angular_velocity_b - before.angular_velocity_b - mean * TIME_STEP).amax(), 1e-12);
        let mean = (before.angular_jerk_b + now.angular_jerk_b) * 0.5;
        assert_within!(
            (now.angular_acceleration_b - before.angular_acceleration_b - mean * TIME_STEP).amax(),
            1e-12
        );
    }
}

/// Coefficients of `(z − 1)^p (z + 1)^q`, lowest power first.
fn binomials(p: usize, q: usize) -> [f64; 4] {
    let mut polynomial = [1.0, 0.0, 0.0, 0.0];
    for root in std::iter::repeat_n(1.0, p).chain(std::iter::repeat_n(-1.0, q)) {
        for power in (0..4).rev() {
            let below = if power > 0 { polynomial[power - 1] } else { 0.0 };
            polynomial[power] = below - root * polynomial[power];
        }
    }
    polynomial
}

/// `sⁿ H(s)` with `s = (2/h) (z − 1)/(z + 1)`, as a difference equation in one input.
struct DifferenceEquation {
    numerator: [f64; 4],
    denominator: [f64; 4],
    inputs: [f64; 4],
    outputs: [f64; 4],
}

impl DifferenceEquation {
    /// `H = A / (s³ + C s² + B s + A)` for a smoothing time of 1 s, in the order `A B C`.
    const COEFFICIENTS: [f64; 3] = [150.765_868_956_161, 84.981_281_946_953_8, 15.966_961_070_938_4];

    fn new(derivative: usize, smoothing_time: f64, initial: f64) -> Self {
        let [a, b, c] = Self::COEFFICIENTS;
        let t = smoothing_time;
        let w = 2.0 / TIME_STEP;
        let mut denominator = [0.0; 4];
        for (factor, power) in
            [(w.powi(3), 3), (c / t * w.powi(2), 2), (b / t.powi(2) * w, 1), (a / t.powi(3), 0)]
        {
            for (sum, x) in denominator.iter_mut().zip(binomials(power, 3 - power)) {
                *sum += factor * x;
            }
        }
        let gain = a / t.powi(3) * w.powi(i32::try_from(derivative).unwrap());
        let numerator = binomials(derivative, 3 - derivative).map(|x| gain * x);
        let outputs = if derivative == 0 { [initial; 4] } else { [0.0; 4] };
        Self { numerator, denominator, inputs: [initial; 4], outputs }
    }

    fn update(&mut self, input: f64) -> f64 {
        // Newest last, as the highest power of z.
        self.inputs.rotate_left(1);
        self.outputs.rotate_left(1);
        self.inputs[3] = input;
        let driven: f64 = self.numerator.iter().zip(&self.inputs).map(|(n, u)| n * u).sum();
        let past: f64 = self.denominator[..3].iter().zip(&self.outputs).map(|(d, y)| d * y).sum();
        self.outputs[3] = (driven - past) / self.denominator[3];
        self.outputs[3]
    }
}

/// The filter is the bilinear transform of its transfer function, worked out as a difference equation. The transfer
/// function has a triple pole at −5.3223/T.
#[test]
fn the_filter_is_the_bilinear_transform() {
    let p = 5.322_335_f64;
    for (found, expected) in
        DifferenceEquation::COEFFICIENTS.into_iter().zip([p.powi(3), 3.0 * p.powi(2), 3.0 * p])
    {
        assert_within!((found - expected).abs(), 1e-4 * expected, because "coefficients are published, and the pole is known to seven digits");
    }
    for (smoothing_time, tolerance) in [(1.5, 1e-6), (0.05, 1e-9), (0.005, 1e-9)] {
        let mut rng = rng(1);
        let initial = random_vector(&mut rng, 1.0);
        let filter = MinimumJerkFilter::new(smoothing_time, TIME_STEP);
        let mut state = FilterState::at_rest(initial);
        let mut equations: Vec<_> = (0..3)
            .flat_map(|derivative| (0..3).map(move |axis| (derivative, axis)))
            .map(|(derivative, axis)| DifferenceEquation::new(derivative, smoothing_time, initial[axis]))
            .collect();
        let mut input = initial;
        for tick in 0..1500 {
            if tick % 50 == 0 {
                input = random_vector(&mut rng, 1.0);
            }
            filter.update(&mut state, &input);
            let outputs = [state.value(), state.rate(), state.acceleration()];
            for (k, equation) in equations.iter_mut().enumerate() {
                let expected = equation.update(input[k % 3]);
                let found = outputs[k / 3][k % 3];
                let scale = smoothing_time.powi(-i32::try_from(k / 3).unwrap());
                assert_within!(
                    (found - expected).abs(),
                    tolerance * scale,
                    "T = {smoothing_time}, derivative {}: {found} instead of {expected}",
                    k / 3
                );
            }
        }
    }
}

/// A turn by more than half a circle is followed the way it was commanded, not by the short cut.
#[test]
fn the_smoothed_yaw_follows_a_whole_circle() {
    let flight = generate("closed_circuit", 135.0);
    let mut unwrapped = PI;
    let mut last = PI;
    for (raw, reference) in &flight {
        let yaw = rpy_from_rotation(&reference.rotation).z;
        unwrapped += (yaw - last + PI).rem_euclid(TAU) - PI;
        last = yaw;
        assert_within!((unwrapped - PI - raw.rpy.z).abs(), 1.2, because "the filter's lag behind a turning yaw, a physical figure", "{unwrapped} behind {}", raw.rpy.z);
    }
    assert_within!((unwrapped - PI - (4.0 * 89.7_f64).to_radians()).abs(), 1e-3);
}

/// M107: the place is where the centre of mass is, velocity and attitude stay.
#[test]
fn a_robot_that_sinks_has_no_place_to_hold() {
    let mut rng = rng(8);
    let mut draw = || random_vector(&mut rng, 2.0);
    let before = Setpoint {
        com_position: draw(),
        com_velocity: draw(),
        com_acceleration: draw(),
        com_jerk: draw(),
        rotation: exp_so3(&draw()),
        angular_velocity_b: draw(),
        angular_acceleration_b: draw(),
        angular_jerk_b: draw(),
    };
    let com = draw();
    let zero = Vector3::zeros();
    let expected = Setpoint { com_position: com, com_acceleration: zero, com_jerk: zero, ..before };
    assert_eq!(before.without_place(&com), expected);
}

/// M107: turned to the heading of a robot, a set-point differs from it by a rotation about a horizontal axis.
#[test]
fn a_set_point_takes_the_heading_of_the_robot() {
    let mut rng = rng(12);
    for _ in 0..20 {
        let [from, base] = [(); 2].map(|()| exp_so3(&random_vector(&mut rng, 1.0)));
        let before = Setpoint::at_rest(first_com(), from);
        let found = before.with_heading_of(&base);
        let turn = found.rotation * from.transpose();
        assert_within!((turn * Vector3::z() - Vector3::z()).amax(), 1e-15, because "rounding");
        let left = log_so3(&(base * found.rotation.transpose()));
        assert_within!(left.z.abs(), 1e-14, because "rounding");
        assert_eq!(Setpoint { rotation: from, ..found }, before);
    }
}

/// M107: of the generator's state too, raw and smooth: the descent goes on with that heading.
#[test]
fn a_descent_goes_on_with_the_heading_of_the_robot() {
    let generator = braking_generator("hover");
    let heading = |yaw: f64| rotation_from_rpy(&Vector3::new(0.0, 0.0, yaw));
    let mut state = generator.start(first_com(), &heading(PI));
    state.take_heading(&(heading(PI - 1.0) * axis_angle(&Vector3::x(), 0.4)));
    let expected = heading(PI - 1.0);
    for tick in 0..200 {
        let found = generator.descend(&mut state, false).rotation;
        assert_within!((found - expected).amax(), 1e-13, because "rounding", "tick {tick}");
    }
}

/// How far ahead a motion of `speed` \[m/s\] comes to rest that loses `loss` of it in each tick, the first one included \[m\]:
/// `v T B/A` by the lag of the filter of the position, and the way on which it brakes.
pub fn distance_to_rest(speed: f64, loss: f64) -> f64 {
    let lag = 1.5 * 84.981_281_946_953_8 / 150.765_868_956_161;
    let speeds = (1..).map(|tick| speed - loss * f64::from(tick)).take_while(|left| *left > 0.0);
    lag * speed + speeds.map(|left| left * TIME_STEP).sum::<f64>()
}

/// A generator that brakes with 2 m/s² and descends with 0.4 m/s.
fn braking_generator(mission: &str) -> SetpointGenerator {
    let config = SetpointConfig { deceleration: 2.0, descent_speed: 0.4, ..config() };
    SetpointGenerator::new(&config, Mission::Commands(commands(mission)), &BACKWARDS, TIME_STEP).unwrap()
}

/// Each part a short time later is the integral of the next one.
#[test]
fn a_set_point_goes_on_by_its_derivatives() {
    const H: f64 = 1e-4;
    let part = |k: f64| Vector3::new(k, 2.0 - k, 0.3 * k);
    let now = Setpoint {
        com_position: part(1.0),
        com_velocity: part(2.0),
        com_acceleration: part(-3.0),
        com_jerk: part(5.0),
        rotation: exp_so3(&part(0.7)),
        angular_velocity_b: part(0.4),
        angular_acceleration_b: part(-1.5),
        angular_jerk_b: part(2.5),
    };
    let rate = |of: fn(&Setpoint) -> Vector3<f64>, time: f64| {
        (of(&now.after(time + H)) - of(&now.after(time - H))) / (2.0 * H)
    };
    let turn = now.after(-H).rotation.transpose() * now.after(H).rotation;
    let mut errors = vec![log_so3(&turn) / (2.0 * H) - now.angular_velocity_b];
    for time in [0.0, 0.08] {
        let then = now.after(time);
        errors.extend([
            rate(|s| s.com_position, time) - then.com_velocity,
            rate(|s| s.com_velocity, time) - then.com_acceleration,
            rate(|s| s.com_acceleration, time) - then.com_jerk,
            rate(|s| s.angular_velocity_b, time) - then.angular_acceleration_b,
            rate(|s| s.angular_acceleration_b, time) - then.angular_jerk_b,
        ]);
    }
    for error in errors {
        assert_within!(error.amax(), 1e-7, because "a central difference is wrong by a sixth of the third derivative times H², and by 1e-16 / H");
    }
}

/// The set-point ahead is that of the samples, between them that of M49, and ends with the last one.
#[test]
fn a_preview_is_interpolated_between_its_samples() {
    let spin = Vector3::new(0.0, 0.0, 0.4);
    // A motion of constant jerk and angular velocity, of which interpolation makes no other.
    let at = |time: f64| {
        let jerk = Vector3::new(0.6, -0.3, 0.9);
        let [_, a, b, c] = [0, 1, 2, 3].map(|order| time.powi(order));
        Setpoint {
            com_velocity: jerk * (b / 2.0),
            com_acceleration: jerk * a,
            com_jerk: jerk,
            angular_velocity_b: spin,
            ..Setpoint::at_rest(jerk * (c / 6.0), exp_so3(&(spin * time)))
        }
    };
    let setpoints = [(0.1, at(0.1)), (0.5, at(0.5))];
    let preview = Preview { setpoints: &setpoints, ..Preview::default() };
    for time in [0.04, 0.1, 0.3, 0.5, 0.504] {
        let (found, expected) = (preview.setpoint(&at(0.0), time, 0.005).unwrap(), at(time.min(0.5)));
        for (one, other) in found.vectors().into_iter().zip(expected.vectors()) {
            assert_within!((one - other).amax(), 1e-14, because "rounding", "at {time} s");
        }
        assert_within!((found.rotation - expected.rotation).amax(), 1e-14, because "rounding", "at {time} s");
    }
    assert_eq!(preview.setpoint(&at(0.0), 0.506, 0.005), None);
}

/// M115: out of the fast leg the velocity becomes that of the descent, or zero, on the straight line between the two and
/// with the deceleration of the configuration, which the smooth set-point does not exceed; the attitude becomes level.
#[test]
fn a_descent_brakes_on_its_way() {
    let generator = braking_generator("in_line");
    let mut fast = generator.start(first_com(), &rotation_from_rpy(&Vector3::new(0.0, 0.0, PI)));
    for tick in 0..2800 {
        let _ = generator.update(&mut fast, f64::from(tick) * TIME_STEP);
    }
    let first = fast.raw().velocity;
    assert_within!((first.norm() - 7.5).abs(), 1e-12);
    for (stays, speed) in [(false, 0.4), (true, 0.0)] {
        let mut state = fast;
        let change = Vector3::new(0.0, 0.0, -speed) - first;
        let mut position = state.raw().position;
        for tick in 1..=1500 {
            let smooth = generator.descend(&mut state, stays);
            let share = (2.0 * f64::from(tick) * TIME_STEP / change.norm()).min(1.0);
            assert_within!((state.raw().velocity - (first + change * share)).amax(), 1e-11, "tick {tick}");
            position += state.raw().velocity * TIME_STEP;
            assert_within!((state.raw().position - position).amax(), 1e-11, "tick {tick}");
            assert!(smooth.com_acceleration.norm() < 2.001, "tick {tick}: {}", smooth.com_acceleration);
        }
        assert_eq!((state.raw().rpy.x, state.raw().rpy.y), (0.0, 0.0));
    }
}

/// Where a given motion brakes already, the set-point goes on with its acceleration, without a jerk.
#[test]
fn what_was_given_goes_on_braking() {
    let generator = braking_generator("hover");
    let (velocity, acceleration) = (Vector3::new(6.0, -8.0, 0.0), Vector3::new(-1.2, 1.6, 0.0));
    let mut state = generator.start(first_com(), &rotation_from_rpy(&Vector3::new(0.0, 0.0, PI)));
    let given = RecordedMotion {
        com: [first_com(), velocity, acceleration, Vector3::zeros()],
        rotation: rotation_from_rpy(&Vector3::new(0.0, 0.0, PI)),
        angular_velocity_b: Vector3::zeros(),
    };
    generator.take_motion(&mut state, &given);
    for tick in 1..300 {
        let smooth = generator.stop(&mut state);
        let time = f64::from(tick) * TIME_STEP;
        assert_within!((smooth.com_acceleration - acceleration).norm(), 0.02, because "a raw set-point in steps of 10 ms is half a step ahead", "tick {tick}");
        let expected = velocity + acceleration * time;
        assert_within!((smooth.com_velocity - expected).norm(), 0.02, because "the same", "tick {tick}");
    }
}

/// Where a given motion ends the set-point goes on smoothly, brakes with the deceleration of the configuration and does not
/// turn back: from a speed v it comes to rest `v T B/A` further and what it takes to brake.
#[test]
fn what_was_given_comes_to_rest_ahead() {
    let generator = braking_generator("hover");
    let (velocity, zero) = (Vector3::new(3.0, -4.0, 0.0), Vector3::zeros());
    let mut state = generator.start(first_com(), &rotation_from_rpy(&Vector3::new(0.0, 0.0, PI)));
    let given = RecordedMotion {
        com: [first_com(), velocity, zero, zero],
        rotation: rotation_from_rpy(&Vector3::new(0.0, 0.0, PI)),
        angular_velocity_b: zero,
    };
    generator.take_motion(&mut state, &given);
    let mut last = velocity;
    for tick in 0..1000 {
        let smooth = generator.stop(&mut state);
        assert!(smooth.com_acceleration.norm() < 2.001, "tick {tick}: {}", smooth.com_acceleration);
        assert!(smooth.com_velocity.dot(&velocity) > -1e-9, "tick {tick}: {}", smooth.com_velocity);
        assert!(smooth.com_velocity.norm() < last.norm() + 1e-12, "tick {tick}");
        last = smooth.com_velocity;
    }
    let distance = velocity / 5.0 * distance_to_rest(5.0, 0.02);
    assert_within!((state.raw().position - first_com() - distance).norm(), 1e-11);
}

/// A set-point is one as far as what is accepted of a robot's own place and speeds, and of a second's acceleration.
#[test]
fn a_set_point_no_robot_can_be_at_is_none() {
    let limits = [1e6, 300.0, 300.0, 1e6, 100.0, 1e6, 1e6];
    for (place, limit) in limits.into_iter().enumerate() {
        for (number, is_valid) in [(limit, true), (-1.001 * limit, false), (f64::NAN, false)] {
            let mut setpoint = Setpoint::at_rest(Vector3::zeros(), Matrix3::identity());
            let vectors = [
                &mut setpoint.com_position,
                &mut setpoint.com_velocity,
                &mut setpoint.com_acceleration,
                &mut setpoint.com_jerk,
                &mut setpoint.angular_velocity_b,
                &mut setpoint.angular_acceleration_b,
                &mut setpoint.angular_jerk_b,
            ];
            vectors.into_iter().nth(place).unwrap().y = number;
            assert_eq!(setpoint.is_valid(), is_valid, "{number} at {place}");
        }
    }
    let turned = Setpoint::at_rest(Vector3::zeros(), Matrix3::identity() * 1.1);
    assert!(!turned.is_valid());
}

/// After a descent that is revoked the mission goes on from where the robot is, with the attitude and the boost that it had, and
/// its later commands; a mission that was never left is not changed.
#[test]
fn a_mission_goes_on_after_a_descent() {
    let mission = || Mission::Commands(commands("in_line"));
    let generator = SetpointGenerator::new(&config(), mission(), &BACKWARDS, TIME_STEP).unwrap();
    let start = || generator.start(first_com(), &rotation_from_rpy(&Vector3::new(0.0, 0.0, PI)));
    let (mut state, mut tick) = (start(), 0);
    let fly = |state: &mut _, tick: &mut usize, to: usize| {
        for at in *tick..to {
            let _ = generator.update(state, at as f64 * TIME_STEP);
        }
        *tick = to;
    };
    // Leaning, in the boost.
    fly(&mut state, &mut tick, 2250);
    let (before, untouched) = (*state.raw(), state);
    let (com, velocity) = (Vector3::new(3.0, -0.2, 5.7), Vector3::new(2.0, 0.1, -0.3));
    generator.resume(&mut state, &com, &velocity);
    assert_eq!(state, untouched, "no descent");
    for _ in 0..16 {
        let _ = generator.descend(&mut state, false);
    }
    tick += 16;
    assert!(state.raw().rpy.y.abs() < before.rpy.y.abs() - 0.02, "it levels");
    generator.resume(&mut state, &com, &velocity);
    assert_eq!(state.raw().rpy, before.rpy);
    let setpoint = generator.update(&mut state, tick as f64 * TIME_STEP);
    assert_within!((setpoint.com_position - com).norm(), 2.0 * TIME_STEP * velocity.norm());
    assert_within!((setpoint.com_velocity - velocity).norm(), 0.1, because "of a boost of 3 m/s in a filter of 1.5 s");
    // The boost goes on as if it had not been left: what is left of the mission moves it as far.
    let mut other = untouched;
    fly(&mut other, &mut { 2250 }, 2251);
    assert_eq!(state.raw().velocity, other.raw().velocity);
    // A second descent begins from the mission of then.
    let _ = generator.descend(&mut state, false);
    generator.resume(&mut state, &com, &velocity);
    assert_eq!(state.raw().rpy.y, before.rpy.y);
}

/// A base that turns may pitch beyond the limits by a thousandth of a degree before the first set-point.
#[test]
fn a_first_pitch_beyond_its_limits_is_named() {
    let mission = Mission::Commands(commands("in_line"));
    let generator = SetpointGenerator::new(&config(), mission, &Vector3::x(), TIME_STEP).unwrap();
    let [low, high] = config().nose_down_limits_deg;
    for (pitch, is_beyond) in
        [(low - 2e-3, true), (low - 5e-4, false), (high + 5e-4, false), (high + 2e-3, true)]
    {
        let rotation = rotation_from_rpy(&Vector3::new(0.0, pitch.to_radians(), 0.3));
        assert_eq!(generator.pitch_beyond_limits(&rotation).is_some(), is_beyond, "{pitch}°");
    }
}
