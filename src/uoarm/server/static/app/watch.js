// Watching a function: its latest message, its picture or scan, and plots of its numbers.

import { useEffect, useState } from "../vendor/htm-preact.js";
import { keyOf, withOptions } from "./address.js";
import { plural, pretty, rate, short, span } from "./format.js";
import { findPicture } from "./picture.js";
import { Grid, Picture, Scan } from "./pixels.js";
import { findGrid, findScan } from "./plane.js";
import { Plots } from "./plot.js";
import { pairOf } from "./shapes.js";
import { sayThrough } from "./system.js";
import { Facts, html, Icon, Notice } from "./ui.js";

const PACES = [[0, "every message"], [0.1, "10 a second"], [0.5, "2 a second"], [2, "1 in 2 s"]];

export function Watch({ store, func, panel, act, keep }) {
  const choose = (options) => act.change(keyOf(panel), (of) => withOptions(of, options));
  const output = func.outputs.includes(panel.options.output) ? panel.options.output : func.outputs[0];
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
  const end = () => during(async () => {
    await store.watches.close(name);
    await store.watches.closeOverlay(name);
  });

  return html`
    <div class="bar">
      ${running
        ? html`<button type="button" class="button" onClick=${end}><${Icon} name="stop" /> Stop</button>`
        : html`<button type="button" class="button main" disabled=${state.busy} onClick=${begin}>
            <${Icon} name="play" /> ${state.busy ? "Starting …" : "Watch"}</button>`}
      ${func.outputs.length > 1 && html`<label>Output <select value=${output} disabled=${running}
        onChange=${(event) => choose({ output: event.target.value })}>${func.outputs.map((other) => html`
          <option value=${other}>${other}</option>`)}</select></label>`}
      <label>Maximum rate <select value=${String(every)} disabled=${running}
        onChange=${(event) => setEvery(Number(event.target.value))}>${PACES.map(([seconds, label]) => html`
          <option value=${String(seconds)}>${label}</option>`)}</select></label>
    </div>
    ${state.refusal && html`<${Notice} kind="bad" title="Refused">${state.refusal}</${Notice}>`}
    ${watch && html`<${Shown} store=${store} func=${func} output=${output} watch=${watch} options=${panel.options} choose=${choose} />`}`;
}

function Shown({ store, func, output, watch, options, choose }) {
  const own = store.status.own.find((other) => other.connection === watch.connection);
  const { latest } = watch;
  const through = sayThrough(store.system, watch.components);
  const picture = latest === undefined ? null : findPicture(latest);
  const [scan, grid] = latest === undefined ? [] : [findScan(latest), findGrid(latest)];
  return html`
    ${watch.end && html`<${Notice} kind=${watch.end.state === "failed" ? "bad" : "info"}
      title=${{ failed: "It failed", killed: "It was killed" }[watch.end.word] ?? "It ended"}>${watch.end.cause || "It has no more messages."}</${Notice}>`}
    ${watch.away && html`<${Notice} kind="warn" title="Interrupted">The connection to the server broke.
      What is watched is opened again when it is back.</${Notice}>`}
    ${through.includes("(recorded)") && !watch.end && html`<${Notice} kind="warn" title="Recorded">What is shown comes from a recording, not from the robot as it is now.</${Notice}>`}
    ${watch.note && html`<${Notice} kind="warn" title="A message could not be shown">${watch.note}</${Notice}>`}
    ${watch.warnings.map((warning) => html`<${Notice} kind="warn">${warning}</${Notice}>`)}
    ${picture && html`<${Overlaid} store=${store} watch=${watch} picture=${picture} chosen=${options.overlay ?? ""} choose=${choose} />`}
    ${scan && html`<${Scan} scan=${scan} />`}
    ${grid && html`<${Grid} grid=${grid} />`}
    ${watch.latest === undefined && !watch.end && !watch.away && html`<p class="quiet" role="status">No message yet.</p>`}
    <${Plots} store=${store} func=${func} output=${output} watch=${watch} options=${options} choose=${choose} />
    <${Facts} of=${[
      ["shown", `${short(watch.taken)} (${rate(store.watches.rate(watch))})`],
      ["left out", own?.left_out ? short(own.left_out) : ""],
      ["dropped", own?.dropped ? short(own.dropped) : ""],
      ["interrupted", watch.gaps ? `${plural(watch.gaps, "time")}; what was missed is not known` : ""],
      ["through", through],
    ]} />
    ${watch.latest !== undefined && html`<h3>Latest message</h3>
      <pre class="message" tabindex="0" aria-label="Latest message">${pretty(watch.latest)}</pre>`}`;
}

/** A picture, and over it the boxes and points of its own message and of a function that is chosen. */
function Overlaid({ store, watch, picture, chosen, choose }) {
  const [refusal, setRefusal] = useState("");
  const names = store.functions.filter((func) => !func.service).flatMap((func) =>
    func.outputs.map((output) => (output === "default" ? func.name : `${func.name}.${output}`)));
  useEffect(() => {
    if (watch.end) return;
    setRefusal("");
    store.watches.overlay(watch.name, names.includes(chosen) ? chosen : "").catch((error) => setRefusal(error.message));
  }, [watch, chosen]);
  const over = store.watches.byName.get(chosen);
  const pair = over ? pairOf(watch.recent, over.recent) : null;
  const messages = pair ? [pair.picture, pair.overlay] : [watch.latest, ...(over?.latest === undefined ? [] : [over.latest])];
  const apart = Math.abs(pair?.apart ?? 0) > 0.0005 ? `${chosen} is ${span(Math.abs(pair.apart))} ${pair.apart < 0 ? "older" : "newer"} than the picture` : "";
  return html`
    <div class="bar"><label>Overlay <select value=${chosen} onChange=${(event) => choose({ overlay: event.target.value })}>
      <option value="">none</option>
      ${names.filter((name) => name !== watch.name).map((name) => html`<option value=${name}>${name}</option>`)}</select></label>${apart && html`<span class="hint">${apart}</span>`}</div>
    ${refusal && html`<${Notice} kind="bad" title=${`${chosen} cannot be drawn`}>${refusal}</${Notice}>`}
    <${Picture} picture=${pair ? findPicture(pair.picture) ?? picture : picture} over=${messages} />`;
}
