// A whole message of a schema, with the button that sends it.

import { useEffect, useMemo, useRef, useState } from "../vendor/htm-preact.js";
import { Field } from "./form.js";
import { gather, start } from "./schema.js";
import { html } from "./ui.js";

export function MessageForm({ schema, act, word, busy = false }) {
  const first = useMemo(() => start(schema, schema), [schema]);
  const [draft, setDraft] = useState(first);
  const [problems, setProblems] = useState([]);
  const [wrong, setWrong] = useState(0);
  const form = useRef(null);
  useEffect(() => form.current.querySelector("[aria-invalid=true]")?.focus(), [wrong]);
  const change = (next) => {
    setDraft(next);
    if (problems.length > 0) setProblems(gather(schema, schema, next).problems);
  };
  const send = (event) => {
    event.preventDefault();
    const found = gather(schema, schema, draft);
    setProblems(found.problems);
    if (found.problems.length === 0) act(found.value);
    else setWrong(wrong + 1);
  };
  return html`
    <form class="form" ref=${form} onSubmit=${send} noValidate>
      <${Field} schema=${schema} root=${schema} draft=${draft} change=${change} problems=${problems} />
      <button class="button main" disabled=${busy}>${busy ? "Waiting …" : word}</button>
    </form>`;
}
