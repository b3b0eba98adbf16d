// JSON Schemas as things that a form can show. Pure.
//
// `nodeOf` says what one schema asks for, `start` makes an empty draft of it, and `gather` makes
// the message of a draft, with every problem by its path. A draft holds what was typed, as typed.

const WIDE = "^-?(0|[1-9][0-9]*)$";
const NAMES = ["NaN", "Infinity", "-Infinity"];
const DEEPEST = 24;
const INTEGER = /^-?\d+$/;

/** What a schema asks for: { kind, ... }, references followed. */
export function nodeOf(schema, root, depth = 0) {
  const one = follow(schema, root);
  if (one === null || typeof one !== "object" || depth > DEEPEST) return { kind: "json" };
  const told = { title: one.description ?? one.title ?? "", preset: one.default };
  if ("const" in one) return { ...told, kind: "fixed", value: one.const };
  if (Array.isArray(one.enum)) return { ...told, kind: "choice", options: one.enum };
  const branches = one.anyOf ?? one.oneOf;
  if (branches) return { ...told, ...ofBranches(branches, root, depth) };
  if (Array.isArray(one.type)) {
    return { ...told, kind: "variants", branches: one.type.map((type) => ({ ...one, type })) };
  }
  return { ...told, ...ofType(one) };
}

function follow(schema, root) {
  let one = schema;
  for (let hop = 0; typeof one?.$ref === "string" && hop < DEEPEST; hop += 1) {
    const parts = one.$ref.replace(/^#/, "").split("/").slice(1);
    const unescape = (part) => decodeURIComponent(part).replaceAll("~1", "/").replaceAll("~0", "~");
    one = parts.reduce((place, part) => place?.[unescape(part)], root);
  }
  return typeof one?.$ref === "string" ? undefined : one;
}

function ofBranches(branches, root, depth) {
  const [first, second] = branches;
  if (branches.length === 2 && second?.pattern === WIDE) return { ...ofType(first), wide: true };
  if (branches.length === 2 && second?.enum?.[0] === "NaN") {
    return { ...nodeOf(first, root, depth + 1), names: NAMES };
  }
  return branches.length === 1 ? nodeOf(first, root, depth + 1) : { kind: "variants", branches };
}

function ofType(one) {
  const { minimum, maximum, exclusiveMinimum, exclusiveMaximum } = one;
  switch (one.type) {
    case "object":
      return one.properties
        ? { kind: "object", fields: one.properties, required: one.required ?? [] }
        : { kind: "json", empty: "{}" };
    case "array":
      if (one.prefixItems) return { kind: "json", empty: "[]" };
      return { kind: "list", items: one.items ?? true, least: one.minItems ?? 0, most: one.maxItems };
    case "integer":
    case "number":
      return { kind: one.type, minimum, maximum, exclusiveMinimum, exclusiveMaximum };
    case "boolean":
      return { kind: "flag" };
    case "null":
      return { kind: "fixed", value: null };
    case "string":
      if (one["x-octets"] || one.contentEncoding === "base64") return { kind: "octets" };
      return { kind: "text", least: one.minLength ?? 0, most: one.maxLength, pattern: one.pattern };
    default:
      return one.properties ? ofType({ ...one, type: "object" }) : { kind: "json" };
  }
}

/** One word or two for a branch, to choose it by. */
export function nameOf(schema, root) {
  const node = nodeOf(schema, root);
  if (node.title) return node.title;
  return node.kind === "fixed" ? JSON.stringify(node.value) : node.kind;
}

/** The draft with which a form begins. Optional fields begin absent. */
export function start(schema, root, depth = 0) {
  const node = nodeOf(schema, root);
  if (depth > DEEPEST) return "";
  switch (node.kind) {
    case "object":
      return Object.fromEntries(
        node.required.filter((name) => name in node.fields)
          .map((name) => [name, start(node.fields[name], root, depth + 1)]));
    case "list":
      return Array.from({ length: Math.min(node.least, 100) }, () => start(node.items, root, depth + 1));
    case "variants":
      return { at: 0, draft: start(node.branches[0], root, depth + 1) };
    case "flag":
      return node.preset ?? false;
    case "choice":
      return Math.max(0, node.options.findIndex((one) => one === node.preset));
    case "json":
      return node.preset === undefined ? node.empty ?? "" : JSON.stringify(node.preset);
    default:
      return node.preset === undefined ? "" : String(node.preset);
  }
}

/** { value, problems: [{ path, text }] } of a draft. */
export function gather(schema, root, draft, path = "") {
  const problems = [];
  const value = read(schema, root, draft, path, problems);
  return { value, problems };
}

function read(schema, root, draft, path, problems) {
  const node = nodeOf(schema, root);
  const wrong = (text) => void problems.push({ path, text });
  const inner = (one, its, name) => read(one, root, its, path ? `${path}.${name}` : name, problems);
  switch (node.kind) {
    case "object": {
      const there = Object.keys(node.fields).filter((name) => draft[name] !== undefined);
      return Object.fromEntries(there.map((name) => [name, inner(node.fields[name], draft[name], name)]));
    }
    case "list":
      if (draft.length < node.least) wrong(`at least ${node.least} items`);
      if (draft.length > (node.most ?? Infinity)) wrong(`at most ${node.most} items`);
      return draft.map((one, at) => inner(node.items, one, String(at)));
    case "variants":
      return read(node.branches[draft.at], root, draft.draft, path, problems);
    case "fixed":
      return node.value;
    case "choice":
      return node.options[draft];
    case "integer":
    case "number":
      return readNumber(node, draft.trim(), wrong);
    case "text":
      if (draft.length < node.least) wrong(`at least ${node.least} characters`);
      if (draft.length > (node.most ?? Infinity)) wrong(`at most ${node.most} characters`);
      if (node.pattern && !matches(node.pattern, draft)) wrong(`must match ${node.pattern}`);
      return draft;
    case "json":
      try {
        return JSON.parse(draft);
      } catch (error) {
        return wrong(`not JSON: ${error.message}`);
      }
    default:
      return draft;
  }
}

function readNumber(node, text, wrong) {
  if (node.names?.includes(text)) return text;
  const value = Number(text);
  if (text === "" || Number.isNaN(value)) return wrong(text ? `${text} is no number` : "a number is missing");
  if (node.kind === "integer" && !INTEGER.test(text)) return wrong("must be a whole number");
  if (value < node.minimum) wrong(`at least ${node.minimum}`);
  if (value > node.maximum) wrong(`at most ${node.maximum}`);
  if (value <= node.exclusiveMinimum) wrong(`more than ${node.exclusiveMinimum}`);
  if (value >= node.exclusiveMaximum) wrong(`less than ${node.exclusiveMaximum}`);
  return node.kind === "integer" && node.wide && !Number.isSafeInteger(value) ? text : value;
}

function matches(pattern, text) {
  try {
    return new RegExp(pattern, "u").test(text);
  } catch {
    return true; // a pattern of another dialect: the server judges
  }
}
