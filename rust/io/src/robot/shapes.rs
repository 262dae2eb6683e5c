//! Reads the geometry of a URDF's links. A robot flies without it, so it is read where sizes or pictures are made.

use super::urdf::{attribute, child, children, describe, number, numbers, origin, parse};
use flight_core::spatial::Pose;
use roxmltree::Node;

/// A primitive or mesh of a link.
#[derive(Debug)]
pub struct Shape {
    /// The link.
    pub link: String,
    /// Pose of the centre, or of a mesh's origin, in link axes.
    pub origin: Pose,
    /// `sphere`, `cylinder`, `capsule`, `box` or `mesh`.
    pub kind: &'static str,
    /// Radius three times of a sphere; radius twice and length along z of a cylinder or capsule; edges of a box
    /// \[m\]; factors on the coordinates of a mesh.
    pub size: [f64; 3],
    /// File of a mesh, as the URDF names it.
    pub file: Option<String>,
}

/// Shapes of all links: the visual ones, or those for collisions if a link has no visual ones.
pub(super) fn shapes(urdf: &str) -> Result<Vec<Shape>, String> {
    let document = parse(urdf)?;
    let mut shapes = Vec::new();
    for link in children(document.root_element(), "link") {
        for tag in ["visual", "collision"] {
            let here = shapes.len();
            for node in children(link, tag) {
                if let Some(geometry) = child(node, "geometry")? {
                    shapes.push(shape(attribute(link, "name")?, node, geometry)?);
                }
            }
            if shapes.len() > here {
                break;
            }
        }
    }
    Ok(shapes)
}

fn shape(link: &str, node: Node<'_, '_>, geometry: Node<'_, '_>) -> Result<Shape, String> {
    let expected = "expected sphere, cylinder, capsule, box or mesh";
    let Some(solid) = geometry.first_element_child() else {
        return Err(format!("{} is empty; {expected}", describe(geometry)));
    };
    if let Some(other) = solid.next_sibling_element() {
        let (first, second) = (solid.tag_name().name(), other.tag_name().name());
        return Err(format!("{} has <{first}> and <{second}>; expected one solid", describe(geometry)));
    }
    let of = |key| number(solid, key, None);
    let (kind, size) = match solid.tag_name().name() {
        "sphere" => ("sphere", [of("radius")?; 3]),
        "cylinder" => ("cylinder", [of("radius")?, of("radius")?, of("length")?]),
        "capsule" => ("capsule", [of("radius")?, of("radius")?, of("length")?]),
        "box" => ("box", numbers(solid, "size", None)?),
        "mesh" => ("mesh", numbers(solid, "scale", Some([1.0; 3]))?),
        other => return Err(format!("{} is a <{other}>; {expected}", describe(geometry))),
    };
    let file = if kind == "mesh" { Some(attribute(solid, "filename")?.to_owned()) } else { None };
    Ok(Shape { link: link.to_owned(), origin: origin(node)?, kind, size, file })
}
