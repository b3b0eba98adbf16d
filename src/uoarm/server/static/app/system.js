// The living system as cards and edges: what the graph and the list show. Pure.

const WORST_FIRST = ["lost", "degraded", "ok", "finished", "idle"];
export const MANY = 60; // with more components than this, cards begin folded

export const worst = (healths) => WORST_FIRST.find((one) => healths.includes(one)) ?? "idle";

const sum = (numbers) => numbers.reduce((total, one) => total + one, 0);
const known = (numbers) => numbers.filter((one) => one !== null && one !== undefined);
const most = (numbers) => (known(numbers).length ? Math.max(...known(numbers)) : null);
const least = (numbers) => (known(numbers).length ? Math.min(...known(numbers)) : null);

export const drops = (route) => sum(route.dropped.map(([, count]) => count));

/** On how many messages of a route its consumer raised: the failure of that one, not of the producer. */
const raised = (route) => sum(route.dropped.map(([why, count]) => (why === "failed" ? count : 0)));

/** The component or connection at one end of a route: "camera.default" is of "camera". */
export const endOf = (place, names) =>
  names.has(place) ? place : place.slice(0, Math.max(0, place.lastIndexOf(".")));

/** Everything known about the system, joined: functions with rows, connections, frameworks, machines. */
export function join(functions, status, events = []) {
  const deaths = lastDeaths(events);
  const open = new Map(status.components.map((one) => [one.name, one]));
  const names = new Set([...open.keys(), ...status.connections.map((one) => one.id)]);
  const routes = status.routes.map((one) => ({
    ...one,
    from: endOf(one.producer, names),
    to: endOf(one.consumer, names),
    lost: drops(one),
  }));
  const from = groupBy(routes, (one) => one.from);
  const to = groupBy(routes, (one) => one.to);
  return {
    functions: functions.map((one) => withRows(one, open, { from, to }, deaths)),
    connections: status.connections.map((one) => withFlow(one, to.get(one.id) ?? from.get(one.id) ?? [])),
    bridges: status.bridges.map((one) => ({ ...one })),
    machines: status.machines.map((one) => ({ ...one, health: one.present ? "ok" : "lost" })),
    routes,
  };
}

function withRows(described, open, routes, deaths) {
  const rows = described.components.map((one) => {
    const live = open.get(one.name);
    const died = deaths.get(`component ${one.name}`);
    const health = live?.health ?? (died ? "lost" : "idle");
    const cause = live?.cause || (live ? "" : died?.cause) || "";
    const users = live?.users ?? [];
    const own = { failed: live?.failed ?? 0, error: live?.last_error ?? "", commands: commandsOf(live) };
    return { ...one, open: Boolean(live), health, cause, users, ...flowOf(one.name, routes), ...own };
  });
  return { ...described, rows, health: worst(rows.map((one) => one.health)) };
}

/** The inputs of an open component that move something: what each was told last, and who may tell it. */
function commandsOf(live) {
  return (live?.channels ?? []).filter(({ command }) => command).map(({ port, command, lease }) => ({
    name: port.split(".")[1], phase: command.phase, left: command.left, lease: lease && (lease.holder ?? "free") }));
}

/** What an application's callback raises is told with the connection, whose own failure it is. */
function withFlow(connection, routes) {
  const failed = sum(routes.map(raised));
  const error = routes.find(raised)?.last_error ?? "";
  return { ...connection, ...flow(routes), failed, error };
}

/** What a component gives; of one that gives nothing, what it takes, whose losses are its producers'. */
function flowOf(name, { from, to }) {
  if (from.has(name)) return flow(from.get(name));
  return { ...flow(to.get(name) ?? []), lost: 0, invalid: 0 };
}

function flow(routes) {
  return {
    rate: most(routes.map((one) => one.rate)),
    age: least(routes.map((one) => one.age)),
    lost: sum(routes.map((one) => one.lost - raised(one))),
    invalid: sum(routes.map((one) => one.invalid)),
    received: most(routes.map((one) => one.received)) ?? 0,
    native: routes.some((one) => one.native),
  };
}

/** The last change of each subject, where that was its death. */
export function lastDeaths(events) {
  const last = new Map();
  for (const one of events) last.set(one.subject, one);
  return new Map([...last].filter(([, one]) => one.change === "lost" || one.change === "failed"));
}

/** The functions that a search finds; every word must be found somewhere in it. */
export function search(functions, query, { running = false, bridge = "" } = {}) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  return functions.filter((one) => {
    if (running && !one.rows.some((row) => row.open)) return false;
    if (bridge && !one.rows.some((row) => row.bridge === bridge)) return false;
    const names = one.rows.map((row) => `${row.name} ${row.bridge}`).join(" ");
    const text = `${one.name} ${one.description} ${names}`.toLowerCase();
    return words.every((word) => text.includes(word));
  });
}

export function groupBy(things, key) {
  const groups = new Map();
  for (const one of things) {
    const name = key(one);
    if (!groups.has(name)) groups.set(name, []);
    groups.get(name).push(one);
  }
  return groups;
}
