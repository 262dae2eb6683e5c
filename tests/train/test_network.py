"""The network of link forces: its symmetry, its gradient, its frames."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jax_aero.aero import network as N  # noqa: N812 (many of its functions are tested)
from jax_aero.aero.axisymmetric import Axisymmetric, axisymmetric_forces
from jax_aero.aero.dataset import mirrored_joints
from jax_aero.aero.network import init_network
from jax_aero.base.terminal import ConfigError
from jax_aero.body.kinematics import kinematics
from jax_aero.data.ironcub import JOINTS, LINKS
from jax_aero.types import State
from tests.measurements import measured

pytestmark = pytest.mark.usefixtures("x64")

SHAPES = {
    "plain": {"hidden": (12,)},
    "link": {
        "hidden": (16, 12),
        "blocks": ("wind", "joints", "link_wind", "link_position", "link_shadow"),
        "activation": "silu",
        "frame": "link",
        "layout": "link",
        "members": 2,
    },
    "base by link": {"hidden": (), "frame": "base", "layout": "link"},
}


TURNED = np.array([[0.0, -1.0, 0.0], [0.8, 0.0, 0.6], [-0.6, 0.0, 0.8]])


def make(ironcub, name, *, mirror=True, baseline=None):
    network = init_network(jax.random.key(3), ironcub, mirror=mirror, baseline=baseline, **SHAPES[name])
    return N.with_precision(network, jnp.float64)


def sample(ironcub, seed):
    rng = np.random.default_rng(seed)
    q = jnp.asarray(rng.uniform(-0.8, 0.8, ironcub.n_joints))
    wind = rng.normal(size=3)
    return q, jnp.asarray(wind / np.linalg.norm(wind))


link_geometry = jax.jit(N.link_geometry)
raw_output = jax.jit(N.raw_output)


@jax.jit
def features_of(network, ironcub, q, wind):
    seen = jnp.array(network.joints)
    return N.features(network.blocks, wind, q[seen], N.link_geometry(ironcub, q))


def test_the_network_sees_the_joints_of_the_tables_in_their_order(ironcub):
    assert [ironcub.joint_names[joint] for joint in N.network_joints(ironcub)] == list(JOINTS)
    assert ironcub.aero_links.names == LINKS


@pytest.mark.parametrize("name", SHAPES)
def test_a_symmetric_network_mirrors_exactly(ironcub, name):
    network = make(ironcub, name)
    for seed in range(3):
        q, wind = sample(ironcub, seed)
        x = features_of(network, ironcub, q, wind)
        there = raw_output(network, network.mirror.features @ x)
        back = network.mirror.output @ raw_output(network, x)
        assert jnp.abs(there).max() > 1e-3
        np.testing.assert_allclose(there, back, rtol=0.0, atol=1e-12)


def test_the_mirror_of_the_features_is_that_of_the_robot(ironcub):
    """Features of the mirrored posture in the mirrored wind, as far as the robot is symmetric (its centres: 3 mm)."""
    blocks = ("wind", "joints", "link_wind", "link_position", "link_shadow")
    mirror = N.mirror_of(ironcub, N.network_joints(ironcub), blocks, "link", "link")
    q, wind = sample(ironcub, 1)
    seen = np.array(N.network_joints(ironcub))
    twin = np.zeros(ironcub.n_joints)
    twin[seen] = mirrored_joints(np.asarray(q)[seen], JOINTS)
    twin = jnp.asarray(twin)
    x = N.features(blocks, wind, q[seen], link_geometry(ironcub, q))
    there = N.features(blocks, wind * jnp.array([1.0, -1.0, 1.0]), twin[seen], link_geometry(ironcub, twin))
    difference = jnp.abs(mirror.features @ x - there)
    measured("difference below the limit", difference[:61].max(), 1e-7)
    assert 1e-5 < difference[61:100].max() < 3e-3
    assert difference[100:].max() < 0.05


def test_the_gradient_in_wind_and_joints_is_that_of_differences(ironcub):
    """Of a force that uses all features, link axes, the mirror and the axisymmetric part, through kinematics."""
    network = make(ironcub, "link", baseline=ironcub.aero_links.coefficients["signed"])
    q, direction = sample(ironcub, 2)
    velocity, air_density = 12.0 * direction, jnp.asarray(1.225)
    weights = jnp.asarray(np.random.default_rng(0).normal(size=(13, 3)))

    def force(velocity, q):
        zero = jnp.zeros(ironcub.n_velocities)
        kin = kinematics(ironcub, State(zero[:3], TURNED, q, zero))
        return jnp.sum(weights * N.network_forces(network, ironcub, kin, q, velocity, air_density))

    found = jax.jit(jax.grad(force, argnums=(0, 1)))(velocity, q)
    inputs = jnp.concatenate([velocity, q])
    steps = 1e-6 * jnp.eye(inputs.size)
    evaluate = jax.jit(jax.vmap(lambda row: force(row[:3], row[3:])))
    sides = evaluate(jnp.concatenate([inputs + steps, inputs - steps])).reshape(2, -1)
    expected = (sides[0] - sides[1]) / 2e-6
    assert jnp.abs(expected[3:]).max() > 1e-2
    np.testing.assert_allclose(jnp.concatenate(found), expected, rtol=1e-6, atol=1e-7)


def test_the_gradient_is_finite_at_rest_and_at_the_poles(ironcub):
    network = make(ironcub, "plain")
    q, _ = sample(ironcub, 0)
    geometry = link_geometry(ironcub, q)
    for velocity in (jnp.zeros(3), jnp.array([0.0, 9.0, 0.0]), jnp.array([0.0, -1.0, 0.0])):

        def force(v):
            areas = N.network_areas(network, N.unit_wind(v), q[jnp.array(network.joints)], geometry)
            return jnp.sum(v * v) * areas

        assert np.isfinite(jax.jit(jax.jacfwd(force))(velocity)).all()
    assert N.unit_wind(jnp.zeros(3)).tolist() == [1.0, 0.0, 0.0]


@pytest.mark.parametrize(("frame", "layout"), [("base", "component"), ("base", "link"), ("link", "link")])
def test_outputs_turn_to_base_axes_and_back_and_keep_their_length(ironcub, frame, layout):
    q, _ = sample(ironcub, 5)
    rotations = link_geometry(ironcub, q).rotations
    areas = jnp.asarray(np.random.default_rng(1).normal(size=(13, 3)))
    y = N.from_base_axes(frame, layout, areas, rotations)
    np.testing.assert_allclose(jnp.sum(y**2), jnp.sum(areas**2), rtol=1e-12)
    np.testing.assert_allclose(N.to_base_axes(frame, layout, y, rotations), areas, atol=1e-12)


@pytest.mark.parametrize(("start", "bound", "bias"), [("published", 1.0, 1.0), ("unit", np.sqrt(3.0), 0.0)])
def test_first_weights_have_the_bounds_of_their_start(ironcub, start, bound, bias):
    layers = init_network(jax.random.key(0), ironcub, hidden=(400, 300), start=start).layers
    for layer in layers:
        small = layer.weight.shape[-1] ** -0.5
        # Of 8800 or more even draws the largest is within 1 % of its bound.
        assert 0.99 < float(jnp.abs(layer.weight).max()) / (bound * small) <= 1.0
        assert (float(jnp.abs(layer.bias).max()) > 0.8 * bias * small) == (bias > 0.0)
        assert float(jnp.abs(layer.bias).max()) <= bias * small


def test_a_component_is_drag_lift_side_as_x_z_y():
    y = jnp.arange(39.0)
    areas = N.to_base_axes("base", "component", y, jnp.zeros((13, 3, 3)))
    assert areas[2].tolist() == [2.0, 28.0, 15.0]


def test_without_output_only_the_axisymmetric_model_is_left(ironcub):
    from dataclasses import replace

    rows = jnp.asarray(ironcub.aero_links.coefficients["signed"])
    network = make(ironcub, "link", baseline=rows)
    network = replace(network, scale=jnp.zeros(39), offset=jnp.zeros(39))
    q, wind = sample(ironcub, 7)
    zero = jnp.zeros(ironcub.n_velocities)
    kin = jax.jit(kinematics)(ironcub, State(zero[:3], jnp.asarray(TURNED), q, zero))
    forces = N.network_forces(network, ironcub, kin, q, 8.0 * wind, jnp.asarray(1.2))
    axes = jnp.einsum("ij,lj->li", TURNED, link_geometry(ironcub, q).axes)
    expected = axisymmetric_forces(Axisymmetric(jnp.asarray(0.6), rows), axes, jnp.broadcast_to(8.0 * wind, (13, 3)))
    np.testing.assert_allclose(forces, expected, atol=1e-7)


def test_a_link_behind_another_is_in_its_shadow():
    centres = jnp.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.5, 0.0]])
    shadow = N.link_shadow(jnp.array([1.0, 0.0, 0.0]), centres)
    assert shadow[1] > 0.99
    assert shadow[0] < 0.01
    assert shadow[2] < 0.01


@pytest.mark.parametrize(("frame", "layout", "key"), [("link", "component", "layout"), ("body", "link", "frame")])
def test_an_output_that_says_nothing_is_refused(ironcub, frame, layout, key):
    with pytest.raises(ConfigError, match=rf"`{key}` is .*; expected"):
        init_network(jax.random.key(0), ironcub, hidden=(4,), frame=frame, layout=layout)
