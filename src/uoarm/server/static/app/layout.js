// Places cards: each connected group by dagre, the groups and the lone cards on shelves, frameworks
// in a column before them, machines in one before those. Pure.

import * as dagre from "../vendor/dagre.js";

const GAP = 28;
const ASIDE = 110; // between frameworks and the rest, and machines and frameworks
const ASIDES = ["bridge", "machine"]; // the column next to the rest first
const CROWD = 12; // a group of more cards than this stands closer
const LABEL = { width: 56, height: 18, labelpos: "c" };

/** Returns { places: Map(id -> {x, y}), paths: Map(edge id -> [points]), width, height }. */
export function layOut(cards, edges, { aspect = 1.6 } = {}) {
  const plane = cards.filter((one) => !ASIDES.includes(one.kind));
  const found = groups(plane, edges.filter((one) => one.kind !== "runs"));
  const blocks = found.map((one) => (one.cards.length > 1 ? arrange(one) : lone(one)));
  blocks.sort((a, b) => b.height - a.height || b.width - a.width);
  return ASIDES.reduce(
    (layout, kind) => before(cards.filter((one) => one.kind === kind), layout),
    onShelves(blocks, aspect),
  );
}

/** Puts a column of cards before a layout, spread over its height. */
function before(column, layout) {
  if (column.length === 0) return layout;
  const shift = Math.max(...column.map((one) => one.width)) + ASIDE;
  const move = ({ x, y }) => ({ x: x + shift, y });
  const places = new Map([...layout.places].map(([id, place]) => [id, move(place)]));
  const paths = new Map([...layout.paths].map(([id, points]) => [id, points.map(move)]));
  const needed = column.reduce((total, one) => total + one.height + GAP, -GAP);
  const height = Math.max(layout.height, needed);
  const room = (height - needed) / column.length;
  let y = room / 2;
  for (const one of column) {
    places.set(one.id, { x: 0, y });
    y += one.height + GAP + room;
  }
  return { places, paths, width: layout.width + shift, height };
}

/** Cards that edges connect, together with those edges. */
export function groups(cards, edges) {
  const leader = new Map(cards.map((one) => [one.id, one.id]));
  const find = (id) => {
    let root = id;
    while (leader.get(root) !== root) root = leader.get(root);
    leader.set(id, root);
    return root;
  };
  for (const one of edges) leader.set(find(one.from), find(one.to));
  const found = new Map();
  const of = (id) => {
    const root = find(id);
    if (!found.has(root)) found.set(root, { cards: [], edges: [] });
    return found.get(root);
  };
  for (const one of cards) of(one.id).cards.push(one);
  for (const one of edges) of(one.from).edges.push(one);
  return [...found.values()];
}

function arrange({ cards, edges }) {
  const graph = new dagre.Graph({ multigraph: true });
  const tight = cards.length > CROWD;
  graph.setGraph({ rankdir: "LR", nodesep: tight ? 12 : GAP, ranksep: tight ? 40 : 60, edgesep: 12 });
  graph.setDefaultEdgeLabel(() => ({}));
  for (const one of cards) graph.setNode(one.id, { width: one.width, height: one.height });
  for (const one of edges) {
    graph.setEdge(one.from, one.to, one.kind === "flows" ? { ...LABEL } : {}, one.id);
  }
  dagre.layout(graph);
  const { width, height } = graph.graph();
  const places = cards.map((one) => {
    const { x, y } = graph.node(one.id);
    return [one.id, { x: x - one.width / 2, y: y - one.height / 2 }];
  });
  const paths = edges.map((one) => [one.id, graph.edge(one.from, one.to, one.id).points]);
  return { width, height, places, paths };
}

const lone = ({ cards: [card] }) =>
  ({ width: card.width, height: card.height, places: [[card.id, { x: 0, y: 0 }]], paths: [] });

/** Rows of blocks, the highest first; what is low enough stands below another in its row. */
function onShelves(blocks, aspect) {
  const area = blocks.reduce((total, one) => total + (one.width + GAP) * (one.height + GAP), 0);
  const widest = Math.max(0, ...blocks.map((one) => one.width));
  const limit = Math.max(widest, Math.sqrt(area * aspect));
  const result = { places: new Map(), paths: new Map(), width: 0, height: 0 };
  const left = [...blocks];
  while (left.length > 0) {
    const top = result.height + (result.height > 0 ? GAP : 0);
    const shelf = { x: 0, top, height: left[0].height };
    for (let column = takeFirst(left, limit, shelf.height); column; ) {
      shelf.x += fillColumn(column, left, shelf, result) + GAP;
      column = takeFirst(left, limit - shelf.x, shelf.height);
    }
    result.width = Math.max(result.width, shelf.x - GAP);
    result.height = top + shelf.height;
  }
  return result;
}

function takeFirst(blocks, width, height) {
  const at = blocks.findIndex((one) => one.width <= width && one.height <= height);
  return at < 0 ? null : blocks.splice(at, 1)[0];
}

function fillColumn(first, blocks, shelf, result) {
  let y = shelf.top;
  for (let block = first; block; ) {
    put(block, shelf.x, y, result);
    y += block.height + GAP;
    block = takeFirst(blocks, first.width, shelf.top + shelf.height - y);
  }
  return first.width;
}

function put(block, left, top, { places, paths }) {
  const move = ({ x, y }) => ({ x: x + left, y: y + top });
  for (const [id, place] of block.places) places.set(id, move(place));
  for (const [id, points] of block.paths) paths.set(id, points.map(move));
}

/** A smooth line through the points of an edge, as the `d` of an SVG path. */
export function curve(points) {
  const [first, ...rest] = points;
  let [path, last] = [`M${first.x} ${first.y}`, first];
  for (const one of rest) {
    const middle = (last.x + one.x) / 2;
    path += `C${middle} ${last.y} ${middle} ${one.y} ${one.x} ${one.y}`;
    last = one;
  }
  return path;
}
