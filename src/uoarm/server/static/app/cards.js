// Cards and edges of the graph, with their sizes, from the joined system. Pure.

import { componentId, groupBy, nameOf, worst } from "./system.js";

export const WIDTH = 250;
export const HEAD = 40;
export const ROW = 28;
export const OPEN_ROW = 46;
const FOOT = 6;
const LETTER = 11; // the width of one, as it is seen from far

export const rowHeight = (row) => (row.open || row.cause ? OPEN_ROW : ROW);

/** Cards of functions, of other managers, of connections (applications) and, if wanted, of frameworks and machines. */
export function makeCards(system, shown, { folded, frameworks, unfolded }) {
  const managers = managerCards(system, shown, unfolded);
  const hidden = new Set(managers.filter((card) => card.folded).flatMap((card) => card.data.own));
  const cards = shown.filter((func) => !hidden.has(func)).map((func) => functionCard(func, folded(func.name)));
  cards.push(...managers);
  const names = new Set(shown.map((func) => func.name));
  for (const connection of system.connections) {
    if (names.has(connection.function)) cards.push(connectionCard(connection));
  }
  if (frameworks) {
    const bridges = bridgeCards(system, shown);
    cards.push(...bridges, ...machineCards(system, new Set(bridges.map((bridge) => bridge.title))));
  }
  return cards;
}

function functionCard(func, isFolded) {
  const rows = isFolded ? [] : func.rows;
  const inside = rows.reduce((total, row) => total + rowHeight(row), 0);
  const height = HEAD + inside + (rows.length ? FOOT : 0);
  const width = isFolded ? Math.min(WIDTH, 80 + LETTER * func.name.length) : WIDTH;
  return { id: `function/${func.name}`, kind: "function", title: func.name, health: func.health,
    data: func, folded: isFolded, rows, width, height };
}

/** One for each manager whose functions are shown; those that come only from there are its own, and fold into it. */
function managerCards({ managers, bridges, connections }, shown, unfolded) {
  return managers.flatMap((name) => {
    const isThere = (row) => row.bridge === name;
    const functions = shown.filter((func) => func.rows.some(isThere));
    if (functions.length === 0) return [];
    const own = functions.filter((func) => func.rows.every(isThere));
    const rows = functions.flatMap((func) => func.rows).filter(isThere);
    const parts = new Set(rows.map((row) => row.name));
    const used = connections.filter(({ components }) => components.some((part) => parts.has(part))).length;
    const live = bridges.find((bridge) => bridge.name === name);
    const url = new Map(live?.facts ?? []).get("url") ?? "";
    const data = { name, own, functions: functions.length, used, url };
    const health = worst([live?.health ?? "idle", ...rows.map((row) => row.health)]);
    return [{ id: `manager/${name}`, kind: "manager", title: name, health, data,
      folded: own.length > 0 && !unfolded(name), rows: [], width: WIDTH, height: 86 }];
  });
}

function connectionCard(connection) {
  const well = connection.failed ? "degraded" : "ok";
  const health = { failed: "lost", closed: "finished", closing: "degraded" }[connection.state] ?? well;
  return { id: `connection/${connection.id}`, kind: "connection", title: nameOf(connection), health,
    data: connection, folded: false, rows: [], width: 190, height: 62 };
}

function bridgeCards(system, shown) {
  const rows = groupBy(shown.flatMap((func) => func.rows), (row) => row.bridge);
  const live = new Map(system.bridges.map((bridge) => [bridge.name, bridge]));
  const machine = new Map(system.machines.flatMap(({ name, bridges }) => bridges.map((bridge) => [bridge, name])));
  const place = ([name]) => machine.get(name) ?? ""; // those of a machine beside each other: its lines cross none
  return [...rows].sort((a, b) => place(a).localeCompare(place(b))).map(([name, its]) => {
    const data = live.get(name) ?? { name, health: "idle", cause: "", open_channels: 0 };
    const open = its.filter((row) => row.open).length;
    return { id: `bridge/${name}`, kind: "bridge", title: name, data: { ...data, open, all: its.length },
      health: worst([data.health]), folded: false, rows: [], width: 160, height: 56 };
  });
}

function machineCards(system, bridges) {
  return system.machines.filter((machine) => machine.bridges.some((name) => bridges.has(name))).map((machine) => (
    { id: `machine/${machine.name}`, kind: "machine", title: machine.name, data: machine, health: machine.health,
      folded: false, rows: [], width: 160, height: 56 }));
}

/** The bridges that a card of a framework or machine stands for; null: it is of another kind. */
export function bridgesOf({ kind, data }) {
  if (kind === "bridge") return [data.name];
  return kind === "machine" ? data.bridges : null;
}

/** Whether a card has something to do with some bridges: what runs there, or where it is. */
export const concerns = (card, bridges) =>
  (bridgesOf(card) ?? (card.kind === "manager" ? [card.data.name] : null) ?? (card.kind === "function" ? card.data.rows.map((row) => row.bridge) : []))
    .some((name) => bridges.includes(name));

/** Edges between cards: messages that flow, dependencies of what is not running, what a manager or machine has. */
export function makeEdges(system, cards) {
  const byId = new Map(cards.map((card) => [card.id, card]));
  const home = new Map(); // the card in which an end of a route is
  const holder = new Map(); // the card in which a function is
  for (const card of cards) {
    for (const func of card.kind === "manager" && card.folded ? card.data.own : []) {
      holder.set(func.name, card);
      for (const row of func.rows) home.set(componentId(row.name), card);
    }
    if (card.kind === "function") holder.set(card.title, card);
    if (card.kind === "function") for (const row of card.data.rows) home.set(componentId(row.name), card);
    if (card.kind === "connection") home.set(card.id, card);
  }
  const edges = new Map();
  for (const route of system.routes) {
    const [from, to] = [home.get(route.from), home.get(route.to)];
    if (from && to && from !== to) {
      const id = `${route.from}>${route.to}`;
      edges.set(id, merge(edges.get(id), flowing(id, from, to, route)));
    }
  }
  const live = new Set([...edges.values()].map((edge) => `${edge.from}>${edge.to}`));
  for (const card of cards.filter((card) => card.kind === "function")) {
    for (const row of card.data.rows) {
      for (const used of row.uses ?? []) wish(holder.get(used), card, live, edges);
    }
  }
  for (const card of cards.filter((card) => card.kind === "manager" && !card.folded)) {
    for (const func of card.data.own) link("holds", card, holder.get(func.name), edges);
  }
  for (const card of cards.filter((card) => card.kind === "machine")) {
    const its = card.data.bridges.map((name) => byId.get(`bridge/${name}`));
    for (const bridge of its.filter(Boolean)) link("runs", card, bridge, edges);
  }
  return [...edges.values()];
}

function wish(from, to, live, edges) {
  const id = from && `${from.id}>${to.id}`;
  if (from && from !== to && !live.has(id)) edges.set(id, edge(id, "uses", from, to));
}

function link(kind, from, to, edges) {
  const id = `${from.id}>${to.id}`;
  edges.set(id, edge(id, kind, from, to));
}

const edge = (id, kind, from, to) => ({ id, kind, from: from.id, to: to.id, fromRow: "", toRow: "" });

const flowing = (id, from, to, route) => ({
  ...edge(id, "flows", from, to),
  fromRow: route.from,
  toRow: route.to,
  rate: route.rate,
  lost: route.lost,
  age: route.age,
  native: route.native,
  bad: route.lost + route.invalid > 0 || Boolean(route.last_error),
});

function merge(first, second) {
  if (!first) return second;
  const rate = first.rate === null ? second.rate : Math.max(first.rate, second.rate ?? 0);
  return { ...first, rate, lost: first.lost + second.lost, bad: first.bad || second.bad };
}

/** Where an edge leaves or enters a card, from its upper edge: the middle of the row's line. */
export function anchor(card, end) {
  let top = HEAD;
  for (const row of card.rows) {
    const height = rowHeight(row);
    if (componentId(row.name) === end) return top + height / 2;
    top += height;
  }
  return card.rows.length ? HEAD / 2 : card.height / 2;
}
