// The lines between cards.

import { anchor } from "./cards.js";
import { rate, short } from "./format.js";
import { curve } from "./layout.js";
import { html } from "./ui.js";

const DIRECT = 3; // an edge of so many points passes no card

export function Edges({ cards, edges, layout }) {
  const byId = new Map(cards.map((card) => [card.id, card]));
  const drawn = edges.map((edge) => ({ ...edge, points: route(edge, byId, layout) }));
  return html`
    <svg class="edges" width=${layout.width} height=${layout.height} aria-hidden="true">
      <defs>${["flows", "uses", "bad"].map((kind) => html`
        <marker id=${`tip-${kind}`} class=${`tip ${kind}`} viewBox="0 0 8 8" refX="7" refY="4"
          markerWidth="8" markerHeight="8" markerUnits="userSpaceOnUse" orient="auto"><path d="M0 0L8 4 0 8z" /></marker>`)}
      </defs>
      ${drawn.map((edge) => html`<${Line} key=${edge.id} edge=${edge} />`)}
      ${drawn.filter((edge) => edge.kind === "flows").map((edge) => html`<${Label} key=${edge.id} edge=${edge} />`)}
    </svg>`;
}

function Line({ edge }) {
  const look = edge.bad ? "bad" : edge.kind;
  const tip = ["runs", "holds"].includes(edge.kind) ? null : `url(#tip-${look})`;
  const moving = edge.kind === "flows" && edge.rate > 0;
  return html`<path class="edge ${edge.kind} ${edge.bad ? "bad" : ""} ${moving ? "moving" : ""}"
    d=${curve(edge.points)} marker-end=${tip} />`;
}

function Label({ edge }) {
  const { x, y } = middle(edge.points);
  const text = edge.native ? "native" : rate(edge.rate);
  return html`<g class="edge-label ${edge.bad ? "bad" : ""}" transform=${`translate(${x} ${y})`}>
    <text y="-5">${text}</text>${edge.lost > 0 && html`<text y="13">${short(edge.lost)} dropped</text>`}</g>`;
}

function route(edge, byId, { places, paths }) {
  const ends = [[byId.get(edge.from), edge.fromRow], [byId.get(edge.to), edge.toRow]];
  const forward = places.get(edge.from).x <= places.get(edge.to).x;
  const [first, last] = ends.map(([card, row], end) => {
    const { x, y } = places.get(card.id);
    const right = forward === (end === 0); // an edge that goes back leaves on the left
    return { x: x + (right ? card.width : 0), y: y + anchor(card, row) };
  });
  const points = paths.get(edge.id) ?? [];
  const bends = points.length > DIRECT ? points.slice(1, -1) : [];
  return [first, ...bends, last];
}

function middle(points) {
  if (points.length % 2) return points[(points.length - 1) / 2];
  const [left, right] = [points[points.length / 2 - 1], points[points.length / 2]];
  return { x: (left.x + right.x) / 2, y: (left.y + right.y) / 2 };
}
