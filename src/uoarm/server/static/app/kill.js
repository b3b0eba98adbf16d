// Ending a connection for everyone who uses it. Watching has a Stop of its own.

import { useState } from "../vendor/htm-preact.js";
import { html, Notice, Sure } from "./ui.js";

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
  return html`
    <${Sure} act=${kill} question="For everyone: sure?" label=${`Kill ${connection.id}`}>Kill</${Sure}>
    ${refusal && html`<${Notice} kind="bad">${refusal}</${Notice}>`}`;
}
