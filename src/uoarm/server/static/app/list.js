// The same system as a list: for phones, for screen readers, and for those who prefer one.

import { plural, rate, short, span } from "./format.js";
import { nameOf } from "./system.js";
import { Framework, Health, html, isBeside } from "./ui.js";

export function List({ system, shown, panels, select }) {
  const using = new Map();
  for (const connection of system.connections) using.set(connection.function, (using.get(connection.function) ?? 0) + 1);
  return html`
    <section class="list" aria-label="Functions">
      ${shown.length === 0 && html`<p class="empty">Nothing is found.</p>`}
      <ul>${shown.map((func) => html`<${Item} key=${func.name} of=${func} users=${using.get(func.name) ?? 0}
        selected=${panels.includes(`function/${func.name}`)} select=${select} />`)}</ul>
      ${system.connections.length > 0 && html`<h2>Applications</h2>
        <ul>${system.connections.map((connection) => html`<${Connection} key=${connection.id} of=${connection}
          selected=${panels.includes(`connection/${connection.id}`)} select=${select} />`)}</ul>`}
      ${system.bridges.length > 0 && html`<h2>Frameworks</h2>
        <ul>${system.bridges.map((bridge) => html`<${Bridge} key=${bridge.name} of=${bridge}
          selected=${panels.includes(`bridge/${bridge.name}`)} select=${select} />`)}</ul>`}
    </section>`;
}

const kindOf = ({ service, outputs }) => (service ? "service" : outputs.length > 0 ? "stream" : "input");

function Item({ of, users, selected, select }) {
  const open = of.rows.filter((row) => row.open);
  const cause = of.rows.find((row) => row.cause)?.cause;
  const bridges = [...new Set(of.rows.map((row) => row.bridge))];
  return html`
    <li><button type="button" class="item" aria-pressed=${selected} data-item=${of.name}
      onClick=${(event) => select({ kind: "function", title: of.name }, isBeside(event))}>
      <span class="item-name"><${Health} of=${of.health} /><b>${of.name}</b>
        <span class="kind">${kindOf(of)}</span></span>
      <span class="item-note">${of.description}</span>
      <span class="item-figures">${open.map((row) => html`<span key=${row.name}>${row.name}${row.recorded && " (recorded)"} <b>${rate(row.rate)}</b>
        ${row.age !== null && html` · ${span(row.age)} ago`}
        ${row.lost > 0 && html` · <span class="bad">${short(row.lost)} dropped</span>`}</span>`)}
        ${cause && html`<span class="cause">${cause}</span>`}</span>
      <span class="item-tags">${bridges.map((bridge) => html`<${Framework} key=${bridge} name=${bridge} />`)}
        <span>${plural(of.rows.length, "component")}${users > 0 && `, ${plural(users, "user")}`}</span></span>
    </button></li>`;
}

const Connection = ({ of, selected, select }) => html`
  <li><button type="button" class="item" aria-pressed=${selected}
    onClick=${(event) => select({ kind: "connection", data: of }, isBeside(event))}>
    <span class="item-name"><b>${nameOf(of)}</b></span>
    <span class="item-note">uses ${of.function}, ${of.state}</span>
    <span class="item-figures"><b>${rate(of.rate)}</b></span></button></li>`;

const Bridge = ({ of, selected, select }) => html`
  <li><button type="button" class="item" aria-pressed=${selected}
    onClick=${(event) => select({ kind: "bridge", data: of }, isBeside(event))}>
    <span class="item-name"><${Health} of=${of.health} /><b>${of.name}</b></span>
    <span class="item-note">${of.cause || `plugin ${of.plugin}`}</span>
    <span class="item-figures">${plural(of.open_channels, "channel")}</span></button></li>`;
