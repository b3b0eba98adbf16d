// One number's line, drawn by uPlot.

import { useEffect, useRef } from "../vendor/htm-preact.js";
import uPlot from "../vendor/uplot.js";
import { short } from "./format.js";
import { html } from "./ui.js";

const HEIGHT = 44;

export function Spark({ path, line }) {
  const place = useRef(null);
  const plot = useRef(null);
  useEffect(() => {
    const color = getComputedStyle(place.current).getPropertyValue("color");
    plot.current = new uPlot(options(place.current.clientWidth, color), [[], []], place.current);
    const watch = new ResizeObserver(() => plot.current.setSize({ width: place.current.clientWidth, height: HEIGHT }));
    watch.observe(place.current);
    return () => {
      watch.disconnect();
      plot.current.destroy();
    };
  }, []);
  useEffect(() => plot.current.setData([line.times, line.values]));
  const values = line.values;
  const [low, high] = [Math.min(...values), Math.max(...values)];
  return html`<li><span class="spark-name" title=${path}>${path}</span><b>${short(values.at(-1))}</b>
    <div class="spark" ref=${place} role="img" aria-label=${`${path} between ${short(low)} and ${short(high)}`}></div>
    <span class="hint">${short(low)} … ${short(high)}</span></li>`;
}

const options = (width, color) => ({
  width,
  height: HEIGHT,
  pxAlign: false,
  cursor: { show: false },
  select: { show: false },
  legend: { show: false },
  scales: { x: { time: false } },
  axes: [{ show: false }, { show: false }],
  padding: [3, 2, 3, 2],
  series: [{}, { stroke: color, width: 1.5, points: { show: false } }],
});
