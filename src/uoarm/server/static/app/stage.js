// The window onto a plane: moved by pointer, wheel and pinch.

import { useLayoutEffect, useRef } from "../vendor/htm-preact.js";
import { fit, pan, reveal, zoom } from "./camera.js";
import { html } from "./ui.js";

const FAR = 0.5; // below this scale small print is left out
const STILL = 4; // pixels that a finger may move and still press

/** On a phone the graph begins large enough to be read, and in part. */
const legible = () => (window.innerWidth < 700 ? { least: 0.6, margin: 14 } : {});

/**
 * The camera of a stage. It shows everything until a user moves it, however much room panels leave;
 * after that it keeps its scale, and the card that was chosen last in sight. It moves the plane itself: nothing is rendered again,
 * however much there is.
 */
export function useCamera(stage, layout, chosen) {
  const state = useRef({ now: { x: 0, y: 0, scale: 1 }, moved: false }).current;
  const size = () => ({ width: stage.current.clientWidth, height: stage.current.clientHeight });
  const put = (camera) => {
    state.now = camera;
    const { x, y, scale } = camera;
    stage.current.firstElementChild.style.transform = `translate(${x}px, ${y}px) scale(${scale})`;
    stage.current.classList.toggle("far", scale < FAR);
  };
  const keepSeen = (card) => put(reveal(state.now, layout.places.get(card.id), card, size()));
  const settle = () => {
    if (!state.moved) put(fit(layout, size(), legible()));
    else if (chosen) keepSeen(chosen);
  };
  const change = (how) => {
    state.moved = true;
    put(how(state.now));
  };
  const zoomBy = (factor) => change((now) => zoom(now, factor, size().width / 2, size().height / 2));
  const fitAll = () => {
    state.moved = false;
    put(fit(layout, size()));
  };
  const follow = () => {
    state.moved = false;
    settle();
  };
  useLayoutEffect(() => {
    settle();
    const watch = new ResizeObserver(settle);
    watch.observe(stage.current);
    return () => watch.disconnect();
  }, [layout, chosen?.id]);
  useLayoutEffect(() => listen(stage.current, change), []);
  return { change, keepSeen, zoomBy, fitAll, follow };
}

export const Stage = ({ stage, children }) =>
  html`<div class="stage" ref=${stage}><div class="plane">${children}</div></div>`;

/** Makes a stage follow pointers and the wheel; returns what ends that. */
function listen(element, change) {
  const pointers = new Map();
  let travelled = 0;
  const place = (event) => {
    const box = element.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  };
  const down = (event) => {
    if (event.button !== 0) return;
    if (pointers.size === 0) travelled = 0;
    pointers.set(event.pointerId, place(event));
  };
  const move = (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = place(event);
    const finger = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    pointers.set(event.pointerId, now);
    travelled += Math.hypot(now.x - before.x, now.y - before.y);
    if (travelled < STILL) return;
    element.classList.add("moving");
    if (finger) {
      const grown = distance(now, finger) / Math.max(1, distance(before, finger));
      change((camera) => zoom(camera, grown, finger.x, finger.y));
    } else {
      change((camera) => pan(camera, now.x - before.x, now.y - before.y));
    }
  };
  const up = (event) => {
    pointers.delete(event.pointerId);
    if (pointers.size === 0) element.classList.remove("moving");
  };
  const click = (event) => {
    if (event.detail > 0 && travelled >= STILL) event.stopPropagation(); // the end of a drag
  };
  const wheel = (event) => {
    event.preventDefault();
    const { x, y } = place(event);
    change((camera) => zoom(camera, Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), x, y));
  };
  element.addEventListener("pointerdown", down);
  element.addEventListener("wheel", wheel, { passive: false });
  element.addEventListener("click", click, { capture: true });
  window.addEventListener("pointermove", move);
  window.addEventListener("pointerup", up);
  window.addEventListener("pointercancel", up);
  return () => {
    element.removeEventListener("pointerdown", down);
    element.removeEventListener("wheel", wheel);
    element.removeEventListener("click", click, { capture: true });
    window.removeEventListener("pointermove", move);
    window.removeEventListener("pointerup", up);
    window.removeEventListener("pointercancel", up);
  };
}

const distance = (start, end) => Math.hypot(start.x - end.x, start.y - end.y);
