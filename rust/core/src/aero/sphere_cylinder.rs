//! Links as spheres and finite cylinders, with drag coefficients from the literature at the link's Reynolds
//! number.
//!
//! Equations M21 and M22 of `docs/model`.

use super::Pchip;
use super::attack::{Attack, normal_direction};
use super::links::check_air_density;
use crate::error::{BuildError, check};
use crate::robot::AeroLink;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_4;

/// Parameters of the sphere and cylinder model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SphereCylinderConfig {
    /// Density of the air \[kg/m³\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub air_density: f64,
    /// Dynamic viscosity of the air \[Pa s\].
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub dynamic_viscosity: f64,
    /// Drag of circular cylinders.
    pub cylinder: CylinderTables,
    /// Drag of spheres.
    pub sphere: SphereTables,
}

/// Measured drag coefficients of circular cylinders.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CylinderTables {
    /// Reynolds number, on the diameter, at which the axial coefficients apply without scaling.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub reference_reynolds: f64,
    /// Reynolds numbers of `crosswind_drag`.
    pub reynolds: Vec<f64>,
    /// Crosswind drag coefficient of a cylinder of infinite length, on the area `d l`.
    pub crosswind_drag: Vec<f64>,
    /// Ratios of diameter to length for `finite_length_drag`.
    pub diameter_over_length: Vec<f64>,
    /// Crosswind drag coefficient of a finite cylinder; only its ratio to its maximum is used.
    pub finite_length_drag: Vec<f64>,
    /// Ratios of length to diameter for `axial_drag`.
    pub length_over_diameter: Vec<f64>,
    /// Axial drag coefficient, on the area `π d²/4`; only its ratio to its maximum is used.
    pub axial_drag: Vec<f64>,
}

/// Measured drag coefficients of spheres, on the area `π d²/4`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SphereTables {
    /// Drag coefficient below Reynolds number 10.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub drag_below_reynolds_10: f64,
    /// Reynolds numbers of `drag`; a correlation is used between 10 and the first of them.
    pub reynolds: Vec<f64>,
    /// Drag coefficient at each of `reynolds`.
    pub drag: Vec<f64>,
}

/// Shape by which a link is modelled.
#[derive(Debug, Clone, Copy)]
enum Shape {
    Sphere,
    /// Crosswind and axial drag coefficient on the area `d l`, relative to an infinite cylinder's.
    Cylinder {
        crosswind: f64,
        axial: f64,
    },
}

/// Constants of one link.
#[derive(Debug, Clone, Copy)]
struct LinkConstants {
    /// `ρ A / 2` \[kg/m\].
    half_density_area: f64,
    /// `ρ d / μ` \[s/m\]: Reynolds number divided by speed.
    reynolds_per_speed: f64,
    shape: Shape,
}

/// The sphere and cylinder model after its checks.
#[derive(Debug, Clone)]
pub struct SphereCylinder {
    links: Vec<LinkConstants>,
    cylinder: Pchip,
    sphere: Pchip,
    drag_below_reynolds_10: f64,
}

impl SphereCylinder {
    /// Checks the tables and computes the constants of every link.
    ///
    /// # Errors
    /// A density, viscosity, drag coefficient or link size that is not positive, a table whose abscissae do
    /// not increase, a reference Reynolds number outside its table.
    pub fn new(config: &SphereCylinderConfig, links: &[AeroLink]) -> Result<Self, BuildError> {
        let positive = |value: f64| value > 0.0;
        let rho = check_air_density(config.air_density)?;
        let mu =
            check("dynamic_viscosity", config.dynamic_viscosity, positive, "a positive viscosity in Pa s")?;
        let c = &config.cylinder;
        let cylinder =
            drag_table("cylinder.reynolds", &c.reynolds, "cylinder.crosswind_drag", &c.crosswind_drag)?;
        let finite = drag_table(
            "cylinder.diameter_over_length",
            &c.diameter_over_length,
            "cylinder.finite_length_drag",
            &c.finite_length_drag,
        )?;
        let axial = drag_table(
            "cylinder.length_over_diameter",
            &c.length_over_diameter,
            "cylinder.axial_drag",
            &c.axial_drag,
        )?;
        let s = &config.sphere;
        let sphere = drag_table("sphere.reynolds", &s.reynolds, "sphere.drag", &s.drag)?;
        // The table must begin where the constant (below 10) and the correlation (from 10) end.
        check("sphere.reynolds[0]", sphere.domain().0, |re| re >= 10.0, "at least 10")?;
        let drag = "a positive drag coefficient";
        let drag_below_reynolds_10 =
            check("sphere.drag_below_reynolds_10", s.drag_below_reynolds_10, positive, drag)?;
        let (low, high) = cylinder.domain();
        let inside = "a positive Reynolds number inside the table `cylinder.reynolds`";
        let reference = check(
            "cylinder.reference_reynolds",
            c.reference_reynolds,
            |re| re > 0.0 && (low..=high).contains(&re),
            inside,
        )?;
        let reference_drag = cylinder.linear_at(reference);
        let links = links
            .iter()
            .map(|link| {
                let size = |what, value| {
                    check(
                        &format!("{what} of link `{}`", link.name),
                        value,
                        positive,
                        "a positive length in m",
                    )
                };
                let (d, l) = (size("diameter", link.diameter)?, size("length", link.length)?);
                let (shape, area) = if link.is_sphere {
                    (Shape::Sphere, FRAC_PI_4 * l * d)
                } else {
                    let crosswind = finite.at(d / l) / finite.max();
                    // π/4 d/l converts the axial coefficient from the area π d²/4 to d l.
                    let axial = axial.at(l / d) / axial.max() * FRAC_PI_4 * (d / l) / reference_drag;
                    (Shape::Cylinder { crosswind, axial }, l * d)
                };
                Ok(LinkConstants {
                    half_density_area: 0.5 * rho * area,
                    reynolds_per_speed: rho * d / mu,
                    shape,
                })
            })
            .collect::<Result<_, BuildError>>()?;
        Ok(Self { links, cylinder, sphere, drag_below_reynolds_10 })
    }

    /// Force on the link with index `link` \[N\], inertial axes; zero if there is no such link.
    ///
    /// ```text
    /// cylinder: C90 = C_cyl(Re) φ(d/l),   C0 = π/4 d/l χ(l/d) C_cyl(Re)/C_cyl(Re_ref)
    ///           F = ρ d l/2 ( (C0 + (C90 − C0) sin³ α) |v| v + C90 sin α cos α (v × k̂) × v )
    /// sphere:   F = ρ π d l/8 C_sph(Re) |v| v
    /// Re = ρ |v| d/μ
    /// ```
    ///
    /// φ and χ are the finite-length and axial tables divided by their maxima. Source: the published
    /// controller, as its alternative to the axisymmetric model; tables after Wieselsberger (1922),
    /// Kritzinger (2004) and Achenbach (1972). Outside a table the value at its end is used. Zero at rest.
    #[must_use]
    pub fn link_force(&self, link: usize, axis_i: &Vector3<f64>, v_air_i: &Vector3<f64>) -> Vector3<f64> {
        let Some(link) = self.links.get(link) else {
            return Vector3::zeros();
        };
        let Attack { speed, cos, sin } = Attack::new(axis_i, v_air_i);
        let reynolds = link.reynolds_per_speed * speed;
        match link.shape {
            Shape::Sphere => link.half_density_area * self.sphere_drag(reynolds) * speed * v_air_i,
            Shape::Cylinder { crosswind, axial } => {
                let drag = axial + (crosswind - axial) * (sin * sin * sin);
                let normal = crosswind * sin * cos;
                link.half_density_area
                    * self.cylinder_drag(reynolds)
                    * (drag * speed * v_air_i + normal * normal_direction(axis_i, v_air_i))
            }
        }
    }

    /// Crosswind drag coefficient of an infinite cylinder, on the area `d l`.
    #[must_use]
    pub fn cylinder_drag(&self, reynolds: f64) -> f64 {
        self.cylinder.at(reynolds)
    }

    /// Drag coefficient of a sphere, on the area `π d²/4`.
    ///
    /// ```text
    /// C = 24/Re (1 + 0.150 Re^0.681) + 0.407/(1 + 8710/Re)   from Re = 10 to the table
    /// ```
    ///
    /// Source: Brown and Lawler (2003). Below Re = 10 the coefficient is constant, so that the force vanishes
    /// at rest as the square of the speed. Above the correlation: the table of Achenbach (1972), then its
    /// last value.
    #[must_use]
    pub fn sphere_drag(&self, reynolds: f64) -> f64 {
        if reynolds < 10.0 {
            self.drag_below_reynolds_10
        } else if reynolds <= self.sphere.domain().0 {
            24.0 / reynolds * (1.0 + 0.150 * libm::pow(reynolds, 0.681)) + 0.407 / (1.0 + 8710.0 / reynolds)
        } else {
            self.sphere.at(reynolds)
        }
    }
}

/// Builds a table of positive drag coefficients; the item names appear in errors.
fn drag_table(x_item: &str, x: &[f64], drag_item: &str, drag: &[f64]) -> Result<Pchip, BuildError> {
    let table = Pchip::new(x_item, x, drag_item, drag)?;
    for (index, value) in drag.iter().enumerate() {
        check(&format!("{drag_item}[{index}]"), *value, |c| c > 0.0, "a positive drag coefficient")?;
    }
    Ok(table)
}
