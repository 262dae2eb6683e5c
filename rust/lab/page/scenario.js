// What can be chosen, what each choice means, how the choices make a configuration, and how a link carries them.

export const TURN = Math.PI / 180;

/** The wind of the paper rises between these times [s]. */
export const RAMP = [5, 10];

/** Strongest wind that can be set [m/s]. */
export const STRONGEST = 30;

/** The engines that can be switched off, in words. */
export const ENGINES = { l_arm_jet: "left arm", r_arm_jet: "right arm", chest_l_jet: "left chest", chest_r_jet: "right chest" };

/** Choices from lists: key, label, and for each value its label and what it means. */
export const LISTS = {
  controller: {
    label: "controller",
    values: {
      baseline: ["baseline", "The published controller without an aerodynamic model."],
      aware: ["aware", "The published controller with a model of the force on every link, and the measured wind."],
      observer: ["observer", "Estimates the wrench of the air from the robot's momentum; no aerodynamic model, no wind sensor."],
      both: ["aware + observer", "The model, and an observer of what the model gets wrong: the controller that we recommend."],
      ahead: ["looking ahead", "A plan over the next 0.8 s with model and observer: it survives an arm engine that stops in hover."],
    },
  },
  air: {
    label: "air",
    values: {
      axisymmetric: ["axisymmetric links", "Drag and normal force of links with fitted areas: the air of TEST1 and TEST2."],
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
  if (["model", "scale", "delay"].includes(key)) return ["aware", "both", "ahead"].includes(settings.controller);
  if (key === "ko") return ["observer", "both", "ahead"].includes(settings.controller);
  if (["kp", "c0"].includes(key)) return settings.controller !== "ahead";
  return true;
}

/** Velocity of the air [m/s] of a wind of this speed from this direction. */
export function velocity(speed, from) {
  const tidy = (x) => Math.round(x * 1e12) / 1e12 + 0;
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

/** The ramp, where it was left at `time`, as samples. */
export function rampUntil(settings, time) {
  const [start, end] = RAMP;
  const [x, y] = velocity(settings.speed, settings.from);
  const samples = [[0, 0, 0], [start, 0, 0], [end, x, y]].filter((sample) => sample[0] < time);
  const share = Math.min(Math.max((time - start) / (end - start), 0), 1);
  return [...samples, [time, x * share, y * share]];
}

function wind(settings) {
  if (settings.steer.length) {
    const [[left], ...dragged] = settings.steer;
    const samples = [...rampUntil(settings, left), ...dragged];
    return { profile: "samples", samples: samples.map(([time, x, y]) => [time, x, y, 0]) };
  }
  const [x, y] = velocity(settings.speed, settings.from);
  return { profile: "ramp", velocity: [x, y, 0], ramp_start: RAMP[0], ramp_end: RAMP[1] };
}

const AIR_FILE = { spheres: "sphere_cylinder", network: "network", off: "off" };

function aero(air, arms) {
  const axisymmetric = arms === "published" ? "axisymmetric_published" : "axisymmetric_corrected";
  return { base: `../aero/${AIR_FILE[air] ?? axisymmetric}.toml` };
}

function controller(settings) {
  const { arms } = settings;
  const isPublished = arms === "published";
  const file = { baseline: "baseline", observer: "observer_without_model", both: "observer", ahead: "mpc" }[settings.controller];
  const table = { base: `../control/${file ?? (isPublished ? "aero_aware_published" : "aero_aware")}.toml` };
  if (isPublished && file) table.torque = { torque_max: 50 }; // as in configs/experiments/test1_published.toml
  if (matters("model", settings)) {
    table.aero = aero(settings.model === "same" ? settings.air : settings.model, arms);
    // As in configs/control/aero_aware_published.toml.
    if (isPublished) Object.assign(table, { lever_arm: "unrotated", jacobian_offset: "base_rotation", link_velocity: "shifted_twice" });
    // Only the axisymmetric model, with forces at the links' centres, has derivatives.
    const isAxisymmetric = ["axisymmetric", "off"].includes(settings.model === "same" ? settings.air : settings.model);
    if (settings.controller === "ahead" && (isPublished || !isAxisymmetric)) table.mpc = { air: "constant" };
  }
  const momentum = {};
  if (matters("kp", settings) && settings.kp !== DEFAULTS.kp) {
    momentum.kp_linear = Array(3).fill(settings.kp);
    momentum.kd_linear = Array(3).fill(2 * Math.sqrt(settings.kp));
  }
  if (matters("c0", settings) && settings.c0 !== DEFAULTS.c0) momentum.c0 = settings.c0;
  if (Object.keys(momentum).length) table.momentum = momentum;
  if (matters("ko", settings) && settings.ko !== DEFAULTS.ko) table.observer = { gain_force: settings.ko, gain_moment: settings.ko };
  return table;
}

function disturbances(settings) {
  const table = {};
  const { mass, comx, comy, scale, delay, engine } = settings;
  if (mass !== 1 || comx || comy) table.model_error = { mass_scale: mass, com_offset: [comx / 100, comy / 100, 0] };
  if (matters("scale", settings) && scale !== 1) table.aero_estimate = { scale };
  if (matters("delay", settings) && delay) table.wind_estimate = { delay };
  if (engine) table.jets = { failure: { jet: engine[0], time: engine[1], kind: "off" } };
  return table;
}

/** One line that identifies a flight. */
export function title(settings) {
  const test = Object.entries(TESTS).find(([, test]) => toHash({ ...DEFAULTS, ...test }) === toHash(settings));
  if (test) return `${test[0]} in the lab`;
  const named = (key) => LISTS[key].values[settings[key]][0];
  const arms = settings.arms === "published" ? ", published arms" : "";
  const wind = settings.steer.length ? "dragged wind" : settings.speed ? `${settings.speed} m/s from ${settings.from}°` : "still air";
  return `${named("controller")}, ${named("mission")}, ${wind}, air: ${named("air")}${arms}`;
}

/** A configuration as a file of `configs/experiments` would be. */
export function configuration(settings) {
  const isPublished = settings.arms === "published";
  return {
    title: title(settings),
    description: `Flown in the lab: ${toHash(settings) || "#"}`,
    robot: "../robot/ironcub_mk1.toml",
    simulator: {
      base: `../simulator/flight${isPublished ? "_published" : ""}.toml`,
      aero: aero(settings.air, settings.arms),
      duration: DURATION[settings.mission],
    },
    controller: controller(settings),
    mission: { base: `../mission/${settings.mission}.toml` },
    wind: wind(settings),
    disturbances: disturbances(settings),
  };
}

// A link: `#key=value&…`, only what differs from the defaults. A dragged wind is a list of knots `dt.x.y` in units of 10 ms and
// 0.01 m/s, in base 36.

const UNIT = 100;

/** To the resolution of a link. */
export const round = (number) => Math.round(number * UNIT) / UNIT + 0;

export function toHash(settings) {
  const parts = [];
  for (const [key, normal] of Object.entries(DEFAULTS)) {
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
      parts.push(`${key}=${value}`);
    }
  }
  return parts.length ? `#${parts.join("&")}` : "";
}

/** Settings of a link; what it does not say, or says wrongly, is as by default. */
export function fromHash(hash) {
  const settings = { ...DEFAULTS, steer: [] };
  for (const [key, text] of new URLSearchParams(hash.replace(/^#/, ""))) {
    if (Object.hasOwn(LISTS, key) && Object.hasOwn(LISTS[key].values, text)) settings[key] = text;
    const range = NUMBERS[key] ?? { speed: { min: 0, max: STRONGEST }, from: { min: -180, max: 180 } }[key];
    const number = Number(text);
    if (range && text !== "" && number >= range.min && number <= range.max) settings[key] = number;
    if (key === "engine") {
      const [jet, time] = text.split(".");
      if (Object.hasOwn(ENGINES, jet) && /^\d{1,9}$/.test(time)) settings.engine = [jet, Number(time) / UNIT];
    }
    if (key === "steer") settings.steer = readSteer(text);
  }
  return settings;
}

function readSteer(text) {
  let at = 0;
  const knots = text.split("~").map((knot) => knot.split(".").map((part) => parseInt(part, 36)));
  const steer = knots.map(([dt, x, y]) => [(at += dt) / UNIT, x / UNIT, y / UNIT]);
  const fits = ([time, x, y], index) => time >= 0 && Math.hypot(x, y) < 2 * STRONGEST && (!index || time > steer[index - 1][0]);
  return steer.length && steer.every(fits) ? steer : [];
}
