// Pictures, laser scans and grids of messages on the page, and what is drawn over them.

import { useEffect, useRef, useState } from "../vendor/htm-preact.js";
import { short } from "./format.js";
import { pixelsOf } from "./picture.js";
import { gridPixels, ringOf } from "./plane.js";
import { shapesOf } from "./shapes.js";
import { html } from "./ui.js";

/** Args: a picture, and messages whose boxes and points are drawn over it. */
export function Picture({ picture, over = [] }) {
  const [loaded, setLoaded] = useState(null); // of a compressed picture: only the browser knows its size
  const size = picture.url ? loaded : picture;
  const shapes = size ? over.flatMap((message) => shapesOf(message, size)) : [];
  const shown = picture.url
    ? html`<img src=${picture.url} alt="Latest picture"
        onLoad=${({ target }) => setLoaded({ width: target.naturalWidth, height: target.naturalHeight })} />`
    : html`<${Pixels} of=${picture} make=${pixelsOf} label=${`Latest picture, ${picture.width} by ${picture.height}`} />`;
  return html`<figure class="picture">${shown}${shapes.length > 0 && html`<${Shapes} of=${shapes} size=${size} />`}</figure>`;
}

function Pixels({ of, make, label }) {
  const canvas = useRef(null);
  useEffect(() => {
    const pixels = make(of);
    if (pixels) canvas.current.getContext("2d").putImageData(new ImageData(pixels, of.width, of.height), 0, 0);
  }, [of.data ?? of.cells]);
  return html`<canvas ref=${canvas} width=${of.width} height=${of.height} role="img" aria-label=${label}></canvas>`;
}

function Shapes({ of, size }) {
  const thick = Math.max(size.width, size.height) / 200;
  const letter = thick * 6;
  const label = of.map((shape) => `${shape.kind} ${shape.label}`.trim()).join(", ");
  return html`
    <svg class="shapes" viewBox=${`0 0 ${size.width} ${size.height}`} role="img" aria-label=${label} stroke-width=${thick}>
      ${of.map((shape) => (shape.kind === "box"
        ? html`<rect x=${shape.x} y=${shape.y} width=${Math.max(0, shape.width)} height=${Math.max(0, shape.height)} />`
        : html`<circle cx=${shape.x} cy=${shape.y} r=${thick * 1.5} />`))}
      ${of.filter((shape) => shape.label).map((shape) => html`<text x=${shape.x} y=${Math.max(letter, shape.y - thick * 2)}
        font-size=${letter} stroke-width=${thick * 1.6}>${shape.label}</text>`)}
    </svg>`;
}

const HALF = 200;

/** A scan from above: its origin in the middle, forward is up, rings say how far. */
export function Scan({ scan }) {
  const reach = scan.reach || 1;
  const scale = (HALF - 8) / reach;
  const ring = ringOf(reach);
  const rings = Array.from({ length: Math.min(6, Math.floor(reach / ring)) }, (_, at) => (at + 1) * ring);
  const dots = scan.points.map(([x, y]) => `M${(-y * scale).toFixed(1)} ${(-x * scale).toFixed(1)}h0`).join("");
  return html`<figure class="picture scan">
    <svg viewBox="-200 -200 400 400" role="img" aria-label=${`Scan: ${scan.points.length} of ${scan.all} beams see something, at most ${short(reach)} m away`}>
      ${rings.map((far) => html`<circle class="ring" r=${far * scale} /><text x="3" y=${4 - far * scale - 6}>${short(far)} m</text>`)}
      <path class="axis" d="M0 -196V196M-196 0H196" /><path class="dots" d=${dots} /><path class="self" d="M0 -9L6 7H-6Z" />
    </svg></figure>`;
}

/** An occupancy grid from above, x to the right and y upwards. */
export function Grid({ grid }) {
  const [wide, high] = [grid.width * grid.resolution, grid.height * grid.resolution];
  const label = `Grid of ${grid.width} by ${grid.height} cells`;
  return html`<figure class="picture grid"><${Pixels} of=${grid} make=${gridPixels} label=${label} />
    <figcaption>${short(wide)} × ${short(high)} m, cells of ${short(grid.resolution)} m, from (${short(grid.origin.x)}, ${short(grid.origin.y)})</figcaption></figure>`;
}
