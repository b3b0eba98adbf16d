// A picture of a message on the page.

import { useEffect, useRef } from "../vendor/htm-preact.js";
import { pixelsOf } from "./picture.js";
import { html } from "./ui.js";

export function Picture({ picture }) {
  const canvas = useRef(null);
  useEffect(() => {
    if (picture.url) return;
    const pixels = pixelsOf(picture);
    if (!pixels) return;
    canvas.current.getContext("2d").putImageData(new ImageData(pixels, picture.width, picture.height), 0, 0);
  }, [picture.url, picture.data]);
  const shown = picture.url
    ? html`<img src=${picture.url} alt="Latest picture" />`
    : html`<canvas ref=${canvas} width=${picture.width} height=${picture.height} role="img"
        aria-label=${`Latest picture, ${picture.width} by ${picture.height}`}></canvas>`;
  return html`<figure class="picture">${shown}</figure>`;
}
