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
  const node = follow(schema, root);
  if (node === null || typeof node !== "object" || depth > DEEPEST) return { kind: "json" };
  const common = { title: node.description ?? node.title ?? "", preset: node.default };
  if ("const" in node) return { ...common, kind: "fixed", value: node.const };
  if (Array.isArray(node.enum)) return { ...common, kind: "choice", options: node.enum };
  const branches = node.anyOf ?? node.oneOf;
  if (branches) return { ...common, ...ofBranches(branches, root, depth) };
  if (Array.isArray(node.type)) {
    return { ...common, kind: "variants", branches: node.type.map((type) => ({ ...node, type })) };
  }
  return { ...common, ...ofType(node) };
}

function follow(schema, root) {
  let node = schema;
  for (let hop = 0; typeof node?.$ref === "string" && hop < DEEPEST; hop += 1) {
    const parts = node.$ref.replace(/^#/, "").split("/").slice(1);
    const unescape = (part) => decodeURIComponent(part).replaceAll("~1", "/").replaceAll("~0", "~");
    node = parts.reduce((place, part) => place?.[unescape(part)], root);
  }
  return typeof node?.$ref === "string" ? undefined : node;
}

function ofBranches(branches, root, depth) {
  const [first, second] = branches;
  if (branches.length === 2 && second?.pattern === WIDE) return ofType(first);
  if (branches.length === 2 && second?.enum?.[0] === "NaN") {
    return { ...nodeOf(first, root, depth + 1), names: NAMES };
  }
  return branches.length === 1 ? nodeOf(first, root, depth + 1) : { kind: "variants", branches };
}

function ofType(node) {
  const { minimum, maximum, exclusiveMinimum, exclusiveMaximum } = node;
  switch (node.type) {
    case "object":
      return node.properties
        ? { kind: "object", fields: node.properties, required: node.required ?? [] }
        : { kind: "json", empty: "{}" };
    case "array":
      if (node.prefixItems) return { kind: "json", empty: "[]" };
      return { kind: "list", items: node.items ?? true, least: node.minItems ?? 0, most: node.maxItems };
    case "integer":
    case "number":
      return { kind: node.type, minimum, maximum, exclusiveMinimum, exclusiveMaximum };
    case "boolean":
      return { kind: "flag" };
    case "null":
      return { kind: "fixed", value: null };
    case "string":
      if (node["x-octets"] || node.contentEncoding === "base64") return { kind: "octets" };
      return { kind: "text", least: node.minLength ?? 0, most: node.maxLength, pattern: node.pattern };
    default:
      return node.properties ? ofType({ ...node, type: "object" }) : { kind: "json" };
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
        node.required.filter((name) => Object.hasOwn(node.fields, name))
          .map((name) => [name, start(node.fields[name], root, depth + 1)]));
    case "list":
      return Array.from({ length: Math.min(node.least, 100) }, () => start(node.items, root, depth + 1));
    case "variants":
      return { at: 0, draft: start(node.branches[0], root, depth + 1) };
    case "flag":
      return node.preset ?? false;
    case "choice":
      return Math.max(0, node.options.findIndex((option) => option === node.preset));
    case "json":
      return node.preset === undefined ? node.empty ?? "" : JSON.stringify(node.preset);
    default:
      return node.preset === undefined ? "" : String(node.preset);
  }
}

/** Whether a draft has a field, also one with the name of what every object has. */
export const isThere = (draft, name) => Object.hasOwn(draft, name) && draft[name] !== undefined;

/** { value, problems: [{ path, text }] } of a draft. */
export function gather(schema, root, draft, path = "") {
  const problems = [];
  const value = read(schema, root, draft, path, problems);
  return { value, problems };
}

function read(schema, root, draft, path, problems) {
  const node = nodeOf(schema, root);
  const wrong = (text) => void problems.push({ path, text });
  const inner = (schema, its, name) => read(schema, root, its, path ? `${path}.${name}` : name, problems);
  switch (node.kind) {
    case "object": {
      const there = Object.keys(node.fields).filter((name) => isThere(draft, name));
      return Object.fromEntries(there.map((name) => [name, inner(node.fields[name], draft[name], name)]));
    }
    case "list":
      if (draft.length < node.least) wrong(`at least ${node.least} items`);
      if (draft.length > (node.most ?? Infinity)) wrong(`at most ${node.most} items`);
      return draft.map((item, at) => inner(node.items, item, String(at)));
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
  if (text === "" || !Number.isFinite(value)) return wrong(text ? `${text} is no number` : "a number is missing");
  if (node.kind === "integer" && !INTEGER.test(text)) return wrong("must be a whole number");
  if (value < node.minimum) wrong(`at least ${node.minimum}`);
  if (value > node.maximum) wrong(`at most ${node.maximum}`);
  if (value <= node.exclusiveMinimum) wrong(`more than ${node.exclusiveMinimum}`);
  if (value >= node.exclusiveMaximum) wrong(`less than ${node.exclusiveMaximum}`);
  return node.kind === "integer" && !Number.isSafeInteger(value) ? String(BigInt(text)) : value; // its digits, as the protocol has it
}

function matches(pattern, text) {
  try {
    return new RegExp(pattern, "u").test(text);
  } catch {
    return true; // a pattern of another dialect: the server judges
  }
}
