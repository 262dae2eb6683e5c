"""Neural network of the link forces of the whole robot, from one wind and all joints that move a link.

The inputs of the published network are the unit vector of the air's velocity relative to the *base origin*, in base
axes, and 19 joint angles; its outputs are the 13 × 3 force areas of the links. Our networks can additionally take the
wind in link axes and the positions of the links, be symmetric by construction, average over members, and correct an
axisymmetric model.

    wind, joints, LinkGeometry ──features──► x (n,) ──raw_output──► y (39,) ──to_base_axes──► areas (13, 3) [m²]

Equations M23 to M25 of `docs/model`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Key

from jax_aero.aero.axisymmetric import Axisymmetric, axisymmetric_forces
from jax_aero.base.network_inputs import Block, block_sizes
from jax_aero.base.terminal import ConfigError
from jax_aero.body.kinematics import frame_poses, kinematics_at_rest
from jax_aero.body.mirror import ODD_JOINTS, opposite_indices
from jax_aero.body.robot import RobotModel
from jax_aero.body.spatial import rotate, rotate_back, safe_norm
from jax_aero.types import Array, Kinematics, pytree, static, with_dtype

Frame: TypeAlias = Literal["base", "link"]
Layout: TypeAlias = Literal["component", "link"]
Activation: TypeAlias = Literal["relu", "tanh", "silu"]

ACTIVATIONS: dict[str, Any] = {"relu": jax.nn.relu, "tanh": jnp.tanh, "silu": jax.nn.silu}
SHADOW_LENGTH = 0.05
"""`ℓ`: distance over which a link moves from upstream of another to downstream of it [m]."""
SHADOW_RADIUS = 0.10
"""`w`: width of a link's wake, a standard deviation [m]."""


class LinkGeometry(NamedTuple):
    """Poses of the links relative to the base."""

    rotations: Float[Array, "L 3 3"]
    """`base_from_link`."""
    centres: Float[Array, "L 3"]
    """Aerodynamic centres relative to the base origin, base axes [m]."""
    axes: Float[Array, "L 3"]
    """Unit axes of symmetry, base axes."""


@pytree
class Layer:
    """One affine layer, for all members."""

    weight: Float[Array, "m out in"]
    bias: Float[Array, "m out"]


@pytree
class Mirror:
    """Reflection about the base's x-z plane, as matrices for the features and for the raw output."""

    features: Float[Array, "x x"]
    output: Float[Array, "y y"]


@pytree
class Network:
    """Network of link force areas, built by `init_network` or read by `network_card.load_network`."""

    blocks: tuple[Block, ...] = static()
    frame: Frame = static()
    layout: Layout = static()
    activation: Activation = static()
    joints: tuple[int, ...] = static()
    """Indices of the input joints in the robot's joint vector."""
    layers: tuple[Layer, ...]
    scale: Float[Array, " y"]
    """Factors on the mean output of the members [m²]."""
    offset: Float[Array, " y"]
    """Offsets of the output [m²]."""
    mirror: Mirror | None
    """Reflection, if the prediction is symmetrised."""
    baseline: Float[Array, "L 6"] | None
    """Axisymmetric coefficients `w0 .. w5` [m²] to which the output is added."""

    @property
    def members(self) -> int:
        """Number of networks whose outputs are averaged."""
        return int(self.layers[0].weight.shape[0])

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return tuple(int(layer.weight.shape[1]) for layer in self.layers[:-1])

    @property
    def parameters(self) -> int:
        """Number of weights and biases of all members."""
        return sum(layer.weight.size + layer.bias.size for layer in self.layers)


# --- inputs from the robot ---------------------------------------------------------------------------------------


def network_joints(robot: RobotModel) -> tuple[int, ...]:
    """Return the indices of the joints that move an aerodynamic link, in the robot's order: all but the ankles."""
    moves = robot.ancestors[np.array(robot.aero_links.bodies, dtype=int)].any(axis=0)
    return tuple(int(joint) for joint in np.flatnonzero(moves))


def link_geometry(robot: RobotModel, joint_position: Float[Array, " n"]) -> LinkGeometry:
    """Return the geometry of the links at joint positions [rad], base axes."""
    return geometry_from_kinematics(robot, kinematics_at_rest(robot, joint_position))


_geometry = jax.jit(link_geometry)


def geometry_from_kinematics(robot: RobotModel, kin: Kinematics) -> LinkGeometry:
    """Return the geometry of the links in base axes, from kinematics at any base pose."""
    links = robot.aero_links
    rotations, origins = frame_poses(kin, links)
    base = kin.body_rotations[0]
    centres = rotate_back(base[None], origins + rotate(rotations, links.centres) - kin.body_positions[:1])
    base_from_link = jnp.einsum("ji,ljk->lik", base, rotations)
    return LinkGeometry(base_from_link, centres, rotate(base_from_link, links.axes))


def unit_wind(v_air_b: Float[Array, "3"]) -> Float[Array, "3"]:
    """Return the unit vector of the air's velocity relative to the base, base axes; (1, 0, 0) if it is zero."""
    speed = safe_norm(v_air_b)
    is_still = speed == 0.0
    forward = jnp.zeros_like(v_air_b).at[0].set(1.0)
    return jnp.where(is_still, forward, v_air_b / jnp.where(is_still, 1.0, speed))


def features(
    blocks: Sequence[str], wind_b: Float[Array, "3"], joint_position: Float[Array, " s"], geometry: LinkGeometry
) -> Float[Array, " x"]:
    """Return the inputs of a network: its blocks of features, concatenated.

    `wind` is the unit vector `wind_b`; `joints` are the angles of `joint_position` [rad], divided by 180°; `link_wind`
    is the unit vector in each link's axes; `link_position` the aerodynamic centres relative to the base origin, base
    axes [m], link by link; `link_shadow` how far each link lies in the wake of the others, see `link_shadow`.

    Angles are not standardised: joints that hardly move in the data would have huge inputs on unseen postures.
    """
    made: dict[str, Callable[[], Array]] = {
        "wind": lambda: wind_b,
        "joints": lambda: joint_position / np.pi,
        "link_wind": lambda: rotate_back(geometry.rotations, wind_b[None]).reshape(-1),
        "link_position": lambda: geometry.centres.reshape(-1),
        "link_shadow": lambda: link_shadow(wind_b, geometry.centres),
    }
    return jnp.concatenate([made[block]() for block in blocks])


def link_shadow(wind_b: Float[Array, "3"], centres: Float[Array, "L 3"]) -> Float[Array, " L"]:
    """Return how far each link lies in the wake of the others.

        S_j = Σ_k≠j exp(−r² / 2w²) / (1 + exp(−d·û / ℓ)),   d = x_j − x_k,   r² = |d|² − (d·û)²

    A hand-made feature, not a physical model: 15 postures alone do not show a network which of its inputs matter.
    """
    d = centres[:, None, :] - centres[None, :, :]
    along = jnp.einsum("lki,i->lk", d, wind_b)
    across = jnp.sum(d * d, -1) - along**2
    shadow = jax.nn.sigmoid(along / SHADOW_LENGTH) * jnp.exp(-across / (2.0 * SHADOW_RADIUS**2))
    return jnp.sum(shadow * (1.0 - jnp.eye(len(centres), dtype=shadow.dtype)), axis=1)


def mirror_of(robot: RobotModel, joints: Sequence[int], blocks: Sequence[str], layout: str, frame: str) -> Mirror:
    """Return the reflection of features and raw output about the base's x-z plane, from names and kinematics.

    `joints` are indices of those that are inputs.

        joint l ↔ r, torso roll and yaw change sign;   link l ↔ r;   base vectors by S = diag(1, −1, 1)
        vectors in link axes by T_l = R_l'ᵀ S R_l, at zero joints; l' is the link opposite to l

    T is constant for a symmetric robot. It is more than a change of signs where a link's axes are rotated.
    """
    # Always in double precision: two reflections must give back the input.
    with jax.enable_x64(True):
        rotations = np.asarray(_geometry(robot, np.zeros(robot.n_joints)).rotations)
    s = np.diag([1.0, -1.0, 1.0])
    opposite_link = opposite_indices(robot.aero_links.names)
    turns = [rotations[other].T @ s @ rotations[link] for link, other in enumerate(opposite_link)]
    names = [robot.joint_names[joint] for joint in joints]
    angles = np.zeros((len(names), len(names)))
    for joint, other in enumerate(opposite_indices(names)):
        angles[other, joint] = -1.0 if names[joint] in ODD_JOINTS else 1.0
    links_by_turn, links_by_s = _blocks(opposite_link, turns), _blocks(opposite_link, [s] * len(turns))
    swap = np.eye(len(opposite_link))[opposite_link]
    parts = {"wind": s, "joints": angles, "link_wind": links_by_turn, "link_position": links_by_s, "link_shadow": swap}
    if layout == "component":
        count = len(opposite_link)
        output = np.zeros((3 * count, 3 * count))
        for component, sign in enumerate((1.0, 1.0, -1.0)):  # the side force changes its sign
            for link, other in enumerate(opposite_link):
                output[component * count + other, component * count + link] = sign
    else:
        output = links_by_turn if frame == "link" else links_by_s
    from scipy.linalg import block_diag  # SciPy is loaded only when needed

    return Mirror(cast(Array, block_diag(*(parts[block] for block in blocks))), cast(Array, output))


def _blocks(opposite: Sequence[int], blocks: Sequence[Any]) -> Any:
    matrix = np.zeros((3 * len(opposite), 3 * len(opposite)))
    for link, (other, block) in enumerate(zip(opposite, blocks, strict=True)):
        matrix[3 * other : 3 * other + 3, 3 * link : 3 * link + 3] = block
    return matrix


# --- evaluation --------------------------------------------------------------------------------------------------


def init_network(
    key: Key[Array, ""],
    robot: RobotModel,
    *,
    hidden: Sequence[int],
    blocks: Sequence[Block] = ("wind", "joints"),
    joints: Sequence[int] | None = None,
    activation: Activation = "relu",
    members: int = 1,
    mirror: bool = False,
    frame: Frame = "base",
    layout: Layout = "component",
    baseline: Float[Array, "L 6"] | None = None,
    start: Literal["published", "unit"] = "published",
) -> Network:
    """Return a network with random weights in single precision.

    `published` draws weights and biases uniformly within ±1/√in, the default of the library of the published training;
    `unit` draws weights within ±√(3/in), which preserves the variance from layer to layer, and sets biases to zero.
    `joints` are the inputs, in the robot's order; unless given, those that move a link.
    """
    check_output(frame, layout)
    seen = network_joints(robot) if joints is None else tuple(joints)
    links = robot.aero_links.count
    known = block_sizes(len(seen), links)
    sizes = [sum(known[block] for block in blocks), *hidden, 3 * links]
    layers = []
    for narrow, wide in itertools.pairwise(sizes):
        key, for_weight, for_bias = jax.random.split(key, 3)
        small = 1.0 / np.sqrt(narrow)
        bound, most = (small, small) if start == "published" else (np.sqrt(3.0) * small, 0.0)
        weight = jax.random.uniform(for_weight, (members, wide, narrow), jnp.float32, -bound, bound)
        layers.append(Layer(weight, jax.random.uniform(for_bias, (members, wide), jnp.float32, -most, most)))
    return Network(
        blocks=tuple(blocks),
        frame=frame,
        layout=layout,
        activation=activation,
        joints=seen,
        layers=tuple(layers),
        scale=jnp.ones(sizes[-1], jnp.float32),
        offset=jnp.zeros(sizes[-1], jnp.float32),
        mirror=mirror_of(robot, seen, blocks, layout, frame) if mirror else None,
        baseline=baseline,
    )


def check_output(frame: str, layout: str) -> None:
    """Refuse a layout that the frame does not allow.

    Raises
    ------
    ConfigError
        If frame and layout do not fit; the message names both.
    """
    possible = {"base": ("component", "link"), "link": ("link",)}
    if frame not in possible:
        raise ConfigError.of("frame", frame, f"one of {', '.join(possible)}")
    if layout not in possible[frame]:
        raise ConfigError.of("layout", layout, f"{' or '.join(possible[frame])}, in {frame} axes")


def members_output(network: Network, x: Float[Array, " x"]) -> Float[Array, " y"]:
    """Return the mean output of the members, before scaling."""
    activation = ACTIVATIONS[network.activation]
    h = jnp.broadcast_to(x, (network.members, *x.shape))
    for layer in network.layers[:-1]:
        h = activation(_affine(layer, h))
    return _affine(network.layers[-1], h).mean(0)


def _affine(layer: Layer, h: Array) -> Array:
    return jnp.einsum("moi,mi->mo", layer.weight, h) + layer.bias


def raw_output(network: Network, x: Float[Array, " x"]) -> Float[Array, " y"]:
    """Return the output [m²] in the network's own frame and layout, in the precision of its weights.

    f(x) = scale · mean over members + offset;   symmetric: (f(x) + M f(M x)) / 2
    """
    x = x.astype(network.scale.dtype)

    def scaled(one: Array) -> Array:
        return network.scale * members_output(network, one) + network.offset

    if network.mirror is None:
        return scaled(x)
    there = network.mirror.features.astype(x.dtype) @ x
    both = jax.vmap(scaled)(jnp.stack([x, there]))
    return 0.5 * (both[0] + network.mirror.output.astype(x.dtype) @ both[1])


def to_base_axes(
    frame: str, layout: str, y: Float[Array, " y"], rotations: Float[Array, "L 3 3"]
) -> Float[Array, "L 3"]:
    """Return the force areas of the links [m²] in base axes, from an output in its own frame and layout."""
    if layout == "link":
        vectors = y.reshape(-1, 3)
        return rotate(rotations, vectors) if frame == "link" else vectors
    drag, lift, side = y.reshape(3, -1)
    return jnp.stack([drag, side, lift], axis=-1)


def from_base_axes(
    frame: str, layout: str, areas: Float[Array, "L 3"], rotations: Float[Array, "L 3 3"]
) -> Float[Array, " y"]:
    """Return an output in its own frame and layout from areas in base axes, the inverse of `to_base_axes`.

    The sum of squares is preserved.
    """
    if layout == "link":
        return (rotate_back(rotations, areas) if frame == "link" else areas).reshape(-1)
    return areas[:, jnp.array([0, 2, 1])].T.reshape(-1)


def network_areas(
    network: Network, wind_b: Float[Array, "3"], joint_position: Float[Array, " s"], geometry: LinkGeometry
) -> Float[Array, "L 3"]:
    """Return the force areas `F / (ρ/2 |v|²)` of the links [m²], base axes.

    Parameters
    ----------
    wind_b
        Unit vector of the air's velocity relative to the base origin, base axes; see `unit_wind`.
    joint_position
        Positions of the input joints [rad].
    geometry
        Geometry of the links at these positions.
    """
    y = raw_output(network, features(network.blocks, wind_b, joint_position, geometry)).astype(wind_b.dtype)
    areas = to_base_axes(network.frame, network.layout, y, geometry.rotations)
    return areas if network.baseline is None else areas + baseline_areas(network.baseline, wind_b, geometry.axes)


def baseline_areas(
    coefficients: Float[Array, "L 6"], wind_b: Float[Array, "3"], axes_b: Float[Array, "L 3"]
) -> Float[Array, "L 3"]:
    """Return the force areas [m²] of the axisymmetric model in base axes, all links in the same wind."""
    one = jnp.ones((), wind_b.dtype)
    return axisymmetric_forces(Axisymmetric(one, coefficients), axes_b, jnp.broadcast_to(wind_b, axes_b.shape))


def network_forces(
    network: Network,
    robot: RobotModel,
    kin: Kinematics,
    joint_position: Float[Array, " n"],
    wind: Float[Array, "3"],
    air_density: Float[Array, ""],
) -> Float[Array, "L 3"]:
    """Return the forces on the links [N], inertial axes, for a wind velocity [m/s, inertial axes].

        F = ρ/2 |v|² R_B c(v/|v|, s),   v = wind − velocity of the base origin

    All links use the wind at the base origin: this defines the published model and is no approximation of ours.
    """
    base = kin.body_rotations[0]
    v_air_b = rotate_back(base, wind - kin.linear_velocities[0])
    seen = joint_position[jnp.array(network.joints)]
    areas = network_areas(network, unit_wind(v_air_b), seen, geometry_from_kinematics(robot, kin))
    forces: Array = 0.5 * air_density * jnp.sum(v_air_b**2) * rotate(base[None], areas)
    return forces


def with_precision(network: Network, dtype: Any) -> Network:
    """Return the network with weights, scale and offset in a precision; features and geometry keep theirs."""
    layers, scale, offset = with_dtype((network.layers, network.scale, network.offset), dtype)
    return replace(network, layers=layers, scale=scale, offset=offset)
