// The configuration: what frameworks show, and the file's text, tried before it is applied.

import { useEffect, useRef, useState } from "../vendor/htm-preact.js";
import { noun } from "./format.js";
import { Facts, Framework, html, Notice } from "./ui.js";

const EVERY = 2000;

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
        if (!over) setTrouble(error.message);
      }
      if (!over) timer = setTimeout(look, EVERY);
    };
    look();
    return () => {
      over = true;
      clearTimeout(timer);
    };
  }, []);
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
  return html`
    <section class="configuration" aria-label="Configuration">
      ${refusal && html`<${Notice} kind="bad" title="The configuration is not shown"><pre>${refusal}</pre></${Notice}>`}
      <h2>What frameworks show</h2>
      ${trouble && html`<${Notice} kind="bad" title="Not shown">${trouble}</${Notice}>`}
      ${bridges && html`<ul class="found">${narrowed(bridges, query).map((bridge) => html`
        <${Bridge} key=${`${bridge.bridge} ${bridge.plugin}`} of=${bridge} take=${refusal ? null : take}
          untaken=${untaken?.bridge === bridge.bridge ? untaken : null} />`)}</ul>`}
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
        ${take && isFree(component) && html`<button type="button" class="button" onClick=${() => take(of.bridge, component.name)}>Take
          <span class="hidden"> ${component.name} into a function</span></button>`}
        ${untaken?.component === component.name && html`<${Notice} kind="bad" title="Not taken">${untaken.cause}</${Notice}>`}
        <ul>${component.ports.map((port) => html`<li key=${`${port.role} ${port.address.join(" ")}`}>${port.role} ${port.address.join(", ")}
          ${!port.known && " (structure unknown)"}${port.rate !== null && `, ${port.rate.toPrecision(3)} a second${port.measured ? "" : ", as stated"}`}${port.used_by.length > 0 && `, used by ${port.used_by.join(", ")}`}</li>`)}</ul>
        ${component.more > 0 && html`<p>and ${component.more} ports more</p>`}</li>`)}</ul>
      ${of.more > 0 && html`<p>and ${of.more} components more</p>`}
      ${of.left_out > 0 && html`<p>and ${of.left_out} ports beyond the limit</p>`}
    </li>`;
}

/** The text in force, or one with something taken into it: first tried, then applied. Nothing where it is refused. */
function Editor({ store, given, refused }) {
  const [text, setText] = useState("");
  const [revision, setRevision] = useState(null);
  const [tried, setTried] = useState(null); // the text that was looked at, and what would happen
  const [keep, setKeep] = useState(false);
  const [trouble, setTrouble] = useState("");
  const said = useRef(null);
  const ask = (message) => store.wire.ask("Configure", "", message);
  const load = async () => {
    try {
      const report = await store.wire.ask("Configure");
      setText(report.configuration);
      setRevision(report.revisions.at(-1).revision);
      setTrouble("");
      refused("");
    } catch (error) {
      if (revision === null) refused(error.message);
      else setTrouble(error.message);
    }
  };
  const look = async (wanted) => {
    setTried(null);
    try {
      const report = await store.wire.ask("Configure");
      setRevision(report.revisions.at(-1).revision);
      setTried({ text: wanted, report: (await ask({ text: wanted, dry_run: true })).text });
      setTrouble("");
    } catch (error) {
      setTrouble(error.message);
    }
  };
  const apply = async () => {
    try {
      const change = await ask({ text, revision, ...(keep ? { keep } : {}) });
      setTried({ text, report: change.text, done: true });
      setRevision(change.revision);
      setTrouble("");
      await store.refresh();
    } catch (error) {
      setTried(null);
      setTrouble(error.message);
    }
  };
  useEffect(() => { // what is being edited stays when the connection comes back
    if (store.link === "open" && revision === null) load();
  }, [store.link, revision]);
  useEffect(() => {
    if (given === null) return;
    setText(given);
    look(given);
  }, [given]);
  useEffect(() => { // below what was pressed
    if (tried || trouble) said.current.scrollIntoView({ block: "nearest" });
  }, [tried, trouble]);
  if (revision === null) return null;
  const isTried = tried !== null && tried.text === text && !tried.done;
  return html`
    <h2>The configuration <span class="quiet">revision ${revision}</span></h2>
    <label class="editor"><span class="hidden">Configuration, YAML</span>
      <textarea spellcheck=${false} rows="24" value=${text} onInput=${(event) => setText(event.target.value)}></textarea></label>
    <p class="editor-tools">
      <button type="button" class="button main" onClick=${() => look(text)}>Show what would happen</button>
      <button type="button" class="button" disabled=${!isTried} onClick=${apply}>Apply</button>
      <label><input type="checkbox" checked=${keep} onChange=${(event) => setKeep(event.target.checked)} />
        write it to the robot's file</label>
      <button type="button" class="button" onClick=${load}>Read again</button>
    </p>
    <div ref=${said}>${tried && html`<${Notice} title=${tried.done ? "Done" : "What would happen"}><pre>${tried.report}</pre></${Notice}>`}
    ${trouble && html`<${Notice} kind="bad" title="Refused"><pre>${trouble}</pre></${Notice}>`}</div>`;
}
