//! Rotations, poses and the small matrices of rigid-body kinematics.
//!
//! Transforms are named `a_from_b`: `p_a = a_from_b * p_b`. Suffixes name frames: `_i` inertial, `_b` body.
//! Quaternions have the order `wxyz` and are used in this file only.
//!
//! Equations M1 to M5 of `docs/model`.

use nalgebra::{Matrix3, Quaternion, Rotation3, Unit, UnitQuaternion, Vector3, Vector6};

/// Greatest magnitude of a plausible position, velocity, time or thrust, measured or commanded \[m, rad, s, N\].
pub(crate) const GREATEST: f64 = 1e6;

/// A rigid transform `a_from_b`: rotation of frame b in frame a, and b's origin in a \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Rotation `a_from_b`.
    pub rotation: Matrix3<f64>,
    /// Origin of b in a \[m\].
    pub position: Vector3<f64>,
}

impl Pose {
    /// The identity transform.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), position: Vector3::zeros() }
    }

    /// Maps a point of frame b into frame a.
    #[must_use]
    pub fn transform_point(&self, point_b: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point_b + self.position
    }
}

/// Composition: `a_from_b * b_from_c = a_from_c`.
impl std::ops::Mul for Pose {
    type Output = Self;
    fn mul(self, rhs: Self) -> Self {
        Self { rotation: self.rotation * rhs.rotation, position: self.transform_point(&rhs.position) }
    }
}

/// Linear and angular part of a six-vector; for a wrench, force and moment.
#[must_use]
pub fn parts(six: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (six.fixed_rows::<3>(0).into(), six.fixed_rows::<3>(3).into())
}

/// The six-vector of a linear and an angular part.
#[must_use]
pub fn stack(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

/// The matrix `S(v)` with `S(v) u = v × u`.
#[must_use]
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Vector of the antisymmetric part, `sk(A)^∨` with `sk(A) = (A − Aᵀ)/2`; inverse of [`skew`].
#[must_use]
pub fn vee_of_skew_part(a: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(a.m32 - a.m23, a.m13 - a.m31, a.m21 - a.m12)
}

/// Rotation by the vector `phi` \[rad\]: `exp(S(φ))`.
#[must_use]
pub fn exp_so3(phi: &Vector3<f64>) -> Matrix3<f64> {
    let angle = phi.norm();
    if angle > 0.0 { axis_angle(&(phi / angle), angle) } else { Matrix3::identity() }
}

/// Angle of a rotation \[rad\], in `[0, π]`; accurate near both ends, because it does not use `acos`.
#[must_use]
pub fn rotation_angle(r: &Matrix3<f64>) -> f64 {
    libm::atan2(vee_of_skew_part(r).norm(), 0.5 * (r.trace() - 1.0))
}

/// Rotation vector \[rad\] of a rotation by at most half a turn: inverse of [`exp_so3`]. Accurate near the
/// identity, where `acos` would lose half of the digits, and near half a turn, where the antisymmetric part vanishes; the
/// axis of exactly half a turn has either sign.
#[must_use]
pub fn log_so3(r: &Matrix3<f64>) -> Vector3<f64> {
    let along = vee_of_skew_part(r);
    let (sine, cosine) = (along.norm(), 0.5 * (r.trace() - 1.0));
    if cosine < 0.0 {
        // (R + Rᵀ)/2 − c I = (1 − c) k kᵀ: each column is along the axis k, and the longest has the greatest diagonal entry.
        let outer = 0.5 * (r + r.transpose()) - Matrix3::from_diagonal_element(cosine);
        let axis = outer.column(outer.diagonal().imax()).normalize();
        let sign = if axis.dot(&along) < 0.0 { -1.0 } else { 1.0 };
        return axis * (sign * rotation_angle(r));
    }
    if sine > 0.0 { along * (rotation_angle(r) / sine) } else { along }
}

/// Rotation about a unit axis by an angle \[rad\].
#[must_use]
pub fn axis_angle(axis: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    // Rodrigues: R = c I + s S(k) + (1 − c) k kᵀ.
    let (s, c) = libm::sincos(angle);
    let v = 1.0 - c;
    let (x, y, z) = (axis.x, axis.y, axis.z);
    Matrix3::new(
        c + v * x * x,
        v * x * y - s * z,
        v * x * z + s * y,
        v * x * y + s * z,
        c + v * y * y,
        v * y * z - s * x,
        v * x * z - s * y,
        v * y * z + s * x,
        c + v * z * z,
    )
}

/// `Rz(yaw) Ry(pitch) Rx(roll)` for `rpy = (roll, pitch, yaw)` \[rad\].
#[must_use]
pub fn rotation_from_rpy(rpy: &Vector3<f64>) -> Matrix3<f64> {
    let [(sr, cr), (sp, cp), (sy, cy)] = [rpy.x, rpy.y, rpy.z].map(libm::sincos);
    Matrix3::new(
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
        -sp,
        cp * sr,
        cp * cr,
    )
}

/// Inverse of [`rotation_from_rpy`], pitch in `[−π/2, π/2]`. At gimbal lock (pitch within √ε of ±π/2) only the sum
/// or difference of roll and yaw is defined; roll is then zero.
#[must_use]
pub fn rpy_from_rotation(r: &Matrix3<f64>) -> Vector3<f64> {
    let cos_pitch = libm::hypot(r.m11, r.m21);
    let pitch = libm::atan2(-r.m31, cos_pitch);
    // Here the rounding errors of roll and yaw are as large as the error of setting roll to zero.
    if cos_pitch < f64::EPSILON.sqrt() {
        return Vector3::new(0.0, pitch, libm::atan2(-r.m12, r.m22));
    }
    Vector3::new(libm::atan2(r.m32, r.m33), pitch, libm::atan2(r.m21, r.m11))
}

/// Projects a matrix that is close to a rotation onto SO(3).
///
/// Two Newton–Schulz steps `R ← R (3 I − RᵀR)/2` towards the polar factor: an orthonormality error ε becomes
/// O(ε⁴).
#[must_use]
pub fn project_to_so3(near: &Matrix3<f64>) -> Matrix3<f64> {
    let mut r = *near;
    for _ in 0..2 {
        r = r * (Matrix3::from_diagonal_element(3.0) - r.transpose() * r) * 0.5;
    }
    r
}

/// Rotation of a quaternion `wxyz`, which is normalised first.
#[must_use]
pub fn rotation_from_wxyz(wxyz: &[f64; 4]) -> Matrix3<f64> {
    let q = Quaternion::new(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
    UnitQuaternion::from_quaternion(q).to_rotation_matrix().into_inner()
}

/// Quaternion `wxyz` of a rotation, with `w ≥ 0`.
#[must_use]
pub fn wxyz_from_rotation(r: &Matrix3<f64>) -> [f64; 4] {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*r));
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [sign * q.w, sign * q.i, sign * q.j, sign * q.k]
}

/// Largest deviation of `RᵀR` from the identity.
#[must_use]
pub fn orthonormality_error(r: &Matrix3<f64>) -> f64 {
    (r.transpose() * r - Matrix3::identity()).amax()
}

/// Whether a matrix is a rotation to six digits; false if it contains a NaN.
#[must_use]
pub fn is_rotation(r: &Matrix3<f64>) -> bool {
    r.iter().all(|x| x.is_finite()) && orthonormality_error(r) < 1e-6 && r.determinant() > 0.0
}

/// A unit vector, or `None` if the length is not 1 to six digits.
#[must_use]
pub fn unit_vector(v: Vector3<f64>) -> Option<Unit<Vector3<f64>>> {
    ((v.norm() - 1.0).abs() < 1e-6).then(|| Unit::new_normalize(v))
}
