// The graph: cards and edges on a plane that one can move over.

import { useLayoutEffect, useMemo, useRef, useState } from "../vendor/htm-preact.js";
import { neighbour } from "./camera.js";
import { Card } from "./card.js";
import { bridgesOf, concerns, makeCards, makeEdges } from "./cards.js";
import { Edges } from "./edges.js";
import { layOut } from "./layout.js";
import { Stage, useCamera } from "./stage.js";
import { MANY } from "./system.js";
import { html, Icon } from "./ui.js";

const FOLDING = ["function", "manager"];

/** Args: the joined system, what the search found, which cards have a panel, which managers are unfolded, `unfold` changes that. */
export function Graph({ system, shown, panels, select, searching, unfolded, unfold }) {
  const [folds, setFolds] = useState(new Map());
  const [frameworks, setFrameworks] = useState(false);
  const [focused, setFocused] = useState("");
  const [pointed, setPointed] = useState(""); // the card of a framework or machine whose functions stand out
  const many = shown.reduce((total, func) => total + func.rows.length, 0) > MANY;
  const folded = (name) => folds.get(name) ?? many;
  const cards = makeCards(system, shown, { folded, frameworks, unfolded: (name) => searching || unfolded.includes(name) });
  const edges = makeEdges(system, cards);
  const shape = shapeOf(cards, edges);
  const stage = useRef(null);
  const layout = useMemo(() => layOut(cards, edges, { aspect: aspectOf(window) }), [shape]);
  const camera = useCamera(stage, layout, cards.findLast((card) => card.id === panels.at(-1)));

  const lit = [pointed, focused, ...panels].map((id) => cards.find((card) => card.id === id && bridgesOf(card))).find(Boolean);

  const fold = (card) => (card.kind === "manager" ? unfold(card.title) : setFolds(new Map(folds).set(card.title, !card.folded)));
  const foldAll = (all) => setFolds(new Map(shown.map((func) => [func.name, all])));
  const allFolded = shown.length > 0 && shown.every((func) => folded(func.name));
  const stop = cards.some((card) => card.id === focused) ? focused : cards[0]?.id;

  const focus = (card) => {
    setFocused(card.id);
    stage.current.querySelector(`[data-title="${CSS.escape(card.id)}"]`)?.focus({ preventScroll: true });
    camera.keepSeen(card);
  };
  const keys = (event) => {
    const at = event.target.closest("[data-card]")?.dataset.card;
    const card = cards.find((card) => card.id === at);
    const act = keyAction(event, { card, cards, edges, layout, camera, fold, focus });
    if (act) {
      event.preventDefault();
      act();
    }
  };
  useLayoutEffect(camera.follow, [shown.map((func) => func.name).join()]);

  const plane = html`
    <${Edges} cards=${cards} edges=${edges} layout=${layout} />
    ${cards.map((card) => html`<${Card} key=${card.id} card=${card} place=${layout.places.get(card.id)}
      selected=${panels.includes(card.id)}
      dim=${lit && !concerns(card, bridgesOf(lit))} stop=${card.id === stop} select=${select} fold=${fold} />`)}`;
  return html`
    <section class="graph" aria-label="Graph of the system" onKeyDown=${keys}
      onPointerOver=${(event) => frameworks && setPointed(event.target.closest("[data-card]")?.dataset.card ?? "")}
      onFocusIn=${(event) => setFocused(event.target.dataset.title ?? focused)}>
      <${Stage} stage=${stage}>${plane}</${Stage}>
      ${cards.length === 0 && html`<p class="empty">Nothing is found.</p>`}
      <div class="graph-tools" role="toolbar" aria-label="Graph">
        <${Tool} icon="plus" label="Zoom in (+)" act=${() => camera.zoomBy(1.25)} />
        <${Tool} icon="minus" label="Zoom out (-)" act=${() => camera.zoomBy(0.8)} />
        <${Tool} icon="fit" label="Fit to view (0)" act=${camera.fitAll} />
        <button type="button" class="tool text" onClick=${() => foldAll(!allFolded)}>
          ${allFolded ? "Unfold all" : "Fold all"}</button>
        <button type="button" class="tool text" aria-pressed=${frameworks}
          onClick=${() => setFrameworks(!frameworks)}>Frameworks</button>
      </div>
      <p class="graph-help">Arrows move · Enter opens · F folds · + − 0 zoom</p>
    </section>`;
}

const Tool = ({ icon, label, act }) => html`<button type="button" class="tool" title=${label}
  aria-label=${label} onClick=${act}><${Icon} name=${icon} /></button>`;

function keyAction(event, { card, cards, edges, layout, camera, fold, focus }) {
  if (event.ctrlKey || event.metaKey || event.altKey) return null;
  if (event.key === "+" || event.key === "=") return () => camera.zoomBy(1.25);
  if (event.key === "-") return () => camera.zoomBy(0.8);
  if (event.key === "0") return camera.fitAll;
  if (!card) return null;
  if (event.key.toLowerCase() === "f" && FOLDING.includes(card.kind)) return () => fold(card);
  if (!event.key.startsWith("Arrow")) return null;
  const next = neighbour(card.id, event.key, cards, layout.places, edges);
  return () => next && focus(next);
}

/** How wide a layout is to be for its height: the same whether panels are open or not, so that cards stay. */
const aspectOf = ({ innerWidth, innerHeight }) => innerWidth / Math.max(200, innerHeight - 120);

/** What makes a new layout needed: which cards there are, how high, and what joins them. */
function shapeOf(cards, edges) {
  const sizes = cards.map((card) => `${card.id}:${card.height}`);
  return [...sizes, ...edges.map((edge) => `${edge.kind}${edge.id}`)].join("\n");
}
