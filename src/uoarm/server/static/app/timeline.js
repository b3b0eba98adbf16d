// What happened, newest first.

import { useState } from "../vendor/htm-preact.js";
import { clock } from "./format.js";
import { html } from "./ui.js";

const KINDS = [["connection", "Applications"], ["component", "Components"], ["bridge", "Frameworks"]];
const SAID = { connection: "application", bridge: "framework" };
const BAD = new Set(["lost", "failed"]);
const QUIET = new Set(["opening", "closed", "finished"]);
const UNSURE = new Set(["degraded", "waiting", "closing"]);
const SHOWN = 300;

/** How grave a change is: "lost", "degraded", "finished" or "ok". */
export function gravity(change) {
  if (BAD.has(change)) return "lost";
  if (UNSURE.has(change)) return "degraded";
  return QUIET.has(change) ? "finished" : "ok";
}

/** Kind and name of what changed: "component camera". */
export function subjectOf({ subject }) {
  const at = subject.indexOf(" ");
  return at < 0 ? { kind: "", name: subject } : { kind: subject.slice(0, at), name: subject.slice(at + 1) };
}

/** What is said of a change, and why. A connection that was closed without a cause was killed by whom it is of. */
export function saidOf({ subject, change, cause }, session = "") {
  if (change !== "closed" || !subject.startsWith("connection ")) return { word: change, cause };
  if (!cause) return { word: "killed", cause: "by its own program" };
  if (!cause.startsWith("killed ")) return { word: change, cause };
  const own = session && cause.startsWith(`killed by session ${session}`);
  return { word: "killed", cause: own ? "by this page" : cause.slice("killed ".length) };
}

/** The newest events that a search and a choice of kinds leave. */
export function filterEvents(events, { query = "", kind = "", bad = false }) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  return events.filter((event) => {
    const text = `${event.subject} ${event.change} ${saidOf(event).word} ${event.cause}`.toLowerCase();
    const kindFits = !kind || subjectOf(event).kind === kind;
    return kindFits && (!bad || gravity(event.change) === "lost") && words.every((word) => text.includes(word));
  }).slice(-SHOWN).reverse();
}

/** Args: the events, since when, what is searched, whose a connection was, the page's session, and open(kind, name). */
export function Timeline({ events, since, query, owners, session, open }) {
  const [kind, setKind] = useState("");
  const [bad, setBad] = useState(false);
  const shown = filterEvents(events, { query, kind, bad });
  const choice = (name, label) => html`<button type="button" class="chip" aria-pressed=${kind === name}
    onClick=${() => setKind(name)}>${label}</button>`;
  return html`
    <section class="timeline" aria-label="Timeline">
      <div class="chips" role="group" aria-label="Filter by kind">
        ${choice("", "All")}${KINDS.map(([kind, label]) => choice(kind, label))}
        <button type="button" class="chip" aria-pressed=${bad} onClick=${() => setBad(!bad)}>Losses only</button>
      </div>
      ${shown.length === 0 && html`<p class="empty">No such events since ${clock(since)}.
        Changes of connections, components and frameworks appear here.</p>`}
      <ol>${shown.map((event) => html`<${Event} key=${event.number} of=${event} owner=${owners.get(subjectOf(event).name)} session=${session} open=${open} />`)}</ol>
    </section>`;
}

function Event({ of, owner, session, open }) {
  const { kind, name } = subjectOf(of);
  const { word, cause } = saidOf(of, session);
  return html`
    <li class="event ${gravity(of.change)}">
      <time datetime=${of.at.toISOString()}>${clock(of.at)}</time>
      <span class="event-dot" aria-hidden="true"></span>
      <div><span class="kind">${SAID[kind] ?? kind}</span> <button type="button" class="link" onClick=${() => open(kind, name)}>
        ${name}</button> ${(owner || kind === "connection") && html`<span class="quiet">${owner ?? of.function}</span>`} <b class="change">${word}</b>
        ${cause && html`<p>${cause}</p>`}</div>
    </li>`;
}
