// Calling a service: a form for the request, and the reply.

import { useState } from "../vendor/htm-preact.js";
import { pretty, span } from "./format.js";
import { providerOf, usePlan } from "./plans.js";
import { MessageForm } from "./message-form.js";
import { html, Notice } from "./ui.js";

export function Call({ store, name, keep }) {
  const { plan, refusal } = usePlan(store, name);
  const [answer, setAnswer] = useState(null);
  const [busy, setBusy] = useState(false);
  if (refusal) return html`<${Notice} kind="bad" title="It cannot be called now">${refusal.message}</${Notice}>`;
  if (!plan) return html`<p class="quiet">Asking …</p>`;
  const { component, structures } = providerOf(plan);
  const call = async (message) => {
    setBusy(true);
    keep();
    const begun = performance.now();
    const took = () => (performance.now() - begun) / 1000;
    try {
      const reply = await store.wire.ask("Call", name, message);
      setAnswer({ reply, took: took() });
    } catch (error) {
      setAnswer({ error: error.message, took: took() });
    }
    setBusy(false);
  };
  return html`
    <p class="quiet">Provided by <b>${component.name}</b> (${component.bridge}).</p>
    <${MessageForm} schema=${structures.request.schema} act=${call} busy=${busy} word="Call" />
    <div aria-live="polite">
      ${answer?.error && html`<${Notice} kind="bad" title=${`Refused after ${span(answer.took)}`}>${answer.error}</${Notice}>`}
      ${answer && !answer.error && html`<h3>Reply <span class="hint">after ${span(answer.took)}</span></h3>
        <pre class="message" tabindex="0">${pretty(answer.reply)}</pre>`}
    </div>`;
}
