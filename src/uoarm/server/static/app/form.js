// A form generated from a JSON Schema; what it holds is a draft, see schema.js.

import { useMemo } from "../vendor/htm-preact.js";
import { isThere, nameOf, nodeOf, start } from "./schema.js";
import { html, Icon } from "./ui.js";

/** Args: the schema and its root, the draft, change(draft), problems by path. */
export function Field({ schema, root, draft, change, problems, name = "", path = "" }) {
  const node = useMemo(() => nodeOf(schema, root), [schema, root]);
  const parts = { object: Fields, list: Items, variants: Variants };
  const Inside = parts[node.kind];
  const given = { node, root, draft, change, problems, path, name };
  if (Inside) {
    if (!name && node.kind === "object") return html`<${Inside} ...${given} />`;
    return html`<fieldset><legend>${name || "message"}</legend>
      ${node.title && html`<p class="hint">${node.title}</p>`}<${Inside} ...${given} />
      ${node.kind !== "variants" && html`<${Problem} of=${problems} path=${path} />`}</fieldset>`;
  }
  const id = `field-${path || "message"}`;
  return html`
    <div class="field">
      <label for=${id}>${name || "message"} <span class="hint">${hint(node)}</span></label>
      <${Simple} id=${id} invalid=${problems.some((problem) => problem.path === path)} ...${given} />
      ${node.title && html`<p class="hint">${node.title}</p>`}
      <${Problem} of=${problems} path=${path} />
    </div>`;
}

function Problem({ of, path }) {
  const found = of.filter((problem) => problem.path === path);
  return found.length > 0 && html`<p class="problem" id=${`problem-${path || "message"}`}>${found.map((item_) => item_.text).join("; ")}</p>`;
}

function hint({ kind, minimum, maximum, names }) {
  const bounds = [minimum, maximum].some((bound) => bound !== undefined)
    ? `${minimum ?? "−∞"} … ${maximum ?? "∞"}` : "";
  const word = { octets: "file", flag: "", choice: "", fixed: "", json: "JSON" }[kind] ?? kind;
  return [word, bounds, names ? "or NaN" : ""].filter(Boolean).join(", ");
}

function Simple({ node, id, draft, change, invalid, path }) {
  const wrong = { "aria-invalid": invalid ? "true" : null,
    "aria-describedby": invalid ? `problem-${path || "message"}` : null };
  const text = (event) => change(event.target.value);
  switch (node.kind) {
    case "flag":
      return html`<input id=${id} type="checkbox" checked=${draft} onChange=${(event) => change(event.target.checked)} />`;
    case "choice":
      return html`<select id=${id} value=${String(draft)} onChange=${(event) => change(Number(event.target.value))}>
        ${node.options.map((option, at) => html`<option value=${String(at)}>${String(option)}</option>`)}</select>`;
    case "fixed":
      return html`<output id=${id}>${JSON.stringify(node.value)}</output>`;
    case "octets":
      return html`<input id=${id} type="file" onChange=${(event) => readFile(event.target.files[0], change)} />
        ${draft && html`<p class="hint">${Math.floor((draft.length * 3) / 4)} octets</p>`}`;
    case "json":
      return html`<textarea id=${id} rows="4" spellcheck=${false} value=${draft} onInput=${text} ...${wrong}></textarea>`;
    case "text":
      return html`<input id=${id} type="text" value=${draft} onInput=${text} ...${wrong} />`;
    default:
      return html`<input id=${id} type="text" inputmode=${node.minimum < 0 || node.minimum === undefined ? null : "decimal"}
        value=${draft} onInput=${text} ...${wrong} />`;
  }
}

function readFile(file, change) {
  if (!file) return change("");
  const reader = new FileReader();
  reader.onload = () => change(reader.result.slice(reader.result.indexOf(",") + 1));
  return reader.readAsDataURL(file);
}

function Fields({ node, root, draft, change, problems, path }) {
  const there = Object.keys(node.fields).filter((name) => isThere(draft, name));
  const absent = Object.keys(node.fields).filter((name) => !isThere(draft, name));
  const set = (name, value) => change({ ...draft, [name]: value });
  return html`
    ${there.map((name) => html`
      <div class="optional" key=${name}>
        <${Field} schema=${node.fields[name]} root=${root} draft=${draft[name]} name=${name}
          path=${path ? `${path}.${name}` : name} problems=${problems} change=${(value) => set(name, value)} />
        ${!node.required.includes(name) && html`<${Less} what=${name} act=${() => set(name, undefined)} />`}
      </div>`)}
    ${absent.map((name) => html`<${More} key=${name} what=${name}
      act=${() => set(name, start(node.fields[name], root))} />`)}
    ${there.length + absent.length === 0 && html`<p class="quiet">The message has no fields.</p>`}`;
}

function Items({ node, root, draft, change, problems, path }) {
  const set = (at, value) => change(draft.map((item, place) => (place === at ? value : item)));
  return html`
    ${draft.map((item, at) => html`
      <div class="optional" key=${at}>
        <${Field} schema=${node.items} root=${root} draft=${item} name=${String(at)} problems=${problems}
          path=${path ? `${path}.${at}` : String(at)} change=${(value) => set(at, value)} />
        ${draft.length > node.least && html`<${Less} what=${`item ${at}`}
          act=${() => change(draft.filter((_, place) => place !== at))} />`}
      </div>`)}
    ${draft.length < (node.most ?? 1000) && html`<${More} what="Add item" act=${() => change([...draft, start(node.items, root)])} />`}`;
}

function Variants({ node, root, draft, change, problems, path }) {
  const choose = (at) => change({ at, draft: start(node.branches[at], root) });
  return html`
    <select aria-label="Variant" value=${String(draft.at)} onChange=${(event) => choose(Number(event.target.value))}>
      ${node.branches.map((branch, at) => html`<option value=${String(at)}>${nameOf(branch, root)}</option>`)}</select>
    <${Field} key=${draft.at} schema=${node.branches[draft.at]} root=${root} draft=${draft.draft} name="value"
      path=${path} problems=${problems} change=${(value) => change({ ...draft, draft: value })} />`;
}

const More = ({ what, act }) => html`<button type="button" class="button small" onClick=${act}>
  <${Icon} name="plus" /> ${what}</button>`;
const Less = ({ what, act }) => html`<button type="button" class="tool small" aria-label=${`Remove ${what}`}
  title=${`Remove ${what}`} onClick=${act}><${Icon} name="close" /></button>`;
