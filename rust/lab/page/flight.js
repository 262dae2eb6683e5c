// Plays recorded flights, which `jax_aero.view.web` writes into the page: the first, and the second as its ghost.
import { $, Player, make } from "./player.js";

const bytes = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0)).buffer;

class Recorded {
  constructor({ numbers, ...about }) {
    Object.assign(this, about);
    this.hasEnded = true;
    this.numbers = Object.fromEntries(Object.entries(numbers).map(([name, packed]) => [name, new Float32Array(bytes(packed))]));
  }

  get flown() {
    return (this.rows - 1) * this.timeStep;
  }

  get duration() {
    return this.flown;
  }

  series(name) {
    return this.numbers[name] ?? new Float32Array(0);
  }

  row(name, row) {
    const { width } = this.signals.find((signal) => signal.name === name);
    return this.series(name).slice(row * width, (row + 1) * width);
  }

  /** Kept are two columns of each rotation, and the position. */
  pose(row) {
    const kept = this.numbers.body_poses;
    const poses = new Float64Array(12 * this.bodies);
    for (let body = 0; body < this.bodies; body++) {
      const at = 9 * (this.bodies * row + body);
      const [ax, ay, az, bx, by, bz, ...position] = kept.subarray(at, at + 9);
      poses.set([ax, ay, az, bx, by, bz, ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx, ...position], 12 * body);
    }
    return poses;
  }
}

class Page extends Player {
  constructor({ looks, flights }) {
    super(looks[0], looks[1]);
    [this.solid, this.ghost = null] = flights.map((table) => new Recorded(table));
    document.title = this.solid.title;
    $("title").textContent = this.solid.title;
    this.buildPlots(this.solid, this.solid.jets);
    this.start();
  }

  showNumbers() {
    super.showNumbers();
    const { solid, ghost } = this;
    const lines = [solid, ghost].filter(Boolean).map((flight) => {
      const isOver = this.now >= flight.flown - 0.5 * flight.timeStep;
      const mood = isOver ? (flight.outcome === "completed" ? "good" : "bad") : "";
      const words = `${isOver ? flight.verdict : "flying"}`;
      return make("div", { className: `outcome ${mood}` }, flight === ghost ? `ghost, ${flight.title}: ${words}` : words);
    });
    $("status").replaceChildren(...lines, make("div", { className: "about" }, this.words));
  }
}

window.page = new Page(window.FLIGHTS);
