// The page's state that is worth a link: view, panels and unfolded managers, in the part of the address after "#". Pure.
//
// "#/graph/function/camera/use/keep=1&function/faces": a view, then panels. A panel is what it shows (kind and
// name), its tab, and options as name=value. At most one panel is not kept: what is opened next takes its place.

export const VIEWS = ["graph", "list", "timeline", "configuration"];
export const KINDS = ["function", "connection", "bridge", "machine"]; // of panels
const MOST_PANELS = 12;
const UNFOLDED = "unfolded=";
const [LEAST_DOCK, MOST_DOCK] = [20, 80];

/**
 * The address as { view, dock, panels: [{ kind, name, tab, options }], unfolded: [manager] }; dock: width of the
 * panels in percent, or 0.
 */
export function readAddress(hash, fallback = "graph") {
  const [first, ...others] = hash.replace(/^#\/?/, "").split("&");
  const [view, ...inside] = first.split("/");
  const dock = others.find((part) => part.startsWith("dock="))?.slice("dock=".length);
  const unfolded = others.find((part) => part.startsWith(UNFOLDED))?.slice(UNFOLDED.length) ?? "";
  const panels = [inside, ...others.map((part) => part.split("/"))].map(readPanel).filter(Boolean);
  return {
    view: VIEWS.includes(view) ? view : fallback,
    dock: dock ? dockOf(Number(dock)) : 0,
    panels: panels.filter((panel, at) => indexOf(panels, keyOf(panel)) === at).slice(0, MOST_PANELS),
    unfolded: unfolded.split(",").filter(Boolean).map(decode),
  };
}

export function writeAddress({ view, dock = 0, panels = [], unfolded = [] }) {
  const [first, ...others] = panels.map(writePanel);
  const place = first === undefined ? view : `${view}/${first}`;
  const names = unfolded.map(encodeURIComponent).join(",");
  const rest = [...(dock ? [`dock=${dock}`] : []), ...(names ? [`${UNFOLDED}${names}`] : [])];
  return `#/${[place, ...others, ...rest].join("&")}`;
}

/** A width of the panels that leaves room for them, and for the view beside them. */
export const dockOf = (percent) =>
  (Number.isFinite(percent) ? Math.round(Math.min(MOST_DOCK, Math.max(LEAST_DOCK, percent))) : 0);

export const keyOf = ({ kind, name }) => `${kind}/${name}`;

const indexOf = (panels, key) => panels.findIndex((panel) => keyOf(panel) === key);

/** Panels with one more: in the place of the one that is not kept, or beside it. What is open stays as it is. */
export function withPanel(panels, { kind, name, tab = "", options = {} }, beside = false) {
  if (indexOf(panels, keyOf({ kind, name })) >= 0) return panels;
  const kept = beside ? panels.map(keep) : panels;
  const at = kept.findIndex((panel) => !panel.options.keep);
  const added = { kind, name, tab, options };
  return at < 0 ? [...kept, added].slice(-MOST_PANELS) : kept.map((panel, place) => (place === at ? added : panel));
}

/** Names with one more, or without it where it is among them. */
export const withToggled = (names, name) =>
  (names.includes(name) ? names.filter((other) => other !== name) : [...names, name]);

export const withoutPanel = (panels, key) => panels.filter((panel) => keyOf(panel) !== key);

/** Panels with one of them changed: change(panel) is what takes its place. */
export const withChange = (panels, key, change) =>
  panels.map((panel) => (keyOf(panel) === key ? change(panel) : panel));

export const keep = (panel) => ({ ...panel, options: { ...panel.options, keep: "1" } });

/** A panel with some options others; an empty one is taken out. */
export function withOptions(panel, options) {
  const all = Object.entries({ ...panel.options, ...options });
  return { ...panel, options: Object.fromEntries(all.filter(([, value]) => value !== "" && value != null)) };
}

/** Panels with one moved by so many places. */
export function withMove(panels, key, by) {
  const from = indexOf(panels, key);
  const others = withoutPanel(panels, key);
  const to = Math.min(others.length, Math.max(0, from + by));
  return [...others.slice(0, to), panels[from], ...others.slice(to)];
}

function readPanel([kind, name, ...rest]) {
  if (!KINDS.includes(kind) || !name) return null;
  const options = rest.filter((part) => part.includes("=")).map((part) => part.split("=", 2).map(decode));
  const tab = rest.find((part) => !part.includes("=")) ?? "";
  return { kind, name: decode(name), tab: decode(tab), options: Object.fromEntries(options) };
}

function writePanel({ kind, name, tab, options }) {
  const given = Object.entries(options).map((pair) => pair.map(encodeURIComponent).join("="));
  return [kind, encodeURIComponent(name), ...(tab ? [encodeURIComponent(tab)] : []), ...given].join("/");
}

function decode(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}
