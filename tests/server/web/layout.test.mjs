import assert from "node:assert/strict";
import { test } from "node:test";
import { fit, neighbour, reveal, zoom } from "../../../src/uoarm/server/static/app/camera.js";
import { layOut } from "../../../src/uoarm/server/static/app/layout.js";

const card = (id) => ({ id, width: 100, height: 40 });
const edge = (from, to, kind = "uses") => ({ id: `${from}>${to}`, from, to, kind });
const boxes = (cards, { places }) => cards.map((card) => ({ ...places.get(card.id), ...card }));

function overlapping(found) {
  const meet = (a, b) => a.x < b.x + b.width && b.x < a.x + a.width && a.y < b.y + b.height && b.y < a.y + a.height;
  return found.flatMap((box, at) => found.slice(at + 1).filter((other) => meet(box, other)));
}

test("cards stand in the direction of flow and none on another", () => {
  const cards = Array.from({ length: 60 }, (_, at) => card(`n${at}`));
  const edges = cards.slice(1, 40).map((card, at) => edge(`n${Math.floor(at / 2)}`, card.id, "flows"));
  const found = layOut(cards, edges);
  assert.deepEqual(overlapping(boxes(cards, found)), []);
  for (const edge of edges) assert.ok(found.places.get(edge.from).x < found.places.get(edge.to).x, edge.id);
});

test("frameworks stand in a column before everything else", () => {
  const cards = [...["a", "b", "c"].map(card), { ...card("x"), kind: "bridge" }, { ...card("y"), kind: "bridge" }];
  const found = layOut(cards, [edge("a", "b"), edge("x", "a", "runs"), edge("y", "c", "runs")]);
  const left = (id) => found.places.get(id).x;
  assert.deepEqual([left("x"), left("y")], [0, 0]);
  assert.ok(["a", "b", "c"].every((id) => left(id) > 100));
  assert.deepEqual(overlapping(boxes(cards, found)), []);
});

test("machines stand in a column before frameworks", () => {
  const cards = [card("a"), { ...card("x"), kind: "bridge" }, { ...card("m"), kind: "machine" }, { ...card("n"), kind: "machine" }];
  const found = layOut(cards, [edge("x", "a", "runs"), edge("m", "x", "runs")]);
  const left = (id) => found.places.get(id).x;
  assert.deepEqual([left("m"), left("n")], [0, 0]);
  assert.ok(left("m") + 100 < left("x") && left("x") + 100 < left("a"));
  assert.deepEqual(overlapping(boxes(cards, found)), []);
});

test("everything lies inside what the layout says it needs", () => {
  const cards = ["a", "b", "c", "d"].map(card);
  const found = layOut(cards, [edge("a", "b")]);
  for (const item_ of boxes(cards, found)) {
    assert.ok(item_.x >= 0 && item_.x + item_.width <= found.width + 1e-9);
    assert.ok(item_.y >= 0 && item_.y + item_.height <= found.height + 1e-9);
  }
});

test("nothing, circles and several edges between two cards are laid out", () => {
  assert.deepEqual([layOut([], []).width, layOut([], []).height], [0, 0]);
  const found = layOut([card("a"), card("b")], [edge("a", "b", "flows"), edge("b", "a", "flows"), { ...edge("a", "b"), id: "x" }]);
  assert.equal(found.paths.size, 3);
});

test("the point under the pointer stays there", () => {
  const before = { x: 10, y: 20, scale: 1 };
  const after = zoom(before, 1.5, 110, 70);
  assert.deepEqual([(110 - after.x) / after.scale, (70 - after.y) / after.scale], [100, 50]);
});

test("all is shown, or, where that is too small, the beginning", () => {
  const view = { width: 400, height: 300 };
  assert.ok(fit({ width: 4000, height: 100 }, view).scale < 0.1);
  assert.deepEqual(fit({ width: 4000, height: 100 }, view, { least: 0.6, margin: 10 }).x, 10);
  assert.equal(fit({ width: 10, height: 10 }, view).scale, 1);
});

test("a card out of sight is brought into it", () => {
  const view = { width: 400, height: 300 };
  const still = { x: 0, y: 0, scale: 1 };
  assert.deepEqual(reveal(still, { x: 100, y: 100 }, card("a"), view), still);
  assert.deepEqual(reveal(still, { x: 900, y: 100 }, card("a"), view), { x: 400 - 24 - 1000, y: 0, scale: 1 });
});

test("arrows find the nearest card in their direction", () => {
  const cards = ["a", "b", "c"].map(card);
  const places = new Map([["a", { x: 0, y: 0 }], ["b", { x: 300, y: 10 }], ["c", { x: 0, y: 200 }]]);
  const from = (id, key) => neighbour(id, key, cards, places)?.id;
  assert.deepEqual([from("a", "ArrowRight"), from("a", "ArrowDown"), from("b", "ArrowLeft"), from("a", "ArrowUp")],
    ["b", "c", "a", undefined]);
  places.set("c", { x: 400, y: 60 });
  assert.equal(from("a", "ArrowRight"), "b");
  assert.equal(neighbour("a", "ArrowRight", cards, places, [edge("a", "c")]).id, "c");
});
