// The simulator: the crate `flight-lab` in WebAssembly. Questions and answers are JSON, signals are read where they lie.

/** The bytes of a text in base 64. */
export function bytes(base64) {
  const letters = atob(base64);
  const found = new Uint8Array(letters.length);
  for (let at = 0; at < letters.length; at++) found[at] = letters.charCodeAt(at);
  return found;
}

export class Lab {
  /** `wasm`: bytes of the module; `files`: path to text or bytes. */
  static async load(wasm, files) {
    const { instance } = await WebAssembly.instantiate(wasm, {});
    const lab = new Lab(instance.exports);
    for (const [path, content] of Object.entries(files)) lab.#hold(path, content);
    return lab;
  }

  constructor(exports) {
    this.exports = exports;
  }

  #write(bytes) {
    const at = this.exports.reserve(bytes.length);
    new Uint8Array(this.exports.memory.buffer, at, bytes.length).set(bytes);
  }

  #hold(path, content) {
    const encoder = new TextEncoder();
    const name = encoder.encode(path);
    const body = typeof content === "string" ? encoder.encode(content) : content;
    const bytes = new Uint8Array(name.length + body.length);
    bytes.set(name);
    bytes.set(body, name.length);
    this.#write(bytes);
    this.exports.hold(name.length);
  }

  /** The answer to a question; throws what the crate refuses. */
  ask(question) {
    this.#write(new TextEncoder().encode(JSON.stringify(question)));
    const length = this.exports.ask();
    const bytes = new Uint8Array(this.exports.memory.buffer, this.exports.answer(), length);
    const answer = JSON.parse(new TextDecoder().decode(bytes));
    if ("refused" in answer) throw new Error(answer.refused);
    return answer;
  }

  /** A new flight of a configuration, as a file of `configs/experiments` has it, with changes of dotted keys. */
  begin(config, changes = []) {
    return new Flight(this, this.ask({ ask: "begin", config, changes }));
  }
}

export class Flight {
  constructor(lab, about) {
    this.lab = lab;
    Object.assign(this, about);
    this.places = new Map(this.signals.map((signal, index) => [signal.name, index]));
    this.rows = 0;
    this.timeStep = this.config.controller.time_step;
    this.hasEnded = false;
  }

  get title() {
    return this.config.title;
  }

  get duration() {
    return this.n_ticks * this.timeStep;
  }

  /** Time of the last row [s]. */
  get flown() {
    return Math.max(this.rows - 1, 0) * this.timeStep;
  }

  /** Flies up to `ticks` ticks. */
  advance(ticks) {
    const before = this.rows;
    this.rows = this.lab.exports.advance(this.flight, ticks);
    this.hasEnded = this.rows - before < ticks || this.rows > this.n_ticks;
    return this.rows - before;
  }

  /** All rows of a signal, one after the other; valid until the next call into the simulator. */
  series(name) {
    const index = this.places.get(name);
    if (index === undefined) return new Float64Array(0);
    const at = this.lab.exports.series(this.flight, index);
    return new Float64Array(this.lab.exports.memory.buffer, at, this.rows * this.signals[index].width);
  }

  /** One row of a signal, as a copy. */
  row(name, row) {
    const { width } = this.signals[this.places.get(name)];
    return this.series(name).slice(row * width, (row + 1) * width);
  }

  /** Poses of all bodies: for each, rotation by columns (9) and position (3). */
  pose(row) {
    const at = this.lab.exports.pose(this.flight, row);
    return new Float64Array(this.lab.exports.memory.buffer, at, 12 * this.bodies.length).slice();
  }

  setWind(wind, title) {
    this.lab.ask({ ask: "wind", flight: this.flight, wind });
    Object.assign(this.config, { wind, title });
  }

  result() {
    return this.lab.ask({ ask: "result", flight: this.flight });
  }

  end() {
    this.lab.ask({ ask: "end", flight: this.flight });
  }
}
