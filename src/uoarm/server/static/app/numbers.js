// The numbers inside messages, to draw lines of. Pure.

import { isTime } from "./format.js";

const MOST_PATHS = 24;
const DEEPEST = 4;
const MOST_ITEMS = 8;

/** [path, number] of what is numeric in a message, the first few. Long lists and times are left out. */
export function numbersOf(message) {
  const found = [];
  walk(message, "", 0, found);
  return found;
}

function walk(value, path, depth, found) {
  if (found.length >= MOST_PATHS || depth > DEEPEST) return;
  if (typeof value === "number") found.push([path || "value", value]);
  else if (typeof value === "boolean") found.push([path || "value", Number(value)]);
  else if (value !== null && typeof value === "object" && !isTime(value)) {
    if (Array.isArray(value) && value.length > MOST_ITEMS) return;
    for (const [name, item] of Object.entries(value)) {
      walk(item, path ? `${path}.${name}` : name, depth + 1, found);
    }
  }
}

/** A line's last points, and which of them begin it anew; it never holds more than `most`. */
export class Series {
  constructor(most = 300) {
    this.most = most;
    this.times = [];
    this.values = [];
    this.starts = [];
    this.starting = true;
  }

  add(time, value) {
    this.times.push(time);
    this.values.push(value);
    this.starts.push(this.starting);
    this.starting = false;
    if (this.times.length > this.most) {
      for (const points of [this.times, this.values, this.starts]) points.shift();
    }
  }

  /** Has no line lead to the next point: what lies between is not known. */
  interrupt() {
    this.starting = true;
  }
}

/** A line as an SVG path in a square of 100: times to the right, values upwards, a level line in the middle. */
export function traced({ times, values, starts = [] }) {
  const scale = (all) => {
    const [low, high] = [Math.min(...all), Math.max(...all)];
    return (item) => (high > low ? (100 * (item - low)) / (high - low) : 50);
  };
  const [x, y] = [scale(times), scale(values)];
  const points = times.map((time, at) =>
    `${at === 0 || starts[at] ? "M" : "L"}${x(time).toFixed(2)} ${(100 - y(values[at])).toFixed(2)}`);
  return points.length > 1 ? points.join("") : "";
}
