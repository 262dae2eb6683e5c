//! Reads those tags and attributes of a URDF that concern bodies and joints.
//!
//! A tag counts where the URDF has a place for it: a link or joint as a direct child of `<robot>`, in the namespace of
//! that tag. What plugins, transmissions and simulators nest below it is theirs.

use flight_core::robot::JointKind;
use flight_core::spatial::{Pose, rotation_from_rpy};
use nalgebra::{Matrix3, Unit, Vector3};
use roxmltree::{Document, Error, Node};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Greatest depth of nested tags.
const MAX_DEPTH: usize = 64;

/// Greatest number of attributes of a tag; the parser compares each with all others.
const MAX_ATTRIBUTES: usize = 256;

/// Name and usual prefix of the namespace of macros.
const XACRO: &str = "xacro";

/// Largest number that is accepted, so that products of three are finite.
const GREATEST: f64 = 1e100;

/// Deviation of an axis from length 1, and of a limit from a whole turn, that is rounding.
const ROUNDING: f64 = 1e-3;

/// Links and joints of a URDF, in the order of the file.
#[derive(Debug)]
pub struct Urdf {
    /// Name of the robot.
    pub name: Option<String>,
    /// Its links.
    pub links: Vec<Link>,
    /// Its joints.
    pub joints: Vec<Joint>,
    /// What is doubtful, but has one meaning, and what changes a flight but is not used.
    pub warnings: Vec<String>,
    /// How often each tag is there that is not used; what it contains is not counted.
    pub unused: BTreeMap<String, usize>,
}

/// A link, which is a frame and may have a mass.
#[derive(Debug)]
pub struct Link {
    /// Name of the link.
    pub name: String,
    /// Its mass, if it has one.
    pub inertial: Option<Inertial>,
}

/// Mass of a link, its centre of mass, and the inertia about it.
#[derive(Debug)]
pub struct Inertial {
    /// Centre of mass and axes of the inertia, in link axes.
    pub origin: Pose,
    /// \[kg\]
    pub mass: f64,
    /// In the axes of `origin` \[kg m²\].
    pub inertia: Matrix3<f64>,
}

/// A joint.
#[derive(Debug)]
pub struct Joint {
    /// Name of the joint.
    pub name: String,
    /// Link that carries it.
    pub parent: String,
    /// Link that it carries.
    pub child: String,
    /// Pose of the child in the parent at position zero.
    pub origin: Pose,
    /// How the joint moves; `None` for a fixed one, whose axis and limits mean nothing.
    pub motion: Option<Motion>,
}

/// Motion of a joint; units are those of a revolute one, m and N replace rad and N m for a prismatic one.
#[derive(Debug)]
pub struct Motion {
    /// Revolute, also for a continuous joint, or prismatic.
    pub kind: JointKind,
    /// Axis in child axes.
    pub axis: Unit<Vector3<f64>>,
    /// Range of positions \[rad\]; `None` for a continuous joint, and where the URDF states none.
    pub limits: Option<(f64, f64)>,
    /// Greatest torque \[N m\]; 0 if the URDF states none.
    pub effort: f64,
    /// Greatest velocity \[rad/s\]; 0 if the URDF states none.
    pub velocity: f64,
    /// Joint that this one follows.
    pub mimic: Option<Mimic>,
}

/// Position of a joint that follows another: `multiplier * position + offset`.
#[derive(Debug)]
pub struct Mimic {
    /// Joint that is followed.
    pub joint: String,
    /// \[rad/rad\]
    pub multiplier: f64,
    /// \[rad\]
    pub offset: f64,
}

/// Decodes the bytes of an XML file: UTF-8, UTF-16 with a byte-order mark, or what its first line declares, where that
/// is ISO-8859-1 or makes no difference.
pub(super) fn decode(bytes: &[u8]) -> Result<String, String> {
    let declared = declared_encoding(bytes).to_ascii_lowercase();
    let text = match bytes {
        [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] => crate::decode(bytes).ok().map(Cow::into_owned),
        [0xEF, 0xBB, 0xBF, rest @ ..] => String::from_utf8(rest.to_vec()).ok(),
        _ if ["iso-8859-1", "latin1", "latin-1"].contains(&declared.as_str()) => {
            Some(bytes.iter().copied().map(char::from).collect())
        }
        _ if ["", "utf-8", "utf8"].contains(&declared.as_str()) || bytes.is_ascii() => {
            String::from_utf8(bytes.to_vec()).ok()
        }
        _ => None,
    };
    text.filter(|text| !text.contains('\0')).ok_or_else(|| {
        let found =
            if declared.is_empty() { "no UTF-8".to_owned() } else { format!("not read as `{declared}`") };
        format!("the text is {found}; expected UTF-8, to which `iconv -f ENCODING -t UTF-8` converts it")
    })
}

/// Encoding that the first line of an XML file declares; empty if it declares none.
fn declared_encoding(bytes: &[u8]) -> String {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(256)]);
    let declaration = head.strip_prefix("<?xml").and_then(|head| head.split("?>").next()).unwrap_or_default();
    let value = declaration.split_once("encoding").and_then(|(_, rest)| rest.split(['"', '\'']).nth(1));
    value.unwrap_or_default().to_owned()
}

/// Parses the text of a URDF.
pub(super) fn parse(text: &str) -> Result<Document<'_>, String> {
    // An attribute has two quotation marks and holds no `<`.
    if text.split('<').any(|tag| tag.matches(['"', '\'']).count() > 2 * MAX_ATTRIBUTES) {
        return Err(format!("a tag has more than {MAX_ATTRIBUTES} attributes"));
    }
    let document = Document::parse(text).map_err(|error| match error {
        Error::UnknownNamespace(prefix, place) if prefix == XACRO => unexpanded("<xacro:…>", place.row),
        error => format!("the URDF is no XML: {error}"),
    })?;
    // The count includes the tag itself and the document.
    if document.descendants().any(|node| node.is_element() && node.ancestors().count() > MAX_DEPTH + 1) {
        return Err(format!("tags nest more than {MAX_DEPTH} deep"));
    }
    check_expanded(&document)?;
    match document.root_element().tag_name().name() {
        "robot" => Ok(document),
        other => Err(format!("the outermost tag is <{other}>; expected <robot>")),
    }
}

/// Refuses macros, which would be links, joints and numbers of another program.
fn check_expanded(document: &Document<'_>) -> Result<(), String> {
    let elements = || document.descendants().filter(Node::is_element);
    let found = elements().find_map(|node| {
        let namespace = node.tag_name().namespace()?;
        let is_macro = namespace.contains(XACRO) || node.lookup_prefix(namespace) == Some(XACRO);
        is_macro.then(|| (node, format!("<{XACRO}:{}>", node.tag_name().name())))
    });
    // Plugins may have a use for such values.
    let is_ours = |node: &Node<'_, '_>| {
        node.ancestors().any(|node| node.has_tag_name("link") || node.has_tag_name("joint"))
    };
    let found = found.or_else(|| {
        elements().filter(is_ours).find_map(|node| {
            let mut values = node.attributes().map(|attribute| attribute.value());
            let value = values.find(|value| value.contains("${") || value.contains("$("))?;
            Some((node, format!("`{value}`")))
        })
    });
    found.map_or(Ok(()), |(node, what)| Err(unexpanded(&what, document.text_pos_at(node.range().start).row)))
}

fn unexpanded(what: &str, line: u32) -> String {
    format!("line {line} has {what}; expand it with xacro first: `xacro FILE > robot.urdf`")
}

impl Urdf {
    /// Reads a URDF; the error states what is missing or invalid.
    pub(super) fn read(text: &str) -> Result<Self, String> {
        let document = parse(text)?;
        let robot = document.root_element();
        let (mut warnings, mut unused) = (Vec::new(), BTreeMap::new());
        check_unused(robot, &mut unused)?;
        let joints =
            children(robot, "joint").map(|node| joint(node, &mut warnings)).collect::<Result<_, _>>()?;
        warnings.extend(unused_motion(robot)?);
        Ok(Self {
            name: robot.attribute("name").map(str::to_owned),
            links: children(robot, "link").map(link).collect::<Result<_, _>>()?,
            joints,
            warnings,
            unused,
        })
    }
}

/// Names the joints that move with friction, damping or a range other than a flight's.
fn unused_motion(robot: Node<'_, '_>) -> Result<Vec<String>, String> {
    let (mut rubbing, mut guarded) = (Vec::new(), Vec::new());
    let (mut friction, mut damping) = (0.0_f64, 0.0_f64);
    for joint in children(robot, "joint").filter(|joint| joint.attribute("type") != Some("fixed")) {
        let name = format!("`{}`", attribute(joint, "name")?);
        if let Some(dynamics) = child(joint, "dynamics")? {
            let of = |key| number(dynamics, key, Some(0.0));
            if (of("friction")?, of("damping")?) != (0.0, 0.0) {
                (friction, damping) = (friction.max(of("friction")?), damping.max(of("damping")?));
                rubbing.push(name.clone());
            }
        }
        if child(joint, "safety_controller")?.is_some() {
            guarded.push(name);
        }
    }
    let mut warnings = Vec::new();
    if !rubbing.is_empty() {
        warnings.push(format!(
            "<dynamics> of joint {} is not used: friction up to {friction}, damping up to {damping}; a flight has both in \
             simulator.motors",
            rubbing.join(", ")
        ));
    }
    if !guarded.is_empty() {
        warnings.push(format!(
            "<safety_controller> of joint {} is not used; limits_deg or limits of the robot's TOML file narrow a range",
            guarded.join(", ")
        ));
    }
    Ok(warnings)
}

/// Attributes of a tag: those that are read, and harmless ones; `None` for tags whose attributes name and draw.
fn attributes(tag: &str) -> Option<(&'static str, &'static str)> {
    // Values of a drive beside its limits are not used in a flight.
    let of_drives = "acceleration deceleration jerk command_effort current gear_velocity k_velocity";
    Some(match tag {
        "link" => ("name", "type concave"),
        "joint" => ("name type", "dont_collapse"),
        "inertial" => ("", ""),
        "origin" => ("xyz rpy", ""),
        "mass" => ("value", ""),
        "inertia" => ("ixx ixy ixz iyy iyz izz", "iyx izx izy"),
        "parent" | "child" => ("link", ""),
        "axis" => ("xyz", ""),
        "limit" => ("lower upper effort velocity", of_drives),
        "mimic" => ("joint multiplier offset", ""),
        "sphere" => ("radius", ""),
        "cylinder" | "capsule" => ("radius length", ""),
        "box" => ("size", ""),
        "mesh" => ("filename scale", "convex"),
        _ => return None,
    })
}

/// Tags that make another robot where they are not read: out of their place, or closing a chain of joints.
const MECHANISM: &str = "inertial origin mass inertia parent child axis limit mimic pose loop_joint";

/// Refuses attributes and tags within this one that are not read and change the robot; counts the other unused tags.
fn check_unused(node: Node<'_, '_>, unused: &mut BTreeMap<String, usize>) -> Result<(), String> {
    let tag = node.tag_name().name();
    let is_fixed = node.attribute("type") == Some("fixed");
    let is_drawn = children(node, "visual").any(|visual| children(visual, "geometry").next().is_some());
    let used: &[&str] = match tag {
        "robot" => &["link", "joint"],
        "link" if is_drawn => &["inertial", "visual"],
        "link" => &["inertial", "visual", "collision"],
        "inertial" => &["origin", "mass", "inertia"],
        "visual" | "collision" => &["origin", "geometry"],
        "geometry" => &["sphere", "cylinder", "capsule", "box", "mesh"],
        "joint" if is_fixed => &["origin", "parent", "child"],
        "joint" => &["origin", "parent", "child", "axis", "limit", "mimic"],
        _ => &[],
    };
    let has = |words: &str, name: &str| words.split(' ').any(|word| word == name);
    if let Some((read, harmless)) = attributes(tag) {
        let is_known = |name| has(read, name) || has(harmless, name);
        let mut others =
            node.attributes().filter(|other| other.namespace().is_none() && !is_known(other.name()));
        if let Some(other) = others.find(|other| !is_nothing(other.name(), other.value())) {
            let (name, value, place) = (other.name(), other.value(), describe(node));
            return Err(format!("`{name}` of {place} is `{value}`, and not read; expected only: {read}"));
        }
    }
    for inner in node.children().filter(Node::is_element) {
        let (name, is_ours) =
            (inner.tag_name().name(), inner.tag_name().namespace() == node.tag_name().namespace());
        let says_nothing = inner.first_element_child().is_none()
            && inner.text().is_none_or(|text| is_nothing("", text))
            && inner.attributes().all(|attribute| is_nothing(attribute.name(), attribute.value()));
        if is_ours && used.contains(&name) {
            check_unused(inner, unused)?;
        } else if is_ours && has(MECHANISM, name) && !is_fixed && !says_nothing {
            let place = describe(inner);
            return Err(format!("{place} is not read in <{tag}>; expected only: {}", used.join(" ")));
        } else {
            *unused.entry(name.to_owned()).or_default() += 1;
        }
    }
    Ok(())
}

/// Whether an attribute that is not read says nothing: no turn, no shift, no other size.
fn is_nothing(name: &str, value: &str) -> bool {
    let nothing = if name == "scale" { 1.0 } else { 0.0 };
    value.split_whitespace().all(|word| word.parse() == Ok(nothing))
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

fn joint(node: Node<'_, '_>, warnings: &mut Vec<String>) -> Result<Joint, String> {
    let linked = |tag| require_child(node, tag).and_then(|end| attribute(end, "link")).map(str::to_owned);
    let name = attribute(node, "name")?;
    let kind = match attribute(node, "type")? {
        "fixed" => None,
        kind @ ("revolute" | "continuous") => Some((JointKind::Revolute, kind == "revolute")),
        "prismatic" => Some((JointKind::Prismatic, true)),
        other => {
            let root = root_and_base(node).map(|(root, base)| {
                format!("; without this joint and link `{root}`, link `{base}` is the base, which floats")
            });
            return Err(format!(
                "type of joint `{name}` is {other}; expected revolute, continuous, prismatic or fixed{}",
                root.unwrap_or_default()
            ));
        }
    };
    let motion = |(kind, has_range)| {
        let limit = child(node, "limit")?;
        let has_either =
            limit.is_some_and(|limit| ["lower", "upper"].iter().any(|key| limit.has_attribute(*key)));
        let limit = |key| limit.map_or(Ok(0.0), |limit| bound(limit, key));
        // Several tools write −1 or infinity for an unknown limit.
        let greatest = |key| limit(key).map(|x| if x + 1.0 == 0.0 || x.is_infinite() { 0.0 } else { x });
        let (lower, upper) = if has_range { (limit("lower")?, limit("upper")?) } else { (0.0, 0.0) };
        let is_range = lower < upper && lower.is_finite() && upper.is_finite();
        let is_unlimited = (lower, upper) == (f64::NEG_INFINITY, f64::INFINITY);
        if has_range && has_either && !is_range && !is_unlimited {
            warnings.push(format!(
                "limits of joint `{name}` are {lower} to {upper}, and taken as none; expected a range"
            ));
        }
        if is_range && kind == JointKind::Revolute && lower.abs().max(upper.abs()) > TAU * (1.0 + ROUNDING) {
            warnings.push(format!(
                "limits of joint `{name}` are {lower} and {upper} rad; expected at most a turn, {TAU:.2} rad: a URDF has no \
                 degrees"
            ));
        }
        Ok::<_, String>(Motion {
            kind,
            axis: axis(node, warnings)?,
            limits: is_range.then_some((lower, upper)),
            effort: greatest("effort")?,
            velocity: greatest("velocity")?,
            mimic: child(node, "mimic")?.map(mimic).transpose()?,
        })
    };
    Ok(Joint {
        name: name.to_owned(),
        parent: linked("parent")?,
        child: linked("child")?,
        origin: origin(node)?,
        motion: kind.map(motion).transpose()?,
    })
}

/// Links that a joint connects, if its parent is the root.
fn root_and_base<'a>(joint: Node<'a, '_>) -> Option<(&'a str, &'a str)> {
    let end = |joint, tag| child(joint, tag).ok().flatten()?.attribute("link");
    let (root, base) = (end(joint, "parent")?, end(joint, "child")?);
    let is_carried =
        |link| children(joint.parent()?, "joint").find(|other| end(*other, "child") == Some(link));
    is_carried(root).is_none().then_some((root, base))
}

/// Direction of a joint's axis, whatever its length: a URDF states a direction, in numbers that may be rounded.
fn axis(joint: Node<'_, '_>, warnings: &mut Vec<String>) -> Result<Unit<Vector3<f64>>, String> {
    let xyz = child(joint, "axis")?.map_or(Ok([1.0, 0.0, 0.0]), |axis| numbers(axis, "xyz", None))?;
    let length = Vector3::from(xyz).norm();
    let item = format!("axis of {} is {xyz:?}", describe(joint));
    if (length - 1.0).abs() > ROUNDING {
        warnings.push(format!("{item}; its direction is taken, at length 1"));
    }
    Unit::try_new(Vector3::from(xyz), 1e-9).ok_or_else(|| format!("{item}; expected a direction"))
}

fn mimic(node: Node<'_, '_>) -> Result<Mimic, String> {
    Ok(Mimic {
        joint: attribute(node, "joint")?.to_owned(),
        multiplier: number(node, "multiplier", Some(1.0))?,
        offset: number(node, "offset", Some(0.0))?,
    })
}

/// Pose that the `<origin>` of a tag states: position \[m\], and angles about fixed x, y and z \[rad\].
pub(super) fn origin(node: Node<'_, '_>) -> Result<Pose, String> {
    child(node, "origin")?.map_or(Ok(Pose::identity()), |origin| {
        let at = |key| numbers(origin, key, Some([0.0; 3])).map(Vector3::from);
        Ok(Pose { rotation: rotation_from_rpy(&at("rpy")?), position: at("xyz")? })
    })
}

/// Tags of this name directly within another, in its namespace.
pub(super) fn children<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> impl Iterator<Item = Node<'a, 'i>> {
    let namespace = node.tag_name().namespace();
    node.children().filter(move |child| child.has_tag_name(tag) && child.tag_name().namespace() == namespace)
}

/// The tag of this name within another, where there is one.
pub(super) fn child<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Result<Option<Node<'a, 'i>>, String> {
    let mut found = children(node, tag);
    match (found.next(), found.next()) {
        (_, Some(_)) => Err(format!("{} has more than one <{tag}>", describe(node))),
        (found, None) => Ok(found),
    }
}

fn require_child<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Result<Node<'a, 'i>, String> {
    child(node, tag)?.ok_or_else(|| format!("{} has no <{tag}>", describe(node)))
}

pub(super) fn attribute<'a>(node: Node<'a, '_>, key: &str) -> Result<&'a str, String> {
    node.attribute(key).ok_or_else(|| format!("{} has no `{key}`", describe(node)))
}

/// A tag, with the name of its link or joint.
pub(super) fn describe(node: Node<'_, '_>) -> String {
    let tag = node.tag_name().name();
    match node.ancestors().find_map(|node| node.attribute("name").map(|name| (node.tag_name().name(), name)))
    {
        Some((owner, name)) if owner == tag => format!("{owner} `{name}`"),
        Some((owner, name)) => format!("the <{tag}> of {owner} `{name}`"),
        None => format!("a <{tag}>"),
    }
}

/// The `N` numbers of an attribute, or `default` if it is missing.
pub(super) fn numbers<const N: usize>(
    node: Node<'_, '_>,
    key: &str,
    default: Option<[f64; N]>,
) -> Result<[f64; N], String> {
    let text = match (node.attribute(key), default) {
        (None, Some(default)) => return Ok(default),
        _ => attribute(node, key)?,
    };
    let number = |word: &str| word.parse().ok().filter(|number: &f64| number.abs() <= GREATEST);
    let found: Option<Vec<f64>> = text.split_whitespace().map(number).collect();
    found.and_then(|found| found.try_into().ok()).ok_or_else(|| {
        let expected = if N == 1 { "a number".to_owned() } else { format!("{N} numbers") };
        format!("`{key}` of {} is `{text}`; expected {expected} up to {GREATEST:e}", describe(node))
    })
}

/// A limit of a joint, 0 if it is not there; infinite if it is no number up to the greatest.
fn bound(limit: Node<'_, '_>, key: &str) -> Result<f64, String> {
    match limit.attribute(key).map(|text| text.trim().parse::<f64>()) {
        Some(Ok(number)) if number.abs() > GREATEST => Ok(f64::INFINITY.copysign(number)),
        _ => number(limit, key, Some(0.0)),
    }
}

pub(super) fn number(node: Node<'_, '_>, key: &str, default: Option<f64>) -> Result<f64, String> {
    numbers(node, key, default.map(|number| [number])).map(|[number]| number)
}
