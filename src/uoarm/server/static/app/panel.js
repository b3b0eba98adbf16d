// What a panel shows, in full: a function, an application's connection, a framework, or a machine.

import { keyOf, withChange, writeAddress } from "./address.js";
import { Call } from "./call.js";
import { Explain } from "./explain.js";
import { rate, short, span } from "./format.js";
import { Kill, Right } from "./kill.js";
import { Recordings } from "./recordings.js";
import { Send } from "./send.js";
import { componentId, holdersOf, nameOf, sayThrough } from "./system.js";
import { Facts, Framework, Health, html, Notice } from "./ui.js";
import { Watch } from "./watch.js";

function FunctionPanel({ store, address, panel, act, keep }) {
  const func = store.system.functions.find((other) => other.name === panel.name);
  if (!func) return html`<${Gone} store=${store} what="function" />`;
  const use = func.service ? "Call" : func.outputs.length ? "Watch" : "Send";
  const tabs = [["", "Overview"], ["use", use], ["explain", "Explain"]];
  const place = (tab) => writeAddress({ ...address, panels: withChange(address.panels, keyOf(panel), (of) => ({ ...of, tab })) });
  return html`
    ${func.description && html`<p class="lead">${func.description}</p>`}
    <nav class="tabs" aria-label=${`About ${func.name}`}>${tabs.map(([tab, label]) => html`
      <a key=${tab} href=${place(tab)}
        aria-current=${panel.tab === tab ? "page" : null}>${label}</a>`)}</nav>
    <div class="panel-body" tabindex="0">
      ${panel.tab === "" && html`<${Overview} store=${store} func=${func} />`}
      ${panel.tab === "use" && html`<${Use} store=${store} func=${func} panel=${panel} act=${act} keep=${keep} />`}
      ${panel.tab === "explain" && html`<${Explain} store=${store} func=${func} />`}
    </div>`;
}

function Use({ store, func, panel, act, keep }) {
  const needs = (operation, to, part) => html`<${Right} store=${store} operations=${[operation]} name=${func.name} to=${to}>${part}</${Right}>`;
  if (func.service) return needs("call", "call it", html`<${Call} store=${store} name=${func.name} keep=${keep} />`);
  return html`
    ${func.inputs.length > 0 && needs("send", "send to it", html`<${Send} store=${store} func=${func} keep=${keep} />`)}
    ${func.outputs.length > 0 && needs("request", "watch it", html`<${Watch} store=${store} func=${func} panel=${panel} act=${act} keep=${keep} />`)}`;
}

function Overview({ store, func }) {
  const connections = store.system.connections.filter((other) => other.function === func.name);
  return html`
    <h3>Applications that use it</h3>
    ${connections.length === 0 && html`<p class="quiet">None at this moment.</p>`}
    <ul class="parts">${connections.map((other) => html`
      <li key=${other.id}><div class="part-head"><b>${nameOf(other)}</b><span>${other.state}</span>
        <span class="push">${rate(other.rate)}</span><${Kill} store=${store} connection=${other} /></div>
        ${holdersOf(other).map((holder) => html`<p class="hint">${holder}</p>`)}</li>`)}</ul>
    ${!func.service && html`<${Recordings} store=${store} name=${func.name} />`}
    ${/* Last: a cause that comes would move what is pressed below it. */ ""}
    <h3>Components, in the order in which they are tried</h3>
    <ul class="parts">${func.rows.map((row) => html`<${Part} key=${row.name} row=${row} />`)}</ul>`;
}

const Part = ({ row }) => html`
  <li><div class="part-head"><${Health} of=${row.health} word=${true} /><b>${row.name}</b>
      <span class="push"><${Framework} name=${row.bridge} recorded=${row.recorded} /></span></div>
    <${Facts} of=${[
      ["priority", String(row.priority)],
      ["takes from", (row.uses ?? []).join(", ")],
      ["rate", row.open ? rate(row.rate) : ""],
      ["last message", row.open ? lastMessage(row.age) : ""],
      ["received", row.open ? short(row.received) : ""],
      ["dropped", row.open ? short(row.lost) : ""],
      ["invalid", row.open ? short(row.invalid) : ""],
      ["raised on", row.open || row.failed ? short(row.failed) : ""],
      ["used by", row.users.join(", ")],
      ...row.commands.map((input) => [`input ${input.name}`, command(input)]),
    ]} />
    ${row.cause && html`<${Notice} kind="bad" title="Cause">${row.cause}</${Notice}>`}
    ${row.error && html`<${Notice} kind="warn" title="Last error">${row.error}</${Notice}>`}</li>`;

// What is nothing yet has its line, too: one that came with the first would move what is pressed below.
const lastMessage = (age) => (age === null ? "none yet" : `${span(age)} ago`);

/** What an input that moves something does, and who commands it. */
function command({ phase, left, lease }) {
  const lives = left == null ? phase : `${phase}, ${span(left)} left`;
  if (!lease) return lives;
  return `${lives}; lease: ${lease === "free" ? lease : `${lease.id}${lease.role && ` (${lease.role})`}`}`;
}

function ConnectionPanel({ store, panel }) {
  const connection = store.system.connections.find((other) => other.id === panel.name);
  if (!connection) return html`<${Gone} store=${store} what="connection" />`;
  const ends = new Set([`connection/${connection.id}`, ...connection.components.map(componentId)]);
  const routes = store.system.routes.filter((route) => ends.has(route.to));
  return html`<div class="panel-body" tabindex="0">
    <p><${Kill} store=${store} connection=${connection} /></p>
    <${Facts} of=${[...holdersOf(connection).map((holder) => ["held by", holder]), ["function", connection.function], ["state", connection.state],
      ["components", sayThrough(store.system, connection.components)], ["cause", connection.cause]]} />
    ${connection.error && html`<${Notice} kind="bad" title="The application">${connection.error}</${Notice}>`}
    <h3>Flows</h3>
    <ul class="parts">${routes.map((route) => html`<li key=${`${route.producer}>${route.consumer}`}>
      <div class="part-head"><b>${route.producer}</b><span>→ ${route.consumer}</span>
        <span class="push">${rate(route.rate)}</span></div>
      <${Facts} of=${[["received", short(route.received)], ["delivered", short(route.delivered)],
        ["last message", lastMessage(route.age)],
        ["dropped", route.dropped.map(([why, count]) => `${short(count)} ${why}`).join(", ") || "0"],
        ["invalid", short(route.invalid)]]} />
      ${route.last_error && html`<${Notice} kind="warn" title="Last error">${route.last_error}</${Notice}>`}
    </li>`)}</ul></div>`;
}

function BridgePanel({ store, panel }) {
  const live = store.system.bridges.find((other) => other.name === panel.name);
  const machine = store.system.machines.find((other) => other.bridges.includes(panel.name));
  const rows = store.system.functions.flatMap((func) => func.rows).filter((row) => row.bridge === panel.name);
  return html`<div class="panel-body" tabindex="0">
    <p><${Health} of=${live?.health ?? "idle"} word=${true} /></p>
    ${live && html`<${Facts} of=${[["plugin", live.plugin], ["open channels", short(live.open_channels)],
      ["machine", machine?.name ?? ""], ["process", live.process ?? ""]]} />`}
    ${live?.cause && html`<${Notice} kind="bad" title="Cause">${live.cause}</${Notice}>`}
    <h3>Components</h3><ul class="parts">${rows.map((row) => html`<${Part} key=${row.name} row=${row} />`)}</ul></div>`;
}

function MachinePanel({ store, panel }) {
  const machine = store.system.machines.find((other) => other.name === panel.name);
  if (!machine) return html`<${Gone} store=${store} what="machine" />`;
  const health = new Map(store.system.bridges.map((bridge) => [bridge.name, bridge.health]));
  return html`<div class="panel-body" tabindex="0">
    <p><${Health} of=${machine.health} word=${true} /></p>
    <${Facts} of=${[["clock", machine.clock_offset === null ? "" : offset(machine)]]} />
    ${machine.cause && html`<${Notice} kind="warn" title="Cause">${machine.cause}</${Notice}>`}
    <h3>Frameworks</h3>
    <ul class="parts">${machine.bridges.map((name) => html`<li key=${name}><div class="part-head">
      <${Health} of=${health.get(name) ?? "idle"} word=${true} /><span class="push"><${Framework} name=${name} /></span>
      </div></li>`)}</ul></div>`;
}

function offset({ clock_offset: seconds, clock_error: error }) {
  return `${span(Math.abs(seconds))} ${seconds < 0 ? "behind" : "ahead"}, give or take ${span(error)}`;
}

export const wordOf = (kind) => ({ connection: "application", bridge: "framework" })[kind] ?? kind;

export const BODIES = {
  function: FunctionPanel, connection: ConnectionPanel, bridge: BridgePanel, machine: MachinePanel,
};

const Gone = ({ store, what }) => html`<div class="panel-body" tabindex="0">${store.loaded
  ? html`<${Notice}>This ${what} is there no more.</${Notice}>` : html`<p class="quiet" role="status">Asking …</p>`}</div>`;
