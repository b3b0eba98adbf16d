// The living system as cards and edges: what the graph and the list show. Pure.

const WORST_FIRST = ["lost", "degraded", "ok", "finished", "idle"];
export const MANY = 60; // with more components than this, cards begin folded

export const worst = (healths) => WORST_FIRST.find((health) => healths.includes(health)) ?? "idle";

const sum = (numbers) => numbers.reduce((total, number) => total + number, 0);
const known = (numbers) => numbers.filter((number) => number !== null && number !== undefined);
const most = (numbers) => (known(numbers).length ? Math.max(...known(numbers)) : null);
const least = (numbers) => (known(numbers).length ? Math.min(...known(numbers)) : null);

export const drops = (route) => sum(route.dropped.map(([, count]) => count));

/** On how many messages of a route its consumer raised: the failure of that one, not of the producer. */
const raised = (route) => sum(route.dropped.map(([why, count]) => (why === "failed" ? count : 0)));

/** What is at one end of a route: "camera.default" is "component/camera", "c1" is "connection/c1". */
export const endOf = (place) => {
  const dot = place.lastIndexOf(".");
  return dot < 0 ? `connection/${place}` : componentId(place.slice(0, dot));
};

export const componentId = (name) => `component/${name}`;

/** Everything known about the system, joined: functions with rows, connections, frameworks, machines. */
export function join(functions, status, events = [], session = "") {
  const deaths = lastDeaths(events);
  const open = new Map(status.components.map((component) => [component.name, component]));
  const routes = status.routes.map((route) => ({
    ...route,
    from: endOf(route.producer),
    to: endOf(route.consumer),
    lost: drops(route),
  }));
  const from = groupBy(routes, (route) => route.from);
  const to = groupBy(routes, (route) => route.to);
  const parts = functions.flatMap((func) => func.components); // also of bridges that were not asked yet
  return {
    functions: functions.map((func) => withRows(func, open, { from, to }, deaths)),
    connections: status.connections.map((connection) => ({
      ...withFlow(connection, to.get(`connection/${connection.id}`) ?? from.get(`connection/${connection.id}`) ?? []),
      clients: (status.clients ?? []).filter((client) => client.connections.includes(connection.id))
        .map((client) => ({ ...client, own: client.session === session })),
    })),
    bridges: status.bridges.map((bridge) => ({ ...bridge })),
    managers: [...new Set(parts.filter(({ plugin }) => plugin === "remote").map(({ bridge }) => bridge))],
    machines: status.machines.map((machine) => ({ ...machine, health: machine.present ? "ok" : "lost" })),
    routes,
  };
}

function withRows(described, open, routes, deaths) {
  const rows = described.components.map((part) => {
    const live = open.get(part.name);
    const died = deaths.get(`component ${part.name}`);
    const health = live?.health ?? (died ? "lost" : "idle");
    const cause = live?.cause || (live ? "" : died?.cause) || "";
    const users = live?.users ?? [];
    const recorded = part.plugin === "recording";
    const own = { recorded, failed: live?.failed ?? 0, error: live?.last_error ?? "", commands: commandsOf(live) };
    return { ...part, open: Boolean(live) && health !== "lost", health, cause, users, ...flowOf(componentId(part.name), routes), ...own };
  });
  return { ...described, rows, health: worst(rows.map((row) => row.health)) };
}

/** Components one after another, and which of them play what was recorded. */
export function sayThrough({ functions }, components) {
  const recorded = new Set(functions.flatMap((func) => func.rows).filter((row) => row.recorded).map((row) => row.name));
  return components.map((name) => (recorded.has(name) ? `${name} (recorded)` : name)).join(" → ");
}

/** Who holds a connection, in a few words: "this page", "ada", "2 clients"; by its number where it is of another protocol or program. */
export function nameOf({ id, clients = [] }) {
  if (clients.length === 0) return `Application ${id}`;
  if (clients.length > 1) return `${clients.length} clients (${id})`;
  const [{ own, principal, role }] = clients;
  return `${own ? "This page" : principal || role} (${id})`;
}

/** Who holds a connection, each with name, role and address. */
export const holdersOf = ({ clients = [] }) =>
  clients.map(({ own, principal, role, address }) => `${own ? "this page" : principal || "no name"}, ${role}, ${address}`);

/** The inputs of an open component that move something: the last command of each, and who may command it. */
function commandsOf(live) {
  return (live?.channels ?? []).filter(({ command }) => command).map(({ port, command, lease }) => ({
    name: port.split(".")[1], phase: command.phase, left: command.left, lease: lease && (lease.holder ?? "free") }));
}

/** What an application's callback raises is shown with the connection, whose own failure it is. */
function withFlow(connection, routes) {
  const failed = sum(routes.map(raised));
  const error = routes.find(raised)?.last_error ?? "";
  return { ...connection, ...flow(routes), failed, error };
}

/** What a component gives; of one that gives nothing, what it takes, whose losses are its producers'. */
function flowOf(id, { from, to }) {
  if (from.has(id)) return flow(from.get(id));
  return { ...flow(to.get(id) ?? []), lost: 0, invalid: 0 };
}

function flow(routes) {
  return {
    rate: most(routes.map((route) => route.rate)),
    age: least(routes.map((route) => route.age)),
    lost: sum(routes.map((route) => route.lost - raised(route))),
    invalid: sum(routes.map((route) => route.invalid)),
    received: most(routes.map((route) => route.received)) ?? 0,
    native: routes.some((route) => route.native),
  };
}

/** The last change of each subject, where that was its death. */
export function lastDeaths(events) {
  const last = new Map();
  for (const event of events) last.set(event.subject, event);
  return new Map([...last].filter(([, event]) => event.change === "lost" || event.change === "failed"));
}

/** The functions that a search finds; every word must be found somewhere in it. */
export function search(functions, query, { running = false, bridge = "" } = {}) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  return functions.filter((func) => {
    if (running && !func.rows.some((row) => row.open)) return false;
    if (bridge && !func.rows.some((row) => row.bridge === bridge)) return false;
    const names = func.rows.map((row) => `${row.name} ${row.bridge}`).join(" ");
    const text = `${func.name} ${func.description} ${names}`.toLowerCase();
    return words.every((word) => text.includes(word));
  });
}

export function groupBy(things, key) {
  const groups = new Map();
  for (const thing of things) {
    const name = key(thing);
    if (!groups.has(name)) groups.set(name, []);
    groups.get(name).push(thing);
  }
  return groups;
}
