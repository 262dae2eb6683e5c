//! Claims about the aerodynamic models: laws, the published numbers, and what is refused.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on fails")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_says, assert_within, relative};
use flight_core::BuildError;
use flight_core::aero::{AeroModel, LinksInAir, Pchip, SphereCylinderConfig};
use flight_core::kinematics::Kinematics;
use flight_core::robot::{AeroLink, RobotModel};
use flight_io::{AeroConfig, load_aero, load_robot};
use nalgebra::{Unit, Vector3};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// The links of iRonCub-Mk1, whose numbers `rust/io/tests/robot/ironcub.rs` compares with the published ones.
fn links() -> Vec<AeroLink> {
    load_robot(&configs().join("../robot/ironcub_mk1.toml")).unwrap().aero_links
}

fn configs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/aero")
}

fn config(stem: &str) -> AeroConfig {
    let path = configs().join(stem).with_extension("toml");
    toml::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn sphere_cylinder_config() -> SphereCylinderConfig {
    match config("sphere_cylinder") {
        AeroConfig::SphereCylinder(config) => *config,
        other => panic!("{other:?}"),
    }
}

/// A model for these links, on a robot that has no say in it.
fn model_of(config: &AeroConfig, links: &[AeroLink]) -> Result<AeroModel, BuildError> {
    let mut robot = load_robot(&configs().join("../robot/sparrow.toml")).unwrap();
    robot.aero_links = links.to_vec();
    load_aero(config, &robot)
}

/// Every model of `configs/aero`, with its name.
fn models() -> Vec<(String, AeroModel)> {
    let stems: Vec<String> = std::fs::read_dir(configs())
        .unwrap()
        .filter_map(|entry| entry.unwrap().path().file_stem()?.to_str().map(str::to_owned))
        .filter(|stem| {
            ["off", "sphere_cylinder"].contains(&stem.as_str()) || stem.starts_with("axisymmetric")
        })
        .collect();
    assert!(stems.len() >= 6, "{stems:?}");
    stems.into_iter().map(|stem| (stem.clone(), model_of(&config(&stem), &links()).unwrap())).collect()
}

/// Writes the forces on links with these axes in this air; the robot has no say in it.
fn evaluate(
    model: &AeroModel,
    axes_i: &[Vector3<f64>],
    v_air_i: &[Vector3<f64>],
    forces_i: &mut [Vector3<f64>],
) {
    static ROBOT: LazyLock<RobotModel> =
        LazyLock::new(|| load_robot(&configs().join("../robot/sparrow.toml")).unwrap());
    let kinematics = &Kinematics::new(&ROBOT);
    let links = LinksInAir { robot: &ROBOT, kinematics, axes_i, v_air_i, wind_i: &Vector3::zeros() };
    model.clone().link_forces(&links, forces_i);
}

/// Forces on all 13 links, each with the same axis and wind.
fn forces(model: &AeroModel, axis_i: Vector3<f64>, v_air_i: Vector3<f64>) -> [Vector3<f64>; 13] {
    let mut forces_i = [Vector3::repeat(f64::NAN); 13];
    evaluate(model, &[axis_i; 13], &[v_air_i; 13], &mut forces_i);
    forces_i
}

#[test]
fn still_air_gives_no_force() {
    for (name, model) in models() {
        for force in forces(&model, Vector3::z(), Vector3::zeros()) {
            assert_eq!(force, Vector3::zeros(), "{name}");
        }
    }
}

#[test]
fn force_is_finite_for_any_wind() {
    let tilted = Vector3::new(0.36, 0.48, 0.8);
    for (name, model) in models() {
        for speed in [1e-300, 1e-160, 1e-12, 1e-9, 1e-3, 1.0, 17.0, 340.0, 1e6, 1e100] {
            for axis_i in [Vector3::x(), Vector3::z(), tilted] {
                for direction in [axis_i, -axis_i, Vector3::x(), Vector3::y(), -Vector3::z(), tilted] {
                    for force in forces(&model, axis_i, speed * direction) {
                        assert!(force.iter().all(|f| f.is_finite()), "{name} at {speed} m/s");
                    }
                }
            }
        }
    }
}

#[test]
fn force_along_the_axis_is_along_the_axis_and_continuous() {
    for (name, model) in models() {
        let aligned = forces(&model, Vector3::z(), -10.0 * Vector3::z());
        let nearly = forces(&model, Vector3::z(), -10.0 * Vector3::new(1e-9, 0.0, 1.0));
        for (aligned, nearly) in aligned.iter().zip(nearly) {
            assert_eq!(aligned.xy().norm(), 0.0, "{name}");
            assert_within!((aligned - nearly).norm(), 1e-8, because "the two directions of wind differ by 1e-9 rad at forces of some newtons", "{name}");
        }
    }
}

/// Abscissae, ordinates, and points of the curve.
type PchipCase<'a> = (&'a [f64], &'a [f64], &'a [(f64, f64)]);

/// Values typed from scipy's `PchipInterpolator` for the three kinds of ends; `tests/parity/test_aero.py` has the insides.
#[test]
fn pchip_equals_scipy() {
    let cases: [PchipCase; 3] = [
        (&[0.0, 1.0, 3.0, 4.0, 6.0], &[0.0, 2.0, 1.0, 1.5, 5.0], &[(5.75, 4.375_174_115_794_573)]),
        (
            &[0.0, 1.0, 3.0],
            &[0.0, 0.1, 5.0],
            &[(0.5, 0.028_211_462_450_592_886), (2.0, 1.589_410_408_432_147_6)],
        ),
        (&[0.0, 1.0, 1.5], &[0.0, 1.0, -7.0], &[(0.5, 0.875), (1.25, -1.645_833_333_333_333_3)]),
    ];
    for (x, y, expected) in cases {
        let table = Pchip::new("x", x, "y", y).unwrap();
        for &(x, value) in expected {
            assert_within!(relative(table.at(x), value), 1e-14);
        }
        for (x, y) in x.iter().zip(y) {
            assert_eq!(table.at(*x), *y);
        }
        assert_eq!((table.at(-9.0), table.at(99.0)), (y[0], y[y.len() - 1]));
        assert!(table.at(f64::NAN).is_nan());
    }
}

#[test]
fn pchip_of_two_points_is_a_line() {
    let table = Pchip::new("x", &[1.0, 3.0], "y", &[2.0, 8.0]).unwrap();
    for x in [1.0, 1.3, 2.0, 2.9, 3.0] {
        assert_within!(relative(table.at(x), 3.0 * x - 1.0), 1e-14);
        assert_within!(relative(table.linear_at(x), 3.0 * x - 1.0), 1e-14);
    }
}

/// The error of building with a changed sphere and cylinder config.
fn sphere_cylinder_error(change: impl FnOnce(&mut SphereCylinderConfig)) -> String {
    let mut config = sphere_cylinder_config();
    change(&mut config);
    model_of(&AeroConfig::SphereCylinder(Box::new(config)), &links()).unwrap_err().to_string()
}

#[test]
fn unknown_coefficient_set_names_link_and_known_sets() {
    let config: AeroConfig =
        toml::from_str("model = 'axisymmetric'\ncoefficients = 'best'\nair_density = 1.2").unwrap();
    let message = model_of(&config, &links()).unwrap_err().to_string();
    assert_says(&message, &["`head`", "`best`", "alternative, corrected, published, refit, signed"]);
}

#[test]
fn coefficients_must_be_finite() {
    let mut links = links();
    links[2].coefficients.get_mut("corrected").unwrap().cda[3] = f64::NAN;
    let config = config("axisymmetric_corrected");
    let message = model_of(&config, &links).unwrap_err().to_string();
    assert_says(&message, &["w3", "`corrected`", "`chest_l_jet_turbine`", "NaN", "finite area"]);
    links[2].coefficients.get_mut("corrected").unwrap().cda[3] = 0.0;
    links[2].coefficients.get_mut("corrected").unwrap().cna = f64::INFINITY;
    assert_says(&model_of(&config, &links).unwrap_err().to_string(), &["w5", "inf"]);
}

#[test]
fn air_and_links_must_be_physical() {
    for density in ["0.0", "-1.2", "nan"] {
        let text = format!("model = 'axisymmetric'\ncoefficients = 'signed'\nair_density = {density}");
        let config: AeroConfig = toml::from_str(&text).unwrap();
        let message = model_of(&config, &links()).unwrap_err().to_string();
        assert_says(&message, &["air_density", "positive density"]);
    }
    assert_says(&sphere_cylinder_error(|c| c.air_density = -1.0), &["air_density is -1"]);
    assert_says(&sphere_cylinder_error(|c| c.dynamic_viscosity = 0.0), &["dynamic_viscosity is 0"]);
    let mut links = links();
    links[9].length = 0.0;
    let message = model_of(&config("sphere_cylinder"), &links).unwrap_err().to_string();
    assert_says(&message, &["length of link `l_upper_leg` is 0"]);
}

#[test]
fn tables_must_increase_and_match() {
    let message = sphere_cylinder_error(|c| c.cylinder.reynolds[4] = 0.728);
    assert_says(&message, &["cylinder.reynolds[4] is 0.728", "more than 0.728"]);
    let message = sphere_cylinder_error(|c| c.cylinder.diameter_over_length[2] = 0.01);
    assert_says(&message, &["cylinder.diameter_over_length[2] is 0.01", "more than 0.0237"]);
    let message = sphere_cylinder_error(|c| c.sphere.reynolds[15] = f64::INFINITY);
    assert_says(&message, &["sphere.reynolds[15] is inf", "finite"]);
    let message = sphere_cylinder_error(|c| c.sphere.drag[1] = -0.5);
    assert_says(&message, &["sphere.drag[1] is -0.5", "positive drag coefficient"]);
    let message = sphere_cylinder_error(|c| c.cylinder.axial_drag.truncate(22));
    assert_says(&message, &["cylinder.axial_drag", "22 points", "23 points"]);
    let message = sphere_cylinder_error(|c| c.sphere.reynolds.truncate(1));
    assert_says(&message, &["sphere.reynolds", "1 points", "at least 2"]);
    let message = sphere_cylinder_error(|c| c.sphere.reynolds[0] = 1.0);
    assert_says(&message, &["sphere.reynolds[0] is 1", "at least 10"]);
    let message = sphere_cylinder_error(|c| c.cylinder.reference_reynolds = 1e8);
    assert_says(&message, &["cylinder.reference_reynolds is 100000000", "inside the table"]);
    let message = sphere_cylinder_error(|c| c.sphere.drag_below_reynolds_10 = 0.0);
    assert_says(&message, &["sphere.drag_below_reynolds_10 is 0"]);
}

/// The coefficient sets differ where they should: correcting the head changes the head alone.
#[test]
fn corrected_differs_from_published_in_the_head_alone() {
    let axis_i = Unit::new_normalize(Vector3::new(0.1, 0.2, 1.0)).into_inner();
    let wind_i = Vector3::new(0.0, 0.0, -10.0);
    let build = |stem| model_of(&config(stem), &links()).unwrap();
    let published = forces(&build("axisymmetric_published"), axis_i, wind_i);
    let corrected = forces(&build("axisymmetric_corrected"), axis_i, wind_i);
    assert!(published[0].dot(&wind_i) < 0.0, "the printed head drag is negative near axial wind");
    assert!(corrected[0].dot(&wind_i) > 0.0);
    assert_eq!(published[1..], corrected[1..]);
}
