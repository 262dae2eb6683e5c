// The scene: robot, ghost, thrusts, forces, wind, trail; three.js, z up.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { bytes } from "./lab.js";

const THEMES = {
  light: { sky: 0xd5e4f0, ground: 0xe4e8ec, fine: 0xb9c0c8, coarse: 0x7d8792, ink: "#3a4450", light: 2.2 },
  dark: { sky: 0x10161d, ground: 0x171e26, fine: 0x303b48, coarse: 0x55657a, ink: "#b8c4d0", light: 1.5 },
};
const FOLLOWED = 0.75; // height at which the followed centre of mass is drawn [m]
const TRAIL = 4000; // points
const STREAKS = 90;
const REACH = 4; // half the box of the streaks [m]
const UP = new THREE.Vector3(0, 0, 1);

const colour = ([r, g, b]) => new THREE.Color(r / 255, g / 255, b / 255).convertSRGBToLinear();

/** An arrow from a point along a vector. */
class Arrow extends THREE.Group {
  constructor(material, radius) {
    super();
    this.shaft = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 1, 12).rotateX(Math.PI / 2), material);
    this.head = new THREE.Mesh(new THREE.ConeGeometry(2.6 * radius, 1, 16).rotateX(Math.PI / 2), material);
    this.tip = 7 * radius;
    this.add(this.shaft, this.head);
  }

  show(tail, vector) {
    const length = vector.length();
    this.visible = length > 1e-3;
    if (!this.visible) return;
    const head = Math.min(this.tip, 0.6 * length);
    this.position.copy(tail);
    this.quaternion.setFromUnitVectors(UP, vector.clone().divideScalar(length));
    this.shaft.scale.z = length - head;
    this.shaft.position.z = 0.5 * (length - head);
    this.head.scale.z = head;
    this.head.position.z = length - 0.5 * head;
  }
}

/** A line that grows; its points are written in place. */
class Path extends THREE.Line {
  constructor(material) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * TRAIL), 3).setUsage(THREE.DynamicDrawUsage));
    super(geometry, material);
    this.frustumCulled = false;
  }

  /** Rows of (x, y, z) up to `row`, thinned. */
  show(rows, row) {
    const { position } = this.geometry.attributes;
    const step = Math.max(1, Math.ceil((row + 1) / (TRAIL - 1)));
    let count = 0;
    for (let index = 0; index <= row; index += step, count++) {
      position.setXYZ(count, rows[3 * index], rows[3 * index + 1], rows[3 * index + 2]);
    }
    position.setXYZ(count, rows[3 * row], rows[3 * row + 1], rows[3 * row + 2]);
    this.geometry.setDrawRange(0, count + 1);
    position.needsUpdate = true;
  }
}

/** The primitives of a robot, with its exhausts. */
class Robot extends THREE.Group {
  constructor(look, isGhost) {
    super();
    this.look = look;
    const material = (name) =>
      new THREE.MeshStandardMaterial({
        color: colour(look.colours[isGhost ? "ghost" : name]),
        roughness: 0.55,
        metalness: name === "engine" ? 0.35 : 0.05,
        transparent: isGhost,
        opacity: isGhost ? 0.3 : 1,
        depthWrite: !isGhost,
        // Where both have the same surface, always the robot's is seen.
        polygonOffset: isGhost,
        polygonOffsetFactor: 1,
        polygonOffsetUnits: 4,
      });
    const materials = Object.fromEntries(["shell", "engine", "sole", "strut"].map((role) => [role, material(role)]));
    this.parts = look.shapes.map((shape) => {
      const mesh = new THREE.Mesh(geometryOf(shape), materials[shape.role]);
      mesh.castShadow = mesh.receiveShadow = !isGhost;
      mesh.matrixAutoUpdate = false;
      this.add(mesh);
      return { mesh, body: shape.body, offset: matrixOf(shape.rotation, shape.position) };
    });
    const plume = new THREE.MeshBasicMaterial({
      color: colour(look.colours[isGhost ? "ghost" : "plume"]),
      transparent: true,
      opacity: isGhost ? 0.25 : 0.85,
      depthWrite: false,
    });
    const cone = new THREE.ConeGeometry(look.plume_radius, 1, 20, 1, true).rotateX(Math.PI / 2).translate(0, 0, 0.5);
    this.exhausts = new THREE.Group();
    this.add(this.exhausts);
    this.plumes = look.jets.map((jet) => {
      const mesh = new THREE.Mesh(cone, plume);
      this.exhausts.add(mesh);
      return { mesh, jet, position: new THREE.Vector3(...jet.position), axis: new THREE.Vector3(...jet.axis) };
    });
  }

  show(poses, thrust) {
    const bodies = [];
    for (let at = 0; at < poses.length; at += 12) bodies.push(matrixOf(poses.subarray(at, at + 9), poses.subarray(at + 9, at + 12)));
    for (const { mesh, body, offset } of this.parts) {
      mesh.matrix.multiplyMatrices(bodies[body], offset);
      mesh.matrixWorldNeedsUpdate = true;
    }
    this.plumes.forEach(({ mesh, jet, position, axis }, index) => {
      mesh.position.copy(position).applyMatrix4(bodies[jet.body]);
      mesh.quaternion.setFromUnitVectors(UP, axis.clone().transformDirection(bodies[jet.body]));
      mesh.scale.z = Math.max(this.look.scales.thrust * thrust[index], 1e-3);
      mesh.visible = thrust[index] > 0.5;
    });
    return bodies;
  }
}

function geometryOf({ kind, size, vertices, faces }) {
  if (kind === "mesh") {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(bytes(vertices).buffer), 3));
    geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(bytes(faces).buffer), 1));
    const faceted = geometry.toNonIndexed(); // corners of a triangle have its normal
    faceted.computeVertexNormals();
    return faceted;
  }
  if (kind === "sphere") return new THREE.SphereGeometry(size[0], 28, 18);
  if (kind === "box") return new THREE.BoxGeometry(...size);
  return new THREE.CylinderGeometry(size[0], size[0], size[2], 28).rotateX(Math.PI / 2);
}

/** Rotation by columns, and position. */
function matrixOf(r, p) {
  return new THREE.Matrix4().set(r[0], r[3], r[6], p[0], r[1], r[4], r[7], p[1], r[2], r[5], r[8], p[2], 0, 0, 0, 1);
}

export class Scene {
  constructor(canvas, look) {
    this.look = look;
    this.scales = { ...look.scales };
    this.at = new THREE.Vector3(); // of the robot, from where it is followed; zero if it is
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.shadowMap.enabled = true;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.05, 400);
    this.camera.up.copy(UP);
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { enablePan: false, maxPolarAngle: 0.53 * Math.PI, minDistance: 1, maxDistance: 40 });
    this.isMoved = true; // since the last picture
    this.controls.addEventListener("change", () => (this.isMoved = true));
    this.world = new THREE.Group(); // shifted so that the robot stays in the middle
    this.scene.add(this.world);
    this.#light();
    this.robot = new Robot(look, false);
    this.ghost = null;
    const line = (name, opacity) =>
      new THREE.LineBasicMaterial({ color: colour(look.colours[name]), transparent: true, opacity });
    this.trail = new Path(line("trail", 0.95));
    this.ghostTrail = new Path(line("ghost", 0.5));
    this.reference = new Path(line("reference", 0.8));
    const arms = [0, 1, 2].flatMap((axis) => [-0.28, 0.28].map((arm) => new THREE.Vector3().setComponent(axis, arm)));
    this.cross = new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(arms), line("reference", 1));
    const lit = (name) => new THREE.MeshStandardMaterial({ color: colour(look.colours[name]), roughness: 0.6 });
    const force = lit("force");
    this.forces = look.links.map((link) => ({ arrow: new Arrow(force, 0.011), link, at: new THREE.Vector3(...link.position) }));
    this.wind = new Arrow(lit("wind"), 0.03);
    // Larger than the arrow's head, so that a finger hits it.
    const unseen = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0, depthWrite: false });
    this.grip = new THREE.Mesh(new THREE.SphereGeometry(0.2, 12, 8), unseen);
    /** What can be hidden, by the names of its colours. */
    this.layers = Object.fromEntries(["force", "wind", "reference", "trail", "ghost"].map((name) => [name, new THREE.Group()]));
    this.layers.force.add(...this.forces.map(({ arrow }) => arrow));
    this.layers.wind.add(this.wind, this.grip);
    this.layers.reference.add(this.reference, this.cross);
    this.layers.trail.add(this.trail);
    this.layers.ghost.add(this.ghostTrail);
    this.world.add(this.robot, ...Object.values(this.layers));
    this.layers.plume = this.robot.exhausts;
    this.#streaks();
    this.posts = [];
    this.#mark(140);
    this.ray = new THREE.Raycaster();
    this.view();
    this.theme("light");
  }

  #light() {
    this.sky = new THREE.HemisphereLight(0xffffff, 0x9aa0a8, 1.6);
    this.sun = new THREE.DirectionalLight(0xffffff, 2.2);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    Object.assign(this.sun.shadow.camera, { left: -3, right: 3, top: 3, bottom: -3, near: 1, far: 30 });
    this.sun.shadow.bias = -5e-4;
    this.scene.add(this.sky, this.sun, this.sun.target);
    this.ground = { offset: { value: new THREE.Vector2() }, fine: { value: new THREE.Color() }, coarse: { value: new THREE.Color() } };
    const material = new THREE.MeshStandardMaterial({ roughness: 1 });
    // Lines every 1 m and 10 m, one pixel wide, fading where they would be closer than a few pixels.
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, this.ground);
      shader.vertexShader = shader.vertexShader
        .replace("#include <common>", "#include <common>\nvarying vec2 place;")
        .replace("#include <begin_vertex>", "#include <begin_vertex>\nplace = position.xy;");
      shader.fragmentShader = shader.fragmentShader
        .replace(
          "#include <common>",
          `#include <common>
          varying vec2 place;
          uniform vec2 offset;
          uniform vec3 fine, coarse;
          float lines(float cell) {
            vec2 at = (place + offset) / cell, width = fwidth(at);
            vec2 near = 1.0 - min(abs(fract(at - 0.5) - 0.5) / width, 1.0);
            return max(near.x, near.y) * (1.0 - smoothstep(0.1, 0.4, max(width.x, width.y)));
          }`,
        )
        .replace(
          "#include <color_fragment>",
          `#include <color_fragment>
          diffuseColor.rgb = mix(diffuseColor.rgb, fine, lines(1.0));
          diffuseColor.rgb = mix(diffuseColor.rgb, coarse, lines(10.0));`,
        );
    };
    this.plane = new THREE.Mesh(new THREE.PlaneGeometry(400, 400), material);
    this.plane.receiveShadow = true;
    this.scene.add(this.plane);
  }

  #mark(farthest) {
    for (let x = 10; x <= farthest; x += 10) {
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [128, 64];
      const material = new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), transparent: true, depthWrite: false });
      const sprite = new THREE.Sprite(material);
      sprite.position.set(x, -1.6, 0.25);
      sprite.scale.set(0.8, 0.4, 1);
      this.posts.push({ sprite, canvas, text: `${x} m` });
      this.world.add(sprite);
    }
  }

  #streaks() {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6 * STREAKS), 3).setUsage(THREE.DynamicDrawUsage));
    const material = new THREE.LineBasicMaterial({ color: colour(this.look.colours.wind), transparent: true, opacity: 0.55 });
    this.streaks = new THREE.LineSegments(geometry, material);
    this.streaks.frustumCulled = false;
    this.layers.wind.add(this.streaks);
    // Evenly spread by the additive recurrence of the cubic plastic number.
    const ratios = [0.8191725134, 0.6710436067, 0.5497004779];
    const place = (index) => ratios.map((ratio) => (2 * ((index * ratio) % 1) - 1) * REACH);
    this.motes = Array.from({ length: STREAKS }, (_, index) => new THREE.Vector3(...place(index)));
  }

  /** Puts the camera behind the right shoulder, so that robot and wind are in view. */
  view() {
    this.camera.position.set(-3.7, -2.0, 1.9).add(this.at);
    this.controls.target.set(0, 0, 0.85).add(this.at);
    this.controls.update();
    this.isMoved = true;
  }

  theme(name) {
    const theme = THEMES[name];
    this.scene.background = new THREE.Color(theme.sky);
    this.scene.fog = new THREE.Fog(theme.sky);
    this.follow(this.isFollowed ?? true);
    this.plane.material.color.set(theme.ground);
    this.sun.intensity = theme.light;
    this.ground.fine.value.set(theme.fine);
    this.ground.coarse.value.set(theme.coarse);
    for (const { sprite, canvas, text } of this.posts) {
      const pen = canvas.getContext("2d");
      pen.clearRect(0, 0, 128, 64);
      pen.font = "500 40px system-ui, sans-serif";
      pen.textAlign = "center";
      pen.fillStyle = theme.ink;
      pen.fillText(text, 64, 46);
      sprite.material.map.needsUpdate = true;
    }
    this.isMoved = true;
  }

  /** Lets the camera go with the robot, or stand and turn towards it. */
  follow(isFollowed) {
    this.isFollowed = isFollowed;
    this.controls.maxDistance = isFollowed ? 40 : 250;
    Object.assign(this.scene.fog, isFollowed ? { near: 12, far: 50 } : { near: 60, far: 250 });
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // A narrow picture keeps the width of a square one.
    const half = Math.tan((20 * Math.PI) / 180);
    this.camera.fov = (2 * Math.atan(half * Math.max(height / width, 1)) * 180) / Math.PI;
    this.camera.updateProjectionMatrix();
    this.isMoved = true;
  }

  /** Shows a moment of a flight, and of a ghost if there is one; `seconds` have passed since the last. */
  show(now, ghost, seconds) {
    const com = new THREE.Vector3(...now.com);
    const { position } = this.world;
    if (this.isFollowed) position.set(-com.x, -com.y, FOLLOWED - com.z);
    const moved = com.clone().add(position).sub(this.at);
    moved.z -= FOLLOWED;
    this.at.add(moved);
    if (this.isFollowed) this.camera.position.add(moved);
    this.controls.target.add(moved);
    this.sun.target.position.copy(this.at);
    this.sun.position.set(-3, -4, 8).add(this.at);
    const bodies = this.robot.show(now.poses, now.thrust);
    this.forces.forEach(({ arrow, link, at }, index) => {
      const force = new THREE.Vector3(...now.forces.subarray(3 * index, 3 * index + 3));
      arrow.show(at.clone().applyMatrix4(bodies[link.body]), force.multiplyScalar(this.scales.force));
    });
    this.trail.show(now.path, now.row);
    this.reference.show(now.referencePath, now.row);
    this.cross.position.set(...now.reference);
    const wind = new THREE.Vector3(...now.wind).multiplyScalar(this.look.scales.wind);
    this.windCentre = com.clone().add(new THREE.Vector3(0, 0, this.look.overhead));
    this.wind.show(this.windCentre.clone().addScaledVector(wind, -0.5), wind);
    this.grip.position.copy(this.windCentre).addScaledVector(wind, 0.5);
    if (ghost?.look !== this.ghost?.look) {
      if (this.ghost) this.layers.ghost.remove(this.ghost);
      this.ghost = ghost && new Robot(ghost.look, true);
      if (ghost) this.layers.ghost.add(this.ghost);
    }
    this.ghostTrail.visible = Boolean(ghost);
    if (ghost) {
      this.ghost.show(ghost.poses, ghost.thrust);
      this.ghostTrail.show(ghost.path, ghost.row);
    }
    this.plane.position.z = position.z;
    this.ground.offset.value.set(-position.x, -position.y);
    this.streaks.position.copy(com).sub(new THREE.Vector3(0, 0, FOLLOWED));
    this.#blow(now, seconds);
    this.isMoved = true;
  }

  /** Moves the streaks with the air, seen by the robot. */
  #blow({ wind, velocity }, seconds) {
    const drift = new THREE.Vector3(...wind).sub(new THREE.Vector3(...velocity)).multiplyScalar(seconds);
    const tail = new THREE.Vector3(...wind).multiplyScalar(0.05);
    const { position } = this.streaks.geometry.attributes;
    this.motes.forEach((mote, index) => {
      mote.add(drift);
      for (const axis of ["x", "y", "z"]) mote[axis] -= 2 * REACH * Math.round(mote[axis] / (2 * REACH));
      position.setXYZ(2 * index, mote.x, mote.y, mote.z + 1);
      position.setXYZ(2 * index + 1, mote.x - tail.x, mote.y - tail.y, mote.z + 1 - tail.z);
    });
    position.needsUpdate = true;
    this.streaks.visible = tail.lengthSq() > 1e-4;
  }

  /** Draws, if there is something new. */
  draw() {
    this.controls.update();
    if (!this.isMoved) return false;
    this.isMoved = false;
    this.renderer.render(this.scene, this.camera);
    return true;
  }

  /** Whether the head of the wind's arrow is under a pointer. */
  grips(event) {
    this.#aim(event);
    return this.ray.intersectObject(this.grip).length > 0;
  }

  /** The wind (x, y) [m/s] whose arrow ends under a pointer; null above the horizon. */
  windAt(event) {
    this.#aim(event);
    const height = this.windCentre.z + this.world.position.z;
    const hit = this.ray.ray.intersectPlane(new THREE.Plane(UP, -height), new THREE.Vector3());
    if (!hit) return null;
    const tip = hit.sub(this.world.position).sub(this.windCentre);
    return [tip.x, tip.y].map((part) => part / (0.5 * this.look.scales.wind));
  }

  #aim({ clientX, clientY }) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    const at = new THREE.Vector2((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height);
    this.ray.setFromCamera(at, this.camera);
  }
}
