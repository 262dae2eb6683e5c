// What can be chosen, what each choice means, how the choices make a configuration, and how a link carries them.

const TURN = Math.PI / 180;

/** The wind of the paper rises between these times [s]. */
const RAMP = [5, 10];

/** Strongest wind that can be set [m/s]. */
export const STRONGEST = 30;

/** Choices from lists: key, label, and for each value its label and what it means. */
export const LISTS = {
  controller: {
    label: "controller",
    values: {
      baseline: ["baseline", "The published controller without an aerodynamic model."],
      aware: ["aware", "The published controller with a model of the force on every link, and the measured wind."],
      observer: ["observer, no model", "Estimates the wrench of the air from the robot's momentum; no aerodynamic model, no wind sensor."],
      both: ["observer", "An aerodynamic model, and an observer of what the model gets wrong."],
      mpc: ["predictive law", "Model predictive control: a plan over the next 0.8 s, with model and observer. It survives an arm engine that stops in hover."],
    },
  },
  air: {
    label: "air",
    values: {
      axisymmetric: ["axisymmetric links", "Drag and normal force of links with fitted areas: the air of TEST1 and TEST2."],
      printed: ["axisymmetric, as printed", "The same with the head's coefficient as the paper prints it."],
      signed: ["axisymmetric, signed", "The same with signed normal forces."],
      alternative: ["axisymmetric, alternative", "The same with the alternative coefficients."],
      spheres: ["spheres and cylinders", "Drag of spheres and finite cylinders from the literature, with the Reynolds number."],
      network: ["neural network", "A network trained on public CFD data gives the force on every link: the air of TEST3 and TEST4."],
      off: ["none", "No aerodynamic force at all: what the baseline assumes."],
    },
  },
  model: {
    label: "its model",
    values: {
      same: ["the same air", "The controller's model is that of the air: its estimates are right."],
      axisymmetric: ["axisymmetric links", "The controller's model is of axisymmetric links, whatever the air is."],
      spheres: ["spheres and cylinders", "The controller's model is of spheres and cylinders, whatever the air is."],
      network: ["neural network", "The controller's model is the network, whatever the air is."],
      off: ["none", "The controller has no model of the air."],
    },
  },
  arms: {
    label: "lever arms",
    values: {
      corrected: ["corrected", "The force on a link acts at its centre, as physics has it."],
      published: ["as published", "Offsets of links are added without being turned: three times the aerodynamic moment at hover."],
    },
  },
  mission: {
    label: "mission",
    values: {
      in_line: ["78 m in a line", "Climb, fly 78 m at up to 7.5 m/s, level out, descend: the paper's flight."],
      hover: ["hover", "Stay in place: wind alone moves the robot."],
      closed_circuit: ["circuit", "Four fast legs with left turns between them; wind from every side."],
      min_time: ["shortest time", "The fastest way to where the paper's flight ends, planned with aerodynamics."],
    },
  },
};

const DURATION = { in_line: 50, hover: 40, closed_circuit: 135, min_time: 26 };

/** Choices of a number: key, label, unit, range, what it means. `value` is what the files have; gains read theirs from them. */
export const NUMBERS = {
  kp: { group: "gains", label: "position gain", unit: "1/s²", min: 4, max: 40, step: 1, value: 15, meaning: "How hard the centre of mass is pulled to its set-point; the damping follows, 2√K." },
  c0: { group: "gains", label: "attitude gain", unit: "1/s²", min: 10, max: 150, step: 5, value: 50, meaning: "How hard the base is turned to its set-point." },
  ko: { group: "gains", label: "observer gain", unit: "1/s", min: 0, max: 10, step: 0.5, value: 3, meaning: "How fast the observed wrench follows; with 0 there is no observer." },
  mass: { group: "errors", label: "mass", unit: "×", min: 0.85, max: 1.15, step: 0.01, value: 1, meaning: "Mass in the controller's model, relative to the robot's." },
  comx: { group: "errors", label: "centre of mass, x", unit: "cm", min: -6, max: 6, step: 0.5, value: 0, meaning: "Error of the base's centre of mass in the controller's model, along the base's x axis." },
  comy: { group: "errors", label: "centre of mass, y", unit: "cm", min: -6, max: 6, step: 0.5, value: 0, meaning: "The same along the base's y axis, sideways." },
  scale: { group: "errors", label: "estimated forces", unit: "×", min: 0, max: 2, step: 0.1, value: 1, meaning: "Factor on every aerodynamic force that the controller estimates." },
  delay: { group: "errors", label: "wind sensor's delay", unit: "s", min: 0, max: 3, step: 0.1, value: 0, meaning: "Age of the wind that the controller is given." },
};

export const DEFAULTS = {
  controller: "baseline",
  air: "axisymmetric",
  model: "same",
  arms: "corrected",
  mission: "in_line",
  /** The wind that the ramp ends with: speed [m/s], and where it comes from [deg]: 0 ahead, 90 the robot's left. */
  speed: 10,
  from: 90,
  ...Object.fromEntries(Object.entries(NUMBERS).map(([key, { value }]) => [key, value])),
  /** An engine that is switched off: its name and when [s]. */
  engine: null,
  /** A dragged wind: [time [s], x, y [m/s]], linear in between. The first is where the ramp is left, with the ramp's wind. */
  steer: [],
};

/** The paper's flights. */
export const TESTS = {
  TEST1: { controller: "baseline", air: "axisymmetric" },
  TEST2: { controller: "aware", air: "axisymmetric" },
  TEST3: { controller: "baseline", air: "network" },
  TEST4: { controller: "aware", air: "network" },
};

/** Whether a choice has an effect. */
export function matters(key, settings) {
  if (["model", "scale", "delay"].includes(key)) return ["aware", "both", "mpc"].includes(settings.controller);
  if (key === "ko") return ["observer", "both", "mpc"].includes(settings.controller);
  if (["kp", "c0"].includes(key)) return settings.controller !== "mpc";
  return true;
}

/** Without the rounding errors of sines and cosines. */
const tidy = (x) => Math.round(x * 1e12) / 1e12 + 0;

/** Velocity of the air [m/s] of a wind of this speed from this direction. */
export function velocity(speed, from) {
  return [tidy(-speed * Math.cos(from * TURN)), tidy(-speed * Math.sin(from * TURN))];
}

/** Speed, and where it comes from in (-180, 180]. */
export function speedAndDirection(x, y) {
  const speed = Math.hypot(x, y);
  return [speed, speed < 1e-9 ? 90 : Math.atan2(-y, -x) / TURN];
}

/** Settings of the ramp that ends with a wind (x, y) [m/s], to the resolution of a link. */
export function rampTo([x, y]) {
  const [speed, from] = speedAndDirection(x, y);
  return { speed: Math.min(round(speed), STRONGEST), from: round(from) };
}

const AIR_FILE = { spheres: "sphere_cylinder", network: "network", off: "off", axisymmetric: "axisymmetric_corrected", printed: "axisymmetric_published", signed: "axisymmetric_signed", alternative: "axisymmetric_alternative" };

/** Files of controllers; two of a file differ in the aerodynamic model alone. */
const CONTROL_FILE = { baseline: "aero_aware", aware: "aero_aware", observer: "observer", both: "observer", mpc: "mpc" };
const hasNoModel = (controller) => ["baseline", "observer"].includes(controller);

/** What configs/simulator/flight_published.toml and configs/control/aero_aware_published.toml change, but coefficients. */
const ARMS = {
  corrected: {
    "simulator.lever_arm": "rotated", "simulator.integrator": "semi_implicit_euler", "simulator.joint_stops": true,
    "controller.lever_arm": "rotated", "controller.jacobian_offset": "link_rotation", "controller.link_velocity": "at_centre",
    "controller.torque.torque_max": false,
  },
  published: {
    "simulator.lever_arm": "unrotated", "simulator.integrator": "explicit_euler", "simulator.joint_stops": false,
    "controller.lever_arm": "unrotated", "controller.jacobian_offset": "base_rotation", "controller.link_velocity": "shifted_twice",
    "controller.torque.torque_max": 50,
  },
};

/** The name of a part in words: "l_arm_jet" is the left arm jet. */
export function partName(name) {
  const words = name.split("_");
  const side = words.findIndex((word) => word === "l" || word === "r");
  if (side >= 0) words.unshift({ l: "left", r: "right" }[words.splice(side, 1)[0]]);
  return words.join(" ");
}

/** The choices about a configuration: what it has, what can be changed, and which changes a choice is. */
export class Scenario {
  /** Resolved configuration, jets of its robot, name of its mission in `LISTS`, and further networks among its files. */
  constructor({ config, jets }, mission = "given", networks = []) {
    this.config = config;
    this.jets = jets;
    const { simulator, controller, disturbances } = config;
    const isPublished = simulator.lever_arm === "unrotated";
    const hasObserver = Boolean(controller.disturbance_observer?.gain_force);
    const isOff = controller.aero.model === "off";
    const still = { profile: "ramp", velocity: [0, 0, 0], ramp_start: RAMP[0], ramp_end: RAMP[1] };
    // Still air does not say how a wind rises.
    const isStill = config.wind.profile === "constant" && !Math.hypot(...config.wind.velocity);
    this.wind = isStill ? still : config.wind;
    const [x, y, z] = this.wind.velocity ?? [0, 0, 0];
    this.hasWind = Boolean(this.wind.velocity);
    this.ramp = [this.wind.ramp_start ?? 0, this.wind.ramp_end ?? 0];
    this.canDrag = z === 0 && (this.wind.profile === "constant" || (this.wind.profile === "ramp" && this.ramp[0] < this.ramp[1]));
    const [speed, from] = speedAndDirection(x, y);
    const airOf = ({ model, coefficients, card }) => {
      const named = { off: "off", sphere_cylinder: "spheres", network: networkOf(card, networks) }[model];
      if (model !== "axisymmetric") return named ?? "given";
      if (coefficients === (isPublished ? "published" : "corrected")) return "axisymmetric";
      return { published: "printed", signed: "signed", alternative: "alternative" }[coefficients] ?? "given";
    };
    const name = controller.mpc ? "mpc" : { false: isOff ? "baseline" : "aware", true: isOff ? "observer" : "both" }[hasObserver];
    const isSame = hasNoModel(name) || JSON.stringify(controller.aero) === JSON.stringify(simulator.aero);
    const { model_error: errors, aero_estimate: estimate, wind_estimate: sensor } = disturbances ?? {};
    this.start = {
      ...DEFAULTS,
      controller: name,
      air: airOf(simulator.aero),
      model: isSame ? "same" : airOf(controller.aero),
      arms: isPublished ? "published" : "corrected",
      mission,
      speed: tidy(speed),
      from: tidy(from),
      kp: controller.momentum.kp_linear[0],
      c0: controller.momentum.c0,
      ko: hasObserver ? controller.disturbance_observer.gain_force : DEFAULTS.ko,
      mass: errors?.mass_scale ?? 1,
      comx: 100 * (errors?.com_offset?.[0] ?? 0),
      comy: 100 * (errors?.com_offset?.[1] ?? 0),
      scale: estimate?.scale ?? 1,
      delay: sensor?.delay ?? 0,
    };
    this.lists = this.#lists(networks);
  }

  /** Choices that this flight has: control files and missions are of the paper's robot. */
  #lists(networks) {
    const { start } = this;
    const isPaper = this.config.robot.endsWith("/ironcub_mk1.toml");
    const fits = {
      controller: (name) => isPaper || CONTROL_FILE[name] === CONTROL_FILE[start.controller],
      mission: () => isPaper,
    };
    const further = Object.fromEntries(networks.map((name) => [`network ${name}`, [`network ${name}`, "A network of configs/aero/networks."]]));
    return Object.fromEntries(Object.entries(LISTS).map(([key, { label, values }]) => {
      const given = start[key] === "given" ? { given: ["as in the result", "What the result was flown with."] } : {};
      const kept = Object.entries(values).filter(([name]) => !fits[key] || fits[key](name));
      return [key, { label, values: { ...given, ...Object.fromEntries(kept), ...(["air", "model"].includes(key) ? further : {}) } }];
    }));
  }

  /** A wind as it was until `time`, as samples (time, x, y). */
  windUntil(settings, time) {
    const [start, end] = this.ramp;
    const [x, y] = velocity(settings.speed, settings.from);
    const rise = end > 0 ? [[0, 0, 0], [start, 0, 0], [end, x, y]] : [[0, x, y]];
    const samples = rise.filter(([at], index) => at < time && at !== rise[index - 1]?.[0]);
    const share = end > 0 ? Math.min(Math.max((time - start) / (end - start), 0), 1) : 1;
    return [...samples, [time, x * share, y * share]];
  }

  windOf(settings) {
    if (!settings.steer.length) return { ...this.wind, velocity: [...velocity(settings.speed, settings.from), this.wind.velocity[2]] };
    const [[left], ...dragged] = settings.steer;
    const samples = [...this.windUntil(settings, left), ...dragged];
    return { profile: "samples", samples: samples.map(([time, x, y]) => [time, x, y, 0]) };
  }

  #air(name, arms) {
    const printed = name === "axisymmetric" && arms === "published";
    const table = { base: `../aero/${name.startsWith("network ") ? "network" : AIR_FILE[printed ? "printed" : name]}.toml` };
    return name.startsWith("network ") ? { ...table, card: `../aero/networks/${name.slice(8)}.json` } : table;
  }

  /** The changes that settings are: dotted keys with their values, in order. */
  changes(settings) {
    const { start, config } = this;
    const { arms, controller } = settings;
    const changed = {};
    const has = (...keys) => keys.some((key) => settings[key] !== start[key]);
    if (has("mission")) Object.assign(changed, { mission: { base: `../mission/${settings.mission}.toml` }, "simulator.duration": DURATION[settings.mission] });
    if (has("air", "arms") && settings.air !== "given") changed["simulator.aero"] = this.#air(settings.air, arms);
    const isReplaced = CONTROL_FILE[controller] !== CONTROL_FILE[start.controller];
    if (isReplaced) changed.controller = { base: `../control/${CONTROL_FILE[controller]}.toml` };
    for (const [key, value] of Object.entries(ARMS[arms])) {
      if (has("arms") || (isReplaced && key.startsWith("controller"))) changed[key] = value;
    }
    const model = settings.model === "same" ? settings.air : settings.model;
    if (isReplaced || has("controller", "model") || (has("air", "arms") && !hasNoModel(controller))) {
      const given = settings.model === "same" ? config.simulator.aero : config.controller.aero;
      changed["controller.aero"] = hasNoModel(controller) ? this.#air("off") : model === "given" ? given : this.#air(model, arms);
      // Only the axisymmetric model, with forces at the links' centres, has derivatives.
      const isLinear = arms === "corrected" && ["axisymmetric", "printed", "signed", "alternative", "off"].includes(model);
      if (controller === "mpc" && !isLinear) changed["controller.mpc.air"] = "constant";
    }
    if (matters("kp", settings) && (isReplaced || has("kp"))) {
      changed["controller.momentum.kp_linear"] = Array(3).fill(settings.kp);
      changed["controller.momentum.kd_linear"] = Array(3).fill(2 * Math.sqrt(settings.kp));
    }
    if (matters("c0", settings) && (isReplaced || has("c0"))) changed["controller.momentum.c0"] = settings.c0;
    if (matters("ko", settings) && (isReplaced || has("ko"))) Object.assign(changed, { "controller.disturbance_observer.gain_force": settings.ko, "controller.disturbance_observer.gain_moment": settings.ko });
    const offset = config.disturbances?.model_error?.com_offset?.[2] ?? 0;
    if (has("mass")) changed["disturbances.model_error.mass_scale"] = settings.mass;
    if (has("comx", "comy")) changed["disturbances.model_error.com_offset"] = [settings.comx / 100, settings.comy / 100, offset];
    if (has("scale")) changed["disturbances.aero_estimate.scale"] = settings.scale;
    if (has("delay")) changed["disturbances.wind_estimate.delay"] = settings.delay;
    if (settings.engine) changed["disturbances.jets.failure"] = { jet: settings.engine[0], time: settings.engine[1], kind: "off" };
    if (settings.steer.length || has("speed", "from")) changed.wind = this.windOf(settings);
    const link = this.toHash(settings);
    if (link) Object.assign(changed, { title: this.title(settings), description: `Flown in the lab: ${link}` });
    return Object.entries(changed);
  }

  /** One line that identifies a flight. */
  title(settings) {
    const link = this.toHash(settings);
    const test = this.start.mission !== "given" && Object.entries(TESTS).find(([, test]) => this.toHash({ ...this.start, ...test }) === link);
    if (test || !link) return test ? `${test[0]} in the lab` : this.config.title;
    const named = (key) => this.lists[key].values[settings[key]][0];
    const wind = settings.steer.length ? "dragged wind" : !this.hasWind ? "its wind" : settings.speed ? `${round(settings.speed)} m/s from ${round(settings.from)}°` : "still air";
    const scale = settings.scale === 1 || hasNoModel(settings.controller) ? "" : ` × ${settings.scale}`;
    const parts = [named("controller") + scale, settings.mission === "given" ? [] : named("mission"), wind, settings.air === "given" ? [] : `air: ${named("air")}`];
    return parts.flat().join(", ") + (settings.arms === "published" ? ", published arms" : "");
  }

  // A link: `#key=value&…`, only what differs from the start. A dragged wind is a list of knots `dt.x.y` in units of 10 ms and
  // 0.01 m/s, in base 36.

  toHash(settings) {
    const parts = [];
    for (const [key, normal] of Object.entries(this.start)) {
      const value = settings[key];
      if (key === "steer") {
        let before = 0;
        const knots = value.map(([time, ...xy]) => {
          const at = Math.round(time * UNIT);
          const knot = [at - before, ...xy.map((part) => Math.round(part * UNIT))].map((whole) => whole.toString(36)).join(".");
          before = at;
          return knot;
        });
        if (knots.length) parts.push(`steer=${knots.join("~")}`);
      } else if (key === "engine") {
        if (value) parts.push(`engine=${value[0]}.${Math.round(value[1] * UNIT)}`);
      } else if (value !== normal) {
        parts.push(`${key}=${encodeURIComponent(value)}`);
      }
    }
    return parts.length ? `#${parts.join("&")}` : "";
  }

  /** Settings of a link; what it does not say, or says wrongly, is as at the start. */
  fromHash(hash) {
    const settings = { ...this.start, steer: [] };
    for (const [key, text] of new URLSearchParams(hash.replace(/^#/, ""))) {
      if (Object.hasOwn(this.lists, key) && Object.hasOwn(this.lists[key].values, text)) settings[key] = text;
      const range = NUMBERS[key] ?? (this.hasWind && { speed: { min: 0, max: STRONGEST }, from: { min: -180, max: 180 } }[key]);
      const number = Number(text);
      if (range && text !== "" && number >= range.min && number <= range.max) settings[key] = number;
      if (key === "engine") {
        const [jet, time] = text.split(".");
        if (this.jets.includes(jet) && /^\d{1,9}$/.test(time)) settings.engine = [jet, Number(time) / UNIT];
      }
      if (key === "steer" && this.canDrag) settings.steer = readSteer(text);
    }
    return settings;
  }
}

/** The name of a network of configs/aero/networks in `LISTS` or among others; undefined for another. */
function networkOf(card, networks) {
  const name = /\/aero\/networks\/(.*)\.json$/.exec(card ?? "")?.[1];
  return name === "default" ? "network" : networks.includes(name) ? `network ${name}` : undefined;
}

const UNIT = 100;

/** To the resolution of a link. */
export const round = (number) => Math.round(number * UNIT) / UNIT + 0;

function readSteer(text) {
  let at = 0;
  const knots = text.split("~").map((knot) => knot.split(".").map((part) => parseInt(part, 36)));
  const steer = knots.map(([dt, x, y]) => [(at += dt) / UNIT, x / UNIT, y / UNIT]);
  const fits = ([time, x, y], index) => time >= 0 && Math.hypot(x, y) < 2 * STRONGEST && (!index || time > steer[index - 1][0]);
  return steer.length && steer.every(fits) ? steer : [];
}
