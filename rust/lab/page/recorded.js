// A recorded flight, which `jax_aero.view.web` writes into the page.
import { bytes } from "./lab.js";

export class Recorded {
  constructor({ numbers, look, ...about }, looks) {
    Object.assign(this, about, { look: looks[look], hasEnded: true });
    this.numbers = Object.fromEntries(Object.entries(numbers).map(([name, packed]) => [name, new Float32Array(bytes(packed).buffer)]));
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
    const count = kept.length / this.rows / 9;
    const poses = new Float64Array(12 * count);
    for (let body = 0; body < count; body++) {
      const at = 9 * (count * row + body);
      const [ax, ay, az, bx, by, bz, ...position] = kept.subarray(at, at + 9);
      poses.set([ax, ay, az, bx, by, bz, ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx, ...position], 12 * body);
    }
    return poses;
  }

  result() {
    return this;
  }

  end() {}
}
