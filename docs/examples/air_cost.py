"""Cost of the air beside a step of MuJoCo Warp, of the humanoid in `humanoid.xml`: medians of turns in one run."""

import time
from statistics import median

import mujoco
import mujoco_warp
import numpy as np
import warp as wp

from jax_aero import air, air_warp

TURNS = 15


def links(model):
    """One link for every capsule, and a sphere for the head."""
    for geom in range(model.ngeom):
        body, radius = model.body(model.geom_bodyid[geom]).name, model.geom_size[geom, 0]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
            yield air.Link(
                body, 2.0 * radius, 2.0 * (radius + model.geom_size[geom, 1]), turn[2::3], model.geom_pos[geom]
            )
        elif body == "torso_link":
            yield air.Link(body, 2.0 * radius, centre=model.geom_pos[geom])


def seconds(function, *arguments):
    """Duration of a call, with all that it started on the device."""
    wp.synchronize()
    began = time.perf_counter()
    function(*arguments)
    wp.synchronize()
    return time.perf_counter() - began


def main():
    """Print a row for each number of worlds."""
    model = mujoco.MjModel.from_xml_path("docs/examples/humanoid.xml")
    declared = list(links(model))
    print(f"| worlds | step | air on {len(declared)} links | |\n|---|---|---|---|")
    for count in (1, 64, 1024):
        worlds, data = mujoco_warp.put_model(model), mujoco_warp.make_data(model, nworld=count)
        blow = air_warp.MujocoWarpAir(air.from_links(model, declared), data)
        blow.wind.assign(np.full((count, 3), 4.0))
        turns = [(seconds(mujoco_warp.step, worlds, data), seconds(blow, worlds, data)) for _ in range(TURNS)]
        step, wind = (1e3 * median(times) for times in zip(*turns[2:], strict=True))
        print(f"| {count} | {step:.1f} ms | {wind:.2f} ms | {100.0 * wind / step:.1f} % |")


if __name__ == "__main__":
    main()
