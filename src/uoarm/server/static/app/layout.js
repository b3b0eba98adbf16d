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
  const plane = cards.filter((card) => !ASIDES.includes(card.kind));
  const found = groups(plane, edges.filter((edge) => edge.kind !== "runs"));
  const blocks = found.map((item_) => (item_.cards.length > 1 ? arrange(item_) : lone(item_)));
  blocks.sort((a, b) => b.height - a.height || b.width - a.width);
  return ASIDES.reduce(
    (layout, kind) => before(cards.filter((card) => card.kind === kind), layout),
    onShelves(blocks, aspect),
  );
}

/** Puts a column of cards before a layout, spread over its height. */
function before(column, layout) {
  if (column.length === 0) return layout;
  const shift = Math.max(...column.map((card) => card.width)) + ASIDE;
  const move = ({ x, y }) => ({ x: x + shift, y });
  const places = new Map([...layout.places].map(([id, place]) => [id, move(place)]));
  const paths = new Map([...layout.paths].map(([id, points]) => [id, points.map(move)]));
  const needed = column.reduce((total, card) => total + card.height + GAP, -GAP);
  const height = Math.max(layout.height, needed);
  const room = (height - needed) / column.length;
  let y = room / 2;
  for (const card of column) {
    places.set(card.id, { x: 0, y });
    y += card.height + GAP + room;
  }
  return { places, paths, width: layout.width + shift, height };
}

/** Cards that edges connect, together with those edges. */
export function groups(cards, edges) {
  const leader = new Map(cards.map((card) => [card.id, card.id]));
  const find = (id) => {
    let root = id;
    while (leader.get(root) !== root) root = leader.get(root);
    leader.set(id, root);
    return root;
  };
  for (const edge of edges) leader.set(find(edge.from), find(edge.to));
  const found = new Map();
  const of = (id) => {
    const root = find(id);
    if (!found.has(root)) found.set(root, { cards: [], edges: [] });
    return found.get(root);
  };
  for (const card of cards) of(card.id).cards.push(card);
  for (const edge of edges) of(edge.from).edges.push(edge);
  return [...found.values()];
}

function arrange({ cards, edges }) {
  const graph = new dagre.Graph({ multigraph: true });
  const tight = cards.length > CROWD;
  graph.setGraph({ rankdir: "LR", nodesep: tight ? 12 : GAP, ranksep: tight ? 40 : 60, edgesep: 12 });
  graph.setDefaultEdgeLabel(() => ({}));
  for (const card of cards) graph.setNode(card.id, { width: card.width, height: card.height });
  for (const edge of edges) {
    graph.setEdge(edge.from, edge.to, edge.kind === "flows" ? { ...LABEL } : {}, edge.id);
  }
  dagre.layout(graph);
  const { width, height } = graph.graph();
  const places = cards.map((card) => {
    const { x, y } = graph.node(card.id);
    return [card.id, { x: x - card.width / 2, y: y - card.height / 2 }];
  });
  const paths = edges.map((edge) => [edge.id, graph.edge(edge.from, edge.to, edge.id).points]);
  return { width, height, places, paths };
}

const lone = ({ cards: [card] }) =>
  ({ width: card.width, height: card.height, places: [[card.id, { x: 0, y: 0 }]], paths: [] });

/** Rows of blocks, the highest first; what is low enough stands below another in its row. */
function onShelves(blocks, aspect) {
  const area = blocks.reduce((total, block) => total + (block.width + GAP) * (block.height + GAP), 0);
  const widest = Math.max(0, ...blocks.map((block) => block.width));
  const limit = Math.max(widest, Math.sqrt(area * aspect));
  const result = { places: new Map(), paths: new Map(), width: 0, height: 0 };
  const left = [...blocks];
  while (left.length > 0) {
    const top = result.height + (result.height > 0 ? GAP : 0);
    const band = { x: 0, top, height: left[0].height };
    for (let column = takeFirst(left, limit, band.height); column; ) {
      band.x += fillColumn(column, left, band, result) + GAP;
      column = takeFirst(left, limit - band.x, band.height);
    }
    result.width = Math.max(result.width, band.x - GAP);
    result.height = top + band.height;
  }
  return result;
}

function takeFirst(blocks, width, height) {
  const at = blocks.findIndex((block) => block.width <= width && block.height <= height);
  return at < 0 ? null : blocks.splice(at, 1)[0];
}

function fillColumn(first, blocks, band, result) {
  let y = band.top;
  for (let block = first; block; ) {
    put(block, band.x, y, result);
    y += block.height + GAP;
    block = takeFirst(blocks, first.width, band.top + band.height - y);
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
  for (const point of rest) {
    const middle = (last.x + point.x) / 2;
    path += `C${middle} ${last.y} ${middle} ${point.y} ${point.x} ${point.y}`;
    last = point;
  }
  return path;
}
