// Sending messages into a function's inputs, over a connection that this page has open.

import { useState } from "../vendor/htm-preact.js";
import { MessageForm } from "./message-form.js";
import { providerOf, usePlan } from "./plans.js";
import { html, Notice } from "./ui.js";

export function Send({ store, func, keep }) {
  const { plan, refusal } = usePlan(store, func.name);
  const [input, setInput] = useState(func.inputs[0]);
  const [answer, setAnswer] = useState(null);
  if (refusal) return html`<${Notice} kind="bad" title="Nothing can be sent now">${refusal.message}</${Notice}>`;
  if (!plan) return html`<p class="quiet">Asking …</p>`;
  const structure = providerOf(plan).structures[`input.${input}`];
  const send = async (message) => {
    setAnswer(null);
    keep();
    try {
      const connection = await openFor(store, func);
      await store.wire.ask("Data", `${connection}.${input}`, message);
      setAnswer({ text: "It was handed over." });
    } catch (error) {
      setAnswer({ error: error.message });
    }
  };
  return html`
    <h3>Send a message</h3>
    ${func.inputs.length > 1 && html`<label class="bar">Input <select value=${input}
      onChange=${(event) => setInput(event.target.value)}>${func.inputs.map((name) => html`
        <option value=${name}>${name}</option>`)}</select></label>`}
    ${structure && html`<${MessageForm} key=${input} schema=${structure.schema} act=${send} word="Send" />`}
    <div aria-live="polite">${answer && html`<${Notice} kind=${answer.error ? "bad" : "info"}>
      ${answer.error ?? answer.text}</${Notice}>`}</div>`;
}

/** The connection to send over: the one that is watched, else a new one. */
async function openFor(store, func) {
  const open = [...store.watches.byConnection.values()]
    .find((watch) => watch.name.split(".")[0] === func.name);
  const options = func.outputs.length > 0 ? { every: 0.1 } : { receive: false };
  return (open ?? (await store.watches.open(func.name, options))).connection;
}
