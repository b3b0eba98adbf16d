// The emergency stop: a button that asks nothing, and while all is held, who has stopped and the release.

import { span } from "./format.js";
import { html, Icon, Notice, Sure } from "./ui.js";

const LATE = 4000; // milliseconds; the server reports after two seconds at most

/** Every open input that moves something, and why it has not stopped where it has not. Pure. */
export function inputsOf(status) {
  return status.components.flatMap((component) => (component.channels ?? []).filter(({ command }) => command).map(
    ({ port, command }) => ({ name: `${component.name}.${port.split(".")[1]}`, of: component.function,
      stopped: command.held && command.phase === "stopped", since: command.since, cause: causeOf(command) })));
}

function causeOf({ held, phase, cause }) {
  if (cause) return cause;
  if (!held) return "it was not reached";
  return phase === "stopping" ? "it has not taken the stop message yet" : "it has no stop message; commands are refused";
}

/** The button; what the server refuses is said where it is asked. */
export function StopAll({ store }) {
  const stop = () => report(store, store.wire.ask("Stop"), "NOT STOPPED", true);
  return html`<button type="button" class="stop-all" onClick=${stop}><${Icon} name="stop" />Stop all</button>`;
}

/** Who has stopped and who has not; shown as long as commands are refused. */
export function Stopped({ store }) {
  const { held } = store.status;
  const trouble = store.trouble && html`<${Notice} kind="bad" title=${store.trouble.title}>${store.trouble.text}</${Notice}>`;
  if (held == null) return trouble && html`<section class="stopped" aria-label="Emergency stop">${trouble}</section>`;
  const release = () => report(store, store.wire.ask("Stop", "", { release: true }), "Not released", false);
  const inputs = inputsOf(store.status);
  const old = store.link === "open" ? "" : "Not connected: this is what was known last.";
  return html`
    <section class="stopped" aria-label="Emergency stop">
      <p role="alert"><b>Stopped.</b> Commands have been refused for ${span(held)}. ${old}</p>
      <ul>${inputs.map((input) => html`<li key=${input.name} class=${input.stopped ? "" : "bad"}>
        <b>${input.stopped ? "stopped" : "NOT STOPPED"}</b> ${input.name} (${input.of})${input.stopped ? `, ${span(input.since)} ago` : `: ${input.cause}`}</li>`)}
        ${inputs.length === 0 && html`<li>Nothing open moves.</li>`}</ul>
      <${Sure} act=${release} question="Confirm: everything may move again">Release</${Sure}>
      ${trouble}
    </section>`;
}

/** `holds` is what was asked for: a status that has it ends the trouble, also where another asked. */
async function report(store, asked, title, holds) {
  const say = (trouble) => {
    store.trouble = trouble;
    store.changed();
  };
  const late = setTimeout(say, LATE, { title, text: "The server has not answered yet.", holds });
  try {
    const report = await asked;
    clearTimeout(late);
    say(report?.unkept ? { title: "Not stopped after a restart", text: report.unkept } : null);
    await store.refresh();
  } catch (error) {
    clearTimeout(late);
    say({ title, text: error.message, holds });
  }
}
