//! Builds the tree of moving bodies from the links and joints of a URDF.

use super::merge::{merge, part};
use super::urdf::{Motion, Urdf};
use flight_core::error::{BuildError, check as check_number, place_of};
use flight_core::robot::{Body, Frame, JointKind, check};
use flight_core::spatial::{Pose, axis_angle};
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Least angle \[rad\], and least distance \[m\] of parallel axes, of two joints with a body without mass in between.
const LEAST_ANGLE: f64 = 0.01;
const LEAST_DISTANCE: f64 = 1e-3;

/// Greatest number of joints, whose mass matrix has 6 MB.
const MAX_JOINTS: usize = 512;

/// A URDF robot without its fixed and locked joints.
pub(super) struct Tree<'a> {
    /// The base, then the body of each joint in the joint order.
    pub(super) bodies: Vec<Body>,
    /// One for each joint, in the joint order.
    pub(super) joints: Vec<TreeJoint<'a>>,
    /// Body of each link, and the link's pose in it.
    pub(super) places: BTreeMap<String, (usize, Pose)>,
    /// Positions of the joints that could move but are held \[rad, m\].
    pub(super) held: BTreeMap<String, f64>,
    /// What is doubtful, but has one meaning.
    pub(super) warnings: Vec<String>,
}

/// Data of a joint in the URDF.
pub(super) struct TreeJoint<'a> {
    pub(super) motion: &'a Motion,
    pub(super) parent_from_child: Pose,
}

impl Tree<'_> {
    /// Frame of a link; `item` names the entry that refers to it.
    pub(super) fn frame(&self, item: &str, link: &str) -> Result<Frame, BuildError> {
        let (body, body_from_frame) =
            *self.places.get(link).ok_or_else(|| BuildError::unknown_name(item, link, self.places.keys()))?;
        Ok(Frame { name: link.to_owned(), body, body_from_frame })
    }
}

/// Builds the tree whose moving joints are those of `order`; `locked` joints have a fixed position \[rad,
/// m\].
pub(super) fn build<'a>(
    urdf: &'a Urdf,
    base_link: &str,
    order: &[&str],
    locked: &BTreeMap<String, f64>,
) -> Result<Tree<'a>, BuildError> {
    check::unique("URDF link", urdf.links.iter().map(|link| link.name.as_str()))?;
    check::unique("URDF joint", urdf.joints.iter().map(|joint| joint.name.as_str()))?;
    if order.len() > MAX_JOINTS {
        let expected = format!("at most {MAX_JOINTS} that move; others in `locked`");
        return Err(BuildError::bad_value("number of joints", order.len(), expected));
    }
    let children = children_of_links(urdf)?;
    let roles = roles(urdf, order, locked)?;

    let n_bodies = order.len() + 1;
    let mut names = vec![String::new(); n_bodies];
    let mut parents = vec![None; n_bodies];
    let mut parts = vec![Vec::new(); n_bodies];
    let mut joints: Vec<Option<TreeJoint>> = order.iter().map(|_| None).collect();
    let mut places = BTreeMap::new();
    let mut held = BTreeMap::new();
    let mut warnings = urdf.warnings.clone();

    let base = base_index(urdf, &children, base_link)?;
    base_link.clone_into(&mut names[0]);
    let mut to_visit = vec![(base, 0, Pose::identity())];
    while let Some((link_index, body, body_from_link)) = to_visit.pop() {
        let link = &urdf.links[link_index];
        parts[body].extend(part(link, &body_from_link, &mut warnings)?);
        places.insert(link.name.clone(), (body, body_from_link));
        for &(joint_index, child) in &children[link_index] {
            let joint = &urdf.joints[joint_index];
            let body_from_joint = body_from_link * joint.origin;
            match roles[joint_index] {
                Role::Fixed => to_visit.push((child, body, body_from_joint)),
                Role::Held(motion, position) => {
                    let axis = motion.axis.into_inner();
                    let moved = match motion.kind {
                        JointKind::Revolute => {
                            Pose { rotation: axis_angle(&axis, position), position: Vector3::zeros() }
                        }
                        JointKind::Prismatic => Pose { position: axis * position, ..Pose::identity() },
                    };
                    held.insert(joint.name.clone(), position);
                    to_visit.push((child, body, body_from_joint * moved));
                }
                Role::Moving(motion, place) => {
                    let moved = place + 1;
                    names[moved].clone_from(&urdf.links[child].name);
                    parents[moved] = Some(body);
                    joints[place] = Some(TreeJoint { motion, parent_from_child: body_from_joint });
                    to_visit.push((child, moved, Pose::identity()));
                }
            }
        }
    }
    check_all_reached(urdf, &places, base_link)?;
    check_ancestors_first(order, &parents)?;

    let bodies = names
        .into_iter()
        .zip(parents)
        .zip(parts)
        .map(|((name, parent), parts)| merge(name, parent, &parts))
        .collect::<Result<Vec<_>, _>>()?;
    // Every joint of the order exists and every link has been reached, so none is missing.
    let joints: Vec<TreeJoint> = joints.into_iter().flatten().collect();
    check_moved(&bodies, &joints)?;
    Ok(Tree { bodies, joints, places, held, warnings })
}

/// Checks that every body without mass moves one with mass, behind another joint: then no motion of the joints leaves all
/// masses where they are, and the mass matrix is positive definite.
fn check_moved(bodies: &[Body], joints: &[TreeJoint]) -> Result<(), BuildError> {
    let behind = |body| bodies.iter().zip(0..).skip(1).filter(move |(other, _)| other.parent == Some(body));
    for (body, joint) in (1..).zip(joints) {
        let moves = |(other, place): (&Body, usize)| other.mass > 0.0 && differ(joint, &joints[place - 1]);
        if bodies[body].mass == 0.0 && !behind(body).any(moves) {
            let expected = "a positive mass, in kg, a position in `locked` for the joint that moves it, or a body with mass \
                            behind it, on a joint with another axis";
            return Err(BuildError::bad_value(
                format!("mass of body `{}`", bodies[body].name),
                0.0,
                expected,
            ));
        }
    }
    Ok(())
}

/// Whether a body moves otherwise by its joint than by that of its child, in every posture: both axes are fixed to it.
fn differ(joint: &TreeJoint, child: &TreeJoint) -> bool {
    let (axis, pose) = (joint.motion.axis, child.parent_from_child);
    let other = pose.rotation * child.motion.axis.into_inner();
    let is_parallel = axis.cross(&other).norm() < LEAST_ANGLE;
    match (joint.motion.kind, child.motion.kind) {
        (JointKind::Revolute, JointKind::Revolute) => {
            !is_parallel || axis.cross(&pose.position).norm() > LEAST_DISTANCE
        }
        (JointKind::Prismatic, JointKind::Prismatic) => !is_parallel,
        _ => true,
    }
}

/// Role of a URDF joint in the tree.
#[derive(Clone, Copy)]
enum Role<'a> {
    Fixed,
    /// Held at a position \[rad, m\].
    Held(&'a Motion, f64),
    /// Moving, with this index in the joint order.
    Moving(&'a Motion, usize),
}

fn roles<'a>(
    urdf: &'a Urdf,
    order: &[&str],
    locked: &BTreeMap<String, f64>,
) -> Result<Vec<Role<'a>>, BuildError> {
    check::unique("joint", order.iter().copied().chain(locked.keys().map(String::as_str)))?;
    let motions: BTreeMap<&str, Option<&Motion>> =
        urdf.joints.iter().map(|joint| (joint.name.as_str(), joint.motion.as_ref())).collect();
    for (list, names) in [
        ("joint order", order.to_vec()),
        ("list of locked joints", locked.keys().map(String::as_str).collect()),
    ] {
        if let Some(name) = names.iter().find(|name| !motions.contains_key(*name)) {
            return Err(BuildError::unknown_name(list, *name, motions.keys()));
        }
    }
    let places: BTreeMap<&str, usize> =
        order.iter().enumerate().map(|(place, name)| (*name, place)).collect();

    // The other joints with the same mistake, so that one refusal names all.
    let others = |refused: &str, mimics: bool| {
        let found = motions.iter().filter(|(name, motion)| {
            **name != refused
                && motion.is_some_and(|motion| motion.mimic.is_some() == mimics)
                && (mimics || !places.contains_key(*name))
                && matches!(held_at(name, &motions, locked), Ok(None))
        });
        let names: Vec<_> = found.map(|(name, _)| format!("`{name}`")).collect();
        if names.is_empty() { String::new() } else { format!("; the same for {}", names.join(", ")) }
    };
    let role = |(name, motion): (&'a str, Option<&'a Motion>)| {
        let item = format!("joint `{name}`");
        let place = places.get(name).copied();
        let Some(motion) = motion else {
            return if place.is_some() || locked.contains_key(name) {
                let item = format!("type of {item}");
                Err(BuildError::bad_value(item, "fixed", "one that moves, as it is listed"))
            } else {
                Ok(Role::Fixed)
            };
        };
        if let Some(&position) = locked.get(name) {
            check_position(name, motion, position)?;
        }
        match (place, held_at(name, &motions, locked)?, &motion.mimic) {
            (None, Some(position), _) => Ok(Role::Held(motion, position)),
            (Some(place), _, None) => Ok(Role::Moving(motion, place)),
            (_, _, Some(mimic)) => {
                let value = format!("a mimic of `{}`", mimic.joint);
                let expected =
                    format!("a position in `locked` for it, or for that joint{}", others(name, true));
                Err(BuildError::bad_value(item, value, expected))
            }
            (None, None, None) => {
                let expected = format!("one of both{}", others(name, false));
                Err(BuildError::bad_value(item, "neither in the joint order nor locked", expected))
            }
        }
    };
    urdf.joints.iter().map(|joint| role((&joint.name, joint.motion.as_ref()))).collect()
}

/// Position of a joint that is locked, fixed, or follows such a joint; `None` for one that moves.
fn held_at(
    joint: &str,
    motions: &BTreeMap<&str, Option<&Motion>>,
    locked: &BTreeMap<String, f64>,
) -> Result<Option<f64>, BuildError> {
    // From the joint to the one that leads; one step too many is a circle.
    let (mut name, mut scale, mut shift) = (joint, 1.0, 0.0);
    for _ in 0..=motions.len() {
        if let Some(position) = locked.get(name) {
            return Ok(Some(scale * position + shift));
        }
        let motion = motions.get(name).ok_or_else(|| {
            BuildError::unknown_name(format!("mimic of joint `{joint}`"), name, motions.keys())
        })?;
        match motion.map(|motion| motion.mimic.as_ref()) {
            None => return Ok(Some(shift)),
            Some(None) => return Ok(None),
            Some(Some(mimic)) => {
                shift += scale * mimic.offset;
                scale *= mimic.multiplier;
                name = &mimic.joint;
            }
        }
    }
    let item = format!("joint `{joint}`");
    Err(BuildError::bad_value(item, "a mimic of itself", "a position in `locked`"))
}

/// Refuses a position \[rad, m\] beyond the limits of a joint that has some.
fn check_position(joint: &str, motion: &Motion, position: f64) -> Result<(), BuildError> {
    let Some((lower, upper)) = motion.limits else { return Ok(()) };
    let item = format!("position of locked joint `{joint}`");
    let expected = format!("a number from {lower} to {upper}, the limits of the URDF");
    check_number(&item, position, |x| (lower..=upper).contains(&x), &expected).map(|_| ())
}

/// For each link, its child joints with their child links.
fn children_of_links(urdf: &Urdf) -> Result<Vec<Vec<(usize, usize)>>, BuildError> {
    let index_of: BTreeMap<&str, usize> =
        urdf.links.iter().enumerate().map(|(i, link)| (link.name.as_str(), i)).collect();
    let find = |item: String, name: &str| {
        index_of.get(name).copied().ok_or_else(|| BuildError::unknown_name(item, name, index_of.keys()))
    };
    let mut children = vec![Vec::new(); urdf.links.len()];
    let mut carrier: Vec<Option<&str>> = vec![None; urdf.links.len()];
    for (joint_index, joint) in urdf.joints.iter().enumerate() {
        let parent = find(format!("parent of joint `{}`", joint.name), &joint.parent)?;
        let child = find(format!("child of joint `{}`", joint.name), &joint.child)?;
        if let Some(first) = carrier[child].replace(&joint.name) {
            return Err(BuildError::bad_value(
                format!("link `{}`", joint.child),
                format!("the child of `{first}` and of `{}`", joint.name),
                "the child of one joint",
            ));
        }
        children[parent].push((joint_index, child));
    }
    Ok(children)
}

/// Index of the link without a parent, which must be the base.
fn base_index(urdf: &Urdf, children: &[Vec<(usize, usize)>], base_link: &str) -> Result<usize, BuildError> {
    let names = || urdf.links.iter().map(|link| link.name.as_str());
    let base = place_of("base_link", base_link, names())?;
    let carried: BTreeSet<usize> = children.iter().flatten().map(|&(_, child)| child).collect();
    let roots: Vec<&str> =
        names().enumerate().filter(|(i, _)| !carried.contains(i)).map(|(_, name)| name).collect();
    if roots == [base_link] {
        Ok(base)
    } else if roots.is_empty() {
        Err(BuildError::bad_value("set of root links", "empty: the joints form a cycle", "one root"))
    } else {
        let expected = format!("only the base link, `{base_link}`");
        Err(BuildError::bad_value("set of root links", roots.join(", "), expected))
    }
}

/// With one root, a link that is not reached is part of a cycle or below one.
fn check_all_reached(
    urdf: &Urdf,
    places: &BTreeMap<String, (usize, Pose)>,
    base_link: &str,
) -> Result<(), BuildError> {
    match urdf.links.iter().find(|link| !places.contains_key(&link.name)) {
        None => Ok(()),
        Some(link) => Err(BuildError::bad_value(
            format!("link `{}`", link.name),
            "part of a cycle of joints",
            format!("a link that hangs from the base link, `{base_link}`"),
        )),
    }
}

fn check_ancestors_first(order: &[&str], parents: &[Option<usize>]) -> Result<(), BuildError> {
    for (place, name) in order.iter().enumerate() {
        if let Some(parent) = parents[place + 1]
            && parent > place
        {
            return Err(BuildError::bad_value(
                format!("place of joint `{name}` in the joint order"),
                place,
                format!("a place after its ancestor `{}`, which is at {}", order[parent - 1], parent - 1),
            ));
        }
    }
    Ok(())
}
