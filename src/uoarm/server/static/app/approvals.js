// What others ask for that this person may approve: with what it would do, and the decision.

import { exact, span } from "./format.js";
import { html, Notice, Sure } from "./ui.js";

/** What waits for a decision, the oldest first; nothing where there is none. */
export function Approvals({ store }) {
  const { waiting, trouble } = store.approvals;
  if (waiting.length === 0 && !trouble) return null;
  return html`
    <section class="approvals" aria-label="Approvals">
      ${trouble && html`<${Notice} kind="bad" title="Not decided">${trouble}</${Notice}>`}
      <ul>${waiting.map((asked) => html`<${Asked} key=${asked.approval} store=${store} of=${asked} />`)}</ul>
    </section>`;
}

/** Whether more than these very arguments, once, would be allowed. */
const allowsMore = (envelope) => envelope && (Object.keys(envelope.ranges).length > 0 || envelope.count > 1);

function Asked({ store, of }) {
  // The digest says which arguments were shown: with others nothing is approved.
  const decide = (approve) => store.decide(of.approval, { approve, digest: of.digest });
  const through = of.components.length > 0 && html` through ${of.components.join(", ")}`;
  return html`
    <li><div><p role="alert"><b>${of.requester}</b> asks to ${of.operation} <b>${of.function}${of.port && `.${of.port}`}</b>${through}
${" "}· ${span(of.left)} left to decide</p>
      ${of.preview && html`<p class="quiet">${of.preview}</p>`}
      <pre class="message" tabindex="0" aria-label="Arguments">${exact(of.arguments)}</pre>
      ${allowsMore(of.envelope) && html`<pre class="message" tabindex="0" aria-label="Also within">${exact(of.envelope)}</pre>`}</div>
      <div class="bar"><${Sure} act=${() => decide(true)} question="Confirm: approve"
          label=${`Approve what ${of.requester} asks for`}>Approve</${Sure}>
        <button type="button" class="button" onClick=${() => decide(false)}>Refuse</button></div></li>`;
}
