// Playback of a flight and of a ghost beside it: scene, time line, plots, figures, keys. A flight is an object with `title`,
// `signals` (name, unit, dims, width), `look`, `rows`, `timeStep`, `duration`, `flown`, `hasEnded`, `series(name)`,
// `row(name, row)`, `pose(row)`, `result()` and `end()`.
import { Plot, short } from "./plots.js";
import { partName } from "./scenario.js";
import { Scene } from "./scene.js";

export const $ = (id) => document.getElementById(id);
export const make = (tag, attributes = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), attributes);
  element.append(...children);
  return element;
};
export const degrees = (radians) => (radians * 180) / Math.PI;

const SETTLED = 3; // errors of position count from here on [s]
const RATES = [0.1, 0.25, 0.5, 1, 2, 5];
const COLOURS = {
  light: ["#0072b2", "#3a9bd0", "#d08a00", "#c24f00", "#00785a", "#a04a80", "#684eaa", "#5a6270"],
  dark: ["#3f9bd8", "#8fd0f5", "#e69f00", "#ff8a4a", "#3cc49b", "#e08fc0", "#a892e0", "#9ca6b4"],
};
const isDark = matchMedia("(prefers-color-scheme: dark)");

/** Curves that are no signals: title, unit, and for a flight a function of the row. */
const DERIVED = {
  attitude: { title: "rotation error", unit: "°", least: 5, read: (flight) => {
    const error = flight.series("rotation_error");
    return [(row) => degrees(error[row])];
  } },
  lean: { title: "lean", unit: "°", least: 5, read: (flight) => {
    const wxyz = flight.series("base_quaternion");
    return [(row) => degrees(Math.acos(Math.min(Math.max(1 - 2 * (wxyz[4 * row + 1] ** 2 + wxyz[4 * row + 2] ** 2), -1), 1)))];
  } },
  com: { title: "CoM error", unit: "m", least: 0.02, read: (flight) => {
    const [com, reference] = [flight.series("com_position"), flight.series("com_setpoint")];
    return [(row) => Math.hypot(...[0, 1, 2].map((axis) => com[3 * row + axis] - reference[3 * row + axis]))];
  } },
};

/** Figures of merit of a whole flight: words by name. */
const figures = (flight) => {
  const largest = (read, from = 0) => {
    let most = 0;
    for (let row = from; row < flight.rows; row++) most = Math.max(most, read(row));
    return most;
  };
  const [angle, course, thrust, force, reference] = [DERIVED.attitude.read(flight)[0], DERIVED.com.read(flight)[0], flight.series("thrust"), flight.series("aero_force_sim"), flight.series("com_setpoint")];
  const settled = flight.flown > SETTLED ? Math.round(SETTLED / flight.timeStep) : flight.rows - 1;
  const links = force.length / flight.rows;
  const total = (row) => Math.hypot(...[0, 1, 2].map((axis) => {
    let sum = 0;
    for (let at = axis; at < links; at += 3) sum += force[links * row + at];
    return sum;
  }));
  let distance = 0;
  for (let at = 3; at < reference.length; at += 3) distance += Math.hypot(reference[at] - reference[at - 3], reference[at + 1] - reference[at - 2]);
  const [least, most] = thrust.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, 0]);
  return {
    rotationError: largest(angle),
    comError: largest(course, settled),
    hasSettled: flight.flown > SETTLED,
    thrust: thrust.length ? [least, most] : null,
    force: largest(total),
    distance,
  };
};

export class Player {
  constructor(look) {
    this.look = look;
    this.scene = new Scene($("scene"), look);
    this.merits = new WeakMap();
    this.solid = this.ghost = null;
    this.now = 0;
    this.isPlaying = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.rate = 1;
    this.times = { simulation: [], drawing: [], plots: [] };
    this.legend = {}; // entries by layer
    this.#build();
  }

  /** Plays, once there is a flight. */
  start() {
    this.#listen();
    this.last = performance.now();
    this.passed = 0; // since the last picture [s]
    requestAnimationFrame((time) => this.#frame(time));
  }

  get duration() {
    return Math.max(...[this.solid, this.ghost].filter(Boolean).map((flight) => flight.duration));
  }

  rowAt(flight, time) {
    return Math.max(Math.min(Math.round(time / flight.timeStep), flight.rows - 1), 0);
  }

  // --- pictures --------------------------------------------------------------------------------------------------

  /** Moves on by `seconds` of the clock; whether there is something new to show. */
  advance(seconds) {
    const moved = this.isStale || this.isPlaying;
    if (this.isPlaying) this.step(seconds * this.rate);
    return moved;
  }

  /** What else is to be done between two pictures; may find something new to show. */
  work() {}

  /** Moves on by `seconds` of the flight, as far as flights are flown; stops where all have ended. */
  step(seconds) {
    const flights = [this.solid, this.ghost].filter(Boolean);
    const isOver = flights.every((flight) => flight.hasEnded);
    const end = isOver ? Math.max(...flights.map((flight) => flight.flown)) : this.duration;
    this.now = Math.min(this.now + seconds, end);
    this.fly(flights);
    if (isOver && this.now >= end) this.play(false);
  }

  /** Flies up to now, or takes back the time that is not reached. */
  fly() {}

  #frame(time) {
    requestAnimationFrame((next) => this.#frame(next));
    this.passed = Math.max(time - this.last, 0) / 1000; // the first picture may have been due before the start
    const seconds = Math.min(this.passed, 0.1);
    this.last = time;
    if (!this.solid) return;
    const begin = performance.now();
    const moved = this.advance(seconds);
    const flown = performance.now();
    this.isStale = false;
    this.work();
    const worked = performance.now();
    if (moved) this.show(this.isPlaying ? seconds * this.rate : 0);
    const hasDrawn = this.scene.draw();
    const drawn = performance.now();
    if (moved && (!this.plotted || time - this.plotted > 90 || !this.isPlaying)) {
      this.plotted = time;
      this.showNumbers();
      this.#keep("plots", performance.now() - drawn);
    }
    if (hasDrawn && this.isPlaying) {
      this.#keep("simulation", flown - begin);
      this.#keep("drawing", drawn - worked);
    }
  }

  #keep(name, milliseconds) {
    const kept = this.times[name];
    kept.push(milliseconds);
    if (kept.length > 600) kept.shift();
  }

  /** What pictures took [ms]: median and 95th percentile of each part, over the last 600. */
  get frameTimes() {
    const at = (sorted, share) => sorted[Math.floor(share * (sorted.length - 1))] ?? null;
    return Object.fromEntries(Object.entries(this.times).map(([name, kept]) => {
      const sorted = [...kept].sort((a, b) => a - b);
      return [name, { median: at(sorted, 0.5), p95: at(sorted, 0.95), pictures: sorted.length }];
    }));
  }

  #moment(flight, poses) {
    const row = this.rowAt(flight, this.now);
    const at = (name, width) => flight.series(name).subarray(row * width, (row + 1) * width);
    return {
      row,
      poses,
      look: flight.look,
      com: at("com_position", 3),
      velocity: at("com_velocity", 3),
      reference: at("com_setpoint", 3),
      thrust: at("thrust", flight.look.jets.length),
      forces: at("aero_force_sim", 3 * flight.look.links.length),
      wind: at("wind", 3),
      path: flight.series("com_position"),
      referencePath: flight.series("com_setpoint"),
    };
  }

  /** Shows now; `seconds` of the flight have passed since the last picture. */
  show(seconds) {
    const poses = [this.solid, this.ghost].map((flight) => flight && flight.pose(this.rowAt(flight, this.now)));
    // Signals are read where they lie: nothing may be asked of the simulator in between.
    this.scene.show(this.#moment(this.solid, poses[0]), this.ghost && this.#moment(this.ghost, poses[1]), seconds);
    $("time").max = this.duration;
    $("time").value = this.now;
    $("clock").value = `${this.now.toFixed(this.rate < 1 ? 2 : 1)} / ${Number(this.duration.toFixed(1))} s`;
  }

  showNumbers() {
    const styles = getComputedStyle(document.documentElement);
    const of = (name) => styles.getPropertyValue(`--${name}`).trim();
    const style = { ink: of("ink"), soft: of("soft"), line: of("line"), ghost: of("ghost") };
    const row = this.rowAt(this.solid, this.now);
    for (const { plot, select, key, names } of this.plots ?? []) {
      plot.colours = { attitude: [of("bad")], com: [of("accent")] }[select.value] ?? COLOURS[isDark.matches ? "dark" : "light"];
      plot.draw(this.solid, this.ghost, this.now, this.duration, style);
      const curves = names.length ? plot.read(this.solid) : [];
      names.forEach((name, index) => (key.children[index].textContent = `${name} ${curves[index] ? short(curves[index](row)) : "–"}`));
    }
    this.#showFigures();
  }

  /** Outcome and figures of merit of a flight that has ended. */
  merit(flight) {
    if (!flight?.hasEnded) return null;
    if (!this.merits.has(flight)) this.merits.set(flight, { ...flight.result(), ...figures(flight) });
    return this.merits.get(flight);
  }

  #showFigures() {
    const flights = [this.solid, this.ghost].filter(Boolean);
    this.legend.ghost.hidden = !this.ghost;
    const merits = flights.map((flight) => this.merit(flight));
    const said = JSON.stringify([flights.map(({ title }) => title), merits.map(Boolean)]);
    if (said === this.saidFigures && merits.every((merit, index) => merit === this.shownMerits[index])) return;
    [this.saidFigures, this.shownMerits] = [said, merits];
    const row = (name, words) => make("tr", {}, make("th", {}, name), ...merits.map((merit) => make("td", {}, merit ? words(merit) : "–")));
    const heads = flights.map((flight, index) => make("th", {}, index ? `ghost: ${flight.title}` : flight.title));
    $("figures").replaceChildren(
      make("tr", {}, make("th", {}), ...heads),
      row("outcome", ({ outcome, lost_time: lost, lost_reason: reason }) => (lost == null ? outcome.replace("_", " ") : `${outcome} at ${lost.toFixed(1)} s${reason ? ` (${reason})` : ""}`)),
      row("rotation error", ({ rotationError }) => `${rotationError.toFixed(1)}°`),
      row("CoM error", ({ comError }) => `${comError.toFixed(3)} m`),
      row("thrusts", ({ thrust }) => (thrust ? `${thrust[0].toFixed(0)}–${thrust[1].toFixed(0)} N` : "–")),
      row("aerodynamic force", ({ force }) => `${force.toFixed(1)} N`),
      row("distance", ({ distance }) => `${distance.toFixed(1)} m`),
    );
  }

  /** The moment in numbers: pairs of name and value. */
  get readings() {
    const { solid } = this;
    const row = this.rowAt(solid, this.now);
    const com = solid.row("com_position", row);
    const off = Math.hypot(...solid.row("com_setpoint", row).map((x, axis) => x - com[axis]));
    const error = degrees(solid.row("rotation_error", row)[0]);
    const speed = Math.hypot(...solid.row("com_velocity", row));
    const forces = solid.row("aero_force_sim", row);
    const air = Math.hypot(...[0, 1, 2].map((axis) => forces.reduce((sum, force, index) => sum + (index % 3 === axis ? force : 0), 0)));
    const course = off < 0.995 ? `${(100 * off).toFixed(1)}\u00a0cm` : `${off.toFixed(2)}\u00a0m`;
    // The third entry of the base's z axis; rotations are kept by columns, the base is the first body.
    const lean = degrees(Math.acos(Math.min(Math.max(solid.pose(row)[8], -1), 1)));
    return [
      ["rotation error", `${error.toFixed(1)}°`],
      ["lean", `${lean.toFixed(1)}°`],
      ["off course", course],
      ["height", `${com[2].toFixed(1)}\u00a0m`],
      ["flown", `${Math.abs(com[0]).toFixed(0)}\u00a0m`],
      ["speed", `${speed.toFixed(1)}\u00a0m/s`],
      ["force of the air", `${air.toFixed(1)}\u00a0N`],
      ["wind", `${Math.hypot(...solid.row("wind", row)).toFixed(1)}\u00a0m/s`],
    ];
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

  /** Goes to a time. */
  seek(time) {
    this.now = Math.min(Math.max(time, 0), this.duration);
    this.isStale = true;
  }

  setRate(rate) {
    this.rate = rate;
    $("rate").value = rate;
  }

  // --- controls --------------------------------------------------------------------------------------------------

  #build() {
    $("rate").append(...RATES.map((rate) => make("option", { value: rate }, `${rate}×`)));
    $("again").innerHTML = '<svg viewBox="0 0 16 16"><path d="M2 1h2.4v14H2zM14 1v14L5 8z"/></svg>';
    this.setRate(1);
    this.play(this.isPlaying);
    const [length, words] = [$("length"), make("span")];
    const rows = {
      force: [words],
      plume: [`thrust: ${(1e4 * this.look.scales.thrust).toFixed(0)} cm per 100 N`],
      wind: [`wind: ${(1000 * this.look.scales.wind).toFixed(0)} cm per 10 m/s`],
      reference: ["centre of mass: set-point"],
      trail: ["centre of mass: trail"],
      ghost: ["ghost; dashed in the plots"],
    };
    for (const [name, said] of Object.entries(rows)) {
      const layer = this.scene.layers[name];
      const toggle = () => ((layer.visible = box.checked), (this.isStale = true));
      const box = make("input", { type: "checkbox", checked: true, onchange: toggle });
      const bar = Object.assign(make("i"), { style: `background: rgb(${this.look.colours[name]})` });
      this.legend[name] = make("label", {}, box, bar, make("span", {}, ...said));
      $("legend").append(this.legend[name]);
    }
    const rescale = () => {
      this.scene.scales.force = length.value / 100;
      words.textContent = `aerodynamic force on a link: ${length.value} cm per N`;
      this.isStale = true;
    };
    length.value = 100 * this.look.scales.force;
    length.oninput = rescale;
    rescale();
    $("follow").onchange = () => (this.scene.follow($("follow").checked), (this.isStale = true));
  }

  /** Makes the plots, whose signals are chosen from those of a flight. */
  buildPlots(flight) {
    const shown = flight.signals.filter(({ name, dims }) => dims[0] === "time" && !["time", "event"].includes(name));
    this.plots = ["attitude", "com", "thrust"].map((chosen) => {
      const select = make("select", { ariaLabel: "Signal of this plot" });
      const option = (value, title, unit) => make("option", { value }, unit ? `${title} [${unit}]` : title);
      select.append(...Object.entries(DERIVED).map(([key, { title, unit }]) => option(key, title, unit)));
      select.append(...shown.map(({ name, unit }) => option(name, name.replaceAll("_", " "), unit)));
      const key = make("span", { className: "key" });
      const canvas = make("canvas", { className: "plot", id: `plot-${chosen}` });
      const made = { plot: new Plot(canvas), select, key, names: [] };
      const choose = (value) => {
        select.value = value;
        const read = (of) => {
          const { width } = of.signals.find(({ name }) => name === value) ?? { width: 0 };
          if (!width) return [];
          const series = of.series(value);
          return Array.from({ length: width }, (_, column) => (row) => series[row * width + column]);
        };
        made.plot.take(DERIVED[value] ?? { read, least: value === "thrust" ? 100 : 0 });
        const { dims } = flight.signals.find(({ name }) => name === value) ?? { dims: [] };
        const entries = (names, dim) => names.flatMap((name) => flight.look.labels[dim].map((label) => [...name, partName(label)]));
        made.names = dims.length > 1 ? dims.slice(1).reduce(entries, [[]]).map((name) => name.join(" ")) : [];
        key.replaceChildren(...made.names.map(() => make("i")));
        this.paintKeys();
        this.isStale = true;
      };
      select.onchange = () => choose(select.value);
      const scrub = (event) => event.buttons && this.seek(made.plot.timeAt(event));
      canvas.addEventListener("pointerdown", scrub);
      canvas.addEventListener("pointermove", scrub);
      $("plots").append(make("figure", {}, make("figcaption", {}, select, key), canvas));
      queueMicrotask(() => choose(chosen));
      return made;
    });
  }

  paintKeys() {
    const colours = COLOURS[isDark.matches ? "dark" : "light"];
    for (const { key } of this.plots ?? []) [...key.children].forEach((name, index) => (name.style.color = colours[index % colours.length]));
  }

  #listen() {
    const theme = () => (this.scene.theme(isDark.matches ? "dark" : "light"), this.paintKeys(), (this.isStale = true));
    isDark.addEventListener("change", theme);
    theme();
    new ResizeObserver(() => (this.scene.resize(), (this.isStale = true))).observe($("stage"));
    this.scene.resize();
    $("play").onclick = () => this.play(!this.isPlaying);
    $("again").onclick = () => this.seek(0);
    $("time").oninput = () => this.seek(Number($("time").value));
    $("rate").onchange = () => this.setRate(Number($("rate").value));
    addEventListener("keydown", (event) => this.#key(event));
  }

  /** What keys do, by their name. */
  keys(event) {
    const second = event.shiftKey ? 1 : 0.1;
    const keys = {
      ArrowLeft: () => this.seek(this.now - second),
      ArrowRight: () => this.seek(this.now + second),
      r: () => this.seek(0),
      v: () => this.scene.view(),
      c: () => $("follow").click(),
    };
    if (!event.target.closest("button")) keys[" "] = () => this.play(!this.isPlaying);
    return keys;
  }

  #key(event) {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest("input, select, summary")) return;
    const action = this.keys(event)[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    action();
    event.preventDefault();
  }
}
