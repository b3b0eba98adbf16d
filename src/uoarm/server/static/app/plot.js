// Plots of the numbers in messages: axes with units, values under the cursor, a choice of fields and of time.

import { useEffect, useRef, useState } from "../vendor/htm-preact.js";
import Chart from "../vendor/uplot.js";
import { fine, labels, short, span } from "./format.js";
import { byUnit } from "./numbers.js";
import { usePlan } from "./plans.js";
import { html } from "./ui.js";

const WINDOWS = [5, 30, 120, 600];
const EVERY = 100; // milliseconds between two drawings
const AT_FIRST = 4; // lines
const HEIGHT = 190;
const LINES = 6; // colours
const FARTHEST = Number.MAX_VALUE / 4; // beyond it what lies between two values is no number
const SMALLER = 4; // is then what is drawn
// Between two marks of an axis: those of uPlot end at 5e32.
const STEPS = [...Array(616).keys()].flatMap((at) => [1, 2, 2.5, 5].map((part) => Number(`${part}e${at - 308}`)));

/** Args: a watch with its series, the output that it is of, the panel's options, and choose(options). */
export function Plots({ store, func, output, watch, options, choose }) {
  const { plan } = usePlan(store, func.name);
  const schema = plan?.steps.at(-1).structures[`output.${output}`]?.schema;
  const paths = [...watch.series.keys()];
  const moving = paths.filter((path) => watch.series.get(path).moves);
  const chosen = options.fields ? options.fields.split(",") : moving.slice(0, AT_FIRST);
  const seconds = Number(options.window) || 30;
  const [held, setHeld] = useState(0); // the time at which the plots stand; 0: they go on
  if (moving.length === 0 && !options.fields) return null;
  const toggle = (path) => choose({ fields: (chosen.includes(path) ? chosen.filter((other) => other !== path)
    : paths.filter((other) => other === path || chosen.includes(other))).join(",") });
  return html`
    <h3>Numbers</h3>
    <div class="bar">
      <label>Last <select value=${String(seconds)} onChange=${(event) => choose({ window: event.target.value })}>
        ${WINDOWS.map((length) => html`<option value=${String(length)}>${span(length)}</option>`)}</select></label>
      <button type="button" class="button small" aria-pressed=${held > 0}
        onClick=${() => setHeld(held ? 0 : store.watches.now())}>${held ? "Resume" : "Pause"}</button>
      <details class="fields"><summary>${chosen.length} of ${paths.length} fields</summary>
        <div class="fields-list">${paths.map((path) => html`<label key=${path}><input type="checkbox" checked=${chosen.includes(path)}
          onChange=${() => toggle(path)} /> ${path} <span class="hint">${short(watch.series.get(path).values.at(-1))}</span></label>`)}</div></details>
    </div>
    ${byUnit(chosen.filter((path) => watch.series.has(path)), schema).map(([unit, its]) => html`
      <${Plot} key=${`${unit} ${its.join()}`} store=${store} watch=${watch} unit=${unit} paths=${its} seconds=${seconds} held=${held} />`)}`;
}

/** Lines of one unit over the same time. The arrow keys move the cursor, whose values stand below. */
function Plot({ store, watch, unit, paths, seconds, held }) {
  const place = useRef(null);
  const given = useRef({});
  const scale = useRef(1);
  given.current = { seconds, held };
  useEffect(() => {
    const chart = new Chart(lookOf(place.current, unit, paths, scale), [[]], place.current);
    const draw = () => {
      if (document.hidden) return;
      const end = given.current.held || store.watches.now();
      const begin = end - given.current.seconds;
      let tables = paths.map((path) => watch.series.get(path).since(begin));
      const isFar = tables.some(([, values]) => values.some((value) => Math.abs(value) > FARTHEST));
      scale.current = isFar ? SMALLER : 1;
      if (isFar) {
        tables = tables.map(([times, values]) => [times,
          values.map((value) => (Number.isFinite(value) ? value / SMALLER : null))]);
      }
      chart.batch(() => {
        chart.setData(tables.length > 1 ? Chart.join(tables) : tables[0], false);
        chart.setScale("x", { min: begin, max: end });
      });
    };
    draw();
    const timer = setInterval(draw, EVERY);
    const width = new ResizeObserver(() => chart.setSize({ width: place.current.clientWidth, height: HEIGHT }));
    width.observe(place.current);
    return () => {
      clearInterval(timer);
      width.disconnect();
      chart.destroy();
    };
  }, [watch]);
  const keys = (event) => {
    const by = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
    const over = place.current.querySelector(".u-over");
    if (!by || !over) return;
    event.preventDefault();
    const at = Number(place.current.dataset.cursor ?? 1) + by;
    place.current.dataset.cursor = String(Math.min(1, Math.max(0, at)));
    const box = over.getBoundingClientRect();
    over.dispatchEvent(new MouseEvent("mousemove", { bubbles: true,
      clientX: box.left + box.width * Number(place.current.dataset.cursor), clientY: box.top + box.height / 2 }));
  };
  return html`<figure class="plot" tabindex="0" ref=${place} onKeyDown=${keys}
    aria-label=${`Plot of ${paths.join(", ")}${unit && ` in ${unit}`}; arrow keys move the cursor`}></figure>`;
}

/** How a chart looks: in the colours of the page, light or dark. */
function lookOf(place, unit, paths, scale) {
  const style = getComputedStyle(place);
  const colour = (name) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--soft"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 } };
  const value = (_, number) => (number == null ? "–" : `${fine(number * scale.current)}${unit && ` ${unit}`}`);
  return {
    width: place.clientWidth,
    height: HEIGHT,
    legend: { live: true },
    cursor: { drag: { x: false, y: false } },
    scales: { x: { time: true }, y: { range: (_, low, high) => padded(low, high) } },
    axes: [{ ...axis, space: 70, values: (_, times) => times.map((time) => clockOf(time)) },
      { ...axis, incrs: STEPS, label: unit || undefined, labelSize: 18,
        size: (_, texts) => Math.max(58, 20 + 7 * Math.max(0, ...(texts ?? []).map((text) => text.length))),
        values: (_, numbers) => labels(numbers.map((number) => number * scale.current)) }],
    series: [{ label: "time", value: (_, time) => (time == null ? "–" : clockOf(time, true)) },
      ...paths.map((path, at) => ({ label: path, stroke: colour(`--line-${at % LINES}`), width: 1.6, value, points: { show: false } }))],
  };
}

function padded(low, high) {
  if (low === null) return [0, 1];
  const room = (high - low) * 0.08 || Math.abs(high) * 0.1 || 1;
  return [low - room, high + room];
}

function clockOf(seconds, fine = false) {
  const date = new Date(seconds * 1000);
  const whole = date.toLocaleTimeString("en-GB", { hour12: false });
  return fine ? `${whole}.${String(date.getMilliseconds()).padStart(3, "0")}` : whole;
}
