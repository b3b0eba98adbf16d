// Laser scans and occupancy grids in messages, as points and pixels seen from above. Pure.

const DEEPEST = 3;
const MOST_CELLS = 4096 * 4096;
const [FREE, TAKEN, UNKNOWN] = [[246, 248, 250], [24, 32, 44], [178, 190, 205]];

/** The first scan inside: { points: [[x, y]] in metres, x forward and y to the left, reach }; or null. */
export const findScan = (message) => find(message, scanOf);

/** The first occupancy grid inside: { width, height, resolution, origin: { x, y }, cells }; or null. */
export const findGrid = (message) => find(message, (value) => gridOf(value) ?? tileOf(value));

function find(message, of, depth = 0) {
  if (message === null || typeof message !== "object" || Array.isArray(message) || depth > DEEPEST) return null;
  const found = of(message);
  if (found) return found;
  for (const value of Object.values(message)) {
    const inside = find(value, of, depth + 1);
    if (inside) return inside;
  }
  return null;
}

/** A scan of ROS, of OpenRTM (with `config`), or of Foxglove (with `start_angle`). */
function scanOf(message) {
  if (!Array.isArray(message.ranges) || message.ranges.length < 2) return null;
  const config = message.config ?? {};
  const first = message.angle_min ?? config.minAngle ?? message.start_angle;
  const last = message.angle_max ?? config.maxAngle ?? message.end_angle;
  const step = message.angle_increment || config.angularRes || (last - first) / (message.ranges.length - 1);
  if (!Number.isFinite(first) || !Number.isFinite(step)) return null;
  const least = message.range_min ?? config.minRange ?? 0;
  const most = message.range_max ?? config.maxRange ?? Infinity;
  const points = message.ranges.flatMap((range, at) => {
    const far = Number(range); // what is infinite or no number is text in JSON
    const isSeen = Number.isFinite(far) && far >= least && far <= most;
    return isSeen ? [[far * Math.cos(first + at * step), far * Math.sin(first + at * step)]] : [];
  });
  return { points, all: message.ranges.length, reach: Math.max(0, ...points.map(([x, y]) => Math.hypot(x, y))) };
}

/** A round distance for rings, of which two to five reach as far as is seen. */
export function ringOf(reach) {
  const size = 10 ** Math.floor(Math.log10(Math.max(reach, 1e-3) / 2));
  return [5, 2, 1].map((times) => times * size).find((ring) => reach / ring >= 2) ?? size;
}

function gridOf({ info, data }) {
  const { width, height, resolution } = info ?? {};
  const isWhole = Number.isInteger(width) && Number.isInteger(height) && width > 0 && height > 0;
  if (!isWhole || width * height > MOST_CELLS || !(resolution > 0)) return null;
  const cells = typeof data === "string" ? octetsOf(data) : data;
  if (!Array.isArray(data) && typeof data !== "string") return null;
  const { x = 0, y = 0 } = info.origin?.position ?? {};
  return cells.length >= width * height ? { width, height, resolution, origin: { x, y }, cells } : null;
}

/** A tile of a map of OpenRTM. Its cells are octets without a meaning that is written down: 0 is drawn dark, 255 light. */
function tileOf({ config, map }) {
  const { xScale, yScale, origin } = config ?? {};
  const { column, row, width, height, cells: given } = map ?? {};
  if (!(xScale > 0) || !(yScale > 0) || !(column >= 0) || !(row >= 0) || given === undefined) return null;
  const { x = 0, y = 0 } = origin?.position ?? {};
  const data = typeof given === "string" ? Array.from(octetsOf(given)) : given;
  const cells = Array.isArray(data) ? data.map((cell) => 100 - (cell & 255) / 2.55) : null;
  const position = { x: x + column * xScale, y: y + row * yScale };
  return cells && gridOf({ info: { width, height, resolution: xScale, origin: { position } }, data: cells });
}

function octetsOf(base64) {
  const letters = atob(base64);
  return Int8Array.from(letters, (letter) => letter.charCodeAt(0));
}

/** The pixels of a grid, its first row at the bottom: dark is taken, light is free, what is not known lies between. */
export function gridPixels({ width, height, cells }) {
  const pixels = new Uint8ClampedArray(width * height * 4);
  for (let row = 0; row < height; row += 1) {
    for (let column = 0, to = (height - 1 - row) * width * 4; column < width; column += 1, to += 4) {
      const taken = Math.min(100, cells[row * width + column]) / 100;
      for (let part = 0; part < 3; part += 1) {
        pixels[to + part] = taken < 0 ? UNKNOWN[part] : FREE[part] + (TAKEN[part] - FREE[part]) * taken;
      }
      pixels[to + 3] = 255;
    }
  }
  return pixels;
}
