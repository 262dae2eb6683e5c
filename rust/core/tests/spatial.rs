//! Rotations and poses: every formula against another way to the same number.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::float_cmp, reason = "claims of exact equality are meant")]

use crate::common::{assert_within, random_vector, rng};
use flight_core::spatial::{
    Pose, axis_angle, exp_so3, is_rotation, log_so3, orthonormality_error, project_to_so3, rotation_angle,
    rotation_from_rpy, rotation_from_wxyz, rpy_from_rotation, skew, unit_vector, vee_of_skew_part,
    wxyz_from_rotation,
};
use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

#[track_caller]
fn assert_close(found: &Matrix3<f64>, expected: &Matrix3<f64>, tolerance: f64) {
    let worst = (found - expected).amax();
    assert_within!(worst, tolerance, because "a few units in the last place of a rotation's entries", "differs by {worst:e}: {found} instead of {expected}");
}

/// `Σ Sᵏ/k!`, the definition.
fn exponential_series(s: &Matrix3<f64>) -> Matrix3<f64> {
    let mut term = Matrix3::identity();
    let mut sum = term;
    for k in 1..40 {
        term = term * s / f64::from(k);
        sum += term;
    }
    sum
}

fn rotation_vectors() -> impl Iterator<Item = Vector3<f64>> {
    let mut rng = rng(1);
    (0..300).map(move |k| {
        let direction = random_vector(&mut rng, 1.0).normalize();
        let angle = match k % 3 {
            0 => rng.random_range(0.0..PI),
            1 => 10_f64.powf(rng.random_range(-12.0..-1.0)),
            _ => PI - 10_f64.powf(rng.random_range(-12.0..-1.0)),
        };
        direction * angle
    })
}

/// `exp` is the matrix exponential, and a rotation.
#[test]
fn exp_is_the_exponential_series() {
    for phi in rotation_vectors() {
        let r = exp_so3(&phi);
        assert_close(&r, &exponential_series(&skew(&phi)), 1e-14);
        assert!(orthonormality_error(&r) < 2e-15 && r.determinant() > 0.0);
        assert_close(&r, &axis_angle(&phi.normalize(), phi.norm()), 1e-15);
    }
    assert_close(&exp_so3(&Vector3::zeros()), &Matrix3::identity(), 0.0);
}

/// Angle and axis of `exp φ` are those of φ, to full precision beside 0 and to rounding beside π.
#[test]
fn rotation_angle_is_exact_near_zero_and_pi() {
    for phi in rotation_vectors() {
        let r = exp_so3(&phi);
        let angle = phi.norm();
        let relative = (rotation_angle(&r) - angle).abs() / angle;
        assert_within!(relative, 1e-14, "{angle:e} rad off by {relative:e}");
        let axis = vee_of_skew_part(&r);
        if angle < PI - 1e-3 {
            assert_within!((axis / angle.sin() - phi / angle).amax(), 1e-12, "axis of {phi}");
        }
    }
    assert!(rotation_angle(&Matrix3::identity()) == 0.0);
    let half_turn = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, -1.0));
    assert!(rotation_angle(&half_turn) == PI);
}

/// `log` undoes `exp`, small turns and those of nearly half a turn to full precision.
#[test]
fn log_is_the_inverse_of_exp() {
    for phi in rotation_vectors() {
        let r = exp_so3(&phi);
        let relative = (log_so3(&r) - phi).amax() / phi.norm();
        // Nearer to half a turn than rounding, the sign of the axis is lost.
        if phi.norm() < PI - 1e-14 {
            assert_within!(relative, 1e-14, "{phi} off by {relative:e}");
        }
        assert_close(&exp_so3(&log_so3(&r)), &r, 1e-14);
    }
    assert_eq!(log_so3(&Matrix3::identity()), Vector3::zeros());
    for axis in [Vector3::x(), Vector3::y(), Vector3::z(), Vector3::new(0.6, 0.0, -0.8)] {
        let half_turn = 2.0 * axis * axis.transpose() - Matrix3::identity();
        assert_within!((log_so3(&half_turn).norm() - PI).abs(), 1e-15);
        assert_close(&exp_so3(&log_so3(&half_turn)), &half_turn, 1e-15);
    }
}

/// `S(v) u = v × u`, and the vee of a matrix undoes it; that of a symmetric matrix is zero.
#[test]
fn skew_is_the_cross_product() {
    let mut rng = rng(2);
    for _ in 0..100 {
        let (u, v) = (random_vector(&mut rng, 1.0), random_vector(&mut rng, 1.0));
        assert_within!((skew(&v) * u - v.cross(&u)).amax(), 1e-16);
        let symmetric = u * u.transpose();
        assert_within!((vee_of_skew_part(&(skew(&v) + symmetric)) - v).amax(), 1e-15);
    }
}

/// Roll, pitch, yaw turn about x, then y, then z of the *inertial* frame.
#[test]
fn rpy_is_roll_then_pitch_then_yaw() {
    let mut rng = rng(3);
    for _ in 0..300 {
        let rpy = Vector3::new(
            rng.random_range(-PI..PI),
            rng.random_range(-FRAC_PI_2..FRAC_PI_2),
            rng.random_range(-PI..PI),
        );
        let r = rotation_from_rpy(&rpy);
        let turns = axis_angle(&Vector3::z(), rpy.z)
            * axis_angle(&Vector3::y(), rpy.y)
            * axis_angle(&Vector3::x(), rpy.x);
        assert_close(&r, &turns, 1e-15);
        // Conditioning: an angle of 1/cos(pitch) ulp.
        let tolerance = 1e-15 / rpy.y.cos() + 1e-15;
        let error = (rpy_from_rotation(&r) - rpy).amax();
        assert_within!(error, tolerance, because "a few roundings, at the sample's own conditioning", "{rpy}");
    }
    // The robot's first attitude faces backwards.
    let start = rotation_from_rpy(&Vector3::new(0.0, 0.0, PI));
    assert_close(&start, &Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0)), 2e-16);
    assert_within!((rpy_from_rotation(&start) - Vector3::new(0.0, 0.0, PI)).amax(), 1e-15);
}

/// Close to gimbal lock roll and yaw lose their meaning one by one, the rotation keeps it: what rounding and what the
/// roll that is left out move it by are both small.
#[test]
fn rpy_near_gimbal_lock_still_names_the_rotation() {
    for distance in [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14] {
        for pitch in [FRAC_PI_2 - distance, distance - FRAC_PI_2] {
            for yaw in [0.7, -2.0, 3.0] {
                let r = axis_angle(&Vector3::z(), yaw)
                    * axis_angle(&Vector3::y(), pitch)
                    * axis_angle(&Vector3::x(), -0.4);
                let rpy = rpy_from_rotation(&r);
                assert_within!((rpy.y - pitch).abs(), 1e-15);
                assert_close(&rotation_from_rpy(&rpy), &r, (1e-15 / distance).min(distance + 1e-15));
            }
        }
    }
}

/// Quaternions stand as `wxyz`, with `w ≥ 0`.
#[test]
fn quaternions_are_wxyz() {
    let quarter_turn_z = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let expected = [FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2];
    for (found, expected) in wxyz_from_rotation(&quarter_turn_z).iter().zip(expected) {
        assert_within!((found - expected).abs(), 1e-15, because "a few units in the last place of numbers of order one");
    }
    assert_close(&rotation_from_wxyz(&expected), &quarter_turn_z, 1e-15);
    let half_turn_x = rotation_from_wxyz(&[0.0, 1.0, 0.0, 0.0]);
    assert_close(&half_turn_x, &Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)), 0.0);

    for phi in rotation_vectors() {
        let r = exp_so3(&phi);
        let q = wxyz_from_rotation(&r);
        assert!(q[0] >= 0.0 && (q.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-14);
        assert_close(&rotation_from_wxyz(&q), &r, 3e-15);
        // Neither length nor sign of a quaternion means anything.
        assert_close(&rotation_from_wxyz(&q.map(|x| -3.0 * x)), &r, 3e-15);
    }
}

/// The projection is the nearest rotation (the polar factor), its orthonormality error of fourth order.
#[test]
fn projection_gives_the_nearest_rotation() {
    let mut rng = rng(4);
    for phi in rotation_vectors().take(100) {
        let r = exp_so3(&phi);
        for epsilon in [1e-2, 1e-3] {
            let near = r + Matrix3::from_fn(|_, _| rng.random_range(-epsilon..epsilon));
            let projected = project_to_so3(&near);
            let before = orthonormality_error(&near);
            assert_within!(orthonormality_error(&projected), 10.0 * before.powi(4) + 1e-15, because "the projection's error is of second order in a disturbance of 1e-6");
            let svd = near.svd(true, true);
            let polar = svd.u.unwrap() * svd.v_t.unwrap();
            assert_close(&projected, &polar, 10.0 * before.powi(4) + 3e-15);
        }
        assert_close(&project_to_so3(&r), &r, 3e-15);
    }
}

/// `a_from_b * b_from_c = a_from_c`: neighbours cancel, on points too.
#[test]
fn poses_compose_as_their_names_do() {
    let mut rng = rng(5);
    let mut pose =
        || Pose { rotation: exp_so3(&random_vector(&mut rng, 3.0)), position: random_vector(&mut rng, 3.0) };
    for _ in 0..100 {
        let (a_from_b, b_from_c) = (pose(), pose());
        let point_c = pose().position;
        let one_by_one = a_from_b.transform_point(&b_from_c.transform_point(&point_c));
        assert_within!(((a_from_b * b_from_c).transform_point(&point_c) - one_by_one).amax(), 1e-14, because "a few units in the last place of numbers of order one");
        assert!(a_from_b * Pose::identity() == a_from_b && Pose::identity() * a_from_b == a_from_b);
    }
}

/// The orthonormality error is the largest entry of `RᵀR − 1`.
#[test]
fn orthonormality_error_sees_stretch_and_shear() {
    assert!(orthonormality_error(&Matrix3::identity()) == 0.0);
    let stretched = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 1.5));
    assert_within!((orthonormality_error(&stretched) - 1.25).abs(), 1e-15);
    let sheared = Matrix3::new(1.0, 0.25, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    assert_within!((orthonormality_error(&sheared) - 0.25).abs(), 1e-15);
}

/// A direction is taken if its length is 1 to six digits, and made exactly 1.
#[test]
fn unit_vectors_are_normalised_or_refused() {
    let accepted = unit_vector(Vector3::new(0.6, 0.8 + 5e-7, 0.0)).unwrap();
    assert_within!((accepted.norm() - 1.0).abs(), 1e-15, because "a few units in the last place of numbers of order one");
    for refused in [
        Vector3::new(0.6, 0.8 + 2e-6, 0.0),
        Vector3::zeros(),
        Vector3::new(f64::NAN, 0.0, 1.0),
        Vector3::new(f64::INFINITY, 0.0, 0.0),
    ] {
        assert!(unit_vector(refused).is_none(), "{refused}");
    }
}

/// A rotation to six digits is one; a reflection, a stretched one and one that holds a NaN are none.
#[test]
fn rotations_are_distinguished_from_other_matrices() {
    let rotation = exp_so3(&Vector3::new(0.3, -1.2, 2.0));
    for accepted in [rotation, rotation * (1.0 + 4e-7), rotation * (1.0 - 4e-7)] {
        assert!(is_rotation(&accepted), "{accepted}");
    }
    let mut unknown = rotation;
    unknown.m12 = f64::NAN;
    for refused in [-rotation, rotation * (1.0 + 6e-7), rotation * (1.0 - 6e-7), unknown] {
        assert!(!is_rotation(&refused), "{refused}");
    }
}
