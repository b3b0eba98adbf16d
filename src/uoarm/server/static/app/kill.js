// What a role may do, and ending a connection for everyone who uses it. Watching has a Stop of its own.

import { useState } from "../vendor/htm-preact.js";
import { noun } from "./format.js";
import { html, Notice, Sure } from "./ui.js";

/** Whether the role of this page may do something with a function; where the server does not say, it is asked. Pure. */
export function mayDo(hello, operation, name) {
  if (!hello?.rights) return true;
  const rights = hello.rights[operation] ?? [];
  const escaped = (pattern) => pattern.replace(/[.+^${}()|[\]\\]/g, "\\$&").replaceAll("*", ".*").replaceAll("?", ".");
  return rights === "all" || rights.some((pattern) => new RegExp(`^${escaped(pattern)}$`).test(name));
}

/** What needs some rights on a function or, where the role lacks one, what gives it. */
export function Right({ store, operations, name, to, children }) {
  const missing = operations.filter((operation) => !mayDo(store.hello, operation, name));
  if (missing.length === 0) return children;
  const rights = missing.map((operation, at) => html`${at > 0 && " and "}<code>${operation}</code>`);
  return html`<p class="hint">To ${to}, a role needs the ${noun(missing.length, "right")} ${rights}; <code>uoarm token NAME --role ROLE</code> makes a token of such a role.</p>`;
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
  return html`<${Right} store=${store} operations=${["kill"]} name=${connection.function} to="kill it">
    <${Sure} act=${kill} question="Confirm: kill for everyone" label=${`Kill ${connection.id}`}>Kill</${Sure}>
    ${refusal && html`<${Notice} kind="bad">${refusal}</${Notice}>`}</${Right}>`;
}
