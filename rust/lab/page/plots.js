// Curves over time on a canvas: of a flight, and dashed of its ghost; the pointer moves the time.

const LEFT = 42;
const BOTTOM = 17;
const TOP = 6;

export class Plot {
  constructor(canvas) {
    this.canvas = canvas;
    this.end = 1;
  }

  /** What is drawn. `read(flight)`: a list of curves, each a function of the row; `least`: what the axis covers at least. */
  take({ read, least }) {
    Object.assign(this, { read, least });
  }

  /** The time [s] under a pointer. */
  timeAt(event) {
    const { left, width } = this.canvas.getBoundingClientRect();
    const inside = width - LEFT - 4;
    return (Math.min(Math.max(event.clientX - left - LEFT, 0), inside) / inside) * this.end;
  }

  draw(solid, ghost, now, end, style) {
    const { canvas } = this;
    const ratio = Math.min(devicePixelRatio, 2);
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height || !this.read) return;
    const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
    this.end = end;
    const flights = [[solid, false], ...(ghost ? [[ghost, true]] : [])];
    const curves = flights.flatMap(([flight, isGhost]) =>
      this.read(flight).map((value, index) => ({ ...sample(flight, value, width - LEFT, end), isGhost, index })),
    );
    const highest = Math.max(this.least, ...curves.map((curve) => curve.top));
    const lowest = Math.min(0, ...curves.map((curve) => curve.bottom));
    const top = highest > 0 ? nice(highest) : lowest < 0 ? 0 : 1;
    const bottom = lowest < -1e-3 * top ? -nice(-lowest) : 0;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const x = (time) => LEFT + (time / end) * (width - LEFT - 4);
    const y = (value) => height - BOTTOM - ((value - bottom) / (top - bottom)) * (height - BOTTOM - TOP);
    this.#axes(pen, x, y, width, height, [bottom, top], style);
    for (const { points, isGhost, index } of curves) {
      pen.beginPath();
      pen.setLineDash(isGhost ? [4, 3] : []);
      pen.lineWidth = isGhost ? 1.2 : 1.6;
      pen.strokeStyle = isGhost && curves.length < 3 ? style.ghost : this.colours[index % this.colours.length];
      for (const [time, value] of points) pen.lineTo(x(time), y(value));
      pen.stroke();
    }
    pen.setLineDash([]);
    pen.fillStyle = style.ink;
    pen.fillRect(x(now) - 0.5, TOP, 1, height - BOTTOM - TOP);
  }

  #axes(pen, x, y, width, height, [bottom, top], style) {
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = style.soft;
    pen.strokeStyle = style.line;
    pen.lineWidth = 1;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of bottom < 0 && top > 0 ? [bottom, 0, top] : [bottom, 0.5 * (bottom + top), top]) {
      const at = Math.round(y(value)) + 0.5;
      pen.beginPath();
      pen.moveTo(LEFT, at);
      pen.lineTo(width - 4, at);
      pen.stroke();
      pen.fillText(short(value), LEFT - 5, value === top ? at + 3 : at);
    }
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    const { end } = this;
    const step = [1, 2, 5, 10, 20, 50].find((wide) => end / wide <= 7) ?? 100;
    for (let time = step; time < end - 0.4 * step; time += step) pen.fillText(`${time}`, x(time), height - 4);
    pen.textAlign = "right";
    pen.fillText("s", width - 4, height - 4);
  }
}

/** The least and the greatest value of every pixel: peaks stay. */
function sample(flight, value, width, end) {
  const { rows } = flight;
  const step = Math.max(1, Math.floor(end / flight.timeStep / width));
  const points = [];
  let [top, bottom] = [0, 0];
  for (let row = 0; row < rows; row += step) {
    let [most, least] = [-Infinity, Infinity];
    for (let at = row; at < Math.min(row + step, rows); at++) {
      const now = value(at);
      most = Math.max(most, now);
      least = Math.min(least, now);
    }
    if (!Number.isFinite(most)) continue;
    const time = row * flight.timeStep;
    points.push([time, least]);
    if (most > least) points.push([time, most]);
    top = Math.max(top, most);
    bottom = Math.min(bottom, least);
  }
  return { points, top, bottom };
}

/** The next round number. */
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return ([1, 1.5, 2, 3, 4, 5, 6, 8].find((factor) => factor * power >= value * 0.9999) ?? 10) * power;
}

/** A number in five letters. */
export function short(value) {
  const size = Math.abs(value);
  if (size >= 1e5 || (size > 0 && size < 1e-3)) return value.toExponential(0);
  return `${Number(value.toPrecision(3))}`;
}
