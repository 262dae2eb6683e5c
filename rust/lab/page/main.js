// The page: settings, playback, wind and plots around flights of the simulator.
import data from "lab:data";
import { Lab } from "./lab.js";
import { Plot } from "./plots.js";
import { Scene } from "./scene.js";
import { DEFAULTS, LISTS, NUMBERS, RAMP, STRONGEST, TESTS, configuration, fromHash, matters, rampUntil, round, speedAndDirection, title, toHash, velocity } from "./scenario.js";
import { TOUR } from "./tour.js";

const $ = (id) => document.getElementById(id);
const bytes = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
const make = (tag, attributes = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), attributes);
  element.append(...children);
  return element;
};
const degrees = (radians) => (radians * 180) / Math.PI;

const RATES = [0.1, 0.25, 0.5, 1, 2, 5];
const BUDGET = 12; // of a picture, for the simulation [ms]
const SPARE = 6; // of a picture, for flights in the background: at least this [ms],
const SHARE = 0.25; // and this share of the time that pictures take
const CHUNK = 5; // ticks between two looks at the clock
const TURNING = 0.2; // a dragged wind needs this long for each change [s]
const LEANING = 10; // beyond this tilt a flight that arrives is said to lean [deg]
const GHOSTS = {
  none: ["none", "One robot flies."],
  baseline: ["baseline", "The same flight under the baseline, in the same wind."],
  aware: ["aware", "The same flight under the aware controller, in the same wind."],
  observer: ["observer", "The same flight under the observer, in the same wind."],
  previous: ["the flight before", "What was flown before the last change."],
};
const ENGINES = { l_arm_jet: "left arm", r_arm_jet: "right arm", chest_l_jet: "left chest", chest_r_jet: "right chest" };
const JET_COLOURS = { light: ["#0072b2", "#3a9bd0", "#d08a00", "#c24f00"], dark: ["#3f9bd8", "#8fd0f5", "#e69f00", "#ff8a4a"] };

class Page {
  constructor(lab) {
    this.lab = lab;
    this.scene = new Scene($("scene"), data.look);
    this.settings = fromHash(location.hash);
    this.ghostKind = "none";
    this.solid = this.ghost = this.previous = null;
    this.now = 0;
    this.goal = 0; // flown to before playing goes on [s]
    this.isPlaying = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.rate = 1;
    this.wanted = null; // wind that is being dragged to (x, y) [m/s]
    this.jobs = []; // flights in the background
    this.whole = new Map(); // results of whole flights, by link
    this.scenario = null; // of the tour
    this.times = { simulation: [], drawing: [], plots: [] };
    this.#build();
    this.begin();
    this.#listen();
    this.last = performance.now();
    requestAnimationFrame((time) => this.#frame(time));
  }

  // --- flights ---------------------------------------------------------------------------------------------------

  /** Starts the flight of the settings; shows it from `time` on. */
  begin(time = 0) {
    try {
      const flight = this.lab.begin(configuration(this.settings));
      this.previous?.end();
      this.previous = this.solid;
      this.solid = flight;
      this.say(null);
    } catch (error) {
      this.say(error.message);
      return;
    }
    this.result = null;
    this.#beginGhost();
    this.now = this.goal = time;
    $("time").max = this.solid.duration;
    history.replaceState(null, "", toHash(this.settings) || location.pathname + location.search);
    this.#showSettings();
    this.isStale = true;
  }

  #beginGhost() {
    if (this.ghost && this.ghost !== this.previous) this.ghost.end();
    const { ghostKind } = this;
    const has = ghostKind !== "none" && ghostKind !== "previous";
    this.ghost = has ? this.lab.begin(configuration({ ...this.settings, controller: ghostKind })) : null;
    if (ghostKind === "previous") this.ghost = this.previous;
  }

  /** Changes settings and flies anew. */
  change(change, time = 0) {
    this.settings = { ...this.settings, ...change };
    this.scenario = null;
    this.begin(time);
  }

  /** Forgets what was flown after `time`, and flies on with a change. */
  branch(time, change = {}) {
    const settings = { ...this.settings, ...change };
    const steer = settings.steer.filter(([at]) => at <= time);
    if (steer.length && settings.steer.length > steer.length) {
      const [x, y] = this.solid.row("wind", this.rowAt(this.solid, time)).subarray(0, 2);
      if (steer.at(-1)[0] < time) steer.push([time, round(x), round(y)]);
    }
    this.settings = { ...settings, steer };
    this.begin(time);
  }

  rowAt(flight, time) {
    return Math.max(Math.min(Math.round(time / flight.timeStep), flight.rows - 1), 0);
  }

  /** Switches an engine off now, or on again. */
  switchEngine(jet) {
    const time = round(this.rowAt(this.solid, this.now) * this.solid.timeStep);
    this.scenario = null;
    const isOff = this.settings.engine?.[0] === jet;
    this.branch(time, { engine: isOff ? null : [jet, time] });
  }

  /** Flies towards `time`, no longer than `budget` [ms]. */
  #fly(flight, time, budget) {
    const begin = performance.now();
    let missing = Math.ceil(time / flight.timeStep) + 1 - flight.rows;
    while (missing > 0 && !flight.hasEnded && performance.now() - begin < budget) missing -= flight.advance(Math.min(missing, CHUNK)) || missing;
  }

  /** The result of a whole flight of these settings, as soon as it is flown. */
  flyWhole(settings) {
    const link = toHash(settings);
    if (!this.whole.has(link)) {
      this.whole.set(
        link,
        new Promise((done) => this.jobs.push({ flight: this.lab.begin(configuration(settings)), done })),
      );
    }
    return this.whole.get(link);
  }

  #work(budget) {
    const [job] = this.jobs;
    if (!job) return;
    this.#fly(job.flight, Infinity, budget);
    if (!job.flight.hasEnded) return;
    this.jobs.shift();
    job.done(job.flight.result());
    job.flight.end();
  }

  // --- wind ------------------------------------------------------------------------------------------------------

  /** The wind that is set: what the flight has at its end, or is being dragged to. */
  get target() {
    if (this.wanted) return this.wanted;
    const { steer, speed, from } = this.settings;
    return steer.length ? steer.at(-1).slice(1) : velocity(speed, from).map(round);
  }

  /** Asks for a wind (x, y) [m/s], from now on. */
  blow([x, y]) {
    const speed = Math.hypot(x, y);
    const share = speed > STRONGEST ? STRONGEST / speed : 1;
    this.wanted = [round(x * share), round(y * share)];
    this.scenario = null;
    const isPast = this.now < this.solid.flown - 2 * this.solid.timeStep;
    if (this.solid.hasEnded || isPast) {
      const time = round(this.rowAt(this.solid, this.now) * this.solid.timeStep);
      if (time >= this.solid.duration) this.now = 0; // an ended flight flies again
      this.branch(time >= this.solid.duration || this.result?.lost_time != null && !isPast ? 0 : time);
    }
    this.isStale = true;
  }

  /** Lets the wind turn to what is wanted, where the last change is over. */
  #steer() {
    if (!this.wanted) return;
    const { settings, solid } = this;
    const time = round(solid.flown);
    const { steer } = settings;
    if (!steer.length && time < RAMP[0]) {
      const [speed, from] = speedAndDirection(...this.wanted);
      Object.assign(settings, { speed: round(speed), from: round(from) });
      this.wanted = null;
    } else if (!steer.length) {
      const [x, y] = rampUntil(settings, time).at(-1).slice(1);
      settings.steer = [[time, round(x), round(y)], [round(time + TURNING), ...this.wanted]];
      if (time < RAMP[1]) this.begin(time); // the ramp ends earlier: its bits differ
    } else {
      const [end, x, y] = steer.at(-1);
      if (end > time + 1e-9) return;
      if (x === this.wanted[0] && y === this.wanted[1]) {
        if (!this.isDragging) this.wanted = null;
        return;
      }
      const held = end < time - 1e-9 ? [[time, x, y]] : [];
      settings.steer = [...steer, ...held, [round(time + TURNING), ...this.wanted]];
    }
    const { wind } = configuration(settings);
    for (const flight of new Set([solid, this.ghost])) if (flight && flight !== this.previous) flight.setWind(wind);
    history.replaceState(null, "", toHash(settings) || location.pathname + location.search);
    this.#showSettings();
  }

  // --- pictures --------------------------------------------------------------------------------------------------

  #frame(time) {
    requestAnimationFrame((next) => this.#frame(next));
    const seconds = Math.min(time - this.last, 100) / 1000;
    this.last = time;
    const begin = performance.now();
    const { solid } = this;
    if (!solid) return; // the link was refused
    const isBehind = (flight, time) => flight && !flight.hasEnded && flight.flown < time - 1e-9;
    const isCatchingUp = isBehind(solid, this.goal) || (!this.isPlaying && isBehind(this.ghost, this.now));
    const moved = this.isStale || isCatchingUp || this.isPlaying;
    if (isCatchingUp) {
      this.#fly(solid, this.goal, 2 * BUDGET);
      if (this.ghost && !isBehind(solid, this.goal)) this.#fly(this.ghost, this.now, 2 * BUDGET);
    } else {
      this.#steer();
      if (this.isPlaying) this.#play(seconds * this.rate);
    }
    const flown = performance.now();
    if (!isCatchingUp) this.#work(Math.max(SPARE, SHARE * seconds * 1000));
    if (this.solid.hasEnded && !this.result) {
      this.result = this.solid.result();
      this.isStale = true; // the next picture says it
    } else if (moved) this.isStale = false;
    const worked = performance.now();
    if (moved) this.#show(this.isPlaying ? seconds * this.rate : 0);
    const hasDrawn = this.scene.draw();
    const drawn = performance.now();
    if (moved && (!this.plotted || time - this.plotted > 90 || !this.isPlaying)) {
      this.plotted = time;
      this.#showNumbers();
      this.#keep("plots", performance.now() - drawn);
    }
    if (hasDrawn && this.isPlaying) {
      this.#keep("simulation", flown - begin);
      this.#keep("drawing", drawn - worked);
    }
  }

  /** Moves on by `seconds`, as far as the simulation follows; stops where both flights have ended. */
  #play(seconds) {
    const { solid, ghost } = this;
    const ends = [solid, ghost].filter((flight) => flight?.hasEnded).map((flight) => flight.flown);
    const isOver = solid.hasEnded && (!ghost || ghost.hasEnded);
    this.now = Math.min(this.now + seconds, isOver ? Math.max(...ends) : solid.duration);
    for (const flight of [solid, ghost]) {
      if (!flight) continue;
      this.#fly(flight, this.now, BUDGET);
      if (!flight.hasEnded) this.now = Math.min(this.now, flight.flown + flight.timeStep);
    }
    if (isOver && this.now >= Math.max(...ends)) this.play(false);
  }

  #keep(name, milliseconds) {
    const kept = this.times[name];
    kept.push(milliseconds);
    if (kept.length > 600) kept.shift();
  }

  #moment(flight, poses) {
    const row = this.rowAt(flight, this.now);
    const at = (name, width) => flight.series(name).subarray(row * width, (row + 1) * width);
    return {
      row,
      poses,
      com: at("com_position", 3),
      velocity: at("com_velocity", 3),
      reference: at("com_setpoint", 3),
      thrust: at("thrust", flight.jets.length),
      forces: at("aero_force_sim", 3 * flight.links.length),
      wind: at("wind", 3),
      path: flight.series("com_position"),
      referencePath: flight.series("com_setpoint"),
    };
  }

  #show(seconds) {
    if (!this.solid.rows) this.solid.advance(1);
    if (this.ghost && !this.ghost.rows) this.ghost.advance(1);
    const poses = [this.solid, this.ghost].map((flight) => flight && flight.pose(this.rowAt(flight, this.now)));
    // Signals are read where they lie: nothing may be asked of the simulator in between.
    this.scene.show(this.#moment(this.solid, poses[0]), this.ghost && this.#moment(this.ghost, poses[1]), seconds);
    $("time").value = this.now;
    $("clock").value = `${this.now.toFixed(this.rate < 1 ? 2 : 1)} / ${this.solid.duration} s`;
    this.#showWind();
  }

  #showNumbers() {
    const isDark = matchMedia("(prefers-color-scheme: dark)").matches;
    const styles = getComputedStyle(document.documentElement);
    const of = (name) => styles.getPropertyValue(`--${name}`).trim();
    const style = { ink: of("ink"), soft: of("soft"), line: of("line"), ghost: of("ghost") };
    this.plots.attitude.colours = [of("bad")];
    this.plots.com.colours = [of("accent")];
    this.plots.thrust.colours = JET_COLOURS[isDark ? "dark" : "light"];
    for (const plot of Object.values(this.plots)) plot.draw(this.solid, this.ghost, this.now, this.solid.duration, style);
    this.#showStatus();
    const middle = (kept) => [...kept].sort((a, b) => a - b)[kept.length >> 1]?.toFixed(1) ?? "–";
    $("timing").textContent = `A picture takes ${middle(this.times.simulation)} ms to simulate and ${middle(this.times.drawing)} ms to draw (medians); commit ${(data.commit ?? "unknown").slice(0, 7)}.`;
  }

  #showStatus() {
    const { solid, result } = this;
    const row = this.rowAt(solid, this.now);
    const com = solid.row("com_position", row);
    const off = Math.hypot(...solid.row("com_setpoint", row).map((x, axis) => x - com[axis]));
    const tilt = degrees(solid.row("rotation_error", row)[0]);
    const hasEnded = solid.hasEnded && this.now >= solid.flown - 0.5 * solid.timeStep && result;
    const [words, mood] = hasEnded ? verdict(result, com[0]) : ["Flying", ""];
    const about = `tilt ${tilt.toFixed(1)}°, ${off < 0.995 ? `${(100 * off).toFixed(1)} cm` : `${off.toFixed(2)} m`} off course, height ${com[2].toFixed(1)} m, ${Math.abs(com[0]).toFixed(0)} m flown`;
    $("status").replaceChildren(
      make("div", { className: `outcome ${mood}` }, words),
      make("div", { className: "about" }, about),
      make("div", { className: "about" }, title(this.settings)),
    );
  }

  #showWind() {
    const [x, y] = this.target;
    const [speed, from] = speedAndDirection(x, y);
    const [nowX, nowY] = this.solid.row("wind", this.rowAt(this.solid, this.now));
    // The robot looks up; its left is left. The handle is where the wind comes from.
    const place = (px, py) => [(py / STRONGEST) * 70, (px / STRONGEST) * 70];
    const [hx, hy] = place(x, y);
    const [bx, by] = place(nowX, nowY);
    const pad = $("pad");
    pad.querySelector(".blows").setAttribute("x1", bx);
    pad.querySelector(".blows").setAttribute("y1", by);
    pad.querySelector(".handle").setAttribute("cx", hx);
    pad.querySelector(".handle").setAttribute("cy", hy);
    const words = `${speed.toFixed(1)} m/s from ${side(from)}`;
    const set = speed < 0.05 ? "still air" : words;
    const blows = Math.hypot(nowX, nowY);
    pad.setAttribute("aria-valuenow", speed.toFixed(1));
    pad.setAttribute("aria-valuetext", set);
    $("wind").value = Math.abs(blows - speed) > 0.05 ? `${blows.toFixed(1)} → ${set}` : set;
  }

  say(message) {
    $("message").hidden = !message;
    $("message").textContent = message ?? "";
  }

  play(isPlaying) {
    if (isPlaying && this.solid?.hasEnded && this.now >= this.solid.flown - 1e-9) this.now = 0;
    this.isPlaying = isPlaying;
    this.isStale = true;
    $("play").innerHTML = isPlaying
      ? '<svg viewBox="0 0 16 16"><path d="M3 1h4v14H3zM9 1h4v14H9z"/></svg>'
      : '<svg viewBox="0 0 16 16"><path d="M3 1l11 7-11 7z"/></svg>';
    $("play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
  }

  /** Goes to a time; what is not flown yet is flown first. */
  seek(time) {
    const wanted = Math.min(Math.max(time, 0), this.solid.duration);
    this.now = this.solid.hasEnded ? Math.min(wanted, this.solid.flown) : wanted;
    this.goal = this.now;
    this.isStale = true;
  }

  // --- tour ------------------------------------------------------------------------------------------------------

  async visit(index) {
    const scene = TOUR[index];
    this.settings = { ...scene.settings, steer: [] };
    this.ghostKind = scene.ghost;
    this.wanted = null;
    this.scene.view();
    this.begin(scene.start);
    this.scenario = index;
    this.#setRate(1);
    this.play(true);
    this.#showScene("…", "computing");
    this.#showSettings();
    const flights = Object.entries({ watched: scene.settings, ...scene.others });
    const results = await Promise.all(flights.map(async ([name, settings]) => [name, await this.flyWhole(settings)]));
    if (this.scenario === index) this.#showScene(...scene.proof(Object.fromEntries(results)));
  }

  #showScene(number, words) {
    const index = this.scenario;
    const scene = TOUR[index];
    const next = index + 1 < TOUR.length ? [make("button", { type: "button", onclick: () => this.visit(index + 1) }, "Next scene")] : [];
    const close = make("button", { type: "button", className: "close", title: "Close", onclick: () => this.#closeScene() }, "×");
    $("caption").replaceChildren(
      make("h2", {}, `${index + 1}. ${scene.name}`),
      make("p", {}, scene.text),
      make("div", { className: "proof" }, make("b", {}, number), make("span", {}, words)),
      ...next,
      close,
    );
    $("caption").hidden = false;
  }

  #closeScene() {
    this.scenario = null;
    $("caption").hidden = true;
    this.#showSettings();
  }

  // --- controls --------------------------------------------------------------------------------------------------

  #build() {
    this.plots = {
      attitude: new Plot($("plot-attitude"), { least: 5, digits: 0, read: (flight) => {
        const error = flight.series("rotation_error");
        return [(row) => degrees(error[row])];
      } }),
      com: new Plot($("plot-com"), { least: 0.02, digits: 2, read: (flight) => {
        const [com, reference] = [flight.series("com_position"), flight.series("com_setpoint")];
        return [(row) => Math.hypot(com[3 * row] - reference[3 * row], com[3 * row + 1] - reference[3 * row + 1], com[3 * row + 2] - reference[3 * row + 2])];
      } }),
      thrust: new Plot($("plot-thrust"), { least: 100, digits: 0, ghosted: false, read: (flight) => {
        const [thrust, jets] = [flight.series("thrust"), flight.jets.length];
        return flight.jets.map((_, jet) => (row) => thrust[row * jets + jet]);
      } }),
    };
    $("tour").append(...TOUR.map(({ name }, index) => make("button", { type: "button", onclick: () => this.visit(index) }, `${index + 1} ${name}`)));
    $("rate").append(...RATES.map((rate) => make("option", { value: rate }, `${rate}×`)));
    $("again").innerHTML = '<svg viewBox="0 0 16 16"><path d="M2 1h2.4v14H2zM14 1v14L5 8z"/></svg>';
    this.#setRate(1);
    this.play(this.isPlaying);
    $("pad").innerHTML = `<circle class="ring" r="23.3"/><circle class="ring" r="46.7"/><circle class="ring" r="70"/>
      <text y="-72">ahead</text><text x="-60" y="-14">left</text><text y="34">10</text><text y="57">20</text>
      <path class="robot" d="M0-9L6 6H-6z"/><line class="blows" x2="0" y2="0"/><circle class="handle" r="8"/>`;
    this.#buildChoices();
    const { colours, scales } = data.look;
    $("legend").append(
      ...[
        [colours.force, `aerodynamic force on a link: ${(100 * scales.force).toFixed(0)} cm per N`],
        [colours.plume, `thrust: ${(1e4 * scales.thrust).toFixed(0)} cm per 100 N`],
        [colours.wind, `wind: ${(1000 * scales.wind).toFixed(0)} cm per 10 m/s`],
        [colours.reference, "centre of mass: set-point"],
        [colours.trail, "centre of mass: trail"],
        [colours.ghost, "ghost"],
      ].flatMap(([colour, words]) => [Object.assign(make("i"), { style: `background: rgb(${colour})` }), make("span", {}, words)]),
    );
  }

  #buildChoices() {
    this.fields = {};
    const list = (key, { label, values }, set) => {
      const hint = make("small", { id: `hint-${key}` });
      const select = make("select", { id: key }, ...Object.entries(values).map(([value, [name]]) => make("option", { value }, name)));
      select.setAttribute("aria-describedby", hint.id);
      select.onchange = () => set(select.value);
      const box = make("div", { className: "choice" }, make("label", { htmlFor: key }, label), select, hint);
      this.fields[key] = { box, show: (value) => ((select.value = value), (hint.textContent = values[value][1])) };
      return box;
    };
    const range = (key, { label, unit, min, max, step, meaning }, set, isLive) => {
      const input = make("input", { id: key, type: "range", min, max, step });
      const output = make("output", { htmlFor: key });
      const say = () => (output.value = `${Number(input.value)} ${unit}`);
      input.oninput = () => (say(), isLive && set(Number(input.value)));
      if (!isLive) input.onchange = () => set(Number(input.value));
      const hint = make("small", { id: `hint-${key}` }, meaning);
      input.setAttribute("aria-describedby", hint.id);
      const box = make("div", { className: "choice" }, make("label", { htmlFor: key }, label), make("div", { className: "range" }, input, output), hint);
      this.fields[key] = { box, show: (value) => ((input.value = value), (output.value = `${round(value)} ${unit}`)) };
      return box;
    };
    const group = (name, ...children) => make("fieldset", {}, make("legend", {}, name), ...children);
    const folded = (name, ...children) => make("details", {}, make("summary", {}, name), make("fieldset", {}, ...children));
    const lists = Object.entries(LISTS).map(([key, entry]) => list(key, entry, (value) => this.change({ [key]: value })));
    const numbers = (of) => Object.entries(NUMBERS).filter(([, { group: name }]) => name === of)
      .map(([key, entry]) => range(key, entry, (value) => this.change({ [key]: value })));
    this.tests = Object.entries(TESTS).map(([name, test]) => {
      const button = make("button", { type: "button", onclick: () => this.change({ ...DEFAULTS, ...test, steer: [] }) }, name);
      return [button, test];
    });
    this.engines = Object.entries(ENGINES).map(([jet, name]) => {
      const button = make("button", { type: "button", onclick: () => this.switchEngine(jet) }, name);
      return [button, jet];
    });
    this.clear = make("button", { type: "button", onclick: () => this.change({ steer: [] }) }, "Forget the dragged wind");
    const windTo = (speed, from) => this.blow(velocity(speed, from).slice(0, 2));
    const hint = (words) => make("small", {}, words);
    $("choices").append(
      group("Flight",
        make("div", { className: "row" }, ...this.tests.map(([button]) => button)),
        hint("The paper's four flights: baseline and aware controller, in the air of axisymmetric links and of the network."),
        ...lists),
      group("Wind, at any time",
        range("speed", { label: "speed", unit: "m/s", min: 0, max: STRONGEST, step: 0.5, meaning: "The paper's wind rises between 5 and 10 s; dragged later, it turns within 0.2 s." }, (speed) => windTo(speed, this.windFrom), true),
        range("from", { label: "from", unit: "°", min: -180, max: 180, step: 5, meaning: "0 from ahead, 90 from the robot's left, −90 from its right." }, (from) => windTo(Math.hypot(...this.target), from), true),
        make("div", { className: "row" }, this.clear)),
      group("Switch an engine off, now",
        make("div", { className: "row" }, ...this.engines.map(([button]) => button)),
        hint("Its thrust is gone at this moment of the flight, and the controller is not told.")),
      group("Ghost", list("ghost", { label: "beside it", values: GHOSTS }, (kind) => {
        this.ghostKind = kind;
        this.#beginGhost();
        this.goal = this.now;
        this.isStale = true;
        this.#showSettings();
      })),
      folded("Gains", ...numbers("gains")),
      folded("Errors of the controller's model", ...numbers("errors")),
    );
    $("jets-key").append(...Object.values(ENGINES).map((name) => make("i", {}, name)));
  }

  get windFrom() {
    const [speed, from] = speedAndDirection(...this.target);
    return speed < 0.05 ? (this.lastFrom ?? 90) : (this.lastFrom = from);
  }

  #showSettings() {
    const { settings } = this;
    for (const key of [...Object.keys(LISTS), ...Object.keys(NUMBERS)]) {
      this.fields[key].show(settings[key]);
      this.fields[key].box.classList.toggle("idle", !matters(key, settings));
    }
    this.fields.ghost.show(this.ghostKind);
    this.fields.speed.show(Math.hypot(...this.target));
    this.fields.from.show(Math.round(this.windFrom));
    this.clear.hidden = !settings.steer.length;
    for (const [button, test] of this.tests) button.setAttribute("aria-pressed", toHash({ ...DEFAULTS, ...test }) === toHash(settings));
    for (const [button, jet] of this.engines) button.setAttribute("aria-pressed", settings.engine?.[0] === jet);
    [...$("tour").children].forEach((button, index) => {
      button.setAttribute("aria-current", index === this.scenario);
      if (index === this.scenario) $("tour").scrollLeft = button.offsetLeft - $("tour").offsetLeft - 40;
    });
    if (this.scenario === null) $("caption").hidden = true;
    const colours = JET_COLOURS[matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"];
    [...$("jets-key").children].forEach((key, index) => (key.style.color = colours[index]));
  }

  #setRate(rate) {
    this.rate = rate;
    $("rate").value = rate;
  }

  #listen() {
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const theme = () => (this.scene.theme(dark.matches ? "dark" : "light"), this.#showSettings(), (this.isStale = true));
    dark.addEventListener("change", theme);
    theme();
    new ResizeObserver(() => (this.scene.resize(), (this.isStale = true))).observe($("stage"));
    this.scene.resize();
    $("play").onclick = () => this.play(!this.isPlaying);
    $("again").onclick = () => this.seek(0);
    $("time").oninput = () => this.seek(Number($("time").value));
    $("rate").onchange = () => this.#setRate(Number($("rate").value));
    $("link").onclick = () => this.#copyLink();
    $("export").onclick = () => this.#export();
    addEventListener("hashchange", () => {
      this.settings = fromHash(location.hash);
      this.scenario = this.wanted = null;
      this.begin();
    });
    addEventListener("keydown", (event) => this.#key(event));
    for (const plot of Object.values(this.plots)) {
      const scrub = (event) => event.buttons && this.seek(plot.timeAt(event));
      plot.canvas.addEventListener("pointerdown", scrub);
      plot.canvas.addEventListener("pointermove", scrub);
    }
    this.#drag($("pad"), () => true, (event) => {
      const { left, top, width, height } = $("pad").getBoundingClientRect();
      const [x, y] = [((event.clientX - left) / width - 0.5) * 164, ((event.clientY - top) / height - 0.5) * 164];
      return [(y / 70) * STRONGEST, (x / 70) * STRONGEST];
    });
    this.#drag($("scene"), (event) => this.scene.grips(event), (event) => this.scene.windAt(event));
    $("scene").addEventListener("pointermove", (event) => {
      if (!event.buttons) $("scene").style.cursor = this.scene.windCentre && this.scene.grips(event) ? "grab" : "";
    });
  }

  /** Lets a pointer drag the wind; `read` gives the wind under it. */
  #drag(element, takes, read) {
    const move = (event) => {
      const wind = read(event);
      if (wind) this.blow(wind);
    };
    element.addEventListener("pointerdown", (event) => {
      if (!takes(event)) return;
      this.isDragging = true;
      this.scene.controls.enabled = false;
      element.setPointerCapture(event.pointerId);
      element.addEventListener("pointermove", move);
      move(event);
    }, { capture: true });
    for (const name of ["pointerup", "pointercancel"]) {
      element.addEventListener(name, () => {
        this.isDragging = false;
        this.scene.controls.enabled = true;
        element.removeEventListener("pointermove", move);
      });
    }
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target === $("pad") && event.key.startsWith("Arrow")) {
      const [speed, from] = [Math.hypot(...this.target), this.windFrom];
      const step = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 5], ArrowRight: [0, -5] }[event.key];
      this.blow(velocity(Math.max(speed + step[0], 0), from + step[1]));
      event.preventDefault();
      return;
    }
    if (event.target.closest("input, select, summary")) return;
    const second = event.shiftKey ? 1 : 0.1;
    const keys = {
      ArrowLeft: () => this.seek(this.now - second),
      ArrowRight: () => this.seek(this.now + second),
      r: () => this.seek(0),
      v: () => this.scene.view(),
      w: () => $("pad").focus(),
    };
    if (!event.target.closest("button")) keys[" "] = () => this.play(!this.isPlaying);
    TOUR.forEach((_, index) => (keys[index + 1] = () => this.visit(index)));
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    action();
    event.preventDefault();
  }

  async #copyLink() {
    const link = location.href.replace(/#.*/, "") + toHash(this.settings);
    try {
      await navigator.clipboard.writeText(link);
      $("link").textContent = "Copied";
    } catch {
      $("link").textContent = "It is in the address bar"; // no clipboard without permission
    }
    setTimeout(() => ($("link").textContent = "Copy link"), 1600);
  }

  /** Every signal of the flight, flown to its end, as a result file. */
  record() {
    const { solid } = this;
    solid.advance(solid.n_ticks + 1);
    const result = solid.result();
    const log = solid.signals.map(({ name, row_shape }) => [name, { shape: [solid.rows, ...row_shape], data: base64(solid.series(name)) }]);
    this.isStale = true;
    return {
      format: "flight-lab-run",
      version: 1,
      name: "lab",
      title: solid.config.title,
      ...result,
      config: solid.config,
      link: toHash(this.settings),
      engine: "rust",
      created: new Date().toISOString(),
      git: { commit: data.commit, dirty: null },
      versions: { "flight-core": data.look.version },
      device: { browser: navigator.userAgent },
      log: Object.fromEntries(log),
    };
  }

  #export() {
    const blob = new Blob([JSON.stringify(this.record())], { type: "application/json" });
    const anchor = make("a", { href: URL.createObjectURL(blob), download: "run.json" });
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(anchor.href), 10000);
  }
}

/** How a flight ended, in words, and whether that is good. */
function verdict({ outcome, lost_time: lost, lost_reason: reason, summary }, distance) {
  const tilt = degrees(summary.max_rotation_error);
  if (outcome === "fell") return [`Falls at ${lost.toFixed(1)} s: ${reason.replace(" deg", "°")}`, "bad"];
  if (outcome === "diverged") return [`The computation diverges at ${lost.toFixed(1)} s: ${reason}`, "bad"];
  if (outcome === "off_course") return [`Flies to the end, but up to ${summary.max_com_error.toFixed(2)} m off course`, "bad"];
  const where = distance > 5 ? "Arrives" : "Stays in place";
  const off = `${(100 * summary.max_com_error).toFixed(1)} cm off course at most`;
  return tilt > LEANING ? [`${where}, leaning: up to ${tilt.toFixed(1)}°, ${off}`, "bad"] : [`${where} upright: ${tilt.toFixed(1)}° of tilt, ${off}`, "good"];
}

/** A direction in words: 0 ahead, 90 left. */
function side(from) {
  const names = ["ahead", "ahead left", "the left", "behind left", "behind", "behind right", "the right", "ahead right"];
  return names[((Math.round(from / 45) % 8) + 8) % 8];
}

function base64(numbers) {
  const all = new Uint8Array(numbers.buffer, numbers.byteOffset, numbers.byteLength);
  let text = "";
  for (let at = 0; at < all.length; at += 0x8000) text += String.fromCharCode(...all.subarray(at, at + 0x8000));
  return btoa(text);
}

const binary = Object.fromEntries(Object.entries(data.binary).map(([path, text]) => [path, bytes(text)]));
Lab.load(bytes(data.wasm), { ...data.files, ...binary }).then(
  (lab) => {
    window.page = new Page(lab);
    window.scenarios = { DEFAULTS, TESTS, TOUR, configuration, fromHash, toHash };
  },
  (error) => {
    $("message").hidden = false;
    $("message").textContent = `The simulator does not start: ${error.message}`;
  },
);
