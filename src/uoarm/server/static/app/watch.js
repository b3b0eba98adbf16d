// Watching a function: its latest message, its picture, and lines of its numbers.

import { useState } from "../vendor/htm-preact.js";
import { plural, pretty, rate, short } from "./format.js";
import { findPicture } from "./picture.js";
import { Picture } from "./pixels.js";
import { Spark } from "./spark.js";
import { Facts, html, Icon, Notice } from "./ui.js";

const PACES = [[0, "every message"], [0.1, "10 a second"], [0.5, "2 a second"], [2, "1 in 2 s"]];

export function Watch({ store, func, keep }) {
  const [output, setOutput] = useState(func.outputs[0]);
  const [every, setEvery] = useState(0.1);
  const [state, setState] = useState({ busy: false, refusal: "" });
  const name = output === "default" ? func.name : `${func.name}.${output}`;
  const watch = store.watches.byName.get(name);
  const running = Boolean(watch && !watch.end);

  const during = async (act) => {
    setState({ busy: true, refusal: "" });
    try {
      await act();
      setState({ busy: false, refusal: "" });
      await store.refresh();
    } catch (error) {
      setState({ busy: false, refusal: error.message });
    }
  };
  const begin = () => during(() => {
    keep();
    return store.watches.open(name, { every, queue: { length: every ? 4 : 200, policy: "drop-oldest" } });
  });
  const end = () => during(() => store.watches.close(name));

  return html`
    <div class="bar">
      ${running
        ? html`<button type="button" class="button" onClick=${end}><${Icon} name="stop" /> Stop</button>`
        : html`<button type="button" class="button main" disabled=${state.busy} onClick=${begin}>
            <${Icon} name="play" /> ${state.busy ? "One moment …" : "Watch"}</button>`}
      ${func.outputs.length > 1 && html`<label>Output <select value=${output} disabled=${running}
        onChange=${(event) => setOutput(event.target.value)}>${func.outputs.map((other) => html`
          <option value=${other}>${other}</option>`)}</select></label>`}
      <label>At most <select value=${String(every)} disabled=${running}
        onChange=${(event) => setEvery(Number(event.target.value))}>${PACES.map(([seconds, label]) => html`
          <option value=${String(seconds)}>${label}</option>`)}</select></label>
    </div>
    ${state.refusal && html`<${Notice} kind="bad" title="It was refused">${state.refusal}</${Notice}>`}
    ${watch && html`<${Shown} store=${store} watch=${watch} />`}`;
}

function Shown({ store, watch }) {
  const own = store.status.own.find((other) => other.connection === watch.connection);
  const picture = watch.latest === undefined ? null : findPicture(watch.latest);
  return html`
    ${watch.end && html`<${Notice} kind=${watch.end.state === "failed" ? "bad" : "info"}
      title=${watch.end.state === "failed" ? "It failed" : "It ended"}>${watch.end.cause || "closed"}</${Notice}>`}
    ${watch.away && html`<${Notice} kind="warn" title="Interrupted">The connection to the server broke.
      What is watched is opened again when it is back.</${Notice}>`}
    ${watch.note && html`<${Notice} kind="warn" title="A message could not be shown">${watch.note}</${Notice}>`}
    ${watch.warnings.map((warning) => html`<${Notice} kind="warn">${warning}</${Notice}>`)}
    <${Facts} of=${[
      ["shown", `${short(watch.taken)} (${rate(store.watches.rate(watch))})`],
      ["left out", own?.left_out ? short(own.left_out) : ""],
      ["dropped", own?.dropped ? short(own.dropped) : ""],
      ["interrupted", watch.gaps ? `${plural(watch.gaps, "time")}; what was missed is not known` : ""],
      ["through", watch.components.join(" → ")],
    ]} />
    ${picture && html`<${Picture} picture=${picture} />`}
    ${watch.latest === undefined && !watch.end && !watch.away && html`<p class="quiet" role="status">No message yet.</p>`}
    <${Lines} watch=${watch} />
    ${watch.latest !== undefined && html`<h3>Latest message</h3>
      <pre class="message" tabindex="0" aria-label="Latest message">${pretty(watch.latest)}</pre>`}`;
}

function Lines({ watch }) {
  const moving = [...watch.series].filter(([, line]) => line.values.some((value) => value !== line.values[0]));
  const [all, setAll] = useState(false);
  if (moving.length === 0) return null;
  const shown = all ? moving : moving.slice(0, 4);
  return html`<h3>Numbers</h3>
    <ul class="sparks">${shown.map(([path, line]) => html`<${Spark} key=${path} path=${path} line=${line} />`)}</ul>
    ${moving.length > 4 && html`<button type="button" class="button small" aria-expanded=${all}
      onClick=${() => setAll(!all)}>${all ? "Fewer" : `${plural(moving.length - 4, "more line")}`}</button>`}`;
}
