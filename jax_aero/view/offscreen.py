"""Pictures of a flight from MuJoCo's offscreen renderer, in software or on a GPU, without a window."""

from __future__ import annotations

import functools
import importlib
import itertools
import os
import subprocess
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jax_aero.view import Refused, require
from jax_aero.view.drawing import FIELD_OF_VIEW_DEG, SUN, Camera, Scene, Solid, shadow_of
from jax_aero.view.recording import Recording
from jax_aero.view.shapes import rotation_onto

BACKENDS = ("egl", "osmesa")
GROUND = 400.0  # m, half the edge length


_PROBE = """
import importlib, sys
context = importlib.import_module("mujoco." + sys.argv[1]).GLContext(16, 16)
context.make_current()
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco/>")
mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
"""


@functools.lru_cache
def find_backend() -> str:
    """Return the first working offscreen backend: `MUJOCO_GL` if set, otherwise EGL, then OSMesa.

    Each is tried in a separate process, since an unusable library may crash it.

    Raises
    ------
    Refused
        If none works.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    candidates = (wanted,) if wanted in BACKENDS else BACKENDS
    for backend in candidates:
        environment = os.environ | {"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
        try:
            answer = subprocess.run(
                [sys.executable, "-c", _PROBE, backend], env=environment, capture_output=True, check=False, timeout=60
            )
        except subprocess.TimeoutExpired:
            continue
        if answer.returncode == 0:
            return backend
    raise Refused(
        f"no offscreen OpenGL here (tried {', '.join(candidates)}); install EGL or OSMesa, e.g. the Debian packages "
        "`libegl1 libgl1-mesa-dri` or `libosmesa6`"
    )


class Studio(Scene):
    """Renderer of a scene, which holds an OpenGL context.

    MuJoCo's model has the ground, the sky and the meshes, which a picture places.
    """

    def __init__(self, recording: Recording, width: int, height: int, ghost: Recording | None = None) -> None:
        require(["mujoco", "OpenGL"], "drawing offscreen")
        backend = find_backend()
        os.environ["MUJOCO_GL"] = os.environ["PYOPENGL_PLATFORM"] = backend  # read when MuJoCo is first imported
        super().__init__(recording, width, height, ghost)
        import mujoco  # type: ignore[import-untyped]

        self._mj = mujoco
        spec, meshes = mujoco.MjSpec(), {id(mesh): mesh for mesh in itertools.chain(*self.meshes)}
        for key, mesh in (meshes | {id(mesh): mesh for mesh in (self.cylinder, self.cone)}).items():
            spec.add_mesh(
                name=str(key),
                uservert=mesh.vertices.reshape(-1).tolist(),
                userface=mesh.faces.reshape(-1).tolist(),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
        _add_world(spec, width, height)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self._scene = mujoco.MjvScene(self.model, maxgeom=6000)
        # Last, since everything with a context must be closed.
        self._context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        self._context.make_current()
        self._drawer = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawer)

    def __exit__(self, *_: object) -> None:
        self._context.make_current()  # another studio's may be
        self._drawer.free()
        # Freed here explicitly, since at the end of the process it would be too late.
        del self._drawer, self._context

    def picture(self, time: float, camera: Camera, *, trail: bool = True, forces: bool = True) -> NDArray[np.uint8]:
        """Return the picture at a time [s], (height, width, 3), without text; `forces` are those of the air."""
        mj, scene = self._mj, self._scene
        view = mj.MjvCamera()
        view.type = mj.mjtCamera.mjCAMERA_FREE
        view.lookat[:] = camera.look_at
        view.azimuth, view.elevation, view.distance = camera.azimuth_deg, camera.elevation_deg, camera.distance
        mj.mjv_updateScene(self.model, self.data, mj.MjvOption(), None, view, mj.mjtCatBit.mjCAT_ALL, scene)
        for solid in self.bodies(time):
            if solid.has_shadow:
                self._add(shadow_of(solid), specular=0.0)
            self._add(solid)
        for solid in self.arrows(time, forces=forces):
            self._add(solid)
        for line in self.lines(time, trail=trail):
            for start, end in itertools.pairwise(line.points):
                length = float(np.linalg.norm(end - start))
                stretch = rotation_onto((end - start) / length) * [line.radius, line.radius, length]
                self._add(Solid(self.cylinder, 0.5 * (start + end), stretch, line.colour))
        pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        viewport = mj.MjrRect(0, 0, self.width, self.height)
        self._context.make_current()
        mj.mjr_render(viewport, scene, self._drawer)
        mj.mjr_readPixels(pixels, None, viewport, self._drawer)
        return np.ascontiguousarray(pixels[::-1])

    def _add(self, solid: Solid, specular: float = 0.5) -> None:
        """Add a solid to the scene, while the scene has free places; MuJoCo keeps meshes in their principal axes."""
        scene, own = self._scene, self.model.mesh(str(id(solid.mesh))).id
        if scene.ngeom >= scene.maxgeom:
            return
        turn = np.zeros(9)
        self._mj.mju_quat2Mat(turn, self.model.mesh_quat[own])
        place = solid.position + solid.stretch @ self.model.mesh_pos[own]
        rgba = np.array([*(part / 255.0 for part in solid.colour), solid.opacity], dtype=np.float32)
        geom = scene.geoms[scene.ngeom]
        self._mj.mjv_initGeom(geom, self._mj.mjtGeom.mjGEOM_MESH, np.zeros(3), place, np.eye(3).reshape(9), rgba)
        geom.mat[:] = solid.stretch @ turn.reshape(3, 3)
        geom.dataid = 2 * own
        geom.specular = specular
        geom.objtype = self._mj.mjtObj.mjOBJ_UNKNOWN  # no object of the model; MuJoCo leaves it as it was in memory
        geom.category = self._mj.mjtCatBit.mjCAT_DECOR  # casts no shadow
        scene.ngeom += 1


def _add_world(spec: Any, width: int, height: int) -> None:
    """Add a ground with lines every metre, sky and sun."""
    import mujoco

    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.74, 0.85, 0.95],
        rgb2=[0.97, 0.98, 0.99],
        width=256,
        height=256,
    )
    spec.add_texture(
        name="ground",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.86, 0.87, 0.88],
        rgb2=[0.82, 0.83, 0.85],
        markrgb=[0.7, 0.72, 0.75],
        width=512,
        height=512,
    )
    textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
    textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "ground"
    spec.add_material(name="ground", textures=textures, texrepeat=[1.0, 1.0], texuniform=True, reflectance=0.0)
    world = spec.worldbody
    world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[GROUND, GROUND, 1.0], material="ground", contype=0, conaffinity=0
    )
    world.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[-1.5, -2.0, 6.0],
        dir=list(SUN),
        diffuse=[0.55, 0.55, 0.55],
        ambient=[0.1, 0.1, 0.1],
        specular=[0.1, 0.1, 0.1],
        castshadow=False,  # shadow maps cost half the time and speckle; `Studio` draws its own
    )
    spec.visual.headlight.ambient = [0.38, 0.38, 0.38]
    spec.visual.headlight.diffuse = [0.3, 0.3, 0.3]
    spec.visual.headlight.specular = [0.0, 0.0, 0.0]
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.global_.fovy = FIELD_OF_VIEW_DEG
    spec.visual.quality.offsamples = 4
    # Relative to this extent, which would otherwise be that of the large ground.
    spec.stat.extent = 2.0
    spec.stat.center = [0.0, 0.0, 1.0]
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 200.0
    spec.visual.map.haze = 0.3
