// The frame around the views: what is connected, where one is, what is searched.

import { useEffect, useRef, useState } from "../vendor/htm-preact.js";
import { VIEWS, writeAddress } from "./address.js";
import { StopAll } from "./emergency.js";
import { noun } from "./format.js";
import { html, Icon } from "./ui.js";

const LINKS = { open: "live", opening: "connecting", closed: "reconnecting", locked: "locked" };
const NAMES = { graph: "Graph", list: "List", timeline: "Timeline", configuration: "Configuration" };

export function Header({ store, address, query, setQuery }) {
  const input = useRef(null);
  useEffect(() => {
    const press = (event) => {
      const [target] = event.composedPath(); // also inside the editor
      const typing = target.isContentEditable || /^(INPUT|TEXTAREA|SELECT)$/.test(target.tagName);
      if (event.key === "/" && !typing) {
        event.preventDefault();
        input.current.focus();
      }
    };
    window.addEventListener("keydown", press);
    return () => window.removeEventListener("keydown", press);
  }, []);
  return html`
    <header class="top">
      <a class="skip" href="#main" onClick=${skip}>Skip to the content</a>
      <h1><img src="icon.svg" alt="" width="26" height="26" /><span>uoarm</span></h1>
      <nav aria-label="Views">${VIEWS.map((view) => html`
        <a href=${writeAddress({ ...address, view: view })}
          aria-current=${address.view === view ? "page" : null}>${NAMES[view]}</a>`)}</nav>
      <label class="search"><${Icon} name="search" /><span class="hidden">Search</span>
        <input type="search" ref=${input} value=${query} placeholder="Search" aria-keyshortcuts="/" autocomplete="off" spellcheck=${false}
          onInput=${(event) => setQuery(event.target.value)} /><kbd aria-hidden="true">/</kbd></label>
      <p class="link-state ${store.link}" role="status"><span class="lamp" aria-hidden="true"></span>
        <span>${LINKS[store.link]}</span></p>
      ${store.link !== "locked" && html`<${StopAll} store=${store} />`}
    </header>`;
}

function skip(event) {
  event.preventDefault();
  document.querySelector("main").focus();
}

/** Counts over everything, and what narrows the view. */
export function Summary({ system, loaded, filter, setFilter }) {
  if (!loaded) return html`<div class="summary"><p role="status">Asking the robot what it has …</p></div>`;
  const rows = system.functions.flatMap((func) => func.rows);
  const running = rows.filter((row) => row.open).length;
  const lost = rows.filter((row) => row.health === "lost").length;
  const bridges = [...new Set(rows.map((row) => row.bridge))].sort();
  const toggle = (change) => setFilter({ ...filter, ...change });
  return html`
    <div class="summary">
      <p><span><b>${system.functions.length}</b> ${noun(system.functions.length, "function")}</span>
        <span><b>${running}</b> of ${rows.length} components running</span>
        <span><b>${system.connections.length}</b> ${noun(system.connections.length, "application")}</span>
        ${lost > 0 && html`<span class="bad"><b>${lost}</b> lost</span>`}</p>
      <div class="chips" role="group" aria-label="Filter">
        <button type="button" class="chip" aria-pressed=${filter.running}
          onClick=${() => toggle({ running: !filter.running })}>Running</button>
        ${bridges.length > 1 && bridges.map((bridge) => html`
          <button type="button" class="chip" key=${bridge} aria-pressed=${filter.bridge === bridge}
            onClick=${() => toggle({ bridge: filter.bridge === bridge ? "" : bridge })}>${bridge}</button>`)}
      </div>
    </div>`;
}

/** Asks for the token where the server wants one. */
export function Lock({ unlock, tried }) {
  const [token, setToken] = useState("");
  const send = (event) => {
    event.preventDefault();
    unlock(token.trim());
  };
  return html`
    <form class="lock" onSubmit=${send}>
      <h2>This server needs a token</h2>
      <p>Its operator makes one with <code>uoarm token</code>. It stays in this tab.</p>
      <label>Token <input type="password" autocomplete="off" required value=${token}
        onInput=${(event) => setToken(event.target.value)} /></label>
      ${tried && html`<p class="bad" role="alert">The server did not accept that token.</p>`}
      <button class="button main">Connect</button>
    </form>`;
}
