// Finds a picture in a message and makes its pixels. Pure.

const TYPED = { jpeg: "image/jpeg", jpg: "image/jpeg", png: "image/png", webp: "image/webp" };
const CHANNELS = {
  rgb8: [0, 1, 2], bgr8: [2, 1, 0], rgba8: [0, 1, 2, 3], bgra8: [2, 1, 0, 3],
  mono8: [0], "8UC1": [0], "8UC3": [2, 1, 0],
};
const DEEPEST = 4;
const LARGEST = 4096 * 4096;

/** The first picture inside: { url } of a compressed one, { width, height, ... } of pixels; or null. */
export function findPicture(message, depth = 0) {
  if (message === null || typeof message !== "object" || depth > DEEPEST) return null;
  const found = compressed(message) ?? raw(message);
  if (found) return found;
  for (const value of Object.values(message)) {
    const inside = Array.isArray(value) ? null : findPicture(value, depth + 1);
    if (inside) return inside;
  }
  return null;
}

function compressed({ format, encoding, data }) {
  if (typeof data !== "string") return null;
  const words = `${format ?? encoding ?? ""}`.toLowerCase().split(/[^a-z0-9]+/);
  const type = words.map((word) => TYPED[word]).find(Boolean) ?? bySignature(data);
  return type ? { url: `data:${type};base64,${data}` } : null;
}

function bySignature(data) {
  if (data.startsWith("/9j/")) return TYPED.jpeg;
  return data.startsWith("iVBORw0KGgo") ? TYPED.png : null;
}

function raw({ width, height, encoding, data, step }) {
  const whole = Number.isInteger(width) && Number.isInteger(height) && width > 0 && height > 0;
  if (!whole || width * height > LARGEST || typeof data !== "string") return null;
  const order = CHANNELS[encoding];
  if (!order) return null;
  const row = Number.isInteger(step) && step > 0 ? step : width * order.length;
  return { width, height, order, data, row };
}

function octetsOf(base64) {
  const letters = atob(base64);
  const octets = new Uint8Array(letters.length);
  for (let at = 0; at < letters.length; at += 1) octets[at] = letters.charCodeAt(at);
  return octets;
}

/** Pixels as red, green, blue, opacity; null when the octets are too few. */
export function pixelsOf({ width, height, order, data, row }) {
  const octets = octetsOf(data);
  const [size, grey] = [order.length, order.length === 1];
  if (row < width * size || octets.length < row * (height - 1) + width * size) return null;
  const pixels = new Uint8ClampedArray(width * height * 4);
  for (let y = 0, to = 0; y < height; y += 1) {
    for (let x = 0, from = y * row; x < width; x += 1, from += size, to += 4) {
      pixels[to] = octets[from + order[0]];
      pixels[to + 1] = octets[from + (grey ? 0 : order[1])];
      pixels[to + 2] = octets[from + (grey ? 0 : order[2])];
      pixels[to + 3] = size === 4 ? octets[from + order[3]] : 255;
    }
  }
  return pixels;
}
