// One card of the graph.

import { rowHeight } from "./cards.js";
import { plural, rate, short, span } from "./format.js";
import { Framework, Health, hueOf, html, Icon, isBeside } from "./ui.js";

const canFold = ({ kind, data }) => kind === "function" || (kind === "manager" && data.own.length > 0);
const sayManager = ({ functions, used }) => `${plural(functions, "function")}, ${plural(used, "connection")} in use`;
const placeOf = ({ url }) => url || "not connected yet"; // known once it was asked for something
const sayMachine = ({ present }) => (present ? "here" : "not here");

/** What the card says, as one sentence for a screen reader. */
export function sayCard({ kind, title, health, data }) {
  if (kind === "bridge") return `Framework ${title}, ${health}, ${data.open} of ${data.all} running`;
  if (kind === "manager") return `Manager ${title}, ${health}, ${sayManager(data)}, ${placeOf(data)}`;
  if (kind === "machine") return `Machine ${title}, ${sayMachine(data)}`;
  if (kind === "connection") return `${title} uses ${data.function}, ${data.state}, ${rate(data.rate)}`;
  const open = data.rows.filter((row) => row.open);
  const running = open.map((row) => `${row.name}${row.recorded ? ", recorded," : ""} ${row.health} ${rate(row.rate)}`).join(", ");
  return `Function ${title}, ${plural(data.rows.length, "component")}, ${running || "not running"}`;
}

export function Card({ card, place, selected, dim, stop, select, fold }) {
  const { x, y } = place;
  const style = { left: `${x}px`, top: `${y}px`, width: `${card.width}px`, height: `${card.height}px` };
  const press = card.kind === "manager" && canFold(card) ? fold : select;
  return html`
    <div class="card ${card.kind} is-${card.health} ${selected ? "selected" : ""} ${dim ? "dim" : ""}" style=${style}
      data-card=${card.id} onClick=${(event) => press(card, isBeside(event))}>
      <div class="card-head">
        <button type="button" class="card-title" tabindex=${stop ? 0 : -1} data-title=${card.id}
          aria-label=${sayCard(card)} aria-pressed=${card.kind === "manager" && canFold(card) ? null : selected}
          aria-expanded=${canFold(card) ? !card.folded : null}>
          <${Health} of=${card.health} /><span>${card.title}</span>
        </button>
        ${canFold(card) && html`<${Fold} card=${card} fold=${fold} />`}
      </div>
      ${card.kind === "function" && card.rows.map((row) => html`<${Row} key=${row.name} row=${row} />`)}
      ${card.kind === "connection" && html`<${Application} data=${card.data} />`}
      ${card.kind === "bridge" && html`<p class="card-note framework hue${hueOf(card.title)}">${card.data.open} of ${card.data.all} running</p>`}
      ${card.kind === "manager" && html`<p class="card-note">${sayManager(card.data)}</p>
        <p class="card-note" title=${placeOf(card.data)}>${placeOf(card.data)}</p>`}
      ${card.kind === "machine" && html`<p class="card-note">machine · ${sayMachine(card.data)}</p>`}
    </div>`;
}

function Fold({ card, fold }) {
  const press = (event) => {
    event.stopPropagation();
    fold(card);
  };
  const parts = card.kind === "manager" ? [] : card.data.rows;
  const open = parts.filter((row) => row.open).length;
  const count = card.kind === "manager" ? `${card.data.own.length}` : `${open ? `${open}/` : ""}${parts.length}`;
  return html`<button type="button" class="card-fold" tabindex="-1" onClick=${press}
    aria-label=${`${count}: ${card.folded ? "unfold" : "fold"} ${card.title}`}>
    <span>${count}</span>
    <${Icon} name=${card.folded ? "unfold" : "fold"} /></button>`;
}

function Row({ row }) {
  return html`
    <div class="row ${row.open ? "open" : ""}" style=${{ height: `${rowHeight(row)}px` }}>
      <div class="row-line"><${Health} of=${row.health} /><span class="row-name">${row.name}</span>
        <${Framework} name=${row.bridge} recorded=${row.recorded} /></div>
      ${row.open && !row.cause && html`<div class="row-figures">${figures(row)}</div>`}
      ${row.cause && html`<div class="row-figures cause" title=${row.cause}>${row.cause}</div>`}
    </div>`;
}

function figures(row) {
  if (row.native) return "moved by the framework itself";
  if (row.age === null) return "no message yet";
  const facts = [html`<b>${rate(row.rate)}</b>`, `${span(row.age)} ago`];
  if (row.lost) facts.push(html`<span class="bad">${short(row.lost)} dropped</span>`);
  if (row.invalid) facts.push(html`<span class="bad">${short(row.invalid)} invalid</span>`);
  return facts.map((fact, at) => html`${at > 0 && " · "}${fact}`);
}

const Application = ({ data }) => html`<div class="row-figures">
  <span class="row-name">${data.function}</span>
  <span>${data.state === "running" ? html`<b>${rate(data.rate)}</b>` : data.state}</span></div>`;
