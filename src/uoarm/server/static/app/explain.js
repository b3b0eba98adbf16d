// The resolution as a tree: what would run and on what it rests, what was passed over and why.

import { pretty } from "./format.js";
import { usePlan } from "./plans.js";
import { Framework, Health, html, Notice } from "./ui.js";

export function Explain({ store, func }) {
  const { plan, refusal, again } = usePlan(store, func.name);
  if (!plan && !refusal) return html`<p class="quiet">Asking …</p>`;
  return html`
    ${refusal && html`<${Notice} kind="bad" title="No plan fits">
      ${refusal.rejected ? "Every candidate was rejected; the reasons stand with each." : refusal.message}</${Notice}>`}
    <ul class="tree" aria-label=${`Resolution of ${func.name}`}>
      ${plan && html`<${Chosen} step=${plan.steps.at(-1)} plan=${plan} />`}
      ${(plan?.rejected ?? refusal?.rejected ?? []).map((other) => html`<${Rejected} of=${other} />`)}
      ${plan && untried(plan, func).map((row) => html`<${Untried} row=${row} />`)}
    </ul>
    ${plan?.warnings.map((text) => html`<${Notice} kind="warn">${text}</${Notice}>`)}
    <button type="button" class="button small" onClick=${again}>Refresh</button>`;
}

/** Candidates that were not looked at, because one before them fits. */
export function untried(plan, { name, components }) {
  const seen = new Set([plan.steps.at(-1).component.name]);
  for (const candidate of plan.rejected) if (candidate.function === name) seen.add(candidate.component);
  return components.filter((component) => !seen.has(component.name));
}

const Node = ({ look, mark, open, label, children }) => html`
  <li><details open=${open} class=${look}><summary><span class="tree-label"><${Health} of=${mark} />
    ${label}</span></summary>
    <div class="tree-body">${children}</div></details></li>`;

function Chosen({ step, plan, edge = null }) {
  const { component } = step;
  const edges = plan.edges.filter((edge) => edge.consumer === component.name);
  const label = html`<b>${component.function}</b> ${component.name} <${Framework} name=${component.bridge} />
    <span class="verdict">chosen, priority ${component.priority}</span>`;
  return html`<${Node} look="chosen" mark="ok" open=${true} label=${label}>
    ${edge && html`<${Fits} edge=${edge} />`}
    ${edges.length === 0 && html`<p class="quiet">It takes nothing from other functions.</p>`}
    ${edges.length > 0 && html`<ul>${edges.map((edge) => html`<${Chosen} edge=${edge} plan=${plan}
      step=${plan.steps.find((other) => other.component.name === edge.producer)} />`)}</ul>`}
    <${Structures} of=${step.structures} /></${Node}>`;
}

const Fits = ({ edge }) => html`
  <p><code>${edge.producer}.${edge.output}</code> → <code>${edge.consumer}.${edge.input}</code>, proven to fit${
    edge.mapping && " through a map"}.</p>
  ${edge.mapping && html`<pre class="message">${pretty(edge.mapping)}</pre>`}
  ${[...edge.losses.map((loss) => `allowed loss: ${loss}`), ...edge.warnings].map((text) => html`
    <${Notice} kind="warn">${text}</${Notice}>`)}`;

const Structures = ({ of }) => html`${Object.entries(of).map(([port, structure]) => html`
  <details class="structure"><summary>Structure of ${port}${structure.native_type && html` <code>${structure.native_type}</code>`}</summary>
    <pre class="message" tabindex="0">${pretty(structure.schema, { items: 200 })}</pre></details>`)}`;

function Rejected({ of }) {
  const label = html`<b>${of.function}</b> ${of.component} <span class="verdict">rejected, priority ${of.priority}</span>`;
  return html`<${Node} look="rejected" mark="lost" open=${true} label=${label}>
    ${of.reasons.map((reason) => html`<${Reason} of=${reason} />`)}
    ${of.because_of.length > 0 && html`<p class="quiet">because of</p>
      <ul>${of.because_of.map((cause) => html`<${Rejected} of=${cause} />`)}</ul>`}</${Node}>`;
}

const Reason = ({ of }) => html`
  <div class="reason"><p>${of.path && html`<code>${of.path}</code> `}${of.sentence}</p>
    <dl class="facts">
      ${of.producer && html`<div><dt>may emit</dt><dd class="clip" tabindex="0">${of.producer}</dd></div>`}
      ${of.consumer && html`<div><dt>takes</dt><dd class="clip" tabindex="0">${of.consumer}</dd></div>`}
      ${of.example !== null && html`<div><dt>counterexample</dt><dd><code>${pretty(of.example, { whole: 500 })}</code></dd></div>`}
    </dl>
    ${of.suggestion && html`<p class="hint">It would fit with:</p><pre class="message" tabindex="0">${of.suggestion}</pre>`}</div>`;

function Untried({ row }) {
  const label = html`${row.name} <${Framework} name=${row.bridge} />
    <span class="verdict">not tried, priority ${row.priority}</span>`;
  return html`<${Node} look="untried" mark="idle" open=${false} label=${label}>
    <p class="quiet">A candidate before it fits, so it was not looked at.</p></${Node}>`;
}
