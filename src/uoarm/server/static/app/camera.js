// The view onto the graph: what is shown of it and how large. Pure.

export const SMALLEST = 0.08;
export const LARGEST = 2;
const LINKED = 5;

const clamp = (scale) => Math.min(LARGEST, Math.max(SMALLEST, scale));

/** Zooms by a factor while the point (x, y) of the window stays where it is. */
export function zoom(camera, factor, x, y) {
  const scale = clamp(camera.scale * factor);
  const grown = scale / camera.scale;
  return { scale, x: x - (x - camera.x) * grown, y: y - (y - camera.y) * grown };
}

export const pan = (camera, dx, dy) => ({ ...camera, x: camera.x + dx, y: camera.y + dy });

/**
 * Shows the whole graph in the middle of the window, never larger than life. Where that would be
 * smaller than `least`, it shows the upper left part.
 */
export function fit(content, view, { margin = 24, below = 68, least = SMALLEST } = {}) {
  const wide = (view.width - 2 * margin) / Math.max(1, content.width);
  const high = (view.height - margin - below) / Math.max(1, content.height);
  const scale = clamp(Math.max(least, Math.min(1, wide, high)));
  return {
    scale,
    x: Math.max(margin, (view.width - content.width * scale) / 2),
    y: Math.max(margin, (view.height - below + margin - content.height * scale) / 2),
  };
}

/** Moves as little as needed to show a card whole. */
export function reveal(camera, place, card, view, margin = 24) {
  const shift = (start, size, room) => {
    if (start < margin) return margin - start;
    return Math.min(0, Math.max(room - margin - (start + size), margin - start));
  };
  const at = (value, offset) => value * camera.scale + offset;
  const dx = shift(at(place.x, camera.x), card.width * camera.scale, view.width);
  const dy = shift(at(place.y, camera.y), card.height * camera.scale, view.height);
  return pan(camera, dx, dy);
}

/** The nearest card from one in a direction ("ArrowLeft" ...), or undefined. Linked ones are nearer. */
export function neighbour(id, direction, cards, places, edges = []) {
  const linked = new Set(edges.flatMap(({ from, to }) => (from === id ? [to] : to === id ? [from] : [])));
  const middle = (card) => {
    const { x, y } = places.get(card.id);
    return { x: x + card.width / 2, y: y + card.height / 2 };
  };
  const here = middle(cards.find((card) => card.id === id));
  const sideways = direction === "ArrowLeft" || direction === "ArrowRight";
  const sign = direction === "ArrowLeft" || direction === "ArrowUp" ? -1 : 1;
  let [best, cost] = [undefined, Infinity];
  for (const card of cards) {
    const there = middle(card);
    const [dx, dy] = [there.x - here.x, there.y - here.y];
    const [along, across] = sideways ? [dx * sign, dy] : [dy * sign, dx];
    const far = (along + 3 * Math.abs(across)) / (sideways && linked.has(card.id) ? LINKED : 1);
    if (along > 1 && far < cost) [best, cost] = [card, far];
  }
  return best;
}
