// Where panels stand beside a view: several at once, moved and closed by pointer and keyboard.

import { useEffect, useLayoutEffect, useRef } from "../vendor/htm-preact.js";
import { dockOf, keyOf, withOptions } from "./address.js";
import { plural } from "./format.js";
import { BODIES, wordOf } from "./panel.js";
import { html, Icon } from "./ui.js";

const TYPING = "input, textarea, select, [contenteditable=true]";

/**
 * Args: the store, the address, which panel gets the keyboard, and `act`, which changes the panels: close(key),
 * closeAll(), move(key, by), change(key, change), widen(percent, done).
 */
export function Dock({ store, address, focus, act }) {
  const { panels, dock } = address;
  const own = useRef(null);
  const width = dock ? { width: `${dock}%` } : null;
  return html`
    <${Divider} dock=${dock} own=${own} widen=${act.widen} />
    <section class="dock ${panels.length > 2 ? "many" : ""}" aria-label="Panels" ref=${own} style=${width}>
      ${panels.length > 1 && html`<p class="dock-head"><span>${plural(panels.length, "panel")}</span>
        <button type="button" class="button small" onClick=${act.closeAll}>Close all</button></p>`}
      <div class="dock-panels">${panels.map((panel, at) => html`
        <${Panel} key=${keyOf(panel)} store=${store} address=${address} panel=${panel} act=${act}
          place=${{ at, of: panels.length }} focused=${focus === keyOf(panel)} />`)}</div>
    </section>`;
}

/** The line between a view and the panels: it is dragged, or moved by the arrow keys. */
function Divider({ dock, own, widen }) {
  const wide = () => (100 * own.current.clientWidth) / own.current.parentElement.clientWidth;
  const drag = (event) => {
    event.preventDefault();
    const line = event.currentTarget;
    const room = own.current.parentElement.getBoundingClientRect();
    const to = (moved) => dockOf((100 * (room.right - moved.clientX)) / room.width);
    const move = (moved) => widen(to(moved), false);
    const up = (moved) => {
      line.removeEventListener("pointermove", move);
      widen(to(moved), true);
    };
    line.setPointerCapture(event.pointerId);
    line.addEventListener("pointermove", move);
    line.addEventListener("lostpointercapture", up, { once: true });
  };
  const keys = (event) => {
    const by = { ArrowLeft: 4, ArrowRight: -4 }[event.key];
    if (!by) return;
    event.preventDefault();
    widen(dockOf(wide() + by), true);
  };
  return html`<div class="divider" role="separator" tabindex="0" aria-orientation="vertical" aria-label="Width of the panels"
    aria-valuenow=${dock || 30} aria-valuemin="20" aria-valuemax="80" onPointerDown=${drag} onKeyDown=${keys}></div>`;
}

function Panel({ store, address, panel, act, place, focused }) {
  const title = useRef(null);
  const key = keyOf(panel);
  useEffect(() => {
    if (!focused) return;
    title.current.focus({ preventScroll: true });
    title.current.closest(".panel").scrollIntoView({ block: "nearest" });
  }, [focused]);
  const moving = useRef(false);
  const move = (by) => {
    moving.current = true;
    act.move(key, by);
  };
  useLayoutEffect(() => { // an element that is put elsewhere loses the keyboard
    if (moving.current) title.current.focus();
    moving.current = false;
  }, [place.at]);
  const keys = (event) => {
    if (event.key === "Escape") return act.close(key);
    if (event.target.closest(TYPING) || event.ctrlKey || event.metaKey || event.altKey) return undefined;
    if (event.key === "[") return move(-1);
    return event.key === "]" ? move(1) : undefined;
  };
  const kept = Boolean(panel.options.keep);
  const keep = (on) => act.change(key, (of) => withOptions(of, { keep: on ? "1" : "" }));
  const Body = BODIES[panel.kind];
  const tool = (icon, label, press, more = {}) => html`<button type="button" class="tool small" aria-label=${label}
    title=${label} onClick=${press} ...${more}><${Icon} name=${icon} /></button>`;
  return html`
    <article class="panel" data-panel=${key} aria-labelledby=${`title-${key}`} onKeyDown=${keys}>
      <header class="panel-head">
        <div><p class="kind">${wordOf(panel.kind)}</p>
          <h2 id=${`title-${key}`} tabindex="-1" ref=${title}>${panel.name}</h2></div>
        <div class="panel-tools">
          ${place.at > 0 && tool("earlier", "Move before ([)", () => move(-1))}
          ${place.at < place.of - 1 && tool("later", "Move after (])", () => move(1))}
          ${tool("keep", kept ? "Kept open: others open beside it" : "Keep open", () => keep(!kept), { "aria-pressed": kept })}
          ${tool("close", "Close (Escape)", () => act.close(key))}
        </div>
      </header>
      <${Body} store=${store} address=${address} panel=${panel} act=${act} keep=${() => kept || keep(true)} />
    </article>`;
}
