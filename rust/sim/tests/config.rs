//! Configuration files: how `base` merges, where paths start, what is refused and how it is said, and
//! that every file we ship is what it claims to be.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use crate::common::{assert_says, configs, experiment};
use flight_core::BuildError;
use flight_io::{AeroConfig, Schema, from_value};
use flight_sim::disturbances::WindEstimateConfig;
use flight_sim::jets::JetsConfig;
use flight_sim::{
    Backend, Scenario, ScenarioConfig, SimulatorConfig, WindConfig, load_flyable, load_scenario, onboard,
};
use serde_json::{Value, json};
use std::collections::BTreeSet;
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

/// The resolved table of an experiment's file.
fn resolve(file: &Path) -> Result<Value, BuildError> {
    flight_io::resolve(file, &Schema::of_type::<ScenarioConfig>())
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
        let schema = Schema::of_type::<WindConfig>();
        assert_eq!(flight_io::resolve(&file, &schema).unwrap(), expected, "{name}");
    }
    for (key, schema) in
        [("model", Schema::of_type::<AeroConfig>()), ("dynamics", Schema::of_type::<JetsConfig>())]
    {
        write(&folder, "under.toml", &format!("{key} = 'a'\nonly_a = 1\n"));
        let over = write(&folder, "over.toml", &format!("base = 'under.toml'\n{key} = 'b'\n"));
        assert_eq!(flight_io::resolve(&over, &schema).unwrap(), json!({key: "b"}));
    }
}

/// `false` removes a key that may be absent, at any depth, and a file above may set it again; of other keys it is a value.
#[test]
fn what_may_be_absent_is_removed_by_false() {
    let folder = tempdir().unwrap();
    write(
        &folder,
        "bottom.toml",
        "[sensors.joints]\nvelocity_time_constant = 0.1\n[motors]\nfriction = 1.0\n",
    );
    let middle = "base = 'bottom.toml'\nground = false\nmotors = false\nsensors.joints.velocity_time_constant = false\n";
    let middle = write(&folder, "middle.toml", &format!("{middle}joint_stops = false\njets = false\n"));
    let top = write(&folder, "top.toml", "base = 'middle.toml'\nmotors = { damping = 2.0 }\n");
    let resolve = |file| flight_io::resolve(file, &Schema::of_type::<SimulatorConfig>()).unwrap();
    let expected = json!({"sensors": {"joints": {}}, "joint_stops": false, "jets": false});
    assert_eq!(resolve(&middle), expected);
    assert_eq!(resolve(&top)["motors"], json!({"damping": 2.0}));
    let flight = write(
        &folder,
        "flight.toml",
        &format!(
            "base = {:?}\ncontroller = {{ fault_detection.engines = false }}\n",
            configs("experiments/test2_observer.toml").canonicalize().unwrap()
        ),
    );
    let (found, mut expected) = (load_scenario(&flight).unwrap(), experiment("test2_observer"));
    assert!(expected.controller.law.fault_detection.engines.take().is_some());
    assert_eq!(found, expected);
}

/// Where the keys of a table are names of the robot's parts, `base` may be one of them.
#[test]
fn base_may_be_a_name() {
    let folder = tempdir().unwrap();
    write(&folder, "links.toml", "chest = 0.2\nbase = 0.3\n");
    let text = "disturbances.aero.links = { base = 0.5 }\ndisturbances.aero_estimate.links = { base = 'links.toml' }\n";
    let expected =
        json!({"aero": {"links": {"base": 0.5}}, "aero_estimate": {"links": {"chest": 0.2, "base": 0.3}}});
    assert_eq!(resolve(&write(&folder, "top.toml", text)).unwrap()["disturbances"], expected);
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
    assert_says(
        &resolve(&absent).unwrap_err(),
        &["`base` is \"absent.toml\"", "expected the path of a file"],
    );
    let robot = write(&folder, "robot.toml", "robot = 'missing.toml'\nbase = 'top.toml'\n");
    let missing = [
        "`robot` is \"missing.toml\"; expected the path of a file that exists; there is no ",
        "missing.toml",
    ];
    assert_says(&resolve(&robot).unwrap_err(), &missing);
    let broken = write(&folder, "broken.toml", "a = 1\nb = = 2\n");
    assert_says(&resolve(&broken).unwrap_err(), &["broken.toml", "line 2"]);
    let number = write(&folder, "number.toml", "base = 7\n");
    assert_says(&resolve(&number).unwrap_err(), &["`base`", "is 7", "the path of a TOML file"]);
    let mut gone = experiment("test2");
    gone.robot = folder.path().join("missing.toml");
    assert_says(&Scenario::new(&gone).unwrap_err(), &["cannot read", "missing.toml"]);
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

/// An unknown key is refused in every table by its whole name, with the key that may have been meant.
#[test]
fn unknown_keys_are_named() {
    let mut tables = vec![];
    walk(&test2_value(), "", &mut |key, value| {
        if value.is_object() {
            tables.push(key.to_owned());
        }
    });
    assert!(tables.len() > 10, "{tables:?}");
    for table in tables.into_iter().filter(|table| !is_free(table)) {
        let mut value = test2_value();
        let key = if table.is_empty() { "typo".to_owned() } else { format!("{table}.typo") };
        set(&mut value, &key, json!(1.0));
        assert_says(
            &from_value::<ScenarioConfig>(value, "here").unwrap_err(),
            &["here: ", &format!("unknown key `{key}`")],
        );
    }
    let mut value = test2_value();
    set(&mut value, "controller.momentum.kp_liner", json!([1.0, 1.0, 1.0]));
    assert_says(
        &from_value::<ScenarioConfig>(value, "here").unwrap_err(),
        &["did you mean `controller.momentum.kp_linear`?"],
    );
}

/// Tables whose keys are names of the robot's parts.
fn is_free(table: &str) -> bool {
    ["posture_gain", "thrust_rate", "thrust_rate_max", "links"].iter().any(|name| table.ends_with(name))
}

/// Calls `visit` with the dotted key of every table and value but the items of lists.
fn walk(value: &Value, key: &str, visit: &mut impl FnMut(&str, &Value)) {
    visit(key, value);
    for (name, inner) in value.as_object().into_iter().flatten() {
        walk(inner, &if key.is_empty() { name.clone() } else { format!("{key}.{name}") }, visit);
    }
}

/// A value of another type is refused at every key, by its whole name, with the value and what was expected.
#[test]
fn wrong_types_are_named_at_every_key() {
    let mut keys = vec![];
    for name in ["test2", "second_order_jets", "min_time", "engine_out", "balancing_front", "sensor_noise"] {
        walk(&serde_json::to_value(experiment(name)).unwrap(), "", &mut |key, _| {
            keys.push((name, key.to_owned()));
        });
    }
    assert!(keys.len() > 300, "{}", keys.len());
    for (name, key) in keys.into_iter().filter(|(_, key)| !key.is_empty()) {
        // No key takes a list of lists of tables.
        let mut value = serde_json::to_value(experiment(name)).unwrap();
        set(&mut value, &key, json!([[{"wrong": true}]]));
        let message = from_value::<ScenarioConfig>(value, "here").unwrap_err().to_string();
        assert!(message.contains(&format!("`{key}")), "{name}: {key}: {message}");
        assert!(message.contains("{\"wrong\":true}") && message.contains("expected"), "{key}: {message}");
    }
}

/// Missing keys, wrong lengths and names, and kinds that do not exist, are refused by their whole name.
#[test]
fn missing_and_ill_typed_keys_are_named() {
    for (key, bad, words) in [
        ("controller.momentum.c0", Value::Null, "is missing"),
        ("controller.weights", Value::Null, "is missing"),
        ("simulator.duration", Value::Null, "is missing"),
        ("wind.ramp_end", Value::Null, "is missing"),
        ("robot", Value::Null, "is missing"),
        ("controller.momentum.c0", json!("fifty"), "is \"fifty\"; expected a number"),
        ("controller.momentum.kp_linear", json!([1.0, 2.0]), "is [1.0,2.0]; expected a list of 3"),
        ("simulator.substeps", json!(-1), "is -1; expected an integer ≥ 1 and ≤ 1000"),
        ("simulator.substeps", json!(5_000_000_000_u64), "is 5000000000; expected an integer ≥ 1 and ≤ 1000"),
        (
            "simulator.integrator",
            json!("magic"),
            "is \"magic\"; expected one of semi_implicit_euler, explicit_euler",
        ),
        ("simulator.jets.dynamics", json!("magic"), "is \"magic\"; expected one of ideal, throttled"),
        ("controller.qp.solver", json!("magic"), "is \"magic\"; expected one of active_set, clarabel"),
        (
            "controller.aero.model",
            json!("magic"),
            "is \"magic\"; expected one of off, axisymmetric, sphere_cylinder, network",
        ),
        (
            "wind.profile",
            json!("magic"),
            "is \"magic\"; expected one of constant, ramp, gust, turbulent, file",
        ),
    ] {
        let mut value = test2_value();
        set(&mut value, key, bad);
        let error = from_value::<ScenarioConfig>(value, "here").unwrap_err();
        assert_says(&error, &["here: ", &format!("`{key}` {words}")]);
    }
}

/// Every experiment loads, says what it is, and can be flown as it is meant, also as it is written out: a manifest holds the
/// whole flight.
#[test]
fn every_experiment_file_is_a_flight() {
    for file in files("experiments") {
        let config = load_scenario(&file).unwrap();
        assert!(!config.title.is_empty() && !config.description.is_empty(), "{}", file.display());
        assert_eq!(Scenario::check(&config).unwrap(), [""; 0], "{}", file.display());
        let value = serde_json::to_value(&config).unwrap();
        assert_eq!(from_value::<ScenarioConfig>(value, "written out").unwrap(), config, "{}", file.display());
    }
}

/// The message names what was probably meant, and how another kind of wind is set.
#[test]
fn a_wind_that_cannot_be_set_says_what_can() {
    let refusal = |key: &str, value: Value| {
        let change = [(key.to_owned(), value)];
        load_flyable(&configs("experiments").join("test2.toml"), None, &change).unwrap_err().to_string()
    };
    for key in ["wind.speed", "wind.direction"] {
        let message = refusal(key, json!(10));
        assert!(
            message.contains(&format!("unknown key `{key}`; did you mean `wind.velocity`?")),
            "{message}"
        );
    }
    let message = refusal("wind.profile", json!("gust"));
    for words in [
        "`wind.profile` is \"gust\"; expected the whole table",
        "wind={profile=\"gust\", …}",
        "duration, gust, start, velocity",
    ] {
        assert!(message.contains(words), "{message}");
    }
    let message = refusal("wind.profile", json!("calm"));
    assert!(message.contains("expected one of ") && message.contains("constant"), "{message}");
}

/// What begins after the end, a start that cannot be, and a wind that no flight survives are warned of, by key.
#[test]
fn what_is_probably_not_meant_is_warned_of() {
    let warnings = |changes: &[(&str, Value)]| {
        let changes: Vec<_> = changes.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        load_flyable(&configs("experiments").join("test2.toml"), None, &changes).unwrap().1
    };
    let failure = |time: f64| json!({ "jet": "l_arm_jet", "time": time, "kind": "off" });
    let push =
        |start: f64| json!([{ "body": "chest", "force": [1.0, 0.0, 0.0], "start": start, "duration": 0.1 }]);
    let outage = |start: f64| json!([{ "channel": "wind", "kind": "missing", "start": start }]);
    let joint = |start: f64| json!([{ "joint": "l_knee", "kind": "stuck", "start": start }]);
    let gust = |start: f64| json!({ "profile": "gust", "velocity": [0.0, 5.0, 0.0], "gust": [0.0, 2.0, 0.0], "start": start, "duration": 2.0 });
    let end = 50.0;
    for (key, named, of_start) in [
        ("disturbances.jets.failure", "disturbances.jets.failure.time", &failure as &dyn Fn(f64) -> Value),
        ("disturbances.pushes", "disturbances.pushes[0].start", &push),
        ("disturbances.outages", "disturbances.outages[0].start", &outage),
        ("disturbances.joints", "disturbances.joints[0].start", &joint),
        ("wind", "wind.start", &gust),
    ] {
        assert_eq!(warnings(&[(key, of_start(end - 0.01))]), [""; 0]);
        let found = warnings(&[(key, of_start(end))]);
        let [only] = found.as_slice() else { panic!("{key}: {found:?}") };
        assert!(only.starts_with(&format!("{named} is 50 s; expected less than")), "{only}");
    }
    for (key, value, words) in [
        (
            "disturbances.pushes",
            json!([{ "body": "chest", "start": 1.0, "duration": 0.1 }]),
            "disturbances.pushes[0] has neither",
        ),
        (
            "simulator.initial.joint_position.0",
            json!(8.7),
            "joint_position of `torso_pitch` is 8.7 rad; expected",
        ),
        ("simulator.initial.base_position", json!([0.0, 0.0, -5.0]), "base_position puts foot `"),
        ("wind.velocity", json!([0.0, -400.0, 0.0]), "wind reaches 400 m/s; expected at most 300"),
    ] {
        let found = warnings(&[(key, value)]);
        assert!(found.iter().any(|warning| warning.contains(words)), "{key}: {found:?}");
    }
    for (first, last, is_met) in
        [(8e8, 8e8 + 60.0, false), (-9.0, -1.0, false), (-1.0, 1.0, true), (50.0, 60.0, true)]
    {
        let sample = |time: f64| json!([time, 0.0, -6.0, 0.0]);
        let found =
            warnings(&[("wind", json!({ "profile": "samples", "samples": [sample(first), sample(last)] }))]);
        let words = &found;
        assert_eq!(words.is_empty(), is_met, "{first} to {last} s: {words:?}");
        assert!(
            words.iter().all(|words| words.contains("none within the flight; expected 0 to 50 s")),
            "{words:?}"
        );
    }
    for height in [0.62, 0.625] {
        // soles at the ground, to the rounding of their heights
        assert_eq!(warnings(&[("simulator.initial.base_position", json!([0.0, 0.0, height]))]), [""; 0]);
    }
}

/// A controller whose torques contain rotors or friction that the simulated robot lacks is refused, by every entry: with
/// 0.01 kg m² of them it falls in 2 s. What it survives is warned of.
#[test]
fn drives_and_engines_that_the_robot_lacks_are_refused_or_warned_of() {
    let load = |name: &str, changes: &[(&str, Value)]| {
        let changes: Vec<_> = changes.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        load_flyable(&configs("experiments").join(format!("{name}.toml")), None, &changes)
    };
    let controller = |name: &str| json!({ "base": configs("control").join(format!("{name}.toml")) });
    let rotors = ("controller.torque.rotor_inertia", json!(0.01));
    let friction = ("controller.torque.friction", json!({ "torso": 1.0 }));
    for (changes, key) in [
        (vec![("controller", controller("robot"))], "controller.torque.rotor_inertia is 0.05"),
        (vec![rotors.clone()], "controller.torque.rotor_inertia is 0.01"),
        (vec![friction.clone()], "controller.torque.friction.torso is 1"),
    ] {
        let message = load("test2", &changes).unwrap_err().to_string();
        assert!(message.contains(key) && message.contains("control/robot_ideal.toml"), "{message}");
    }
    let message = load("robot", &[("simulator.motors.inertia", json!(0.0))]).unwrap_err().to_string();
    assert!(message.contains("controller.torque.rotor_inertia is 0.05"), "{message}");
    let mut config = experiment("test2");
    config.controller.law.torque.rotor_inertia = 0.01;
    assert!(Scenario::new(&config).is_err());
    assert!(onboard(json!(config), "here").is_err());

    for (name, ideal) in [("test2", "robot_ideal"), ("mk3_test2", "mk3_robot_ideal")] {
        assert_eq!(load(name, &[("controller", controller(ideal))]).unwrap().1, [""; 0]);
    }
    let found = load("robot", &[("simulator.motors.friction", json!(0.0))]).unwrap().1;
    assert_eq!(found.len(), 5, "{found:?}"); // groups of joints
    assert!(
        found.iter().all(|words| words.contains("is 1 N m; expected 0, as the simulated drives")),
        "{found:?}"
    );
    let found = load("robot", &[("simulator.jets", json!({ "dynamics": "ideal" }))]).unwrap().1;
    let [only] = found.as_slice() else { panic!("{found:?}") };
    assert!(only.starts_with("controller.jet_dynamics is throttled; expected ideal"), "{only}");
}

/// A start from which commands turn the set-point into its limits at once is warned of, of every engine; a recording
/// has no limits. Facing +x, this robot leans backward with a positive pitch of its base.
#[test]
fn a_start_outside_the_limits_of_the_set_point_is_warned_of() {
    let warnings = |name: &str, backend: Backend, pitch: f64| {
        let mut config = experiment(name);
        (config.backend, config.simulator.initial.base_rpy_deg[1]) = (backend, pitch);
        Scenario::check(&config).unwrap()
    };
    for backend in [Backend::Rust, Backend::Jax] {
        for (pitch, count) in [(0.0, 0), (-30.0, 0), (-30.1, 1), (10.0, 1)] {
            assert_eq!(warnings("test2", backend, pitch).len(), count, "{pitch}");
        }
    }
    let said = &warnings("test2", Backend::Rust, 10.0)[0];
    assert!(
        said.starts_with("simulator.initial.base_rpy_deg has a nose-down pitch of -10.000 deg"),
        "{said}"
    );
    assert_eq!(warnings("take_off", Backend::Mujoco, 10.0).len(), 1);
    assert!(warnings("min_time", Backend::Rust, 10.0).is_empty());
}

/// A number beyond a limit that the schema states, by key: in the place of every number of a flight that has one.
fn beyond_limits(schema: &Value, value: &Value) -> Vec<(String, Value)> {
    fn follow<'a>(root: &'a Value, node: &'a Value) -> &'a Value {
        match node["$ref"].as_str() {
            Some(target) => follow(root, root.pointer(target.trim_start_matches('#')).unwrap()),
            None => node,
        }
    }
    fn visit(root: &Value, node: &Value, value: &Value, key: &str, found: &mut Vec<(String, Value)>) {
        let node = follow(root, node);
        for list in ["anyOf", "oneOf"] {
            for option in node[list].as_array().into_iter().flatten() {
                let properties = follow(root, option)["properties"].as_object().into_iter().flatten();
                let mut constants = properties.filter(|(_, property)| !property["const"].is_null());
                if constants.all(|(name, property)| value[name] == property["const"]) {
                    visit(root, option, value, key, found);
                }
            }
        }
        match value {
            Value::Object(table) => {
                for (name, value) in table {
                    let of_name = node["properties"].get(name).or_else(|| node.get("additionalProperties"));
                    if let Some(node) = of_name {
                        visit(root, node, value, &format!("{key}/{name}"), found);
                    }
                }
            }
            Value::Array(list) => {
                if let Some(value) = list.first() {
                    visit(root, &node["items"], value, &format!("{key}/0"), found);
                }
            }
            Value::Number(_) => {
                let limit = |name: &str, beyond: f64| node[name].as_f64().map(|limit| limit + beyond);
                let beyond = [
                    limit("minimum", -1.0),
                    limit("exclusiveMinimum", 0.0),
                    limit("maximum", 1.0),
                    limit("exclusiveMaximum", 0.0),
                ];
                found.extend(beyond.into_iter().flatten().map(|number| (key.to_owned(), json!(number))));
            }
            _ => {}
        }
    }
    let mut found = vec![];
    visit(schema, schema, value, "", &mut found);
    found
}

/// Limits are stated in the schema, for files and editors, and in the checks of the types, for programs that make a
/// configuration of their own: what the former refuse, the latter refuse.
#[test]
fn what_the_schema_refuses_cannot_be_built() {
    let schema = Schema::of_type::<ScenarioConfig>();
    let shipped = files("experiments");
    let mut flights: Vec<_> = shipped.iter().map(|file| json!(load_scenario(file).unwrap())).collect();
    // Tables that no shipped flight has.
    let mut own = json!(experiment("test2_observer"));
    own["controller"]["wind_observer"] = true.into();
    own["controller"]["torque"]["friction"] = json!({ "torso": 1.0 });
    own["simulator"]["motors"] = json!({ "friction": 1.0, "damping": 0.5, "inertia": 0.05 });
    own["simulator"]["fuel"] =
        json!({ "body": "chest", "mass": 1.0, "position": [0.0, 0.0, 0.0], "idle": 0.0, "by_thrust": 1e-5 });
    own["simulator"]["sensors"] =
        json!({ "joints": { "tremble": { "amplitude": 0.001, "frequency": 3.0 } } });
    own["simulator"]["jets"] = json!({ "dynamics": "throttled", "shaft": { "idle": 0.3, "ramps": [0.1, 0.1],
        "lags": [1.2, 1.6], "accelerations": [0.1, 0.4], "exponent": 2.0, "square_share": 0.1 } });
    own["disturbances"]["pushes"] = json!([{ "body": "chest", "start": 1.0, "duration": 0.1 }]);
    own["disturbances"]["wind_estimate"] = json!(WindEstimateConfig::default());
    own["disturbances"]["outages"] =
        json!([{ "channel": "wind", "kind": "missing", "start": 1.0, "duration": 1.0 }]);
    for wind in [
        json!({ "profile": "turbulent", "velocity": [0.0, 5.0, 0.0], "ramp_start": 1.0, "ramp_end": 2.0,
            "std": [1.0, 1.0, 1.0], "time_scale": 1.0, "seed": 0 }),
        json!({ "profile": "gust", "velocity": [0.0, 5.0, 0.0], "gust": [0.0, 2.0, 0.0], "start": 1.0, "duration": 2.0 }),
    ] {
        own["disturbances"]["controller_wind"] = wind;
        Scenario::check(&from_value(own.clone(), "own").unwrap()).unwrap();
        flights.push(own.clone());
    }
    let (mut tried, mut built) = (BTreeSet::new(), vec![]);
    for flight in flights {
        for (key, number) in beyond_limits(schema.json(), &flight) {
            if !tried.insert((key.clone(), number.to_string())) {
                continue;
            }
            let mut changed = flight.clone();
            *changed.pointer_mut(&key).unwrap() = number.clone();
            assert!(from_value::<ScenarioConfig>(changed.clone(), "flight").is_err(), "{key} = {number}");
            let config = serde_json::from_value::<ScenarioConfig>(changed);
            if config.is_ok_and(|config| Scenario::check(&config).is_ok()) {
                built.push(format!("{key} = {number} ({})", flight["title"]));
            }
        }
    }
    assert!(tried.len() > 100, "{}", tried.len());
    assert!(built.is_empty(), "{built:#?}");
}
