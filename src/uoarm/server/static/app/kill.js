// Ending a connection for everyone who uses it. Watching has a Stop of its own.

import { useState } from "../vendor/htm-preact.js";
import { html, Notice, Sure } from "./ui.js";

/** Whether the role of this page may do something with a function; where the server does not say, it is asked. Pure. */
export function mayDo(hello, operation, name) {
  if (!hello?.rights) return true;
  const rights = hello.rights[operation] ?? [];
  const escaped = (pattern) => pattern.replace(/[.+^${}()|[\]\\]/g, "\\$&").replaceAll("*", ".*").replaceAll("?", ".");
  return rights === "all" || rights.some((pattern) => new RegExp(`^${escaped(pattern)}$`).test(name));
}

export function Kill({ store, connection }) {
  const [refusal, setRefusal] = useState("");
  const kill = async () => {
    try {
      await store.wire.ask("Kill", connection.id, { everyone: true });
      await store.refresh();
    } catch (error) {
      setRefusal(error.message);
    }
  };
  if (connection.state === "closed" || connection.state === "failed") return null;
  if (!mayDo(store.hello, "kill", connection.function)) {
    return html`<p class="hint">To kill it, a role needs the right <code>kill</code>; <code>uoarm token NAME --role ROLE</code> makes a token of such a role.</p>`;
  }
  return html`
    <${Sure} act=${kill} question="Confirm: kill for everyone" label=${`Kill ${connection.id}`}>Kill</${Sure}>
    ${refusal && html`<${Notice} kind="bad">${refusal}</${Notice}>`}`;
}
