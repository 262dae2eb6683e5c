//! Builds the tree of moving bodies from the links and joints of a URDF.

use super::merge::{merge, part};
use super::urdf::{Joint, Urdf};
use flight_core::error::{BuildError, place_of};
use flight_core::robot::{Body, Frame, JointKind, check};
use flight_core::spatial::{Pose, axis_angle};
use nalgebra::{Unit, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// A URDF robot without its fixed and locked joints.
pub(super) struct Tree {
    /// The base, then the body of each joint in the joint order.
    pub(super) bodies: Vec<Body>,
    /// One for each joint, in the joint order.
    pub(super) joints: Vec<TreeJoint>,
    /// Body of each link, and the link's pose in it.
    places: BTreeMap<String, (usize, Pose)>,
}

/// Data of a joint in the URDF.
pub(super) struct TreeJoint {
    pub(super) kind: JointKind,
    pub(super) parent_from_child: Pose,
    pub(super) axis_b: Unit<Vector3<f64>>,
    /// Limits of the URDF \[rad, m\]; `None` for a continuous joint.
    pub(super) limits: Option<(f64, f64)>,
    /// Greatest torque of the URDF \[N m, N\].
    pub(super) torque_max: Option<f64>,
    /// Greatest velocity of the URDF \[rad/s, m/s\].
    pub(super) velocity_max: Option<f64>,
}

impl Tree {
    /// Frame of a link; `item` names the entry that refers to it.
    pub(super) fn frame(&self, item: &str, link: &str) -> Result<Frame, BuildError> {
        let (body, body_from_frame) =
            *self.places.get(link).ok_or_else(|| BuildError::unknown_name(item, link, self.places.keys()))?;
        Ok(Frame { name: link.to_owned(), body, body_from_frame })
    }
}

/// Builds the tree whose moving joints are those of `order`; `locked` joints have a fixed position \[rad,
/// m\].
pub(super) fn build(
    urdf: &Urdf,
    base_link: &str,
    order: &[&str],
    locked: &BTreeMap<String, f64>,
) -> Result<Tree, BuildError> {
    check::unique("URDF link", urdf.links.iter().map(|link| link.name.as_str()))?;
    check::unique("URDF joint", urdf.joints.iter().map(|joint| joint.name.as_str()))?;
    let children = children_of_links(urdf)?;
    let motions = motions(urdf, order, locked)?;

    let n_bodies = order.len() + 1;
    let mut names = vec![String::new(); n_bodies];
    let mut parents = vec![None; n_bodies];
    let mut parts = vec![Vec::new(); n_bodies];
    let mut joints: Vec<Option<TreeJoint>> = order.iter().map(|_| None).collect();
    let mut places = BTreeMap::new();

    let base = base_index(urdf, &children, base_link)?;
    base_link.clone_into(&mut names[0]);
    let mut to_visit = vec![(base, 0, Pose::identity())];
    while let Some((link_index, body, body_from_link)) = to_visit.pop() {
        let link = &urdf.links[link_index];
        parts[body].extend(part(link, &body_from_link)?);
        places.insert(link.name.clone(), (body, body_from_link));
        for &(joint_index, child) in &children[link_index] {
            let joint = &urdf.joints[joint_index];
            let body_from_joint = body_from_link * joint.origin.pose(&format!("joint `{}`", joint.name))?;
            match motions[joint_index] {
                Motion::Fixed => to_visit.push((child, body, body_from_joint)),
                Motion::Locked(kind, position) => {
                    joint.check_position(position)?;
                    let axis = joint.axis()?.into_inner();
                    let moved = match kind {
                        JointKind::Revolute => {
                            Pose { rotation: axis_angle(&axis, position), position: Vector3::zeros() }
                        }
                        JointKind::Prismatic => Pose { position: axis * position, ..Pose::identity() },
                    };
                    to_visit.push((child, body, body_from_joint * moved));
                }
                Motion::Moving(kind, place) => {
                    let moved = place + 1;
                    names[moved].clone_from(&urdf.links[child].name);
                    parents[moved] = Some(body);
                    joints[place] = Some(TreeJoint {
                        kind,
                        parent_from_child: body_from_joint,
                        axis_b: joint.axis()?,
                        limits: joint.limits()?,
                        torque_max: joint.greatest("effort", joint.effort)?,
                        velocity_max: joint.greatest("velocity", joint.velocity)?,
                    });
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
        .collect::<Result<_, _>>()?;
    // Every joint of the order exists and every link has been reached, so none is missing.
    Ok(Tree { bodies, joints: joints.into_iter().flatten().collect(), places })
}

/// Role of a URDF joint in the tree.
#[derive(Clone, Copy)]
enum Motion {
    Fixed,
    /// Fixed at a position \[rad, m\].
    Locked(JointKind, f64),
    /// Moving, with this index in the joint order.
    Moving(JointKind, usize),
}

fn motions(urdf: &Urdf, order: &[&str], locked: &BTreeMap<String, f64>) -> Result<Vec<Motion>, BuildError> {
    check::unique("joint", order.iter().copied().chain(locked.keys().map(String::as_str)))?;
    let known = urdf.joints.iter().map(|joint| joint.name.as_str());
    for name in order {
        place_of("joint order", name, known.clone())?;
    }
    for name in locked.keys() {
        place_of("list of locked joints", name, known.clone())?;
    }

    let motion = |joint: &Joint| {
        let name = joint.name.as_str();
        let item = format!("type of joint `{name}`");
        if let Some(mimic) = &joint.mimic {
            let item = format!("joint `{name}`");
            let value = format!("a mimic of `{mimic}`");
            return Err(BuildError::bad_value(item, value, "a joint that moves on its own"));
        }
        let place = order.iter().position(|listed| *listed == name);
        let locked_at = locked.get(name);
        match (joint.kind()?, place, locked_at) {
            (None, None, None) => Ok(Motion::Fixed),
            (None, _, _) => Err(BuildError::bad_value(item, "fixed", "one that moves, as it is listed")),
            (Some(kind), Some(place), _) => Ok(Motion::Moving(kind, place)),
            (Some(kind), None, Some(&position)) => Ok(Motion::Locked(kind, position)),
            (Some(_), None, None) => Err(BuildError::bad_value(
                format!("joint `{name}`"),
                "neither in the joint order nor locked",
                "one of both",
            )),
        }
    };
    urdf.joints.iter().map(motion).collect()
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
