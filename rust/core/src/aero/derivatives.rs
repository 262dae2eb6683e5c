//! Derivatives of the force on a link by the velocity of the air and by the link's axis.
//!
//! Equation M116 of `docs/model`.

use super::attack::{Attack, normal_direction};
use super::factors::LinkFactors;
use super::{AeroModel, Axisymmetric, ForceFactors};
use nalgebra::{Matrix3, Vector3};

/// Derivatives of a link's force, inertial axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceDerivatives {
    /// By the velocity of the air relative to the link \[N s/m\].
    pub by_velocity: Matrix3<f64>,
    /// By the link's axis, of which only changes perpendicular to it occur \[N\].
    pub by_axis: Matrix3<f64>,
}

impl ForceDerivatives {
    /// A force that depends on nothing.
    #[must_use]
    pub fn zero() -> Self {
        Self { by_velocity: Matrix3::zeros(), by_axis: Matrix3::zeros() }
    }
}

impl AeroModel {
    /// Whether [`AeroModel::derivatives`] are those of this model, so that its force on a link depends on nothing but
    /// the link's axis and the air relative to it.
    #[must_use]
    pub fn has_derivatives(&self) -> bool {
        match self {
            Self::Off | Self::Axisymmetric(_) => true,
            Self::Weighted(model, _) => model.has_derivatives(),
            Self::SphereCylinder(_) | Self::Network(_) => false,
        }
    }

    /// Derivatives of the force on the link with index `link`; zero for a model without [`Self::has_derivatives`].
    #[must_use]
    pub fn derivatives(
        &self,
        link: usize,
        axis_i: &Vector3<f64>,
        v_air_i: &Vector3<f64>,
    ) -> ForceDerivatives {
        self.force_and_derivatives(link, axis_i, v_air_i).1
    }

    fn force_and_derivatives(
        &self,
        link: usize,
        axis_i: &Vector3<f64>,
        v_air_i: &Vector3<f64>,
    ) -> (Vector3<f64>, ForceDerivatives) {
        match self {
            Self::Axisymmetric(model) => {
                (model.link_force(link, axis_i, v_air_i), model.link_derivatives(link, axis_i, v_air_i))
            }
            Self::Weighted(model, factors) => {
                let (force, derivatives) = model.force_and_derivatives(link, axis_i, v_air_i);
                (force, factors.derivatives(link, &force, &derivatives, v_air_i))
            }
            Self::Off | Self::SphereCylinder(_) | Self::Network(_) => {
                (Vector3::zeros(), ForceDerivatives::zero())
            }
        }
    }
}

impl Axisymmetric {
    /// ```text
    /// ∂cos α/∂v = −(k̂ + cos α v̂)/(|v| + ε)   ∂cos α/∂k̂ = −v/(|v| + ε)   ∂ sin α = −(cos α / sin α) ∂cos α
    /// ```
    fn link_derivatives(
        &self,
        link: usize,
        axis_i: &Vector3<f64>,
        v_air_i: &Vector3<f64>,
    ) -> ForceDerivatives {
        let Some(areas) = self.coefficients.get(link) else { return ForceDerivatives::zero() };
        let Attack { speed, cos, sin } = Attack::new(axis_i, v_air_i);
        let direction = v_air_i.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        let regular = speed + super::attack::SPEED_EPSILON;
        let cos_by_velocity = -(axis_i + direction * cos) / regular;
        let cos_by_axis = -v_air_i / regular;
        let sin_by_cos = -cos / sin;

        let [w0, w1, w2, w3, w4] = areas.cda;
        let drag_area = w0 + cos * (w1 + w4 * cos * cos) + sin * sin * (w2 + w3 * sin);
        let drag_by_cos = w1 + 3.0 * w4 * cos * cos + sin * (2.0 * w2 + 3.0 * w3 * sin) * sin_by_cos;
        let normal = normal_direction(axis_i, v_air_i);
        // d(sin α cos α) = (sin α + cos α ∂sin α/∂cos α) d cos α
        let by_cos = v_air_i * (speed * drag_by_cos) + normal * (areas.cna * (sin + cos * sin_by_cos));
        let normal_by_velocity = axis_i * v_air_i.transpose() * 2.0
            - v_air_i * axis_i.transpose()
            - Matrix3::from_diagonal_element(v_air_i.dot(axis_i));
        let normal_by_axis = Matrix3::from_diagonal_element(speed * speed) - v_air_i * v_air_i.transpose();
        let drag_by_velocity =
            (v_air_i * direction.transpose() + Matrix3::from_diagonal_element(speed)) * drag_area;
        let normal_area = areas.cna * sin * cos;
        ForceDerivatives {
            by_velocity: (by_cos * cos_by_velocity.transpose()
                + drag_by_velocity
                + normal_by_velocity * normal_area)
                * self.k_a,
            by_axis: (by_cos * cos_by_axis.transpose() + normal_by_axis * normal_area) * self.k_a,
        }
    }
}

impl ForceFactors {
    /// Derivatives of the weighted force, from the force and the derivatives of the model.
    fn derivatives(
        &self,
        link: usize,
        force: &Vector3<f64>,
        of_model: &ForceDerivatives,
        v_air_i: &Vector3<f64>,
    ) -> ForceDerivatives {
        let Some(&LinkFactors { drag, normal, whole }) = self.links.get(link) else {
            return ForceDerivatives::zero();
        };
        let speed = v_air_i.norm();
        let direction = v_air_i.try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        let along = direction * direction.transpose();
        let weights = Matrix3::from_diagonal_element(normal) + along * (drag - normal);
        let turn = if speed > 0.0 {
            // d(v̂ v̂ᵀ F) at constant F
            let across = (Matrix3::identity() - along) / speed;
            (Matrix3::from_diagonal_element(force.dot(&direction)) + direction * force.transpose()) * across
        } else {
            Matrix3::zeros()
        };
        ForceDerivatives {
            by_velocity: (weights * of_model.by_velocity + turn * (drag - normal)) * whole,
            by_axis: weights * of_model.by_axis * whole,
        }
    }
}
