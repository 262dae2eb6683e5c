"""Pictures of a flight from MuJoCo's offscreen renderer, in software or on a GPU, without a window."""

from __future__ import annotations

import functools
import importlib
import os
import subprocess
import sys
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jax_aero.body.urdf import Vector
from jax_aero.view import Refused, drawing, require
from jax_aero.view.drawing import FIELD_OF_VIEW_DEG, SHADOW, SUN, Camera, Colour, Scales
from jax_aero.view.recording import Instant, Recording
from jax_aero.view.shapes import Shape, rotation_onto

Image = NDArray[np.uint8]

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


class Studio:
    """Renderer of a recording, and of a ghost in the same scene; a context manager, since it holds an OpenGL context.

    Parameters
    ----------
    recording
        Flight to show.
    width, height
        Size of the pictures [pixels].
    ghost
        Another flight, drawn translucent.
    """

    def __init__(
        self,
        recording: Recording,
        width: int,
        height: int,
        ghost: Recording | None = None,
    ) -> None:
        require(["mujoco", "OpenGL", "jax"], "drawing offscreen")
        backend = find_backend()
        os.environ["MUJOCO_GL"] = os.environ["PYOPENGL_PLATFORM"] = backend  # read when MuJoCo is first imported
        self.recording, self.ghost, self.width, self.height = recording, ghost, width, height
        self.scales = Scales()
        self.look = recording.look

        import mujoco  # type: ignore[import-untyped]

        from jax_aero.mujoco.model import order_of

        self._mj = mujoco
        self.model = display_model(recording, width, height, ghost)
        self.data = mujoco.MjData(self.model)
        flights = [flight for flight in (recording, ghost) if flight is not None]
        orders = [order_of(str(f.robot_path), tuple(f.robot.joint_names)) for f in flights]
        # The ghost's positions follow the robot's: seven of its base, then its joints.
        starts = (0, 7 + len(recording.robot.joint_names))
        self._flights = list(zip(flights, starts, [order.joints for order in orders], strict=False))
        self._cone = self.model.mesh("cone").id
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, self.model.mesh_quat[self._cone])
        self._cone_from_mesh = self.model.mesh_pos[self._cone].copy(), turn.reshape(3, 3)
        self._scene = mujoco.MjvScene(self.model, maxgeom=6000)
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        # Last, since everything with a context must be closed.
        self._context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        self._context.make_current()
        self._drawer = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawer)

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, *_: object) -> None:
        self._context.make_current()  # another studio's may be
        self._drawer.free()
        # Freed here explicitly, since at the end of the process it would be too late.
        del self._drawer, self._context

    def picture(self, time: float, camera: Camera, *, trail: bool = True) -> Image:
        """Return the picture at a time [s], (height, width, 3), without text."""
        mj, scene = self._mj, self._scene
        instant = self.recording.at(time)
        self._pose(time)
        view = mj.MjvCamera()
        view.type = mj.mjtCamera.mjCAMERA_FREE
        view.lookat[:] = camera.look_at
        view.azimuth, view.elevation, view.distance = camera.azimuth_deg, camera.elevation_deg, camera.distance
        mj.mjv_updateScene(self.model, self.data, self._option, None, view, mj.mjtCatBit.mjCAT_ALL, scene)
        self._add_shadow()
        self._add_forces(instant)
        self._add_plumes(instant)
        arrow = drawing.wind_arrow(instant, self.scales)
        if arrow is not None:
            self._arrow(arrow, 0.03, drawing.WIND)
        self._add_reference(instant, trail)
        pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        viewport = mj.MjrRect(0, 0, self.width, self.height)
        self._context.make_current()
        mj.mjr_render(viewport, scene, self._drawer)
        mj.mjr_readPixels(pixels, None, viewport, self._drawer)
        return np.ascontiguousarray(pixels[::-1])

    def pixels_per_metre(self, camera: Camera) -> float:
        """Return the scale of the picture at the distance of the point looked at [pixels/m]."""
        return drawing.focal_length(self.height) / camera.distance

    def _pose(self, time: float) -> None:
        for recording, start, joints in self._flights:
            s, t = recording.signals, recording.signals["time"]
            place = int(np.clip(np.searchsorted(t, time), 0, t.size - 1))
            qpos = self.data.qpos[start:]
            qpos[:3], qpos[3:7] = s["base_position"][place], s["base_quaternion"][place]
            qpos[joints] = s["joint_position"][place]
        self._mj.mj_kinematics(self.model, self.data)
        self._mj.mj_comPos(self.model, self.data)
        self._mj.mj_camlight(self.model, self.data)

    def _geom(self, kind: Any, size: Any, position: Any, rotation: Any, colour: Colour, opacity: float = 1.0) -> Any:
        scene = self._scene
        if scene.ngeom >= scene.maxgeom:
            return None
        geom = scene.geoms[scene.ngeom]
        rgba = np.array([*(part / 255.0 for part in colour), opacity], dtype=np.float32)
        self._mj.mjv_initGeom(geom, kind, np.asarray(size, float), position, np.asarray(rotation).reshape(9), rgba)
        geom.objtype = self._mj.mjtObj.mjOBJ_UNKNOWN  # no object of the model; MuJoCo leaves it as it was in memory
        geom.category = self._mj.mjtCatBit.mjCAT_DECOR  # casts no shadow
        scene.ngeom += 1
        return geom

    def _arrow(self, ends: Vector, radius: float, colour: Colour) -> None:
        arrow = drawing.arrow(ends, radius)
        if arrow is None:
            return
        rotation = rotation_onto(arrow.axis)
        half = 0.5 * (arrow.length - arrow.head)
        kind = self._mj.mjtGeom.mjGEOM_CYLINDER
        self._geom(kind, [radius, half, 0.0], ends[0] + half * arrow.axis, rotation, colour)
        self._cone_at(ends[1] - arrow.head * arrow.axis, rotation, arrow.head_radius, arrow.head, colour)

    def _cone_at(
        self, base: Vector, rotation: Vector, radius: float, height: float, colour: Colour, opacity: float = 1.0
    ) -> None:
        # A mesh has one size, but the matrix of a geom can scale it. MuJoCo keeps meshes in their principal axes.
        stretched = rotation * np.array([radius, radius, height])
        offset, turn = self._cone_from_mesh
        geom = self._geom(
            self._mj.mjtGeom.mjGEOM_MESH, np.zeros(3), base + stretched @ offset, np.eye(3), colour, opacity
        )
        if geom is not None:
            geom.mat[:] = stretched @ turn
            geom.dataid = 2 * self._cone

    def _add_shadow(self) -> None:
        """Draw every shape projected onto the ground along the light, with negligible thickness."""
        flatten = np.array([[1.0, 0.0, -SUN[0] / SUN[2]], [0.0, 1.0, -SUN[1] / SUN[2]], [0.0, 0.0, 1e-3]])
        for number, shape in enumerate(self.look.shapes):
            own = self.model.geom(f"shape_{number}").id
            position, rotation = self.data.geom_xpos[own], self.data.geom_xmat[own].reshape(3, 3)
            if shape.role == "strut" or position[2] < 0.0:
                continue
            kind = self.model.geom_type[own]
            geom = self._geom(kind, self.model.geom_size[own], flatten @ position, np.eye(3), SHADOW)
            if geom is not None:
                geom.dataid = 2 * self.model.geom_dataid[own]
                geom.pos[2] += 0.004
                geom.mat[:] = flatten @ rotation
                geom.specular = 0.0

    def _add_forces(self, instant: Instant) -> None:
        for ends in drawing.force_arrows(self.look, instant, self.scales):
            self._arrow(ends, 0.0105, drawing.FORCE)

    def _add_plumes(self, instant: Instant) -> None:
        plumes = drawing.plumes(self.look, instant, self.scales)
        for position, rotation, length in zip(*plumes, strict=True):
            if length > 1e-3:
                self._cone_at(position, rotation, drawing.PLUME_RADIUS, float(length), drawing.PLUME, 0.85)

    def _add_reference(self, instant: Instant, trail: bool) -> None:
        at = instant.com_setpoint
        for axis in np.eye(3):
            self._line(at - 0.28 * axis, at + 0.28 * axis, 0.006, drawing.REFERENCE)
        if trail:
            self._path("com_setpoint", instant.time + drawing.AHEAD, drawing.REFERENCE, 0.006)
            self._path("com_position", instant.time, drawing.TRAIL, 0.009)

    def _path(self, name: str, until: float, colour: Colour, radius: float) -> None:
        for start, end in pairwise(drawing.path(self.recording, name, until)):
            self._line(start, end, radius, colour)

    def _line(self, start: Vector, end: Vector, radius: float, colour: Colour) -> None:
        length = float(np.linalg.norm(end - start))
        kind = self._mj.mjtGeom.mjGEOM_CAPSULE
        rotation = rotation_onto((end - start) / length)
        self._geom(kind, [radius, 0.5 * length, 0.0], 0.5 * (start + end), rotation, colour)


def display_model(recording: Recording, width: int, height: int, ghost: Recording | None = None) -> Any:
    """Return MuJoCo's model of the robot from `mujoco_model`, which has no geometry, with shapes for pictures.

    A ghost is a second robot in it, with names that begin with `ghost_`.
    """
    spec = _robot_spec(recording, is_ghost=False)
    if ghost is not None:
        other = _robot_spec(ghost, is_ghost=True)
        spec.attach(other, prefix="ghost_", frame=spec.worldbody.add_frame())
    cone = drawing.cone()
    _add_mesh(spec, "cone", cone.vertices, cone.faces)
    _add_world(spec, width, height)
    return spec.compile()


def _robot_spec(recording: Recording, *, is_ghost: bool) -> Any:
    """Return a robot with the shapes of its look, coloured by role or as a ghost."""
    import mujoco

    from jax_aero.mujoco.model import mujoco_spec

    spec = mujoco_spec(str(recording.robot_path))
    spec.compiler.discardvisual = False
    types = {
        "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
        "box": mujoco.mjtGeom.mjGEOM_BOX,
        "mesh": mujoco.mjtGeom.mjGEOM_MESH,
    }
    names = recording.robot.body_names
    for number, shape in enumerate(recording.look.shapes):
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, shape.body_from_shape.rotation.reshape(9))
        colour = drawing.GHOST if is_ghost else drawing.ROLES[shape.role]
        geom = spec.body(names[shape.body]).add_geom(
            name=f"shape_{number}",
            type=types[shape.kind],
            pos=shape.body_from_shape.position,
            quat=quaternion,
            rgba=[*(part / 255.0 for part in colour), 0.35 if is_ghost else 1.0],
            contype=0,
            conaffinity=0,
            mass=0.0,
        )
        if shape.mesh is None:
            geom.size = _mujoco_size(shape)
        else:
            geom.meshname = f"mesh_{number}"
            _add_mesh(spec, geom.meshname, shape.mesh.vertices * shape.size, shape.mesh.faces)
    return spec


def _add_mesh(spec: Any, name: str, vertices: Vector, faces: Any) -> None:
    import mujoco

    spec.add_mesh(
        name=name,
        uservert=vertices.reshape(-1).tolist(),
        userface=faces.reshape(-1).tolist(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )


def _mujoco_size(shape: Shape) -> list[float]:
    x, y, z = shape.size
    return {"cylinder": [x, 0.5 * z, 0.0], "sphere": [x, 0.0, 0.0], "box": [0.5 * x, 0.5 * y, 0.5 * z]}[shape.kind]


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
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        targetbody=world.first_body().name,
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
