"""The attitude task: angular momentum that rotates the base to its set-point.

Everything is in body coordinates. With `R` the base rotation, `w = Rᵀ ω_B`, `I₀` the centroidal inertia in body axes
*at the first tick* (held constant):

```text
k = I₀ w,   k̇ = Rᵀ L̇_ang − w × k,   E = R_dᵀ R,   e = sk(E)^∨,   ė = sk(E S(w) − S(ω_d) E)^∨
k̈* = I₀ ω̈_d − ė − (1 + c₀ I₀⁻¹)(k̇ − I₀ ω̇_d) − c₀ I₀⁻¹ e − c₁ I₀⁻¹ (k − I₀ ω_d)
σ  = R ( w × (w × k) + 2 w × k̇ + (I₀⁻¹ k̇) × k )
```

The task is `Rᵀ (L̈_ang − σ) = k̈*`. There is no integral action: a constant moment `d` that the controller's model does
not contain leaves the steady error `e = (1 + I₀/c₀) d`. Equations M59 to M61 of `docs/model`.
"""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float

from jax_aero.body.spatial import cross, inverse, multiply, rotate, rotate_back, skew, vee_of_skew_part
from jax_aero.types import Array, Setpoint, pytree


@pytree
class MomentumGains:
    """Gains of the momentum task (M57 of `docs/model`) and of the attitude task (M60)."""

    kp_linear: Float[Array, "3"]
    """[1/s²]."""
    kd_linear: Float[Array, "3"]
    """[1/s]."""
    ko: Float[Array, ""]
    """[s]."""
    c0: Float[Array, ""]
    """[N m]."""
    c1: Float[Array, ""]
    """[N m s]."""


class AttitudeDemand(NamedTuple):
    """Output of the attitude law."""

    k_ddot_desired: Float[Array, "3"]
    """Desired second derivative of the body angular momentum, `k̈*` [N m/s, body axes]."""
    sigma: Float[Array, "3"]
    """Gyroscopic terms between `L̈` and `k̈`, `σ` [N m/s, inertial axes]."""


def attitude_demand(
    gains: MomentumGains,
    setpoint: Setpoint,
    rotation: Float[Array, "3 3"],
    angular_velocity: Float[Array, "3"],
    moment_estimate: Float[Array, "3"],
    inertia_0: Float[Array, "3 3"],
) -> AttitudeDemand:
    """Evaluate the attitude law; `inertia_0` is `I₀` [kg m²], velocity and moment [rad/s, N m] are in inertial axes."""
    c0, c1 = gains.c0, gains.c1
    i0, i0_inv = inertia_0, inverse(inertia_0)
    w, w_d = rotate_back(rotation, angular_velocity), setpoint.angular_velocity

    k = rotate(i0, w)
    k_dot = rotate_back(rotation, moment_estimate) - cross(w, k)
    error = multiply(setpoint.rotation.T, rotation)
    e = vee_of_skew_part(error)
    e_dot = vee_of_skew_part(multiply(error, skew(w)) - multiply(skew(w_d), error))

    k_dot_error = k_dot - rotate(i0, setpoint.angular_acceleration)
    through_inertia = c0 * (k_dot_error + e) + c1 * (k - rotate(i0, w_d))
    k_ddot_desired = rotate(i0, setpoint.angular_jerk) - e_dot - k_dot_error - rotate(i0_inv, through_inertia)
    sigma_b = cross(w, cross(w, k) + 2.0 * k_dot) + cross(rotate(i0_inv, k_dot), k)
    return AttitudeDemand(k_ddot_desired, rotate(rotation, sigma_b))
