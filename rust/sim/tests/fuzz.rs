//! Files spoilt at random: each is refused with a message, or makes a controller whose commands are numbers.
//!
//! `make fuzz` tries other cases for an hour. Ticks with spoilt measurements: `allocations.rs`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

#[path = "common/cases.rs"]
pub(crate) mod cases;

use crate::common::{configs, experiment, hover_of};
use cases::cases;
use flight_core::aero::Precision;
use flight_core::robot::RobotModel;
use flight_core::{BuildError, Measurement};
use flight_io::mission::parse_recording;
use flight_io::{
    AeroConfig, ControllerSection, NetworkConfig, Schema, from_value, hold, load_aero, resolve_table,
    robot_from_text, toml,
};
use flight_sim::{ScenarioConfig, Wind, WindConfig};
use nalgebra::Vector3;
use proptest::collection::vec;
use proptest::prelude::*;
use std::ops::Range;
use std::path::PathBuf;

/// What a number is replaced by.
const NUMBERS: [&str; 14] = [
    "0",
    "-1",
    "1",
    "0.5",
    "2",
    "1e-320",
    "-1e300",
    "1e308",
    "1e999",
    "nan",
    "-inf",
    "99999999999999999999",
    "1e6",
    "",
];

/// A change of a text.
#[derive(Debug, Clone)]
enum Edit {
    /// Replaces a number.
    Number(usize, usize),
    /// Replaces a word by another one of the text.
    Word(usize, usize),
    /// Deletes a line.
    Delete(usize),
    /// Writes a line once more behind another.
    Repeat(usize, usize),
    /// Replaces a byte.
    Byte(usize, u8),
    /// Ends the text early.
    End(usize),
}

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let place = 0..1_000_000_usize;
    let pair = || (place.clone(), place.clone());
    vec(
        prop_oneof![
            6 => pair().prop_map(|(at, with)| Edit::Number(at, with)),
            3 => pair().prop_map(|(at, with)| Edit::Word(at, with)),
            2 => place.clone().prop_map(Edit::Delete),
            2 => pair().prop_map(|(line, behind)| Edit::Repeat(line, behind)),
            1 => (place.clone(), any::<u8>()).prop_map(|(at, with)| Edit::Byte(at, with)),
            1 => place.clone().prop_map(Edit::End),
        ],
        1..4,
    )
}

/// Where bytes of a kind follow each other.
fn runs(bytes: &[u8], is_part: impl Fn(u8) -> bool, is_needed: impl Fn(u8) -> bool) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut begin = 0;
    for end in 0..=bytes.len() {
        if end == bytes.len() || !is_part(bytes[end]) {
            if bytes[begin..end].iter().any(|byte| is_needed(*byte)) {
                found.push(begin..end);
            }
            begin = end + 1;
        }
    }
    found
}

fn spoil(bytes: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for edit in edits {
        let is_number = |byte: u8| byte.is_ascii_digit() || b".+-eE".contains(&byte);
        let numbers = || runs(&bytes, is_number, |byte| byte.is_ascii_digit());
        let words = || runs(&bytes, |byte| byte.is_ascii_alphanumeric() || byte == b'_', |_| true);
        let lines = || runs(&bytes, |byte| byte != b'\n', |_| true);
        let pick = |runs: Vec<Range<usize>>, place: usize| match runs.len() {
            0 => 0..0,
            count => runs[place % count].clone(),
        };
        match *edit {
            Edit::Number(at, with) => {
                let with = NUMBERS[with % NUMBERS.len()].bytes();
                let at = pick(numbers(), at);
                bytes.splice(at, with);
            }
            Edit::Word(at, with) => {
                let with = bytes[pick(words(), with)].to_vec();
                let at = pick(words(), at);
                bytes.splice(at, with);
            }
            Edit::Delete(line) => {
                let line = pick(lines(), line);
                bytes.drain(line);
            }
            Edit::Repeat(line, behind) => {
                let line = [b"\n", &bytes[pick(lines(), line)]].concat();
                let end = pick(lines(), behind).end;
                bytes.splice(end..end, line);
            }
            Edit::Byte(at, with) => {
                let length = bytes.len().max(1);
                bytes.get_mut(at % length).into_iter().for_each(|byte| *byte = with);
            }
            Edit::End(at) => bytes.truncate(at % (bytes.len() + 1)),
        }
    }
    bytes
}

fn spoil_text(text: &str, edits: &[Edit]) -> String {
    String::from_utf8_lossy(&spoil(text.as_bytes(), edits)).into_owned()
}

fn file(name: &str) -> String {
    std::fs::read_to_string(configs(name)).unwrap()
}

/// A refusal says something.
fn refusal<T>(result: Result<T, BuildError>) -> Option<T> {
    result.map_err(|error| assert!(!error.to_string().trim().is_empty())).ok()
}

/// What can be built ticks, and commands numbers.
fn assert_ticks(scenario: &ScenarioConfig, robot: RobotModel) {
    let (joints, jets) = (robot.joints.len(), robot.jets.len());
    let Some(mut controller) = refusal(scenario.controller(robot)) else { return };
    let feet = controller.model().feet.len();
    let measure = |tick: u32| Measurement {
        time: f64::from(tick) * scenario.controller.law.time_step,
        thrust: vec![50.0; jets],
        wind: Vector3::new(1.0, -5.0, 0.2),
        ..Measurement::zero(joints, jets, feet)
    };
    let Ok(mut flight) = controller.start(&measure(0)) else { return };
    for tick in 0..4 {
        let command = controller.tick(&mut flight, &measure(tick));
        let commands = command.thrust_rate.iter().chain(&command.joint_velocity).chain(&command.joint_torque);
        assert!(commands.into_iter().all(|number| number.is_finite()), "tick {tick}: {command:?}");
    }
}

#[test]
fn a_spoilt_robot() {
    let names = ["sparrow", "slider", "platform"];
    let texts = names.map(|name| (file(&format!("robot/{name}.toml")), file(&format!("robot/{name}.urdf"))));
    proptest!(cases(400), |(which in 0..names.len(), of_toml in any::<bool>(), edits in edits())| {
        let (toml, urdf) = &texts[which];
        let (toml, urdf) = if of_toml {
            (spoil_text(toml, &edits), urdf.clone())
        } else {
            (toml.clone(), spoil_text(urdf, &edits))
        };
        if let Some(robot) = refusal(robot_from_text(&toml, &urdf, "spoilt.toml")) {
            let mut scenario = hover_of(&robot);
            scenario.controller.aero = AeroConfig::Off {};
            assert_ticks(&scenario, robot);
        }
    });
}

#[test]
fn a_spoilt_configuration() {
    let robot = flight_io::load_robot(&configs("robot/ironcub_mk1.toml")).unwrap();
    let names = ["aero_aware", "observer", "estimator", "balancing"];
    let texts = names.map(|name| file(&format!("control/{name}.toml")));
    let scenario = experiment("test2");
    let (folder, schema) = (configs("control"), Schema::of_type::<ControllerSection>());
    proptest!(cases(250), |(which in 0..names.len(), edits in edits(), step in prop_oneof![Just(0.01), Just(0.001)])| {
        let table = refusal(toml::parse(&spoil_text(&texts[which], &edits), "spoilt.toml"));
        let value = table.and_then(|table| refusal(resolve_table(table, &folder, &schema)));
        let section = value.and_then(|value| refusal(from_value(value, "spoilt.toml")));
        if let Some(controller) = section {
            let mut scenario = ScenarioConfig { controller, ..scenario.clone() };
            scenario.controller.law.time_step = step;
            assert_ticks(&scenario, robot.clone());
        }
    });
}

#[test]
fn a_spoilt_network() {
    use crate::common::network::{SMALL, card, digest, random_weights};

    let robot = flight_io::load_robot(&configs("robot/ironcub_mk1.toml")).unwrap();
    let weights = random_weights(&robot, &SMALL);
    let card = format!("{:#}", card(&robot, &SMALL, "network_small", &weights));
    let (sha, path) = (digest(&weights), PathBuf::from("fuzz/network_small.json"));
    let scenario = experiment("test4");
    proptest!(cases(300), |(of_card in any::<bool>(), edits in edits(), density in prop_oneof![Just(1.2), Just(1e308)])| {
        let (card, weights) = if of_card {
            (spoil_text(&card, &edits), weights.clone())
        } else {
            let weights = spoil(&weights, &edits);
            (card.replace(&sha, &digest(&weights)), weights)
        };
        hold(&path, card.into_bytes());
        hold(&path.with_extension("safetensors"), weights);
        let (card, precision) = (path.clone(), Precision::F32);
        let mut scenario = scenario.clone();
        scenario.controller.aero = AeroConfig::Network(NetworkConfig { card, precision, air_density: density });
        if refusal(load_aero(&scenario.controller.aero, &robot)).is_some() {
            assert_ticks(&scenario, robot.clone());
        }
    });
}

#[test]
fn a_spoilt_aerodynamic_model() {
    let robot = flight_io::load_robot(&configs("robot/ironcub_mk1.toml")).unwrap();
    let names = ["axisymmetric_corrected", "axisymmetric_signed", "sphere_cylinder"];
    let texts = names.map(|name| file(&format!("aero/{name}.toml")));
    let scenario = experiment("test2");
    let (folder, schema) = (configs("aero"), Schema::of_type::<AeroConfig>());
    proptest!(cases(200), |(which in 0..names.len(), edits in edits())| {
        let table = refusal(toml::parse(&spoil_text(&texts[which], &edits), "spoilt.toml"));
        let value = table.and_then(|table| refusal(resolve_table(table, &folder, &schema)));
        if let Some(aero) = value.and_then(|value| refusal(from_value(value, "spoilt.toml"))) {
            let mut scenario = scenario.clone();
            scenario.controller.aero = aero;
            assert_ticks(&scenario, robot.clone());
        }
    });
}

#[test]
fn spoilt_tables() {
    let recording = file("mission/min_time.csv").lines().take(12).collect::<Vec<_>>().join("\n");
    let wind = "time,x,y,z\n0,0,0,0\n1.5,1,-2,0.5\n4,3,-9.5,0\n";
    let path = PathBuf::from("fuzz/wind.csv");
    proptest!(cases(500), |(edits in edits(), time in -1.0..20.0)| {
        refusal(parse_recording(&spoil_text(&recording, &edits), "spoilt.csv"));
        hold(&path, spoil(wind.as_bytes(), &edits));
        if let Some(wind) = refusal(Wind::new(&WindConfig::File { path: path.clone() })) {
            prop_assert!(wind.velocity(time).iter().all(|speed| speed.is_finite()));
        }
    });
}
