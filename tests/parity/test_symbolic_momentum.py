"""Each implementation against the symbolic derivation, which shares no expression with it: all terms, to 1e-9.

An implementation is a function from (robot file, aerodynamic table) to a function from a state to its terms by name;
`IMPLEMENTATIONS` lists them. What is said nothing about is not compared.
"""

from pathlib import Path

import jax
import numpy as np
import pytest

from jax_aero import rust
from jax_aero.aero import LinkConventions, aero_model, link_forces
from jax_aero.base.typed_config import scenario_config
from jax_aero.body.dynamics import dynamics
from jax_aero.body.kinematics import kinematics
from jax_aero.body.robot import load_robot as twin_robot
from jax_aero.control.law.momentum import momentum_model
from jax_aero.rust import Controller
from jax_aero.symbolic import MomentumModel, load_robot
from jax_aero.types import State as TwinState
from tests.aero_kinds import OF_LINKS
from tests.parity.fitted import fitted

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = ("ironcub_mk1", "sparrow", "slider")
TOLERANCE = 1e-9
COUNT = 60
"""States of each robot in each model of the air."""


def crate(path, aero):
    """The Rust crate, through one tick of its controller."""
    controller = Controller(fitted("test2", path, aero)[1])

    def terms(state, thrust, wind):
        tick = controller.tick(state, thrust, wind)
        same = ("com_position", "mass_matrix", "bias", "momentum_matrix", "momentum", "centroidal_inertia")
        found = {name: getattr(tick, name) for name in (*same, "aero_force", "a_t", "lambda_t", "lambda_a")}
        return found | {
            "momentum_rate": tick.momentum_rate_estimate,
            "joint_acceleration_free": tick.joint_acceleration_free,
        }

    return terms


def twin(path, aero):
    """The JAX implementation, one compiled function of a state."""
    with jax.enable_x64(True):
        config = scenario_config(fitted("test2", path, aero)[1])
        robot = twin_robot(path)
        model = aero_model(config.controller.aero, robot)

    @jax.jit
    def evaluate(state, thrust, wind):
        kin = kinematics(robot, state)
        dyn = dynamics(robot, state, kin)
        link = link_forces(model, robot, kin, LinkConventions(), wind)
        momentum = momentum_model(robot, kin, dyn, thrust, link)
        found = dyn._asdict() | {"com_position": kin.com, "aero_force": link.forces}
        found |= {"a_t": momentum.a_t, "lambda_t": momentum.lambda_t, "lambda_a": momentum.lambda_a}
        return found | {"momentum_rate": momentum.rate_estimate}

    def terms(state, thrust, wind):
        with jax.enable_x64(True):
            return {name: np.asarray(value) for name, value in evaluate(TwinState(*state), thrust, wind).items()}

    return terms


IMPLEMENTATIONS = {"rust": crate, "jax": twin}


def aero_tables(robot_name):
    others = [rust.load_aero(name) for kind, name in OF_LINKS.items() if kind != "axisymmetric"]
    sets = load_robot(ROOT / f"configs/robot/{robot_name}.toml").coefficients
    printed = [{"model": "axisymmetric", "coefficients": name, "air_density": 1.225} for name in sorted(sets)]
    return [*others, *printed]


CASES = [
    pytest.param(name, table, id="-".join([name, table["model"], table.get("coefficients", "")]).rstrip("-"))
    for name in ROBOTS
    for table in aero_tables(name)
]


TWIN_CASES = {("ironcub_mk1", "axisymmetric", "corrected"), ("sparrow", "sphere_cylinder", None)}
"""Cases of the JAX implementation: both robots, both models. The others differ in numbers that the kernel tests
vary, and each would compile again."""


def list_implementations(case):
    """Yield a case with every implementation that it is compared with."""
    robot_name, aero = case.values
    for implementation in IMPLEMENTATIONS:
        if implementation != "jax" or (robot_name, aero["model"], aero.get("coefficients")) in TWIN_CASES:
            yield pytest.param(implementation, robot_name, aero, id=f"{case.id}-{implementation}")


@pytest.mark.parametrize(
    ("implementation", "robot_name", "aero"), [x for case in CASES for x in list_implementations(case)]
)
def test_every_term_of_a_state(implementation, robot_name, aero, random_states, agree):
    path = ROOT / f"configs/robot/{robot_name}.toml"
    derived = MomentumModel(load_robot(path), aero)
    theirs = IMPLEMENTATIONS[implementation](path, aero)
    rng = np.random.default_rng(7)
    for index, (state, _) in enumerate(random_states):
        if index == COUNT:
            break
        thrust = rng.uniform(0.0, 220.0, len(derived.robot.jets))
        # Storms, breezes and still air: every branch of the sphere/cylinder tables.
        wind = rng.normal(size=3) * (0.0, 1.0, 10.0, 40.0)[index % 4]
        terms = derived.terms(*state, thrust, wind)
        ours = terms._asdict() | {"joint_acceleration_free": _free(terms)}
        for name, value in theirs(state, thrust, wind).items():
            # Relative to the largest entry; below one newton or metre, absolute.
            scale = max(1.0, float(np.max(np.abs(value))))
            agree(f"{implementation} = symbolic: {name}", ours[name] / scale, value / scale, TOLERANCE)


def _free(terms):
    """Joint accelerations without torque, M⁻¹(Σ Jᵀ f − h): they see every generalised force."""
    force = terms.jet_generalised + terms.aero_generalised - terms.bias
    return np.linalg.solve(terms.mass_matrix, force)[6:]
