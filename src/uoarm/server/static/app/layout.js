// Places cards: each connected group by dagre, then the groups and the lone cards on shelves. Pure.

import * as dagre from "../vendor/dagre.js";

const GAP = 28;
const LABEL = { width: 70, height: 18, labelpos: "c" };

/** Returns { places: Map(id -> {x, y}), paths: Map(edge id -> [points]), width, height }. */
export function layOut(cards, edges, { aspect = 1.6 } = {}) {
  const blocks = groups(cards, edges).map((one) => one.cards.length > 1 ? arrange(one) : lone(one));
  blocks.sort((a, b) => b.count - a.count || b.height - a.height);
  return onShelves(blocks, aspect);
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
  graph.setGraph({ rankdir: "LR", nodesep: GAP, ranksep: 64, edgesep: 16, marginx: 0, marginy: 0 });
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
  return { count: cards.length, width, height, places, paths };
}

const lone = ({ cards: [card] }) =>
  ({ count: 1, width: card.width, height: card.height, places: [[card.id, { x: 0, y: 0 }]], paths: [] });

function onShelves(blocks, aspect) {
  const area = blocks.reduce((total, one) => total + (one.width + GAP) * (one.height + GAP), 0);
  const widest = Math.max(0, ...blocks.map((one) => one.width));
  const limit = Math.max(widest, Math.sqrt(area * aspect));
  const [places, paths] = [new Map(), new Map()];
  let [left, top, shelf, width] = [0, 0, 0, 0];
  for (const block of blocks) {
    if (left > 0 && left + block.width > limit) [left, top, shelf] = [0, top + shelf + GAP, 0];
    const move = ({ x, y }) => ({ x: x + left, y: y + top });
    for (const [id, place] of block.places) places.set(id, move(place));
    for (const [id, points] of block.paths) paths.set(id, points.map(move));
    left += block.width + GAP;
    shelf = Math.max(shelf, block.height);
    width = Math.max(width, left - GAP);
  }
  return { places, paths, width, height: top + shelf };
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
