// One number's line over the last messages.

import { short } from "./format.js";
import { traced } from "./numbers.js";
import { html } from "./ui.js";

export function Spark({ path, line }) {
  const values = line.values;
  const [low, high] = [Math.min(...values), Math.max(...values)];
  return html`<li><span class="spark-name" title=${path}>${path}</span><b>${short(values.at(-1))}</b>
    <svg class="spark" viewBox="-1 -6 102 112" preserveAspectRatio="none"
      role="img" aria-label=${`${path} between ${short(low)} and ${short(high)}`}><path d=${traced(line)} /></svg>
    <span class="hint">${short(low)} … ${short(high)}</span></li>`;
}
