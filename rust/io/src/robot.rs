//! Loads a [`RobotModel`] from a robot's files: names become indices, degrees become radians, and unknown keys are
//! refused. Every value is checked once: its range by the schema of the file, its relation to other values here.
//!
//! The URDF describes the mechanism; the TOML file beside it adds the order of the joints, the points where
//! aerodynamic forces and thrusts act, and the geometry of the feet. `urdf` reads links and joints, `tree` finds the
//! moving bodies, `merge` merges links without relative motion, `shapes` reads the geometry of links.

mod joints;
mod merge;
mod shapes;
mod tree;
mod urdf;

use crate::files::absolute_path;
use crate::toml::{from_value, parse, resolve};
use crate::{read_bytes, read_text};
use flight_core::error::{BuildError, check as check_number, place_of};
use flight_core::jets::{EngineCoefficients, SecondOrder};
use flight_core::robot::{AeroLink, AxisymmetricCoefficients, Foot, Jet, JointGroup, RobotModel, check};
use flight_core::schema::Schema;
use flight_core::spatial::{Pose, unit_vector};
use joints::JointEntry;
use nalgebra::{Unit, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tree::Tree;

pub use shapes::Shape;
use urdf::Urdf;
pub use urdf::{Inertial, Joint, Link, Motion};

/// A robot's TOML file.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotFile {
    /// Name of the robot.
    name: String,
    /// URDF file, relative to this one.
    #[schemars(extend("format" = "path"))]
    urdf: String,
    /// Link of the URDF that is the floating base.
    base_link: String,
    /// Forward direction in base axes, a unit vector orthogonal to z.
    #[serde(default = "default_forward_axis")]
    forward_axis: [f64; 3],
    /// Gravity \[m/s²\].
    #[serde(default = "default_gravity")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    gravity: f64,
    /// Joints that move, in groups; every joint vector has their order.
    #[serde(default)]
    joint_groups: Vec<GroupEntry>,
    /// Joints that are fixed at a position \[rad, m\].
    #[serde(default)]
    locked: BTreeMap<String, f64>,
    /// Links on which aerodynamic force acts.
    #[serde(default)]
    aero_links: Vec<AeroEntry>,
    /// Coefficients by set, then by link family.
    #[serde(default)]
    coefficients: BTreeMap<String, BTreeMap<String, AxisymmetricCoefficients>>,
    /// Jet engines on the robot.
    #[serde(default)]
    jets: Vec<JetEntry>,
    /// Second-order engines, by name.
    #[serde(default)]
    engines: BTreeMap<String, EngineCoefficients>,
    /// Feet that can touch the ground.
    #[serde(default)]
    feet: Vec<FootEntry>,
}

/// Forward is base x, the convention of robotics (REP 103).
fn default_forward_axis() -> [f64; 3] {
    [1.0, 0.0, 0.0]
}

/// Default of gravity \[m/s²\].
fn default_gravity() -> f64 {
    9.81
}

/// Joints that share a posture gain and a figure.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct GroupEntry {
    /// Name of the group in posture gains and figures.
    name: String,
    /// Its joints.
    joints: Vec<JointEntry>,
}

/// A link on which aerodynamic force acts.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct AeroEntry {
    /// Name of the link in tables and figures.
    name: String,
    /// Link of the URDF.
    frame: String,
    /// Name of its coefficients in every coefficient set.
    family: String,
    /// Axis of symmetry in link axes, a unit vector.
    axis: [f64; 3],
    /// Point where the force acts, in link axes \[m\].
    centre: [f64; 3],
    /// Diameter \[m\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    diameter: f64,
    /// Length along the axis \[m\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    length: f64,
    /// Whether the sphere and cylinder model treats the link as a sphere.
    #[serde(default)]
    is_sphere: bool,
}

/// A thruster, jet or rotor: a force along a fixed axis of a frame, and a moment about it.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct JetEntry {
    /// Name of the jet.
    name: String,
    /// Link of the URDF.
    frame: String,
    /// Point of that link at which the thrust acts \[m\].
    #[serde(default)]
    position: [f64; 3],
    /// Direction of the force on the robot in frame axes, a unit vector.
    axis: [f64; 3],
    /// Moment on the robot about the axis per thrust \[m\]: the reaction torque of a rotor, negative if the rotor turns
    /// anticlockwise as seen from where the thrust points.
    #[serde(default)]
    torque_to_thrust: f64,
    /// Least thrust of its engine while it runs \[N\].
    #[schemars(range(min = 0))]
    #[serde(default)]
    thrust_min: f64,
    /// Greatest thrust \[N\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    thrust_max: f64,
    /// Name of its engine.
    engine: String,
}

/// A foot: a sole and the corners that can touch the ground.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct FootEntry {
    /// Name of the foot.
    name: String,
    /// Link of the URDF that is the sole.
    frame: String,
    /// Corners that can touch the ground, in sole axes \[m\].
    vertices: Vec<[f64; 3]>,
}

/// Texts of a robot's files as read; a manifest has their hashes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RobotFiles {
    /// The TOML file.
    pub toml: String,
    /// The URDF file it names.
    pub urdf: String,
    /// The TOML file's path; named in errors.
    pub origin: String,
}

/// A robot, with what only its files contain.
#[derive(Debug)]
pub struct LoadedRobot {
    /// The robot.
    pub model: RobotModel,
    /// Index of the body that carries each link of the URDF, and the link's pose in it.
    pub links: BTreeMap<String, (usize, Pose)>,
    /// Positions of the joints that do not move though they could: locked ones, and mimics of such \[rad, m\].
    pub held: BTreeMap<String, f64>,
    /// What is doubtful in the URDF, but has one meaning.
    pub warnings: Vec<String>,
}

impl RobotFiles {
    /// Reads a robot's TOML file, with its base files, and the URDF file it names (a path relative to the TOML file).
    ///
    /// # Errors
    /// [`BuildError`] for a file that cannot be read or parsed.
    pub fn read(path: &Path) -> Result<Self, BuildError> {
        let origin = path.display().to_string();
        let toml = with_base(read_text(path)?, path, &origin)?;
        let urdf = read_urdf_text(&path.with_file_name(parse_toml(&toml, &origin)?.urdf))?;
        Ok(Self { toml, urdf, origin })
    }

    /// Builds the robot that they describe.
    ///
    /// # Errors
    /// [`BuildError`] naming the item and its value, for a file that cannot be parsed and for a robot that is
    /// physically impossible.
    pub fn load(&self) -> Result<LoadedRobot, BuildError> {
        let file = parse_toml(&self.toml, &self.origin)?;
        let origin = self.urdf_path(&file);
        let of_both = |error: BuildError| error.in_context(&self.origin);
        let urdf = Urdf::read(&self.urdf).map_err(|error| of_both(BuildError::malformed(&origin, error)))?;
        let order: Vec<&str> = file
            .joint_groups
            .iter()
            .flat_map(|group| &group.joints)
            .map(|joint| joint.name.as_str())
            .collect();
        let tree = tree::build(&urdf, &file.base_link, &order, &file.locked)
            .map_err(|error| of_both(error.in_file(&origin)))?;
        let warnings = tree.warnings.iter().map(|warning| format!("{origin}: {warning}")).collect();
        let (links, held) = (tree.places.clone(), tree.held.clone());
        let model = model(file, tree).map_err(|error| error.in_file(&self.origin))?;
        Ok(LoadedRobot { model, links, held, warnings })
    }

    /// Geometry of the URDF's links.
    ///
    /// # Errors
    /// [`BuildError`] naming the link.
    pub fn shapes(&self) -> Result<Vec<Shape>, BuildError> {
        let file = parse_toml(&self.toml, &self.origin)?;
        shapes::shapes(&self.urdf).map_err(|error| BuildError::malformed(self.urdf_path(&file), error))
    }

    /// The URDF's path; named in errors.
    fn urdf_path(&self, file: &RobotFile) -> String {
        let path = Path::new(&self.origin).with_file_name(&file.urdf);
        absolute_path(&path).unwrap_or(path).display().to_string()
    }
}

/// Loads a robot from its TOML file and the URDF file that it names.
///
/// # Errors
/// As [`RobotFiles::read`] and [`RobotFiles::load`].
pub fn load_robot(path: &Path) -> Result<RobotModel, BuildError> {
    RobotFiles::read(path)?.load().map(|loaded| loaded.model)
}

/// The text of a robot's file; of one with a base file, that of the merged table with whole paths.
fn with_base(text: String, path: &Path, origin: &str) -> Result<String, BuildError> {
    if !parse(&text, origin)?.contains_key("base") {
        return Ok(text);
    }
    let merged = resolve(path, &Schema::of_type::<RobotFile>())?;
    ::toml::to_string(&merged).map_err(|error| BuildError::malformed(origin, error))
}

fn parse_toml(text: &str, origin: &str) -> Result<RobotFile, BuildError> {
    from_value(parse(text, origin)?.into(), origin)
}

/// Builds a robot from the texts of its TOML and URDF file; `origin` is named in errors.
///
/// # Errors
/// As [`RobotFiles::load`].
pub fn robot_from_text(toml: &str, urdf: &str, origin: &str) -> Result<RobotModel, BuildError> {
    let files = RobotFiles { toml: toml.to_owned(), urdf: urdf.to_owned(), origin: origin.to_owned() };
    files.load().map(|loaded| loaded.model)
}

/// Reads the links, joints and shapes of a URDF alone, of which a robot's TOML file can be made.
///
/// # Errors
/// [`BuildError`] naming the file, for one that cannot be read or parsed.
pub fn read_urdf(path: &Path) -> Result<(Urdf, Vec<Shape>), BuildError> {
    let text = read_urdf_text(path)?;
    let read = Urdf::read(&text).and_then(|urdf| Ok((urdf, shapes::shapes(&text)?)));
    read.map_err(|error| BuildError::malformed(path.display().to_string(), error))
}

fn read_urdf_text(path: &Path) -> Result<String, BuildError> {
    urdf::decode(&read_bytes(path)?).map_err(|error| BuildError::malformed(path.display().to_string(), error))
}

fn model(file: RobotFile, tree: Tree<'_>) -> Result<RobotModel, BuildError> {
    check_coefficients(&file)?;
    let engine = |(name, k): (&String, &EngineCoefficients)| Ok((name.clone(), SecondOrder::new(name, *k)?));
    let engines = file.engines.iter().map(engine).collect::<Result<BTreeMap<_, _>, BuildError>>()?;
    Ok(RobotModel {
        forward_axis_b: forward_axis(file.forward_axis)?,
        gravity: file.gravity,
        joints: joints::joints(file.joint_groups.iter().flat_map(|group| &group.joints), &tree)?,
        groups: groups(&file)?,
        aero_links: aero_links(&file, &tree)?,
        jets: jets(&file, &tree, &engines)?,
        soles: feet(&file, &tree)?,
        feet: feet(&file, &tree)?,
        bodies: tree.bodies,
        name: file.name,
        engines,
    })
}

fn forward_axis(axis: [f64; 3]) -> Result<Unit<Vector3<f64>>, BuildError> {
    let expected = "a unit vector orthogonal to base z";
    unit_vector(Vector3::from(axis))
        .filter(|axis| axis.z.abs() < 1e-6)
        .ok_or_else(|| BuildError::bad_value("forward_axis", format!("{axis:?}"), expected))
}

fn groups(file: &RobotFile) -> Result<Vec<JointGroup>, BuildError> {
    check::unique("joint group", file.joint_groups.iter().map(|group| group.name.as_str()))?;
    let mut next = 0;
    let groups = file.joint_groups.iter().map(|group| {
        let first = next;
        next += group.joints.len();
        JointGroup { name: group.name.clone(), joints: (first..next).collect() }
    });
    Ok(groups.collect())
}

fn aero_links(file: &RobotFile, tree: &Tree<'_>) -> Result<Vec<AeroLink>, BuildError> {
    check::unique("aerodynamic link", file.aero_links.iter().map(|link| link.name.as_str()))?;
    let link = |entry: &AeroEntry| {
        let of = |what: &str| format!("{what} of aerodynamic link `{}`", entry.name);
        let coefficients = file.coefficients.iter().map(|(set, families)| {
            let found = families.get(&entry.family).copied().ok_or_else(|| {
                let item = format!("{}, in coefficient set `{set}`,", of("family"));
                BuildError::unknown_name(item, &entry.family, families.keys())
            });
            found.map(|coefficients| (set.clone(), coefficients))
        });
        Ok(AeroLink {
            name: entry.name.clone(),
            frame: tree.frame(&of("frame"), &entry.frame)?,
            axis_l: check::unit(&of("axis"), &entry.axis)?,
            centre_l: Vector3::from(entry.centre),
            diameter: entry.diameter,
            length: entry.length,
            is_sphere: entry.is_sphere,
            coefficients: coefficients.collect::<Result<_, _>>()?,
        })
    };
    file.aero_links.iter().map(link).collect()
}

fn check_coefficients(file: &RobotFile) -> Result<(), BuildError> {
    for (set, families) in &file.coefficients {
        for family in families.keys() {
            let known = file.aero_links.iter().map(|link| &link.family);
            place_of(format!("coefficient set `{set}`"), family, known)?;
        }
    }
    Ok(())
}

fn jets(
    file: &RobotFile,
    tree: &Tree<'_>,
    engines: &BTreeMap<String, SecondOrder>,
) -> Result<Vec<Jet>, BuildError> {
    check::unique("jet", file.jets.iter().map(|jet| jet.name.as_str()))?;
    let jet = |entry: &JetEntry| {
        let of = |what: &str| format!("{what} of jet `{}`", entry.name);
        let unknown = || BuildError::unknown_name(of("engine"), &entry.engine, engines.keys());
        let engine = *engines.get(&entry.engine).ok_or_else(unknown)?;
        let greatest = entry.thrust_max;
        let expected = format!("newtons from 0 to less than {greatest}, its greatest");
        check_number(
            &of("thrust_min"),
            entry.thrust_min,
            |thrust| (0.0..greatest).contains(&thrust),
            &expected,
        )?;
        let mut frame = tree.frame(&of("frame"), &entry.frame)?;
        frame.body_from_frame.position =
            frame.body_from_frame.transform_point(&Vector3::from(entry.position));
        Ok(Jet {
            name: entry.name.clone(),
            frame,
            axis_f: check::unit(&of("axis"), &entry.axis)?,
            torque_to_thrust: entry.torque_to_thrust,
            thrust_min: entry.thrust_min,
            thrust_max: entry.thrust_max,
            engine: engine.into(),
            engine_name: entry.engine.clone(),
        })
    };
    file.jets.iter().map(jet).collect()
}

fn feet(file: &RobotFile, tree: &Tree<'_>) -> Result<Vec<Foot>, BuildError> {
    check::unique("foot", file.feet.iter().map(|foot| foot.name.as_str()))?;
    let foot = |entry: &FootEntry| {
        let of = |what: &str| format!("{what} of foot `{}`", entry.name);
        if entry.vertices.is_empty() {
            return Err(BuildError::bad_value(of("vertices"), "[]", "at least one point"));
        }
        Ok(Foot {
            name: entry.name.clone(),
            frame: tree.frame(&of("frame"), &entry.frame)?,
            vertices_f: entry.vertices.iter().copied().map(Vector3::from).collect(),
        })
    };
    file.feet.iter().map(foot).collect()
}
