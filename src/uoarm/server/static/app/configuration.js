// The configuration: what frameworks show, and the file's text, tried before it is applied.

import { useEffect, useMemo, useRef, useState } from "../vendor/htm-preact.js";
import { Difference, TextEditor } from "./editor.js";
import { noun, short } from "./format.js";
import { Facts, Framework, html, Notice } from "./ui.js";
import { problemsOf } from "./yaml.js";

const EVERY = 2000;
const PAUSE = 700; // milliseconds without a key after which a text is checked

/** What a search leaves of the bridges: whole ones by their name, else their components. Pure. */
export function narrowed(bridges, query) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  const has = (...texts) => words.every((word) => texts.join(" ").toLowerCase().includes(word));
  return bridges.map((bridge) => (has(bridge.bridge, bridge.plugin) ? bridge
    : { ...bridge, components: bridge.components.filter((component) => has(bridge.bridge, bridge.plugin, component.name, component.detail)) }))
    .filter((bridge) => words.length === 0 || bridge.components.length > 0 || has(bridge.bridge, bridge.plugin));
}

/** Whether something of a component is in no function yet. Pure. */
export const isFree = (component) => component.ports.some((port) => port.used_by.length === 0);

/** Args: the store, and what is searched. */
export function Configuration({ store, query }) {
  const [bridges, setBridges] = useState(null);
  const [trouble, setTrouble] = useState("");
  const [untaken, setUntaken] = useState(null); // a component, and why it could not be taken
  const [edited, setEdited] = useState(null);
  const [refusal, setRefusal] = useState("");
  const editor = useRef(null);
  useEffect(() => {
    let over = false;
    let timer;
    const look = async () => {
      try {
        const report = await store.wire.ask("Discover");
        if (over) return;
        setBridges(report.bridges);
        setTrouble("");
      } catch (error) {
        if (!over && error.code !== "closed") setTrouble(error.message); // the head of the page says that
      }
      if (!over) timer = setTimeout(look, EVERY);
    };
    if (store.link === "open") look();
    return () => {
      over = true;
      clearTimeout(timer);
    };
  }, [store.link]);
  const take = async (bridge, component) => {
    try {
      const { text } = await store.wire.ask("Discover", "", { take: { bridge, component } });
      setEdited(text);
      setUntaken(null);
      editor.current?.scrollIntoView({ block: "nearest" });
    } catch (error) {
      setUntaken({ bridge, component, cause: error.message });
    }
  };
  const found = narrowed(bridges ?? [], query);
  const spare = found.filter((bridge) => !bridge.configured);
  return html`
    <section class="configuration" aria-label="Configuration">
      ${refusal && html`<${Notice} kind="bad" title="The configuration is not shown"><pre>${refusal}</pre></${Notice}>`}
      <h2>What frameworks show</h2>
      ${trouble && html`<${Notice} kind="bad" title="Not shown">${trouble}</${Notice}>`}
      ${!bridges && !trouble && html`<p class="quiet" role="status">Asking the frameworks …</p>`}
      ${bridges && html`<ul class="found">${found.filter((bridge) => bridge.configured).map((bridge) => html`
        <${Bridge} key=${`${bridge.bridge} ${bridge.plugin}`} of=${bridge} take=${refusal ? null : take}
          untaken=${untaken?.bridge === bridge.bridge ? untaken : null} />`)}</ul>`}
      ${spare.length > 0 && html`<details class="spare"><summary>Installed plugins that no bridge is of: ${spare.map(({ plugin }) => plugin).join(", ")}</summary>
        <ul class="found">${spare.map((bridge) => html`<${Bridge} key=${bridge.plugin} of=${bridge} />`)}</ul></details>`}
      <div ref=${editor}><${Editor} store=${store} given=${edited} refused=${setRefusal} /></div>
    </section>`;
}

function Bridge({ of, take, untaken }) {
  const state = !of.configured ? "not configured" : of.cause ? `not reachable: ${of.cause}` : "reachable";
  const ports = of.components.reduce((sum, component) => sum + component.ports.length + component.more, 0);
  const count = `${of.components.length} ${noun(of.components.length, "component")}, ${ports} ${noun(ports, "port")}`;
  return html`
    <li class="found-bridge">
      <h3><${Framework} name=${of.bridge || of.plugin} /> <span class="quiet">${of.plugin}</span> <b>${state}</b>
        ${of.configured && !of.cause && html`<span class="quiet">${count}</span>`}</h3>
      <details><summary>What is installed</summary><${Facts} of=${Object.entries(of.facts)} /></details>
      <ul>${of.components.map((component) => html`<li key=${component.name} class="found-component">
        <b>${component.name}</b> <span class="quiet">${component.detail}</span>
        ${take && isFree(component) && html`<button type="button" class="button" onClick=${() => take(of.bridge, component.name)}>Add
          <span class="hidden"> ${component.name} as a function</span></button>`}
        ${untaken?.component === component.name && html`<${Notice} kind="bad" title="Not added">${untaken.cause}</${Notice}>`}
        <ul>${component.ports.map((port) => html`<li key=${`${port.role} ${port.address.join(" ")}`}>${port.role} ${port.address.join(", ")}
          ${!port.known && " (structure unknown)"}${port.rate !== null && `, ${short(port.rate)} a second${port.measured ? "" : ", as stated"}`}${port.used_by.length > 0 && `, used by ${port.used_by.join(", ")}`}</li>`)}</ul>
        ${component.more > 0 && html`<p>and ${component.more} ports more</p>`}</li>`)}</ul>
      ${of.more > 0 && html`<p>and ${of.more} components more</p>`}
      ${of.left_out > 0 && html`<p>and ${of.left_out} ports beyond the limit</p>`}
    </li>`;
}

/** The text in force, or one with something taken into it: first tried, then applied. Nothing where it is refused. */
function Editor({ store, given, refused }) {
  const [text, setText] = useState("");
  const [source, setSource] = useState({ text: "" }); // what the editor was given last; it goes on from there by itself
  const [force, setForce] = useState(null); // the text in force, its revision, and the schema of such texts
  const [tried, setTried] = useState(null); // the text that was looked at, and what would happen
  const [keep, setKeep] = useState(false);
  const [trouble, setTrouble] = useState("");
  const [checked, setChecked] = useState({ text: "", problems: [] }); // by line, as the robot found them
  const said = useRef(null);
  const ask = (message) => store.wire.ask("Configure", "", message);
  const inForce = async () => {
    const report = await store.wire.ask("Configure");
    return { text: report.configuration, revision: report.revisions.at(-1).revision };
  };
  const put = (wanted) => {
    setText(wanted);
    setSource({ text: wanted });
  };
  const load = async () => {
    try {
      const [{ schema }, current] = await Promise.all([ask({ schema: true }), inForce()]);
      setForce({ ...current, schema });
      put(current.text);
      setTried(null);
      setTrouble("");
      refused("");
    } catch (error) {
      if (force === null) refused(error.message);
      else setTrouble(error.message);
    }
  };
  const failed = (error, wanted) => {
    setTrouble(error.message);
    setChecked({ text: wanted, problems: problemsOf(error.message) });
  };
  const look = async (wanted) => {
    setTried(null);
    try {
      const current = await inForce();
      setForce({ ...force, ...current });
      setTried({ text: wanted, before: current.text, report: (await ask({ text: wanted, dry_run: true })).text });
      setChecked({ text: wanted, problems: [] });
      setTrouble("");
    } catch (error) {
      failed(error, wanted);
    }
  };
  const apply = async () => {
    try {
      const change = await ask({ text, revision: force.revision, ...(keep ? { keep } : {}) });
      setTried({ text, report: change.text, done: true });
      setForce({ ...force, text, revision: change.revision });
      setTrouble("");
      await store.refresh();
    } catch (error) {
      setTried(null);
      failed(error, text);
    }
  };
  useEffect(() => { // what is being edited stays when the connection comes back
    if (store.link === "open" && force === null) load();
  }, [store.link, force]);
  useEffect(() => {
    if (given === null) return;
    put(given);
    look(given);
  }, [given]);
  useEffect(() => { // mistakes show while one writes, where they are
    if (force === null || text === checked.text || text === force.text) return undefined;
    const timer = setTimeout(() => ask({ text, dry_run: true }).then(() => setChecked({ text, problems: [] }),
      (error) => setChecked({ text, problems: problemsOf(error.message) })), PAUSE);
    return () => clearTimeout(timer);
  }, [text, force, checked]);
  useEffect(() => { // below what was pressed
    if (tried || trouble) said.current.scrollIntoView({ block: "nearest" });
  }, [tried, trouble]);
  const problems = useMemo(() => (text === force?.text ? [] : checked.problems), [checked, text === force?.text]);
  if (force === null) return null;
  const isTried = tried !== null && tried.text === text && !tried.done;
  return html`
    <h2>The configuration <span class="quiet">revision ${force.revision}</span></h2>
    <${TextEditor} source=${source} change=${setText} problems=${problems} schema=${force.schema} label="Configuration, YAML" />
    <p class="hint">Ctrl+Space completes, pointing at a word explains it, Ctrl+F searches. Tab leaves the text, Ctrl+] indents.</p>
    <p class="editor-tools">
      <button type="button" class="button main" onClick=${() => look(text)}>Preview changes</button>
      <button type="button" class="button" disabled=${!isTried} onClick=${apply}>Apply</button>
      <label><input type="checkbox" checked=${keep} onChange=${(event) => setKeep(event.target.checked)} />
        write it to the robot's file</label>
      <button type="button" class="button" onClick=${load}>Reload</button>
    </p>
    <div ref=${said}>${tried && html`<${Notice} title=${tried.done ? "Done" : "Preview"}><pre>${tried.report}</pre></${Notice}>`}
    ${isTried && tried.text !== tried.before && html`<h3>What changes in the text</h3><${Difference} before=${tried.before} after=${tried.text} />`}
    ${trouble && html`<${Notice} kind="bad" title="Refused"><pre>${trouble}</pre></${Notice}>`}</div>`;
}
