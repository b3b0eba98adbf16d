// CBOR (RFC 8949) with typed arrays (RFC 8746), as much of it as messages need.

const TEXT = new TextEncoder();
const HALF_PAIR = /\p{Surrogate}/u;
const PLAIN = new TextDecoder("utf-8", { fatal: true });

// Tag to array type and byte order; those without an order are of single bytes.
const TYPED = {
  64: [Uint8Array], 65: [Uint16Array, "big"], 66: [Uint32Array, "big"],
  67: [BigUint64Array, "big"], 68: [Uint8ClampedArray], 69: [Uint16Array, "little"],
  70: [Uint32Array, "little"], 71: [BigUint64Array, "little"], 72: [Int8Array],
  73: [Int16Array, "big"], 74: [Int32Array, "big"], 75: [BigInt64Array, "big"],
  77: [Int16Array, "little"], 78: [Int32Array, "little"], 79: [BigInt64Array, "little"],
  81: [Float32Array, "big"], 82: [Float64Array, "big"],
  85: [Float32Array, "little"], 86: [Float64Array, "little"],
};
const MOST_DIGITS = 384; // octets of an integer, as the protocol says
const DEEPEST = 512; // values within one another: far less than the stack has room for
const ORDER = new Uint8Array(new Uint16Array([1]).buffer)[0] ? "little" : "big";
const TAGS = new Map(Object.entries(TYPED)
  .filter(([tag, [, order]]) => tag !== "68" && (order === undefined || order === ORDER))
  .map(([tag, [type]]) => [type, Number(tag)]));

/** Return the value that CBOR stands for. Integers beyond 53 bits come as BigInt. */
export function decode(data) {
  const bytes = data instanceof Uint8Array ? data : new Uint8Array(data);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;

  const take = (count) => {
    if (at + count > bytes.length) throw new RangeError("the CBOR ends too early");
    at += count;
    return at - count;
  };
  const count = (more) => {
    if (more < 24) return more;
    if (more === 24) return view.getUint8(take(1));
    if (more === 25) return view.getUint16(take(2));
    if (more === 26) return view.getUint32(take(4));
    if (more === 27) return narrow(view.getBigUint64(take(8)));
    throw new RangeError("CBOR of indefinite length");
  };
  const octets = (length) => {
    const start = take(length);
    return bytes.subarray(start, start + length);
  };
  const simple = (more) => {
    if (more === 20 || more === 21) return more === 21;
    if (more === 22 || more === 23) return null;
    if (more === 25) return half(view.getUint16(take(2)));
    if (more === 26) return view.getFloat32(take(4));
    if (more === 27) return view.getFloat64(take(8));
    throw new RangeError(`CBOR of simple value ${more}`);
  };
  let depth = 0;
  const item = () => {
    depth = deeper(depth);
    const made = whole();
    depth -= 1;
    return made;
  };
  const whole = () => {
    const first = view.getUint8(take(1));
    const [major, more] = [first >> 5, first & 31];
    if (major === 7) return simple(more);
    const length = count(more);
    if (major === 0) return length;
    if (major === 1) return typeof length === "bigint" ? -1n - length : -1 - length;
    if (major === 2) return octets(length);
    if (major === 3) return PLAIN.decode(octets(length));
    if (major === 4) {
      if (length > bytes.length - at) throw new RangeError("the CBOR ends too early"); // before it is held
      return Array.from({ length }, item);
    }
    if (major === 6) return tagged(length, item());
    const made = {};
    for (let left = length; left > 0; left--) {
      const key = item();
      Object.defineProperty(made, key, { value: item(), enumerable: true, writable: true, configurable: true });
    }
    return made;
  };
  const value = item();
  if (at !== bytes.length) throw new RangeError("more follows the CBOR");
  return value;
}

/** Return the numbers of an array of any type, or the octets of what has no type. */
export function listOf(view) {
  const octets = () => new Uint8Array(view.buffer ?? view, view.byteOffset ?? 0, view.byteLength);
  return Array.from(view.length === undefined ? octets() : view);
}

function deeper(depth) {
  if (depth === DEEPEST) throw new RangeError(`CBOR of more than ${DEEPEST} values within one another`);
  return depth + 1;
}

/** Whether JSON leaves a value out, too. */
function isNothing(value) {
  return value === undefined || typeof value === "function" || typeof value === "symbol";
}

/** Return a value as CBOR: numbers, text, buffers, typed arrays, lists and plain objects. */
export function encode(value) {
  const parts = [];
  const head = (major, count) => {
    const first = major << 5;
    if (count < 24) parts.push(Uint8Array.of(first | count));
    else if (count < 2 ** 8) parts.push(Uint8Array.of(first | 24, count));
    else if (count < 2 ** 16) parts.push(Uint8Array.of(first | 25, count >> 8, count & 255));
    else {
      const wide = new DataView(new ArrayBuffer(9));
      wide.setUint8(0, first | 27);
      wide.setBigUint64(1, BigInt(count));
      parts.push(new Uint8Array(wide.buffer));
    }
  };
  const number = (input) => {
    if (typeof input === "bigint") {
      const size = input < 0n ? -1n - input : input;
      if (size < 2n ** 64n) head(input < 0n ? 1 : 0, narrow(size));
      else {
        const digits = size.toString(16);
        const pairs = (digits.length & 1 ? `0${digits}` : digits).match(/../g);
        head(6, input < 0n ? 3 : 2);
        octets(Uint8Array.from(pairs, (pair) => parseInt(pair, 16)));
      }
      return;
    }
    if (Number.isSafeInteger(input)) {
      if (input >= 0) head(0, input);
      else head(1, -1 - input);
      return;
    }
    const wide = new DataView(new ArrayBuffer(9));
    wide.setUint8(0, 0xfb);
    wide.setFloat64(1, input);
    parts.push(new Uint8Array(wide.buffer));
  };
  const octets = (input) => {
    head(2, input.byteLength);
    parts.push(new Uint8Array(input.buffer ?? input, input.byteOffset ?? 0, input.byteLength));
  };
  let depth = 0;
  const item = (input) => {
    depth = deeper(depth);
    put(input);
    depth -= 1;
  };
  const put = (input) => {
    if (input === null || isNothing(input)) parts.push(Uint8Array.of(0xf6));
    else if (typeof input === "boolean") parts.push(Uint8Array.of(input ? 0xf5 : 0xf4));
    else if (typeof input === "number" || typeof input === "bigint") number(input);
    else if (typeof input === "string") {
      if (HALF_PAIR.test(input)) throw new TypeError("a text with half of a surrogate pair");
      const text = TEXT.encode(input);
      head(3, text.length);
      parts.push(text);
    } else if (input instanceof Uint8Array || input instanceof ArrayBuffer) octets(input);
    else if (TAGS.has(input.constructor) || input instanceof Uint8ClampedArray || input instanceof DataView) {
      head(6, TAGS.get(input.constructor) ?? 64);
      octets(input);
    } else if (ArrayBuffer.isView(input)) put(listOf(input));
    else if (Array.isArray(input)) {
      head(4, input.length);
      input.forEach(item);
    } else if (typeof input.toJSON === "function") put(input.toJSON());
    else {
      const entries = Object.entries(input).filter(([, inner]) => !isNothing(inner));
      head(5, entries.length);
      for (const [key, inner] of entries) {
        item(key);
        item(inner);
      }
    }
  };
  item(value);
  const whole = new Uint8Array(parts.reduce((sum, input) => sum + input.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}

function tagged(tag, value) {
  if (tag === 2 || tag === 3) {
    if (value.length > MOST_DIGITS) throw new RangeError("CBOR of an integer that is too long");
    const size = value.reduce((sum, input) => (sum << 8n) | BigInt(input), 0n);
    return tag === 2 ? narrow(size) : narrow(-1n - size);
  }
  if (tag === 40) return rows(value[0], value[1]);
  const [type, order] = TYPED[tag] ?? [];
  if (!type) throw new RangeError(`CBOR with the tag ${tag}`);
  const copy = value.slice();
  if (order !== undefined && order !== ORDER) {
    for (let start = 0; start < copy.length; start += type.BYTES_PER_ELEMENT) {
      copy.subarray(start, start + type.BYTES_PER_ELEMENT).reverse();
    }
  }
  return new type(copy.buffer);
}

function rows(sizes, items) {
  const product = sizes.reduce((sum, size) => (Number.isSafeInteger(size) && size >= 0 ? sum * size : NaN), 1);
  if (product !== items.length) throw new RangeError("CBOR of an array that is not of its sizes");
  let at = 0;
  const row = (dimension) => {
    const made = new Array(sizes[dimension]);
    const isLast = dimension === sizes.length - 1;
    for (let place = 0; place < made.length; place++) made[place] = isLast ? items[at++] : row(dimension + 1);
    return made;
  };
  return row(0);
}

function narrow(wide) {
  const safe = BigInt(Number.MAX_SAFE_INTEGER);
  return wide <= safe && wide >= -safe ? Number(wide) : wide;
}

function half(bits) {
  const [sign, exponent, rest] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  if (exponent === 0) return sign * rest * 2 ** -24;
  if (exponent === 31) return rest ? NaN : sign * Infinity;
  return sign * (1 + rest / 1024) * 2 ** (exponent - 15);
}
