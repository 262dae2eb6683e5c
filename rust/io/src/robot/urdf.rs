//! Parser for those tags and attributes of a URDF that concern bodies and joints.

use flight_core::error::{BuildError, check as check_number};
use flight_core::robot::{JointKind, check};
use flight_core::spatial::{Pose, rotation_from_rpy};
use nalgebra::{Matrix3, Unit, Vector3};
use roxmltree::{Document, Node};

/// Greatest depth of nested tags, as in the JAX twin.
const MAX_DEPTH: usize = 64;

/// Links and joints of a URDF, in the order of the file.
pub(super) struct Urdf {
    pub(super) links: Vec<Link>,
    pub(super) joints: Vec<Joint>,
}

/// A link, which is a frame and may have a mass.
pub(super) struct Link {
    pub(super) name: String,
    pub(super) inertial: Option<Inertial>,
}

/// Mass of a link, its centre of mass, and the inertia about it.
pub(super) struct Inertial {
    pub(super) origin: Origin,
    /// \[kg\]
    pub(super) mass: f64,
    /// In the axes of `origin` \[kg m²\].
    pub(super) inertia: Matrix3<f64>,
}

/// A pose in the URDF's form: position \[m\], and angles about fixed x, y and z \[rad\].
#[derive(Clone, Copy, Default)]
pub(super) struct Origin {
    xyz: [f64; 3],
    rpy: [f64; 3],
}

/// A joint; missing numbers have the URDF's defaults.
pub(super) struct Joint {
    pub(super) name: String,
    pub(super) origin: Origin,
    pub(super) parent: String,
    pub(super) child: String,
    /// The joint that this one mimics, if any.
    pub(super) mimic: Option<String>,
    /// Greatest effort \[N m, N\] and velocity \[rad/s, m/s\].
    pub(super) effort: f64,
    pub(super) velocity: f64,
    kind: String,
    axis: [f64; 3],
    lower: f64,
    upper: f64,
}

impl Urdf {
    /// Reads a URDF; the error states what is missing or invalid.
    pub(super) fn read(text: &str) -> Result<Self, String> {
        let document = Document::parse(text).map_err(|error| error.to_string())?;
        // The count includes the tag itself and the document.
        if document.descendants().any(|node| node.is_element() && node.ancestors().count() > MAX_DEPTH + 1) {
            return Err(format!("tags nest more than {MAX_DEPTH} deep"));
        }
        let robot = document.root_element();
        if !robot.has_tag_name("robot") {
            return Err(format!("the outermost tag is <{}>; expected <robot>", robot.tag_name().name()));
        }
        let tags = |tag| robot.children().filter(move |node: &Node<'_, '_>| node.has_tag_name(tag));
        Ok(Self {
            links: tags("link").map(link).collect::<Result<_, _>>()?,
            joints: tags("joint").map(joint).collect::<Result<_, _>>()?,
        })
    }
}

fn link(node: Node<'_, '_>) -> Result<Link, String> {
    let inertial = |node| {
        let inertia = require_child(node, "inertia")?;
        let of = |key| number(inertia, key, None);
        let (xy, xz, yz) = (of("ixy")?, of("ixz")?, of("iyz")?);
        Ok::<_, String>(Inertial {
            origin: origin(node)?,
            mass: number(require_child(node, "mass")?, "value", None)?,
            inertia: Matrix3::new(of("ixx")?, xy, xz, xy, of("iyy")?, yz, xz, yz, of("izz")?),
        })
    };
    Ok(Link {
        name: attribute(node, "name")?.to_owned(),
        inertial: child(node, "inertial")?.map(inertial).transpose()?,
    })
}

fn joint(node: Node<'_, '_>) -> Result<Joint, String> {
    let linked = |tag| require_child(node, tag).and_then(|end| attribute(end, "link")).map(str::to_owned);
    let limit = child(node, "limit")?;
    let limit = |key| limit.map_or(Ok(0.0), |limit| number(limit, key, Some(0.0)));
    let mimic = child(node, "mimic")?.map(|mimic| attribute(mimic, "joint").map(str::to_owned));
    Ok(Joint {
        name: attribute(node, "name")?.to_owned(),
        origin: origin(node)?,
        parent: linked("parent")?,
        child: linked("child")?,
        mimic: mimic.transpose()?,
        effort: limit("effort")?,
        velocity: limit("velocity")?,
        kind: attribute(node, "type")?.to_owned(),
        axis: child(node, "axis")?.map_or(Ok([1.0, 0.0, 0.0]), |axis| numbers(axis, "xyz", None))?,
        lower: limit("lower")?,
        upper: limit("upper")?,
    })
}

fn origin(node: Node<'_, '_>) -> Result<Origin, String> {
    child(node, "origin")?.map_or(Ok(Origin::default()), |origin| {
        let at = |key| numbers(origin, key, Some([0.0; 3]));
        Ok(Origin { xyz: at("xyz")?, rpy: at("rpy")? })
    })
}

/// The tag of this name within another, where there is one.
fn child<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Result<Option<Node<'a, 'i>>, String> {
    let mut found = node.children().filter(|child| child.has_tag_name(tag));
    match (found.next(), found.next()) {
        (_, Some(_)) => Err(format!("{} has more than one <{tag}>", describe(node))),
        (found, None) => Ok(found),
    }
}

fn require_child<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Result<Node<'a, 'i>, String> {
    child(node, tag)?.ok_or_else(|| format!("{} has no <{tag}>", describe(node)))
}

fn attribute<'a>(node: Node<'a, '_>, key: &str) -> Result<&'a str, String> {
    node.attribute(key).ok_or_else(|| format!("{} has no `{key}`", describe(node)))
}

/// A tag, with the name of its link or joint.
fn describe(node: Node<'_, '_>) -> String {
    let tag = node.tag_name().name();
    match node.ancestors().find_map(|node| node.attribute("name").map(|name| (node.tag_name().name(), name)))
    {
        Some((owner, name)) if owner == tag => format!("{owner} `{name}`"),
        Some((owner, name)) => format!("the <{tag}> of {owner} `{name}`"),
        None => format!("a <{tag}>"),
    }
}

/// The `N` numbers of an attribute, or `default` if it is missing.
fn numbers<const N: usize>(
    node: Node<'_, '_>,
    key: &str,
    default: Option<[f64; N]>,
) -> Result<[f64; N], String> {
    let text = match (node.attribute(key), default) {
        (None, Some(default)) => return Ok(default),
        _ => attribute(node, key)?,
    };
    let found: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    found.and_then(|found| found.try_into().ok()).ok_or_else(|| {
        let expected = if N == 1 { "a number".to_owned() } else { format!("{N} numbers") };
        format!("`{key}` of {} is `{text}`; expected {expected}", describe(node))
    })
}

fn number(node: Node<'_, '_>, key: &str, default: Option<f64>) -> Result<f64, String> {
    numbers(node, key, default.map(|number| [number])).map(|[number]| number)
}

impl Origin {
    /// Converts to a pose; `item` names its owner in errors.
    pub(super) fn pose(&self, item: &str) -> Result<Pose, BuildError> {
        let position = check::finite(&format!("origin xyz of {item}"), &self.xyz)?;
        let rpy = check::finite(&format!("origin rpy of {item}"), &self.rpy)?;
        Ok(Pose { rotation: rotation_from_rpy(&rpy), position })
    }
}

impl Joint {
    pub(super) fn axis(&self) -> Result<Unit<Vector3<f64>>, BuildError> {
        check::unit(&format!("axis of joint `{}`", self.name), &self.axis)
    }

    /// Type of the joint; `None` for a fixed one.
    pub(super) fn kind(&self) -> Result<Option<JointKind>, BuildError> {
        match self.kind.as_str() {
            "fixed" => Ok(None),
            "revolute" | "continuous" => Ok(Some(JointKind::Revolute)),
            "prismatic" => Ok(Some(JointKind::Prismatic)),
            other => {
                let expected = "revolute, continuous, prismatic or fixed";
                Err(BuildError::bad_value(format!("type of joint `{}`", self.name), other, expected))
            }
        }
    }

    /// Limit of effort or velocity; `None` if it is zero or missing in the URDF.
    pub(super) fn greatest(&self, key: &str, value: f64) -> Result<Option<f64>, BuildError> {
        let item = format!("URDF {key} limit of joint `{}`", self.name);
        check_number(&item, value, |x| x >= 0.0, "a number ≥ 0").map(|x| (x > 0.0).then_some(x))
    }

    /// Refuses a position \[rad, m\] beyond the limits of a joint that has some.
    pub(super) fn check_position(&self, position: f64) -> Result<(), BuildError> {
        let (lower, upper) = (self.lower, self.upper);
        let has_limits = self.kind != "continuous" && lower < upper;
        let item = format!("position of locked joint `{}`", self.name);
        let expected = format!("a number from {lower} to {upper}, the limits of the URDF");
        check_number(&item, position, |x| !has_limits || (lower <= x && x <= upper), &expected).map(|_| ())
    }

    /// The limits of the joint \[rad, m\]; a continuous one has none.
    pub(super) fn limits(&self) -> Result<Option<(f64, f64)>, BuildError> {
        if self.kind == "continuous" {
            return Ok(None);
        }
        check::interval(&format!("URDF limit of joint `{}`", self.name), self.lower, self.upper).map(Some)
    }
}
