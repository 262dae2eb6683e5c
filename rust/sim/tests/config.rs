//! Configuration files: how `base` merges, where paths start, what is refused and how it is said, and
//! that every file we ship is what it claims to be.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

mod common;

use common::{configs, experiment, robot};
use flight_core::BuildError;
use flight_io::{AeroConfig, ControllerSection, MissionConfig, load_aero, resolve};
use flight_sim::jets::JetsConfig;
use flight_sim::{Flight, SimulatorConfig, Wind, WindConfig, flight_from_value, load_flight};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::{TempDir, tempdir};

fn write(folder: &TempDir, name: &str, text: &str) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, text).unwrap();
    path
}

/// The TOML files of a folder of `configs/`; what stands beside them is data.
fn files(name: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(configs(name)).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    assert!(files.len() > 1, "{name}: {files:?}");
    files
}

fn parse<T: DeserializeOwned>(file: &Path) -> T {
    let value = resolve(file).unwrap();
    serde_json::from_value(value).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// Keys beside `base` are laid over the base's table, table by table; lists are replaced whole.
#[test]
fn base_merges_table_by_table() {
    let folder = tempdir().unwrap();
    write(&folder, "bottom.toml", "a = 1\nlist = [1, 2, 3]\n[inner]\nb = 2\nc = 3\n[inner.deep]\nd = 4\n");
    write(&folder, "middle.toml", "base = 'bottom.toml'\nlist = [9]\n[inner]\nc = 30\n");
    let top = write(&folder, "top.toml", "base = 'middle.toml'\ne = 5\n[inner.deep]\nf = 6\n");
    let expected = json!({
        "a": 1, "list": [9], "e": 5,
        "inner": {"b": 2, "c": 30, "deep": {"d": 4, "f": 6}},
    });
    assert_eq!(resolve(&top).unwrap(), expected);
}

/// A `base` may stand in any table, and starts at the file that names it.
#[test]
fn base_may_stand_in_any_table() {
    let folder = tempdir().unwrap();
    write(&folder, "parts/wheel.toml", "base = 'common/round.toml'\nsize = 2\n");
    write(&folder, "parts/common/round.toml", "corners = 0\nsize = 1\n");
    let top = write(&folder, "top.toml", "front = { base = 'parts/wheel.toml', size = 3 }\n");
    assert_eq!(resolve(&top).unwrap(), json!({"front": {"corners": 0, "size": 3}}));
}

/// A table that changes its kind takes no key of the old kind along; one that repeats it does.
#[test]
fn another_kind_replaces_the_table() {
    let folder = tempdir().unwrap();
    write(
        &folder,
        "wind.toml",
        "profile = 'ramp'\nvelocity = [1.0, 0.0, 0.0]\nramp_start = 1.0\nramp_end = 2.0\n",
    );
    for (name, keys, expected) in [
        (
            "other.toml",
            "profile = 'constant'\nvelocity = [3.0, 0.0, 0.0]",
            json!({"profile": "constant", "velocity": [3.0, 0.0, 0.0]}),
        ),
        (
            "same.toml",
            "profile = 'ramp'\nramp_end = 9.0",
            json!({"profile": "ramp", "velocity": [1.0, 0.0, 0.0], "ramp_start": 1.0, "ramp_end": 9.0}),
        ),
        (
            "silent.toml",
            "velocity = [3.0, 0.0, 0.0]",
            json!({"profile": "ramp", "velocity": [3.0, 0.0, 0.0], "ramp_start": 1.0, "ramp_end": 2.0}),
        ),
    ] {
        let file = write(&folder, name, &format!("base = 'wind.toml'\n{keys}\n"));
        assert_eq!(resolve(&file).unwrap(), expected, "{name}");
    }
    for key in ["model", "dynamics"] {
        write(&folder, "under.toml", &format!("{key} = 'a'\nonly_a = 1\n"));
        let over = write(&folder, "over.toml", &format!("base = 'under.toml'\n{key} = 'b'\n"));
        assert_eq!(resolve(&over).unwrap(), json!({key: "b"}));
    }
}

/// Our own experiments rely on it: `head_wind` keeps the ramp, `no_wind` drops it, `baseline` and
/// `second_order_jets` change their model.
#[test]
fn our_experiments_merge_as_meant() {
    let head_wind = experiment("head_wind");
    let expected = WindConfig::Ramp { velocity: [-10.0, 0.0, 0.0], ramp_start: 5.0, ramp_end: 10.0 };
    assert_eq!(head_wind.wind, expected);
    assert_eq!(head_wind.controller, experiment("test2").controller);
    assert_eq!(head_wind.title, "Head wind: aerodynamic-aware controller");
    assert_eq!(experiment("no_wind").wind, WindConfig::Constant { velocity: [0.0; 3] });
    assert_eq!(experiment("test1").controller.aero, AeroConfig::Off {});
    assert!(matches!(experiment("second_order_jets").simulator.jets, JetsConfig::SecondOrder(_)));
    let ablation = experiment("test2_without_aero_momentum").controller;
    let mut expected = experiment("test2_published").controller;
    expected.law.aero_feedback.momentum_rate = false;
    assert_eq!(ablation, expected);
}

/// Baseline and aware controller are the same but for their aerodynamics.
#[test]
fn the_baseline_is_the_aware_controller_without_air() {
    let mut baseline = experiment("test1");
    baseline.controller.aero = experiment("test2").controller.aero;
    assert_eq!(baseline.controller, experiment("test2").controller);
    assert_eq!(baseline.simulator, experiment("test2").simulator);
}

/// `robot` and `path` become absolute, starting at the file that names them, through any `base`.
#[test]
fn paths_start_at_the_file_that_names_them() {
    let folder = tempdir().unwrap();
    let robot = write(&folder, "deep/robots/r.toml", "");
    let wind = write(&folder, "winds/w.csv", "time,x,y,z\n0,1,2,3\n");
    write(&folder, "deep/base.toml", "robot = 'robots/r.toml'\n");
    let top = write(
        &folder,
        "top.toml",
        "base = 'deep/base.toml'\nwind = { profile = 'file', path = 'winds/w.csv' }\n",
    );
    let value = resolve(&top).unwrap();
    for (found, expected) in [(&value["robot"], robot), (&value["wind"]["path"], wind)] {
        let found = Path::new(found.as_str().unwrap());
        assert!(found.is_absolute());
        assert_eq!(found, expected.canonicalize().unwrap());
    }
    assert_eq!(experiment("test2").robot, configs("robot/ironcub_mk1.toml").canonicalize().unwrap());
}

#[track_caller]
fn assert_says(error: &BuildError, words: &[&str]) {
    let message = error.to_string();
    for word in words {
        assert!(message.contains(word), "`{message}` does not say `{word}`");
    }
}

/// Files that name one another in a circle are refused, by name.
#[test]
fn circles_are_refused() {
    let folder = tempdir().unwrap();
    write(&folder, "a.toml", "base = 'b.toml'\n");
    let b = write(&folder, "b.toml", "base = 'a.toml'\n");
    assert_says(&resolve(&b).unwrap_err(), &["more than 16 deep", ".toml"]);
    let own = write(&folder, "own.toml", "wind = { base = 'own.toml' }\n");
    assert_says(&resolve(&own).unwrap_err(), &["more than 16 deep", "own.toml"]);
}

/// A file that is absent, that is no TOML, or a `base` that is no path, is named.
#[test]
fn unreadable_files_are_named() {
    let folder = tempdir().unwrap();
    let absent = write(&folder, "top.toml", "base = 'absent.toml'\n");
    assert_says(&resolve(&absent).unwrap_err(), &["cannot read", "absent.toml"]);
    let robot = write(&folder, "robot.toml", "robot = 'nobody.toml'\n");
    assert_says(&resolve(&robot).unwrap_err(), &["cannot read", "nobody.toml"]);
    let broken = write(&folder, "broken.toml", "a = 1\nb = = 2\n");
    assert_says(&resolve(&broken).unwrap_err(), &["broken.toml", "line 2"]);
    let number = write(&folder, "number.toml", "base = 7\n");
    assert_says(&resolve(&number).unwrap_err(), &["`base`", "is 7", "the path of a TOML file"]);
    let mut gone = experiment("test2");
    gone.robot = folder.path().join("nobody.toml");
    assert_says(&Flight::new(&gone).unwrap_err(), &["cannot read", "nobody.toml"]);
}

fn test2_value() -> Value {
    resolve(&configs("experiments/test2.toml")).unwrap()
}

/// Sets `keys` (separated by dots) to `value`; `null` removes.
fn set(target: &mut Value, keys: &str, value: Value) {
    let (tables, last) = keys.rsplit_once('.').map_or((None, keys), |(head, last)| (Some(head), last));
    let table =
        tables.into_iter().flat_map(|head| head.split('.')).fold(target, |table, key| &mut table[key]);
    if value.is_null() {
        table.as_object_mut().unwrap().remove(last);
    } else {
        table[last] = value;
    }
}

/// An unknown key is refused in every table, with its section and its name.
#[test]
fn unknown_keys_are_named_with_their_section() {
    for (keys, section) in [
        ("simulator.typo", "section simulator"),
        ("simulator.initial.typo", "section simulator"),
        ("simulator.fall.typo", "section simulator"),
        ("simulator.aero.typo", "section simulator"),
        ("simulator.jets.typo", "section simulator"),
        ("controller.typo", "section controller"),
        ("controller.aero.typo", "section controller"),
        ("controller.aero_feedback.typo", "section controller"),
        ("controller.momentum.typo", "section controller"),
        ("controller.weights.typo", "section controller"),
        ("controller.bounds.typo", "section controller"),
        ("controller.torque.typo", "section controller"),
        ("controller.qp.typo", "section controller"),
        ("controller.references.typo", "section controller"),
        ("envelope.typo", "section envelope"),
        ("wind.typo", "section wind"),
        ("typo", "here"),
    ] {
        let mut value = test2_value();
        set(&mut value, keys, json!(1.0));
        let error = flight_from_value(value, "here").unwrap_err();
        assert_says(&error, &["here", section, "unknown field `typo`"]);
    }
    // Also beside a model without numbers of its own.
    for (keys, table) in [
        ("controller.aero", json!({"model": "off", "typo": 1})),
        ("simulator.jets", json!({"dynamics": "ideal", "typo": 1})),
        ("simulator.jets", json!({"dynamics": "second_order", "typo": 1})),
        ("wind", json!({"profile": "constant", "velocity": [0.0, 0.0, 0.0], "typo": 1})),
    ] {
        let mut value = test2_value();
        set(&mut value, keys, table);
        assert_says(&flight_from_value(value, "here").unwrap_err(), &["unknown field `typo`"]);
    }
}

/// Missing and ill-typed keys, and kinds that do not exist, are refused with their section.
#[test]
fn missing_and_ill_typed_keys_are_named() {
    for (keys, bad, words) in [
        ("controller.momentum.c0", Value::Null, ["section controller", "missing field `c0`"]),
        ("controller.weights", Value::Null, ["section controller", "missing field `weights`"]),
        ("simulator.duration", Value::Null, ["section simulator", "missing field `duration`"]),
        ("simulator.initial.thrust", Value::Null, ["section simulator", "missing field `thrust`"]),
        ("wind.ramp_end", Value::Null, ["section wind", "missing field `ramp_end`"]),
        ("robot", Value::Null, ["here", "missing field `robot`"]),
        ("wind", Value::Null, ["here", "missing field `wind`"]),
        ("controller.momentum.c0", json!("fifty"), ["section controller", "invalid type"]),
        ("controller.momentum.kp_linear", json!([1.0, 2.0]), ["section controller", "invalid length 2"]),
        ("simulator.substeps", json!(-1), ["section simulator", "invalid value"]),
        ("simulator.integrator", json!("magic"), ["section simulator", "unknown variant `magic`"]),
        ("simulator.kinematics", json!("magic"), ["section simulator", "unknown variant `magic`"]),
        ("simulator.lever_arm", json!("magic"), ["section simulator", "unknown variant `magic`"]),
        ("simulator.jets.dynamics", json!("magic"), ["section simulator", "unknown variant `magic`"]),
        ("controller.lever_arm", json!("magic"), ["section controller", "unknown variant `magic`"]),
        ("controller.jacobian_offset", json!("magic"), ["section controller", "unknown variant `magic`"]),
        ("controller.link_velocity", json!("magic"), ["section controller", "unknown variant `magic`"]),
        ("controller.qp.solver", json!("magic"), ["section controller", "unknown variant `magic`"]),
        ("controller.qp.fallback", json!("magic"), ["section controller", "unknown variant `magic`"]),
        ("controller.aero.model", json!("magic"), ["section controller", "unknown variant `magic`"]),
        ("wind.profile", json!("magic"), ["section wind", "unknown variant `magic`"]),
        ("envelope.up", json!([[1.0]]), ["section envelope", "invalid length 1"]),
    ] {
        let mut value = test2_value();
        set(&mut value, keys, bad);
        let error = flight_from_value(value, "here").unwrap_err();
        assert_says(&error, &words);
    }
}

/// Every aerodynamic model parses and builds for the robot.
#[test]
fn every_aero_file_is_an_aerodynamic_model() {
    let robot = robot("ironcub_mk1");
    for file in files("aero") {
        let config: AeroConfig = parse(&file);
        load_aero(&config, &robot).unwrap();
    }
}

/// Every controller parses and fits the robot.
#[test]
fn every_control_file_is_a_controller() {
    let robot = robot("ironcub_mk1");
    for file in files("control") {
        let config: ControllerSection = parse(&file);
        config.law.check(&robot).unwrap();
    }
}

/// Every envelope parses and holds intervals.
#[test]
fn every_envelope_file_is_an_envelope() {
    for file in files("envelope") {
        let config: MissionConfig = parse(&file);
        config.check().unwrap();
    }
}

/// Every simulator parses and fits the robot.
#[test]
fn every_simulator_file_is_a_simulator() {
    let robot = robot("ironcub_mk1");
    for file in files("simulator") {
        let config: SimulatorConfig = parse(&file);
        config.check(&robot).unwrap();
    }
}

/// Every wind parses and blows.
#[test]
fn every_wind_file_is_a_wind() {
    for file in files("wind") {
        let wind = Wind::new(&parse(&file)).unwrap();
        assert!(wind.velocity(7.0).iter().all(|v| v.is_finite()));
    }
}

/// Every experiment loads, says what it is, and can be flown.
#[test]
fn every_experiment_file_is_a_flight() {
    for file in files("experiments") {
        let config = load_flight(&file).unwrap();
        assert!(!config.title.is_empty() && !config.description.is_empty(), "{}", file.display());
        Flight::check(&config).unwrap();
    }
}

/// What is written out is read back the same: a manifest holds the whole flight.
#[test]
fn a_flight_survives_being_written_out() {
    for file in files("experiments") {
        let config = load_flight(&file).unwrap();
        let value = serde_json::to_value(&config).unwrap();
        assert_eq!(flight_from_value(value, "written out").unwrap(), config, "{}", file.display());
    }
}
