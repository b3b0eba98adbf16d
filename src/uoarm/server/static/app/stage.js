// The window onto a plane: moved by pointer, wheel and pinch.

import { useEffect, useLayoutEffect, useState } from "../vendor/htm-preact.js";
import { fit, pan, zoom } from "./camera.js";
import { html } from "./ui.js";

const STILL = 4; // pixels that a finger may move and still press

/** The camera of a stage. It shows everything until someone moves it. */
export function useCamera(stage, layout) {
  const [camera, setCamera] = useState({ x: 0, y: 0, scale: 1 });
  const [moved, setMoved] = useState(false);
  const size = () => ({ width: stage.current.clientWidth, height: stage.current.clientHeight });
  const fitAll = () => {
    setMoved(false);
    setCamera(fit(layout, size()));
  };
  const change = (how) => {
    setCamera((now) => {
      const next = how(now);
      if (next.x !== now.x || next.y !== now.y || next.scale !== now.scale) setMoved(true);
      return next;
    });
  };
  const keepSeen = (how) => moved && setCamera(how); // while all is shown, nothing is out of sight
  const zoomBy = (factor) => change((now) => zoom(now, factor, size().width / 2, size().height / 2));
  useLayoutEffect(() => {
    if (!moved) setCamera(fit(layout, size()));
  }, [layout]);
  useEffect(() => {
    const watch = new ResizeObserver(() => !moved && setCamera(fit(layout, size())));
    watch.observe(stage.current);
    return () => watch.disconnect();
  }, [layout, moved]);
  return { camera, change, keepSeen, zoomBy, fitAll };
}

export function Stage({ stage, camera: { camera, change }, children }) {
  useEffect(() => listen(stage.current, change), []);
  const transform = `translate(${camera.x}px, ${camera.y}px) scale(${camera.scale})`;
  return html`<div class="stage ${camera.scale < 0.5 ? "far" : ""}" ref=${stage}>
    <div class="plane" style=${{ transform }}>${children}</div></div>`;
}

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
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    pointers.set(event.pointerId, now);
    travelled += Math.hypot(now.x - before.x, now.y - before.y);
    if (travelled < STILL) return;
    element.classList.add("moving");
    if (other) {
      const grown = distance(now, other) / Math.max(1, distance(before, other));
      change((camera) => zoom(camera, grown, other.x, other.y));
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

const distance = (one, other) => Math.hypot(one.x - other.x, one.y - other.y);
