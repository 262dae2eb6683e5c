"""Write `network_small.*`: a network of random weights with every kind of feature, and what JAX makes of it.

    python rust/core/tests/data/make_network.py

The crate's tests read the card, the weights, and the answers; they need no Python for it.
"""

import json
from pathlib import Path

import jax
import numpy as np

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[3]
CASES = 4


def main():
    """Write card, weights and answers beside this file."""
    jax.config.update("jax_enable_x64", True)
    from jax_aero.aero.network import init_network, link_geometry, network_areas, wind_direction, with_precision
    from jax_aero.aero.network_card import load_network, save_network
    from jax_aero.robot import load_robot

    robot = load_robot(ROOT / "configs" / "robot" / "ironcub_mk1.toml")
    sets = robot.aero_links.coefficients["corrected"]
    network = init_network(
        jax.random.key(3),
        robot,
        hidden=(5, 9),
        blocks=("link_shadow", "wind", "joints", "link_position", "link_wind"),
        activation="silu",
        members=2,
        mirror=True,
        frame="link",
        layout="link",
        baseline=sets,
    )
    card = HERE / "network_small.json"
    save_network(card, network, robot, description="Random weights; a test's.", training={"note": "not trained"})
    network = load_network(card, robot)
    rng = np.random.default_rng(20260104)
    cases = []
    for _ in range(CASES):
        joints, v_air_b = rng.uniform(-0.7, 0.7, robot.n_joints), rng.normal(size=3) * 8.0
        case = {"joint_position": joints, "v_air_b": v_air_b}
        for precision, dtype in (("f32", np.float32), ("f64", np.float64)):
            chosen, seen = with_precision(network, dtype), joints[list(network.joints)]
            case[precision] = network_areas(chosen, wind_direction(v_air_b), seen, link_geometry(robot, joints))
        cases.append({name: np.asarray(value).tolist() for name, value in case.items()})
    (HERE / "network_small_areas.json").write_text(json.dumps(cases, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
