// Where one is in the YAML of a configuration, and what its schema says there. Pure.
//
// It reads lines by their indentation, and braces on the line: enough for completion, whatever is half written.

const ITEM = Symbol("an item of a list");
const DEEPEST = 12;

/** What a line begins, from the left: items of lists, and a key with what follows it. */
function tokensOf(line) {
  const found = [];
  let rest = line;
  let indent = 0;
  for (;;) {
    const space = /^ */.exec(rest)[0].length;
    indent += space;
    rest = rest.slice(space);
    if (!/^- /.test(rest) && rest !== "-") break;
    found.push({ indent, name: ITEM });
    indent += 1;
    rest = rest.slice(1);
  }
  const key = /^("[^"]*"|'[^']*'|[^\s#{[\]},:][^:#{[]*?)\s*:(?=\s|$)/.exec(rest);
  if (key) found.push({ indent, name: unquoted(key[1]), end: indent + key[0].length });
  return { tokens: found, indent, isBlank: rest === "" || rest.startsWith("#") };
}

const unquoted = (text) => text.replace(/^(["'])(.*)\1$/, "$2");

/**
 * Where a place in the text is: { path, isKey, from }. `path` leads to the mapping whose key stands there (isKey), or to the
 * value; items of lists are 0. `from` is where the word begins.
 */
export function pathAt(text, offset) {
  const lines = text.slice(0, offset).split("\n");
  const line = lines.pop();
  const { tokens, indent, isBlank } = tokensOf(line);
  const path = [];
  let limit = isBlank ? line.length : (tokens[0]?.indent ?? indent);
  for (const token of tokens.toReversed()) path.unshift(token.name === ITEM ? 0 : token.name);
  if (tokens[0]?.name === ITEM) limit += 1; // a list may stand as far left as the key that it is of
  for (const above of lines.toReversed()) {
    const known = tokensOf(above);
    if (known.isBlank) continue;
    for (const token of known.tokens.toReversed()) {
      if (token.indent >= limit) continue;
      path.unshift(token.name === ITEM ? 0 : token.name);
      limit = token.indent + (token.name === ITEM ? 1 : 0);
    }
    if (limit === 0) break;
  }
  const word = /[\w.-]*$/.exec(line)[0];
  const from = offset - word.length;
  const after = line.slice(tokens.at(-1)?.end ?? indent);
  const inside = braces(after);
  if (inside) return { path: [...path, ...inside.path], isKey: inside.isKey, from };
  const isValue = tokens.at(-1)?.end !== undefined;
  return { path, isKey: !isValue, from };
}

/** The path inside braces that are open at the end of a text, or null. */
function braces(text) {
  const open = [];
  let word = "";
  let quote = "";
  for (const letter of text) {
    const top = open.at(-1);
    if (quote) quote = letter === quote ? "" : quote;
    else if (letter === '"' || letter === "'") quote = letter;
    else if (letter === "{" || letter === "[") open.push({ isMap: letter === "{", key: null });
    else if (letter === "}" || letter === "]") open.pop();
    else if (letter === ":" && top?.isMap && top.key === null) top.key = unquoted(word.trim());
    else if (letter === "," && top) top.key = null;
    word = "{}[],:".includes(letter) ? "" : word + letter;
  }
  if (open.length === 0) return null;
  const path = open.flatMap(({ isMap, key }) => (isMap ? (key === null ? [] : [key]) : [0]));
  return { path, isKey: open.at(-1).isMap && open.at(-1).key === null };
}

/** The names of the entries of a mapping at the top of the text, such as "bridges". */
export function namesUnder(text, top) {
  const inline = new RegExp(`^${top}: *\\{(.*)\\}`, "m").exec(text);
  if (inline) return [...inline[1].matchAll(/(?:^|[,{])\s*([\w.-]+)\s*:/g)].map(([, name]) => name);
  const lines = text.split("\n");
  const begin = lines.findIndex((line) => line.startsWith(`${top}:`));
  const found = [];
  for (const line of begin < 0 ? [] : lines.slice(begin + 1)) {
    const { tokens, isBlank } = tokensOf(line);
    if (isBlank) continue;
    if (tokens[0]?.indent === 0) break;
    if (tokens[0] && (found.length === 0 || tokens[0].indent === found[0].indent)) found.push(tokens[0]);
  }
  return found.map((token) => token.name).filter((name) => name !== ITEM);
}

/** Every schema that may hold at a path, references followed. */
export function schemasAt(root, path) {
  let nodes = branches(root, root);
  for (const name of path) {
    nodes = nodes.flatMap((node) => {
      const inside = name === 0 ? node.items : node.properties?.[name] ?? node.additionalProperties;
      return inside && inside !== true ? branches(inside, root) : [];
    });
  }
  return nodes;
}

function branches(schema, root, depth = 0) {
  if (schema === null || typeof schema !== "object" || depth > DEEPEST) return [];
  const inside = (part) => branches(part, root, depth + 1);
  const target = schema.$ref?.startsWith("#/")
    ? schema.$ref.slice(2).split("/").reduce((place, part) => place?.[part.replaceAll("~1", "/").replaceAll("~0", "~")], root) : null;
  const unless = schema.if?.not ? inside(schema.then) : []; // options of the plugin that a bridge is named after
  return [schema, ...(target ? inside(target) : []), ...unless,
    ...["anyOf", "oneOf", "allOf"].flatMap((word) => (schema[word] ?? []).flatMap(inside))];
}

/** What can stand at a place: [{ label, detail, info }]; of keys, those that the mapping has are left to the writer. */
export function offersAt(root, text, offset) {
  const { path, isKey, from } = pathAt(text, offset);
  if (isKey) {
    const keys = new Map();
    for (const node of schemasAt(root, path)) {
      for (const [label, inside] of Object.entries(node.properties ?? {})) {
        if (!keys.has(label)) keys.set(label, { label, detail: kindOf(inside, root), info: infoOf(inside, root), isKey: true });
      }
    }
    return { from, offers: [...keys.values()] };
  }
  const key = path.at(-1);
  const names = { bridge: "bridges", from: "functions" }[key];
  const known = schemasAt(root, path).flatMap((node) => node.enum ?? ("const" in node ? [node.const] : node.type === "boolean" ? [true, false] : []));
  const labels = [...new Set([...known.map(String), ...(names ? namesUnder(text, names) : [])])];
  return { from, offers: labels.map((label) => ({ label, detail: "", info: "", isKey: false })) };
}

/** What the schema says of the key or value at a place, as lines of text; "" where it says nothing. */
export function explainAt(root, text, offset) {
  const end = offset + /^[\w.-]*/.exec(text.slice(offset))[0].length;
  const { path, isKey, from } = pathAt(text, end);
  const word = text.slice(from, end);
  if (word === "") return "";
  const place = isKey ? [...path, word] : path;
  const [schema] = schemasAt(root, place);
  if (!schema) return "";
  return [`${place.filter((name) => name !== 0).join(".")}  ${kindOf(schema, root)}`.trim(), infoOf(schema, root)].filter(Boolean).join("\n");
}

function infoOf(schema, root) {
  const nodes = branches(schema, root);
  const text = nodes.map((node) => node.description).find(Boolean) ?? "";
  const preset = nodes.find((node) => "default" in node);
  return preset ? `${text} Without it: ${JSON.stringify(preset.default)}.`.trim() : text;
}

function kindOf(schema, root) {
  const nodes = branches(schema, root);
  const choice = nodes.find((node) => node.enum);
  if (choice) return choice.enum.join(" | ").slice(0, 60);
  const bounds = nodes.find((node) => node.minimum !== undefined || node.maximum !== undefined);
  const type = nodes.map((node) => node.type).find(Boolean) ?? "";
  return `${[type].flat().join(" or ")}${bounds ? ` ${bounds.minimum ?? "…"} to ${bounds.maximum ?? "…"}` : ""}`;
}

/** The mistakes that an error names: [{ line, column, text }], of lines "PLACE:LINE:COLUMN: text". */
export function problemsOf(error) {
  const found = [];
  for (const line of error.split("\n")) {
    const place = /^.*?:(\d+):(\d+): (.*)$/.exec(line);
    if (place) found.push({ line: Number(place[1]), column: Number(place[2]), text: place[3] });
    else if (found.length > 0) found.at(-1).text += `\n${line}`;
  }
  return found;
}
