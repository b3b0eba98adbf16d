// Boxes and points in messages, to be drawn over a picture. Pure.

const DEEPEST = 7;
const MOST = 300;
const CORNERS = [["left", "top", "right", "bottom"], ["x1", "y1", "x2", "y2"], ["xmin", "ymin", "xmax", "ymax"],
  ["x_min", "y_min", "x_max", "y_max"]];
const SIZED = [["x", "y", "width", "height"], ["x", "y", "w", "h"], ["left", "top", "width", "height"],
  ["x_offset", "y_offset", "width", "height"]];
const POINTS = [["x", "y"], ["u", "v"]];
const NAMES = ["name", "label", "class_name", "class_id", "class", "person", "id", "text"];
const SHARES = ["score", "confidence", "probability"];

/**
 * Shapes in a message: { kind: "box", x, y, width, height, label } or { kind: "point", x, y, label }, in pixels.
 * Where all of them lie between 0 and 1 they are shares of the picture, whose size is given.
 */
export function shapesOf(message, { width, height }) {
  const found = [];
  walk(message, "", "", 0, found);
  const far = (shape) => Math.max(shape.x + (shape.width ?? 0), shape.y + (shape.height ?? 0));
  if (found.length === 0 || found.some((shape) => far(shape) > 1.001)) return found;
  return found.map((shape) => ({ ...shape, x: shape.x * width, y: shape.y * height,
    ...(shape.kind === "box" ? { width: shape.width * width, height: shape.height * height } : {}) }));
}

/**
 * Which picture is shown with which overlay, of those that came last, oldest first, as { time, message }: the picture that
 * the newest overlay was made of, where it is still there; else the newest picture with what is nearest to it in time.
 * Returns { picture, overlay, apart } with the messages, and how many seconds the overlay is after the picture; or null.
 */
export function pairOf(pictures, overlays) {
  if (pictures.length === 0 || overlays.length === 0) return null;
  const [first, last] = [pictures[0], pictures.at(-1)];
  const every = pictures.length > 1 ? Math.abs(last.time - first.time) / (pictures.length - 1) : 0;
  const newest = overlays.at(-1);
  const own = nearest(pictures, newest.time);
  const isOwn = Math.abs(own.time - newest.time) <= every / 2;
  const [picture, overlay] = isOwn ? [own, newest] : [last, nearest(overlays, last.time)];
  return { picture: picture.message, overlay: overlay.message, apart: overlay.time - picture.time };
}

const nearest = (items, time) =>
  items.reduce((found, item) => (Math.abs(item.time - time) <= Math.abs(found.time - time) ? item : found));

function walk(value, key, label, depth, found) {
  if (value === null || typeof value !== "object" || depth > DEEPEST || found.length >= MOST) return;
  if (Array.isArray(value)) {
    const box = /box|rect|roi/i.test(key) && value.length === 4 && value.every(Number.isFinite);
    if (box) found.push({ kind: "box", x: value[0], y: value[1], width: value[2], height: value[3], label });
    else for (const item of value.slice(0, MOST)) walk(item, key, label, depth + 1, found);
    return;
  }
  if (isPicture(value)) return;
  const name = labelOf(value) || label;
  const shape = boxOf(value) ?? pointOf(value);
  if (shape) found.push({ ...shape, label: name });
  else for (const [inside, item] of Object.entries(value)) walk(item, inside, name, depth + 1, found);
}

const isPicture = ({ data, encoding, format }) => typeof data === "string" && (encoding ?? format) !== undefined;

const has = (value, names) => names.every((name) => Number.isFinite(value[name]));

function boxOf(value) {
  const corners = CORNERS.find((names) => has(value, names));
  if (corners) {
    const [left, top, right, bottom] = corners.map((name) => value[name]);
    return { kind: "box", x: left, y: top, width: right - left, height: bottom - top };
  }
  const sized = SIZED.find((names) => has(value, names));
  if (sized) {
    const [x, y, width, height] = sized.map((name) => value[name]);
    return { kind: "box", x, y, width, height };
  }
  const middle = value.center?.position ?? value.center;
  if (!middle || !has(middle, ["x", "y"]) || !has(value, ["size_x", "size_y"])) return null;
  const { size_x: width, size_y: height } = value;
  return { kind: "box", x: middle.x - width / 2, y: middle.y - height / 2, width, height };
}

function pointOf(value) {
  const names = POINTS.find((pair) => has(value, pair));
  return names && !("z" in value) ? { kind: "point", x: value[names[0]], y: value[names[1]] } : null;
}

/** What a shape is of, with how sure its finder is; also where that stands in its first result. */
function labelOf(value) {
  const result = Array.isArray(value.results) ? value.results[0]?.hypothesis ?? value.results[0] : null;
  const holder = [value, result].find((of) => of && NAMES.some((name) => isName(of[name])));
  if (!holder) return "";
  const share = SHARES.map((name) => holder[name]).find(Number.isFinite);
  const name = String(holder[NAMES.find((key) => isName(holder[key]))]).slice(0, 40);
  return share === undefined ? name : `${name} ${Math.round(share * 100)} %`;
}

const isName = (value) => (typeof value === "string" && value !== "") || Number.isInteger(value);
