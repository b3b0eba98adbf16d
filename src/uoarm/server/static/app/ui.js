// Small pieces of markup that every view uses.

import { html, useEffect, useState } from "../vendor/htm-preact.js";

export { html };

const WORDS = {
  ok: "ok", degraded: "degraded", finished: "finished", lost: "lost", idle: "not running",
};

/** A health as a shape and a colour; the word is there for those who see neither. */
export const Health = ({ of, word = false }) => html`
  <span class="health ${of}"><svg viewBox="0 0 12 12" aria-hidden="true"><path d=${SHAPES[of]} /></svg>
  <span class=${word ? "" : "hidden"}>${WORDS[of]}</span></span>`;

const SHAPES = {
  ok: "M6 1a5 5 0 1 0 0 10a5 5 0 1 0 0-10z",
  degraded: "M6 1L11.5 11H.5z",
  finished: "M1.5 1.5h9v9h-9z",
  lost: "M2.2.8L6 4.6 9.8.8 11.2 2.2 7.4 6l3.8 3.8-1.4 1.4L6 7.4 2.2 11.2.8 9.8 4.6 6 .8 2.2z",
  idle: "M6 1.2a4.8 4.8 0 1 0 0 9.6a4.8 4.8 0 1 0 0-9.6zm0 1.6a3.2 3.2 0 1 1 0 6.4a3.2 3.2 0 1 1 0-6.4z",
};

/** A framework's name with a colour of its own, the same everywhere. */
export const Framework = ({ name, recorded = false }) =>
  html`<span class="framework hue${hueOf(name)}">${name}${recorded && html` <b class="recorded">recorded</b>`}</span>`;

export function hueOf(name) {
  let sum = 0;
  for (const letter of name) sum = (sum * 31 + letter.codePointAt(0)) % 8191;
  return sum % 8;
}

const PATHS = {
  search: "M7 2a5 5 0 1 0 0 10A5 5 0 1 0 7 2zM11 11l4 4",
  close: "M3 3l10 10M13 3L3 13",
  plus: "M8 3v10M3 8h10",
  minus: "M3 8h10",
  fit: "M2 6V2h4M10 2h4v4M14 10v4h-4M6 14H2v-4",
  fold: "M4 6l4 4 4-4",
  unfold: "M6 4l4 4-4 4",
  keep: "M8 10v4.5M4.5 10h7M5.5 2h5M6.5 2v4l-2 4M9.5 2v4l2 4",
  earlier: "M10 3L5 8l5 5",
  later: "M6 3l5 5-5 5",
  record: "M8 3.5a4.5 4.5 0 1 0 0 9a4.5 4.5 0 1 0 0-9z",
  play: "M4.5 2.5v11l9-5.5z",
  stop: "M3.5 3.5h9v9h-9z",
};

export const Icon = ({ name }) =>
  html`<svg class="icon" viewBox="0 0 16 16" aria-hidden="true"><path d=${PATHS[name]} /></svg>`;

export const Notice = ({ kind = "info", title, children }) => html`
  <div class="notice ${kind}" role=${kind === "bad" ? "alert" : "status"}>
    ${title && html`<strong>${title}</strong>`}<div>${children}</div>
  </div>`;

/** Names and values, one under the other. */
export const Facts = ({ of }) => html`
  <dl class="facts">${of.filter(([, value]) => value !== "" && value !== null).map(([name, value]) => html`
    <div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>`;

/** Whether what is pressed is to open beside what is open. */
export const isBeside = (event) => event.ctrlKey || event.metaKey || event.shiftKey;

/** A button that asks once more before it does what cannot be undone. */
export function Sure({ children, question, act, label = "" }) {
  const [asking, setAsking] = useState(false);
  useEffect(() => {
    if (!asking) return undefined;
    const timer = setTimeout(() => setAsking(false), 5000);
    return () => clearTimeout(timer);
  }, [asking]);
  const press = () => {
    setAsking(!asking);
    if (asking) act();
  };
  return html`<button type="button" class="button bad" aria-label=${asking ? null : label || null}
    onClick=${press}>${asking ? question : children}</button>`;
}
