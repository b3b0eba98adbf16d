// The numbers inside messages, and their last values, to draw lines of. Pure.

import { isTime } from "./format.js";
import { nodeOf } from "./schema.js";

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

/** A line's last points, and which of them begin it anew; it holds at most `most`, and a quarter more for a while. */
export class Series {
  constructor(most = 6000) {
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
    if (this.times.length > this.most * 1.25) {
      for (const points of [this.times, this.values, this.starts]) points.splice(0, points.length - this.most);
    }
  }

  /** Has no line lead to the next point: what lies between is not known. */
  interrupt() {
    this.starting = true;
  }

  /** Whether it has had more than one value. */
  get moves() {
    return this.values.some((value) => value !== this.values[0]);
  }

  /** [times, values] since a time, with one point before it; null where a line is interrupted. */
  since(begin) {
    const first = this.times.findIndex((time) => time >= begin);
    const [times, values] = [[], []];
    for (let at = Math.max(0, first < 0 ? this.times.length - 1 : first - 1); at < this.times.length; at += 1) {
      if (this.starts[at] && times.length > 0) {
        times.push(this.times[at] - 1e-6);
        values.push(null);
      }
      times.push(this.times[at]);
      values.push(this.values[at]);
    }
    return [times, values];
  }
}

/** The unit of the number at a path of a structure, as its schema states it; "" where it states none. */
export function unitAt(schema, path) {
  let node = schema;
  let unit = "";
  for (const name of path.split(".")) {
    const known = nodeOf(node, schema);
    node = known.fields?.[name] ?? known.items;
    if (node === undefined || node === true) return unit;
    unit = node["x-unit"] ?? unit;
  }
  return unit;
}

/** What the lines of one plot have in common: [unit, paths], in the order of the paths. */
export function byUnit(paths, schema) {
  const groups = new Map();
  for (const path of paths) {
    const unit = schema ? unitAt(schema, path) : "";
    groups.set(unit, [...(groups.get(unit) ?? []), path]);
  }
  return [...groups];
}
