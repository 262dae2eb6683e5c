"""Measure forward dynamics and its gradient in several libraries: `python -m experiments.tools.bench_peers`.

The robot is iRonCub-Mk1, with a torque at every joint, in random states. The benchmark is refused unless accelerations,
and their gradients by the joint positions, are those of our JAX. JAX, MJX and JaxSim compute a batch in one call; crate
and Pinocchio are called from Python for each state. JaxSim is installed into `target/peers` and uses our JAX. Times are
processor times, in which other programs do not count. Prints all of it; `--store` keeps it.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import logging
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from experiments.tools import bench
from jax_aero import rust
from jax_aero.base import files, places
from jax_aero.base.arguments import count
from jax_aero.base.terminal import REFUSED, Refused
from jax_aero.body import mujoco_model as mujoco
from jax_aero.body.dynamics import dynamics, forward_dynamics
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import RobotModel, load_robot
from jax_aero.body.spatial import rotation_from_wxyz
from jax_aero.results import manifest
from jax_aero.results.study import listing
from jax_aero.stored import keep
from jax_aero.types import State

untyped: Any = jax
"""JAX, for the parts of it that have no types."""
Numbers = NDArray[np.float64]
Accelerate = Callable[[Any, Any, Any, Any], Any]
"""ν̇ of base position, quaternion wxyz, joint positions and ν."""

NAME, TITLE = "bench_peers", "Forward dynamics and its gradient in several libraries"
FORWARD, GRADIENT, DIFFERENCE = "forward dynamics [µs]", "its gradient [µs]", "largest difference"
BATCH, TORQUE = 64, 1.0
TOLERANCE = 1e-9
"""Greatest difference, relative to the largest number of ours."""
FOLDER = places.HOME / "target" / "peers"
PACKAGES = """jaxsim==0.9.0 rod==0.5.0 jax-dataclasses==1.6.3 jaxlie==1.5.0 optax==0.2.8 qpax==0.1.4 equinox==0.13.8
wadler-lindig==0.1.8 chex==0.1.92 toolz==1.2.0 absl-py==2.5.1 mashumaro==3.23 xmltodict==1.0.4 packaging==26.4
resolve-robotics-uri-py==0.6.1 coloredlogs==15.0.1 humanfriendly==10.0 pptree==3.1"""
"""JaxSim and what it imports, but for what we have."""


class Peer(NamedTuple):
    """What a library computes of all states, and how it is called."""

    accelerations: Numbers
    """ν̇ (batch, 6 + n) [m/s², rad/s²]."""
    gradient: Numbers | None
    """Gradient of the sum of their squares by the joint positions (batch, n)."""
    forward: Callable[[], Any]
    backward: Callable[[], Any] | None = None
    compiled: dict[str, float] | None = None
    """Processor times of compilation [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m experiments.tools.bench_peers", description=__doc__)
    parser.add_argument("--turns", type=count, default=40, help="number of runs of everything (default 40)")
    parser.add_argument("--store", action="store_true", help="store what is measured")
    given = parser.parse_args(arguments)
    untyped.config.update("jax_enable_x64", True)
    untyped.config.update("jax_enable_compilation_cache", False)
    robot = load_robot(places.CONFIGS / "robot" / "ironcub_mk1.toml")
    states = draw(robot, BATCH)
    peers = {"crate": of_crate(robot, states), "JAX": of_jax(ours(robot), states), "MJX": of_jax(mjx(robot), states)}
    try:
        peers["JaxSim"] = of_jax(jaxsim(robot), states)
    except (Refused, ImportError) as reason:
        print(f"JaxSim is not measured: {reason}")
    peers["Pinocchio"] = of_pinocchio(robot, states)
    try:
        figures = measure(peers, given.turns)
    except Refused as reason:
        print(f"error: {reason}", file=sys.stderr)
        return REFUSED
    print(listing(figures))
    if given.store:
        versions = ", ".join(f"{name} {manifest.version_of(name)[name]}" for name in ("jax", "mujoco-mjx", "pin"))
        about = f"{manifest.device()['cpu']}; {versions}, {PACKAGES.split()[0].replace('==', ' ')}"
        command = "taskset -c 0 python -m experiments.tools.bench_peers --store"
        keep.benchmark(NAME, TITLE, about, command, figures)
    return 0


def measure(peers: Mapping[str, Peer], turns: int) -> dict[str, dict[str, float]]:
    """Return figures by library, of the fastest of some runs in turns.

    Raises
    ------
    Refused
        Naming a library that computes something else than JAX.
    """
    figures = {name: difference(name, peer, peers["JAX"]) | (peer.compiled or {}) for name, peer in peers.items()}
    for _, (name, peer) in itertools.product(range(turns), peers.items()):
        for figure, run in ((FORWARD, peer.forward), (GRADIENT, peer.backward)):
            if run is not None:
                started = time.process_time()
                run()
                taken = 1e6 * (time.process_time() - started) / len(peer.accelerations)
                figures[name][figure] = min(figures[name].get(figure, np.inf), taken)
    return figures


def difference(name: str, peer: Peer, own: Peer) -> dict[str, float]:
    """Return the largest difference of accelerations, relative to the largest one; refuse what is above `TOLERANCE`."""
    worst = {}
    for what in ("accelerations", "gradient"):
        theirs, ours = getattr(peer, what), getattr(own, what)
        if theirs is not None:
            worst[what] = float(np.max(np.abs(theirs - ours)) / np.max(np.abs(ours)))
            if not worst[what] <= TOLERANCE:
                raise Refused(f"{name} and JAX differ in {what} by {worst[what]:.2g} of the largest; expected none")
    return {DIFFERENCE: worst["accelerations"]}


def draw(robot: RobotModel, batch: int) -> tuple[Numbers, ...]:
    """Return random states within the joints' limits: positions [m], quaternions wxyz, joints [rad], ν [m/s, rad/s]."""
    rng = np.random.default_rng(0)
    wxyz = rng.normal(size=(batch, 4))
    low, high = np.asarray(robot.joint_limits, np.float64).T
    joints = rng.uniform(low, high, size=(batch, robot.n_joints))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    return rng.normal(size=(batch, 3)), wxyz, joints, rng.normal(size=(batch, robot.n_velocities))


def force_of(robot: RobotModel) -> Numbers:
    """Return the generalised force (6 + n) [N, N m]: torques alone."""
    return np.concatenate([np.zeros(6), np.full(robot.n_joints, TORQUE)])


# --- libraries ------------------------------------------------------------------------------------------------------


def of_crate(robot: RobotModel, states: Sequence[Numbers]) -> Peer:
    """Return the crate, which has no gradient."""
    crate, force = rust.Robot(robot.source), force_of(robot)
    rows: list[Any] = [(p, np.asarray(rotation_from_wxyz(w)), s, v) for p, w, s, v in zip(*states, strict=True)]
    accelerations = np.array([crate.forward_dynamics(row, force) for row in rows])
    return Peer(accelerations, None, lambda: [crate.forward_dynamics(row, force) for row in rows])


def of_pinocchio(robot: RobotModel, states: Sequence[Numbers]) -> Peer:
    """Return Pinocchio, which differentiates every acceleration by the whole state and the torques."""
    pin: Any = importlib.import_module("pinocchio")
    model = pin.buildModelFromXML(rust.Robot(robot.source).urdf_text, pin.JointModelFreeFlyer())
    model.gravity.linear = np.array([0.0, 0.0, -robot.gravity])
    data, joints = model.createData(), [model.joints[model.getJointId(name)] for name in robot.joint_names]
    dofs = np.array([*range(6), *(joint.idx_v for joint in joints)])
    force, rows, accelerations, by_joints = np.zeros(model.nv), [], [], []
    force[dofs] = force_of(robot)
    for position, wxyz, angles, velocity in zip(*states, strict=True):
        q, v, axes = np.zeros(model.nq), np.zeros(model.nv), np.eye(model.nv)
        axes[:3, :3] = axes[3:6, 3:6] = rotation_from_wxyz(wxyz)
        q[:7] = [*position, *wxyz[1:], wxyz[0]]
        q[[joint.idx_q for joint in joints]] = angles
        v[dofs] = axes.T @ velocity
        rows.append((q, v))
        turning = np.pad(np.cross(velocity[3:6], velocity[:3]), (0, model.nv - 3))  # its velocity is in base axes
        accelerations.append(axes @ pin.aba(model, data, q, v, force)[dofs] + turning)
        jacobian = pin.computeABADerivatives(model, data, q, v, force)[0][np.ix_(dofs, dofs[6:])]
        by_joints.append(2.0 * accelerations[-1] @ axes @ jacobian)
    return Peer(
        np.array(accelerations),
        np.array(by_joints),
        lambda: [pin.aba(model, data, q, v, force) for q, v in rows],
        lambda: [pin.computeABADerivatives(model, data, q, v, force) for q, v in rows],
    )


def of_jax(accelerate: Accelerate, states: Sequence[Numbers]) -> Peer:
    """Return compiled functions of the whole batch; the gradient is that in reverse mode by the whole state."""
    batch = tuple(map(jnp.asarray, states))
    gradient = jax.grad(lambda *state: jnp.sum(accelerate(*state) ** 2), argnums=(0, 1, 2, 3))
    started = time.process_time()
    forward: Any = jax.jit(jax.vmap(accelerate)).lower(*batch).compile()
    between = time.process_time()
    backward: Any = jax.jit(jax.vmap(gradient)).lower(*batch).compile()
    times = {"compile [s]": between - started, "compile, gradient [s]": time.process_time() - between}
    accelerations, by_joints = np.asarray(forward(*batch)), np.asarray(backward(*batch)[2])
    wait = untyped.block_until_ready
    return Peer(accelerations, by_joints, lambda: wait(forward(*batch)), lambda: wait(backward(*batch)), times)


def ours(robot: RobotModel) -> Accelerate:
    """Return our forward dynamics in JAX."""

    def accelerate(position: Any, wxyz: Any, joints: Any, velocity: Any) -> Any:
        state = State(position, rotation_from_wxyz(wxyz), joints, velocity)
        return forward_dynamics(dynamics(robot, state, kinematics(robot, state)), jnp.asarray(force_of(robot)))

    return accelerate


def mjx(robot: RobotModel) -> Accelerate:
    """Return MJX's forward dynamics of our MuJoCo model, whose angular velocity of the base is in base axes."""
    order, compiled = mujoco.order_of(robot.source, robot.joint_names), mujoco.mujoco_model(robot.source)
    model, start = mujoco.mjx.put_model(compiled), mujoco.mjx.make_data(compiled)
    force = jnp.zeros(compiled.nv).at[order.dofs].set(force_of(robot))

    def accelerate(position: Any, wxyz: Any, joints: Any, velocity: Any) -> Any:
        turn = rotation_from_wxyz(wxyz)
        rates = jnp.concatenate([velocity[:3], turn.T @ velocity[3:6], velocity[6:]])
        qpos = jnp.zeros(compiled.nq).at[:7].set(jnp.concatenate([position, wxyz])).at[order.joints].set(joints)
        data = start.replace(qpos=qpos, qvel=jnp.zeros(compiled.nv).at[order.dofs].set(rates), qfrc_applied=force)
        acceleration = mujoco.mjx.forward(model, data).qacc[order.dofs]
        return jnp.concatenate([acceleration[:3], turn @ acceleration[3:6], acceleration[6:]])

    return accelerate


def jaxsim(robot: RobotModel) -> Accelerate:
    """Return JaxSim's articulated-body algorithm; install it if it is not there."""
    if not FOLDER.is_dir():
        with files.complete_folder(FOLDER) as folder:
            pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(folder)]
            bench.run([*pip, *PACKAGES.split()], limit=bench.PIP_LIMIT)
    logging.disable(logging.INFO)
    sys.path.append(str(FOLDER))  # what our environment has comes first
    js: Any = importlib.import_module("jaxsim.api")
    model = js.model.JaxSimModel.build_from_model_description(to_sdf(robot), gravity=float(robot.gravity))
    order = np.array([robot.joint_names.index(name) for name in model.joint_names()])

    def accelerate(position: Any, wxyz: Any, joints: Any, velocity: Any) -> Any:
        base, rates, torques = velocity[:6], velocity[6:][order], jnp.asarray(force_of(robot)[6:][order])
        mixed = js.data.JaxSimModelData.build(model, position, wxyz, joints[order], base[:3], base[3:], rates)
        of_base, acceleration = js.model.forward_dynamics_aba(model, mixed, joint_forces=torques)
        return jnp.concatenate([of_base, acceleration[np.argsort(order)]])

    return accelerate


def to_sdf(robot: RobotModel) -> str:
    """Return the moving bodies and joints of a robot in SDF; all axes are those of the base at joint position zero."""
    n, parts = robot.n_joints, []
    rest = rust.State(np.zeros(3), np.eye(3), np.zeros(n), np.zeros(6 + n))
    zero = rust.dynamics(rust.Robot(robot.source), rest)
    for body, (name, turn) in enumerate(zip(robot.body_names, zero.body_rotations, strict=True)):
        tensor = turn @ robot.inertias[body] @ turn.T
        moments = {f"i{'xyz'[i]}{'xyz'[j]}": tensor[i, j] for i, j in zip(*np.triu_indices(3), strict=True)}
        inertia = "".join(f"<{key}>{_words(value)}</{key}>" for key, value in moments.items())
        inertial = f"<pose>{_words(turn @ robot.coms[body])} 0 0 0</pose><mass>{_words(robot.masses[body])}</mass>"
        pose = f"<pose>{_words(zero.body_positions[body])} 0 0 0</pose>"
        parts.append(f'<link name="{name}">{pose}<inertial>{inertial}<inertia>{inertia}</inertia></inertial></link>')
    for joint, (name, is_prismatic) in enumerate(zip(robot.joint_names, robot.joint_is_prismatic, strict=True)):
        above, below = robot.body_names[robot.parent[joint + 1]], robot.body_names[joint + 1]
        ends = f"<parent>{above}</parent><child>{below}</child>"
        low, high = map(_words, robot.joint_stops[joint])
        axis = f"<xyz>{_words(zero.body_rotations[joint + 1] @ robot.joint_axes[joint])}</xyz>"
        axis += f"<limit><lower>{low}</lower><upper>{high}</upper></limit>"
        kind = "prismatic" if is_prismatic else "revolute"
        parts.append(f'<joint name="{name}" type="{kind}">{ends}<axis>{axis}</axis></joint>')
    return f'<sdf version="1.10"><model name="{robot.name}">{"".join(parts)}</model></sdf>'


def _words(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


if __name__ == "__main__":
    sys.exit(main())
