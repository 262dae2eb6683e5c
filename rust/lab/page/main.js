// The page: playback of recorded flights, and flights of the simulator with settings, wind, engines and a tour around them.
import { Lab, bytes } from "./lab.js";
import { $, Player, degrees, make } from "./player.js";
import { Recorded } from "./recorded.js";
import { DEFAULTS, NUMBERS, STRONGEST, Scenario, TESTS, matters, partName, rampTo, round, speedAndDirection, velocity } from "./scenario.js";
import { TOUR } from "./tour.js";

const data = JSON.parse($("data").textContent);
const { simulator } = data;
const BUDGET = 12; // of a picture, for the simulation [ms]
const SPARE = 6; // of a picture, for flights in the background: at least this [ms],
const SHARE = 0.25; // and this share of the time that pictures take
const CHUNK = 5; // ticks between two looks at the clock
const TURNING = 0.2; // a dragged wind needs this long for each change [s]
const LEANING = 10; // beyond this rotation error a flight that completes is said to lean [deg]
const GHOSTS = {
  none: ["none", "One robot flies."],
  baseline: ["baseline", "The same flight under the baseline, in the same wind."],
  aware: ["aware", "The same flight under the aware controller, in the same wind."],
  observer: ["observer, no model", "The same flight under the observer without a model, in the same wind."],
  previous: ["the flight before", "What was flown before the last change."],
  kept: "A result, or a flight that was kept.",
};

class Page extends Player {
  /** Plays recorded flights; with a simulator, flies a scenario. */
  constructor(lab) {
    super(data.looks[0]);
    this.lab = lab;
    this.kept = data.flights.map((flight) => new Recorded(flight, data.looks)); // ghosts to choose from
    [this.solid = null] = this.kept;
    this.ghostKind = this.kept.length > 1 ? "1" : "none";
    this.previous = null;
    this.goal = 0; // flown to before playing goes on [s]
    this.wanted = null; // wind that is being dragged to (x, y) [m/s]
    this.jobs = []; // flights in the background
    this.whole = new Map(); // results of whole flights, by link
    this.visited = null; // scene of the tour
    this.isLab = !this.solid;
    if (lab) this.#prepare();
    this.#build();
    if (this.scenario && (this.isLab || this.scenario.toHash(this.settings))) this.begin();
    else this.#beginGhost();
    this.#showSettings();
    this.buildPlots(this.solid);
    this.#listen();
    this.start();
  }

  /** Reads the scenario from its configuration; without it, recorded flights are only played. */
  #prepare() {
    try {
      const base = this.lab.begin(simulator.config);
      this.scenario = new Scenario(base, this.isLab ? DEFAULTS.mission : "given", simulator.networks);
      base.end();
      this.settings = this.scenario.fromHash(location.hash);
    } catch (error) {
      this.lab = null;
      this.say(`This flight cannot be repeated here: ${error.message}`);
    }
  }

  // --- flights ---------------------------------------------------------------------------------------------------

  /** Starts the flight of the settings; shows it from `time` on. */
  begin(time = 0) {
    try {
      const flight = this.flightOf(this.settings);
      if (this.ghost === this.previous) this.ghost = null;
      if (!this.kept.includes(this.previous)) this.previous?.end();
      this.previous = this.solid;
      this.solid = flight;
      this.say(null);
    } catch (error) {
      this.say(error.message);
      return;
    }
    this.#beginGhost();
    this.now = this.goal = time;
    this.#showLink();
    this.#showSettings();
    this.isStale = true;
  }

  flightOf(settings) {
    return Object.assign(this.lab.begin(simulator.config, this.scenario.changes(settings)), { look: data.looks[0] });
  }

  #beginGhost() {
    this.ownGhost?.end();
    const { ghostKind } = this;
    const isOwn = this.scenario?.lists.controller.values[ghostKind];
    this.ownGhost = isOwn ? this.flightOf({ ...this.settings, controller: ghostKind }) : null;
    this.ghost = this.ownGhost ?? (ghostKind === "previous" ? this.previous : (this.kept[ghostKind] ?? null));
  }

  /** Makes the flight that is shown a ghost of the following ones. */
  keep() {
    if (!this.kept.includes(this.solid)) this.kept.push(this.solid);
    this.ghostKind = `${this.kept.indexOf(this.solid)}`;
    this.#beginGhost();
    this.isStale = true;
    this.#showSettings();
  }

  #showLink() {
    history.replaceState(null, "", this.scenario.toHash(this.settings) || location.pathname + location.search);
  }

  /** Changes settings and flies anew. */
  change(change, time = 0) {
    this.settings = { ...this.settings, ...change };
    this.visited = this.wanted = null;
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

  /** Switches an engine off now, or on again. */
  switchEngine(jet) {
    const time = round(this.rowAt(this.solid, this.now) * this.solid.timeStep);
    this.visited = null;
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
    const link = this.scenario.toHash(settings);
    if (!this.whole.has(link)) {
      this.whole.set(link, new Promise((done) => this.jobs.push({ flight: this.flightOf(settings), done })));
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
    this.visited = null;
    const isPast = this.now < this.solid.flown - 2 * this.solid.timeStep;
    if (this.solid.hasEnded || isPast || this.kept.includes(this.solid)) {
      const time = round(this.rowAt(this.solid, this.now) * this.solid.timeStep);
      if (time >= this.solid.duration) this.now = 0; // an ended flight flies again
      this.branch(time >= this.solid.duration || this.merit(this.solid)?.lost_time != null && !isPast ? 0 : time);
    }
    this.isStale = true;
  }

  /** Lets the wind turn to what is wanted, where the last change is over. */
  #steer() {
    if (!this.wanted) return;
    const { settings, solid, scenario } = this;
    const [rise, risen] = scenario.ramp;
    const time = round(solid.flown);
    const { steer } = settings;
    const start = round(time + solid.timeStep); // of the turn: the tick that was flown last keeps its wind to the last bit
    const turn = [round(start + TURNING), ...this.wanted];
    if (!steer.length && time < rise) {
      Object.assign(settings, rampTo(this.wanted));
      this.wanted = null;
    } else if (!steer.length) {
      const [x, y] = scenario.windUntil(settings, start).at(-1).slice(1);
      settings.steer = [[start, round(x), round(y)], turn];
      if (time < risen) this.begin(time); // the ramp ends earlier: its bits differ
    } else {
      const [end, x, y] = steer.at(-1);
      if (end > time + 1e-9) return;
      if (x === this.wanted[0] && y === this.wanted[1]) {
        if (!this.isDragging) this.wanted = null;
        return;
      }
      settings.steer = [...steer, [start, x, y], turn];
    }
    for (const flight of [this.solid, this.ownGhost].filter(Boolean)) flight.setWind(scenario.windOf(settings), scenario.title(settings));
    this.#showLink();
    this.#showSettings();
  }

  // --- pictures --------------------------------------------------------------------------------------------------

  advance(seconds) {
    const isBehind = (flight, time) => flight && !flight.hasEnded && flight.flown < time - 1e-9;
    const { solid, ghost } = this;
    if (!isBehind(solid, this.goal) && (this.isPlaying || !isBehind(ghost, this.now))) {
      this.isCatchingUp = false;
      this.#steer();
      return super.advance(seconds);
    }
    this.isCatchingUp = true;
    const budget = Math.max(2 * BUDGET, SHARE * this.passed * 1000);
    this.#fly(solid, this.goal, budget);
    if (ghost && !isBehind(solid, this.goal)) this.#fly(ghost, this.now, budget);
    return true;
  }

  work() {
    if (!this.isCatchingUp) this.#work(Math.max(SPARE, SHARE * this.passed * 1000));
    if (this.solid.hasEnded && !this.merits.has(this.solid)) {
      this.merit(this.solid);
      this.isStale = true; // the next picture says it
    }
  }

  fly(flights) {
    for (const flight of flights) {
      this.#fly(flight, this.now, BUDGET);
      if (!flight.hasEnded) this.now = Math.min(this.now, flight.flown + flight.timeStep);
    }
  }

  show(seconds) {
    if (!this.solid.rows) this.solid.advance(1);
    if (this.ghost && !this.ghost.rows) this.ghost.advance(1);
    super.show(seconds);
    if (this.scenario?.canDrag) this.#showWind();
  }

  showNumbers() {
    super.showNumbers();
    const hasEnded = (flight) => flight.hasEnded && this.now >= flight.flown - 0.5 * flight.timeStep;
    const outcome = (flight, name) => {
      const [words, mood] = hasEnded(flight) ? verdict(this.merit(flight), flight.row("com_position", flight.rows - 1)[0]) : ["Flying", ""];
      return make("div", { className: `outcome ${mood}` }, name + words);
    };
    const lines = [outcome(this.solid, ""), ...(this.ghost && hasEnded(this.ghost) ? [outcome(this.ghost, "Ghost: ")] : [])];
    const readings = this.readings.map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value)));
    $("status").replaceChildren(...lines, make("div", { className: "about" }, this.solid.title), make("dl", {}, ...readings));
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

  /** Goes to a time; what is not flown yet is flown first. */
  seek(time) {
    super.seek(this.solid.hasEnded ? Math.min(time, this.solid.flown) : time);
    this.goal = this.now;
  }

  // --- tour ------------------------------------------------------------------------------------------------------

  async visit(index) {
    const scene = TOUR[index];
    this.settings = { ...scene.settings, steer: [] };
    this.ghostKind = scene.ghost;
    this.wanted = null;
    this.scene.view();
    this.begin(scene.start);
    this.visited = index;
    this.setRate(1);
    this.play(true);
    this.#showScene("…", "computing");
    this.#showSettings();
    const flights = Object.entries({ shown: scene.settings, ...scene.others });
    const results = await Promise.all(flights.map(async ([name, settings]) => [name, await this.flyWhole(settings)]));
    if (this.visited === index) this.#showScene(...scene.proof(Object.fromEntries(results)));
  }

  #showScene(number, words) {
    const index = this.visited;
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
    this.visited = null;
    $("caption").hidden = true;
    this.#showSettings();
  }

  // --- controls --------------------------------------------------------------------------------------------------

  #build() {
    $("tour").append(...TOUR.map(({ name }, index) => make("button", { type: "button", onclick: () => this.visit(index) }, `${index + 1} ${name}`)));
    $("pad").innerHTML = `<circle class="ring" r="23.3"/><circle class="ring" r="46.7"/><circle class="ring" r="70"/>
      <text y="-54">ahead</text><text x="-58" y="-4">left</text><text y="34">10</text><text y="57">20</text>
      <path class="robot" d="M0-9L6 6H-6z"/><line class="blows" x2="0" y2="0"/><circle class="handle" r="8"/>`;
    document.title = $("title").textContent = this.isLab ? "Flight lab" : this.solid.title;
    $("tour").hidden = !this.isLab;
    if (!this.isLab) $("plots").after($("figures"));
    $("link").hidden = $("keys").hidden = !this.lab;
    $("compass").hidden = !this.scenario?.canDrag;
    this.#buildChoices();
  }

  #buildChoices() {
    this.fields = {};
    const list = (key, { label, values }, set) => {
      const hint = make("small", { id: `hint-${key}` });
      const select = make("select", { id: key });
      const fill = (values) => select.replaceChildren(...Object.entries(values).map(([value, [name]]) => make("option", { value }, name)));
      fill(values);
      select.setAttribute("aria-describedby", hint.id);
      select.onchange = () => set(select.value);
      const box = make("div", { className: "choice" }, make("label", { htmlFor: key }, label), select, hint);
      box.hidden = Object.keys(values).length < 2;
      const show = (value, given = values) => (given !== values && fill(given), (select.value = value), (hint.textContent = given[value][1]));
      this.fields[key] = { box, show };
      return box;
    };
    const range = (key, { label, unit, min, max, step, meaning }, set, isLive) => {
      const input = make("input", { id: key, type: "range", min, max, step });
      const exact = make("input", { type: "number", min, max, step: "any", ariaLabel: `${label}, exactly` });
      exact.onchange = () => exact.reportValidity() && set(Number(exact.value));
      input.oninput = () => ((exact.value = input.value), isLive && set(Number(input.value)));
      if (!isLive) input.onchange = () => set(Number(input.value));
      const hint = make("small", { id: `hint-${key}` }, meaning);
      input.setAttribute("aria-describedby", hint.id);
      const box = make("div", { className: "choice" }, make("label", { htmlFor: key }, label), make("div", { className: "range" }, input, exact, make("span", {}, unit)), hint);
      this.fields[key] = { box, show: (value) => ((input.value = value), (exact.value = round(value))) };
      return box;
    };
    const group = (name, ...children) => make("fieldset", {}, make("legend", {}, name), ...children);
    const folded = (name, ...children) => make("details", {}, make("summary", {}, name), make("fieldset", {}, ...children));
    const ghost = [list("ghost", { label: "beside it", values: {} }, (kind) => {
      this.ghostKind = kind;
      this.#beginGhost();
      this.goal = this.now;
      this.isStale = true;
      this.#showSettings();
    })];
    this.fields.ghost.box.hidden = false;
    if (!this.lab) {
      if (this.kept.length > 1) $("choices").append(group("Ghost", ...ghost));
      this.#showSettings();
      return;
    }
    const { scenario } = this;
    ghost.push(make("div", { className: "row" }, make("button", { type: "button", onclick: () => this.keep() }, "Keep this flight as ghost")));
    const lists = Object.entries(scenario.lists).map(([key, entry]) => list(key, entry, (value) => this.change({ [key]: value })));
    const numbers = (of) => Object.entries(NUMBERS).filter(([, { group: name }]) => name === of)
      .map(([key, entry]) => range(key, within(entry, scenario.start[key]), (value) => this.change({ [key]: value })));
    this.tests = Object.entries(TESTS).map(([name, test]) => {
      const button = make("button", { type: "button", onclick: () => this.change({ ...DEFAULTS, ...test, steer: [] }) }, name);
      return [button, test];
    });
    this.engines = scenario.jets.map((jet) => {
      const button = make("button", { type: "button", onclick: () => this.switchEngine(jet) }, partName(jet));
      return [button, jet];
    });
    this.clear = make("button", { type: "button", onclick: () => this.change({ steer: [] }) }, "Forget the dragged wind");
    const windTo = (speed, from) => (scenario.canDrag ? this.blow(velocity(speed, from)) : this.change({ speed, from }));
    const { start } = scenario;
    const speed = within({ label: "speed", unit: "m/s", min: 0, max: STRONGEST, step: 0.5, meaning: `${scenario.ramp[1] ? `The wind rises between ${scenario.ramp[0]} and ${scenario.ramp[1]} s. ` : ""}Dragged later, it turns within 0.2 s.` }, start.speed);
    const hint = (words) => make("small", {}, words);
    $("choices").append(
      group("Flight",
        ...(this.isLab ? [make("div", { className: "row" }, ...this.tests.map(([button]) => button)),
          hint("The paper's four flights: baseline and aware controller, in the air of axisymmetric links and of the network.")] : []),
        ...lists),
      ...(scenario.hasWind ? [group("Wind, at any time",
        range("speed", speed, (speed) => windTo(speed, this.windFrom), true),
        range("from", { label: "from", unit: "°", min: -180, max: 180, step: 5, meaning: "0 from ahead, 90 from the robot's left, −90 from its right." }, (from) => windTo(Math.hypot(...this.target), from), true),
        make("div", { className: "row" }, this.clear))] : []),
      ...(scenario.jets.length ? [group("Switch an engine off, now",
        make("div", { className: "row" }, ...this.engines.map(([button]) => button)),
        hint("Its thrust is gone at this moment of the flight, and the controller receives no signal of it."))] : []),
      group("Ghost", ...ghost),
      folded("Gains", ...numbers("gains")),
      folded("Errors of the controller's model", ...numbers("errors")),
    );
  }

  get windFrom() {
    const [speed, from] = speedAndDirection(...this.target);
    return speed < 0.05 ? (this.lastFrom ?? 90) : (this.lastFrom = from);
  }

  /** Ghosts to choose from: of another controller, and those kept, under names of their own. */
  get ghosts() {
    const { kept, previous, ...others } = GHOSTS;
    const controllers = this.scenario?.lists.controller.values ?? {};
    const titles = [];
    for (const { title } of this.kept) {
      let name = title;
      for (let number = 2; titles.includes(name); number++) name = `${title} (${number})`;
      titles.push(name);
    }
    return {
      ...Object.fromEntries(Object.entries(others).filter(([name]) => name === "none" || controllers[name])),
      ...(this.lab ? { previous } : {}),
      ...Object.fromEntries(titles.map((name, index) => [index, [name, kept]])),
    };
  }

  #showSettings() {
    const { settings, scenario } = this;
    this.fields.ghost.show(this.ghostKind, this.ghosts);
    if (!this.lab) return;
    for (const key of [...Object.keys(scenario.lists), ...Object.keys(NUMBERS)]) {
      this.fields[key].show(settings[key]);
      this.fields[key].box.classList.toggle("idle", !matters(key, settings));
    }
    this.fields.speed?.show(Math.hypot(...this.target));
    this.fields.from?.show(Math.round(this.windFrom));
    this.clear.hidden = !settings.steer.length;
    for (const [button, test] of this.tests) button.setAttribute("aria-pressed", scenario.toHash({ ...DEFAULTS, ...test }) === scenario.toHash(settings));
    for (const [button, jet] of this.engines) button.setAttribute("aria-pressed", settings.engine?.[0] === jet);
    [...$("tour").children].forEach((button, index) => {
      button.setAttribute("aria-current", index === this.visited);
    });
    if (this.visited === null) $("caption").hidden = true;
  }

  #listen() {
    if (!this.lab) return;
    $("link").onclick = () => this.#copyLink();
    addEventListener("hashchange", () => {
      this.settings = this.scenario.fromHash(location.hash);
      this.visited = this.wanted = null;
      this.begin();
    });
    if (!this.scenario.canDrag) return;
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

  keys(event) {
    const keys = super.keys(event);
    if (this.scenario?.canDrag) keys.w = () => $("pad").focus();
    if (this.isLab) TOUR.forEach((_, index) => (keys[index + 1] = () => this.visit(index)));
    if (event.target === $("pad")) {
      const turn = (faster, further) => () => {
        const [speed, from] = [Math.hypot(...this.target), this.windFrom];
        this.blow(velocity(Math.max(speed + faster, 0), from + further));
      };
      Object.assign(keys, { ArrowUp: turn(1, 0), ArrowDown: turn(-1, 0), ArrowLeft: turn(0, 5), ArrowRight: turn(0, -5) });
    }
    return keys;
  }

  async #copyLink() {
    const link = location.href.replace(/#.*/, "") + this.scenario.toHash(this.settings);
    try {
      await navigator.clipboard.writeText(link);
      $("link").textContent = "Copied";
    } catch {
      $("link").textContent = "It is in the address bar"; // no clipboard without permission
    }
    setTimeout(() => ($("link").textContent = "Copy link"), 1600);
  }
}

/** How a flight ended, in words, and whether that is good. */
function verdict({ outcome, lost_time: lost, lost_reason: reason, rotationError, comError, hasSettled }, distance) {
  if (lost != null) return [`${outcome === "diverged" ? "The computation diverges" : outcome === "crashed" ? "Crashes" : "Falls"} at ${lost.toFixed(1)} s${reason ? `: ${reason.replace(" deg", "°")}` : ""}`, "bad"];
  if (outcome === "off_course") return [`Flies to the end, but up to ${comError.toFixed(2)} m off course`, "bad"];
  if (outcome === "landing") return ["Gave up the mission: still on its way down at the end", "bad"];
  if (outcome === "landed") return [`Gave up the mission: down, leaning up to ${rotationError.toFixed(1)}° on the way`, "good"];
  const where = distance > 5 ? "Arrives" : "Stays in place";
  // A flight that ends before it has settled has no error of position.
  const off = hasSettled ? `, ${(100 * comError).toFixed(1)} cm off course at most` : "";
  return rotationError > LEANING ? [`${where}, leaning: up to ${rotationError.toFixed(1)}°${off}`, "bad"] : [`${where} upright: rotation error up to ${rotationError.toFixed(1)}°${off}`, "good"];
}

/** A range that contains a value. */
function within(range, value) {
  return { ...range, min: Math.min(range.min, value), max: Math.max(range.max, value) };
}

/** A direction in words: 0 ahead, 90 left. */
function side(from) {
  const names = ["ahead", "ahead left", "the left", "behind left", "behind", "behind right", "the right", "ahead right"];
  return names[((Math.round(from / 45) % 8) + 8) % 8];
}

const open = (lab) => {
  window.page = new Page(lab);
};
if (simulator) {
  const binary = Object.fromEntries(Object.entries(simulator.binary).map(([path, text]) => [path, bytes(text)]));
  Lab.load(bytes(simulator.wasm), { ...simulator.files, ...binary }).then(open, (error) => {
    $("message").hidden = false;
    $("message").textContent = `The simulator does not start: ${error.message}`;
  });
} else open(null);
