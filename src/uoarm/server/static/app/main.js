// The page: one store, one address, the views.

import { render, useEffect, useMemo, useState } from "../vendor/htm-preact.js";
import { keyOf, KINDS, readAddress, withChange, withMove, withoutPanel, withPanel, withToggled, writeAddress } from "./address.js";
import { Approvals } from "./approvals.js";
import { Configuration } from "./configuration.js";
import { Dock } from "./dock.js";
import { Stopped } from "./emergency.js";
import { Graph } from "./graph.js";
import { List } from "./list.js";
import { Header, Lock, Summary } from "./shell.js";
import { Store } from "./store.js";
import { search } from "./system.js";
import { Timeline } from "./timeline.js";
import { html } from "./ui.js";

const NARROW = "(max-width: 700px)";
const NARROWED = new Set(["graph", "list"]); // by search and filter, and by what runs
const ANSWER = 5000; // milliseconds
const KEPT = "uoarm.token";

function App({ store }) {
  useVersion(store);
  const [address, read, go] = useAddress();
  const [query, setQuery] = useState("");
  const [filter, setFilter] = useState({ running: false, bridge: "" });
  const shown = useMemo(() => search(store.system.functions, query, filter), [store.system, query, filter]);
  const [focus, setFocus] = useState("");
  const act = panelActs(read, go, setFocus);
  const selected = address.panels.map(keyOf).join("&");
  const open = act.open;
  const select = ({ kind, title, data }, beside) =>
    open(kind === "manager" ? "bridge" : kind, { connection: data?.id, bridge: data?.name }[kind] ?? title, beside);
  const unfold = (name) => go({ ...read(), unfolded: withToggled(read().unfolded, name) }, { replace: true });
  const follow = (kind, name) => {
    const owner = kind === "component" && store.functions.find((func) => func.components.some((part) => part.name === name));
    if (owner) open("function", owner.name);
    else if (KINDS.includes(kind)) open(kind, name);
  };
  const given = { system: store.system, shown, panels: address.panels.map(keyOf), select };
  const groups = { searching: query.trim() !== "", unfolded: address.unfolded, unfold };
  const view = useMemo(() => {
    if (!NARROWED.has(address.view) || !store.loaded) return null;
    return address.view === "list" ? html`<${List} ...${given} />` : html`<${Graph} ...${given} ...${groups} />`;
  }, [store.system, store.loaded, shown, selected, address.view, address.unfolded.join()]);

  return html`
    <${Header} store=${store} address=${address} query=${query} setQuery=${setQuery} />
    ${store.link !== "locked" && html`<${Stopped} store=${store} /><${Approvals} store=${store} />`}
    <main id="main" tabindex="-1" class=${selected ? "with-panels" : ""}>
      ${store.link === "locked"
        ? html`<${Lock} tried=${store.wire.token !== ""} unlock=${(token) => unlock(store, token)} />`
        : html`
          <div class="view">
            ${NARROWED.has(address.view) && html`<${Summary} system=${store.system} loaded=${store.loaded} filter=${filter} setFilter=${setFilter} />`}
            ${address.view === "configuration" && html`<${Configuration} store=${store} query=${query} />`}
            ${address.view === "timeline" && html`<${Timeline} events=${store.events} since=${store.since} query=${query}
              owners=${store.owners} session=${store.hello?.session} open=${follow} />`}
            ${view}
          </div>
          ${address.panels.length > 0 && html`<${Dock} store=${store} address=${address} focus=${focus} act=${act} />`}`}
    </main>`;
}

function useVersion(store) {
  const [, setVersion] = useState(0);
  useEffect(() => store.listen(setVersion), []);
}

function useAddress() {
  const read = () => readAddress(location.hash, matchMedia(NARROW).matches ? "list" : "graph");
  const [address, setAddress] = useState(read);
  useEffect(() => {
    const changed = () => setAddress(read());
    window.addEventListener("hashchange", changed);
    return () => window.removeEventListener("hashchange", changed);
  }, []);
  const go = (next, { replace = false } = {}) => {
    if (!replace) location.hash = writeAddress(next); // a step that one can go back
    else {
      history.replaceState(null, "", writeAddress(next));
      setAddress(next);
    }
  };
  return [address, read, go];
}

/** What changes the panels, as the address has them then; `setFocus` says which of them gets the keyboard. */
function panelActs(read, go, setFocus) {
  const put = (change, how) => go({ ...read(), panels: change(read().panels) }, how);
  return {
    open: (kind, name, beside = false) => {
      put((panels) => withPanel(panels, { kind, name }, beside));
      setFocus("");
      requestAnimationFrame(() => setFocus(keyOf({ kind, name })));
    },
    close: (key) => {
      put((panels) => withoutPanel(panels, key));
      giveBack(key);
    },
    closeAll: () => {
      const [first] = read().panels;
      put(() => []);
      giveBack(keyOf(first));
    },
    move: (key, by) => put((panels) => withMove(panels, key, by), { replace: true }),
    change: (key, change) => put((panels) => withChange(panels, key, change), { replace: true }),
    widen: (dock) => go({ ...read(), dock }, { replace: true }),
  };
}

/** Gives the keyboard back to where a panel was opened. */
function giveBack(key) {
  const name = key.slice(key.indexOf("/") + 1);
  const opener = `[data-title="${CSS.escape(key)}"], [data-item="${CSS.escape(name)}"]`;
  document.querySelector(opener)?.focus({ preventScroll: true });
}

function unlock(store, token) {
  sessionStorage.setItem(KEPT, token);
  store.unlock(token);
}

/** Whether the server wants a token, or another one: a browser hides why a WebSocket was refused. */
async function isLocked(token) {
  const headers = token ? { Authorization: `Bearer ${token}` } : {};
  try {
    const signal = AbortSignal.timeout(ANSWER);
    return (await fetch("metrics", { headers, signal })).status === 401;
  } catch {
    return false; // the server is away
  }
}

const url = new URL(".", location.href);
url.protocol = url.protocol.replace("http", "ws");
url.hash = "";
const store = new Store(url.href, { isLocked });
store.unlock(sessionStorage.getItem(KEPT) ?? "");
render(html`<${App} store=${store} />`, document.getElementById("page"));
