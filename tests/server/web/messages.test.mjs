import assert from "node:assert/strict";
import { test } from "node:test";
import { findGrid, findScan, gridPixels, ringOf } from "../../../src/uoarm/server/static/app/plane.js";
import { pairOf, shapesOf } from "../../../src/uoarm/server/static/app/shapes.js";
import {
  readAddress, withMove, withOptions, withoutPanel, withPanel, writeAddress,
} from "../../../src/uoarm/server/static/app/address.js";
import { exact, fine, labels, pretty, rate, short, span, stamp, timeOf } from "../../../src/uoarm/server/static/app/format.js";
import { byUnit, numbersOf, Series } from "../../../src/uoarm/server/static/app/numbers.js";
import { findPicture, pixelsOf } from "../../../src/uoarm/server/static/app/picture.js";

const base64 = (...octets) => Buffer.from(octets).toString("base64");

test("raw pictures are found wherever they lie, in their order of colours", () => {
  const frame = { width: 2, height: 1, encoding: "bgr8", data: base64(1, 2, 3, 4, 5, 6) };
  const pixels = pixelsOf(findPicture({ faces: [], frame }));
  assert.deepEqual([...pixels], [3, 2, 1, 255, 6, 5, 4, 255]);
});

test("rows may be longer than their pixels", () => {
  const image = { width: 1, height: 2, encoding: "mono8", step: 3, data: base64(7, 0, 0, 9) };
  assert.deepEqual([...pixelsOf(findPicture(image))], [7, 7, 7, 255, 9, 9, 9, 255]);
});

test("compressed pictures are known by their format or their first octets", () => {
  assert.equal(findPicture({ format: "rgb8; jpeg compressed bgr8", data: "AA==" }).url, "data:image/jpeg;base64,AA==");
  assert.match(findPicture({ data: base64(0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a) }).url, /^data:image\/png/);
});

test("what is no picture is not taken for one", () => {
  const image = { width: 2, height: 2, encoding: "rgb8", data: base64(1) };
  assert.equal(pixelsOf(findPicture(image)), null);
  for (const value of [null, 3, [], { data: "hello" }, { ...image, width: 1e9 }, { ...image, encoding: "yuv" }]) {
    assert.equal(findPicture(value), null);
  }
});

test("numbers are found by path, long lists left out", () => {
  const message = { a: 1, b: { c: [2, true] }, long: Array(100).fill(1), s: "x" };
  assert.deepEqual(numbersOf(message), [["a", 1], ["b.c.0", 2], ["b.c.1", 1]]);
  assert.deepEqual(numbersOf(5), [["value", 5]]);
  assert.ok(numbersOf(Object.fromEntries(Array.from({ length: 500 }, (_, at) => [at, at]))).length <= 24);
});

test("no line is drawn of a time, and a time is shown as one", () => {
  const message = { header: { stamp: { sec: 1795715647, nanosec: 250000000 } }, x: 1, lasts: { secs: 2, nsecs: 0 } };
  assert.deepEqual(numbersOf(message), [["x", 1]]);
  assert.ok(pretty(message).includes('"stamp": "2026-11-26 17:54:07.250 UTC"'));
  assert.deepEqual(JSON.parse(pretty(message)).lasts, { secs: 2, nsecs: 0 });
  assert.deepEqual([stamp(null), stamp({ sec: 1795715647 }), stamp({ sec: 5, nanosec: 0 })], [null, null, null]);
});

test("a message says when it is of as its framework does", () => {
  const of = (seconds, parts) => ({ sec: seconds, nanosec: parts });
  assert.deepEqual([{ header: { stamp: of(2, 5e8) } }, { stamp: of(2, 0) }, { timestamp: of(0, 1e6) }, { tm: { sec: 3, nsec: 0 } }]
    .map(timeOf), [2.5, 2, 0.001, 3]);
  assert.deepEqual([null, 3, {}, { stamp: 4 }, { stamp: of(0, 0) }].map(timeOf), [null, null, null, null, null]);
});

test("a picture is shown with the overlay that was made of it", () => {
  const at = (...times) => times.map((time) => ({ time, message: `of ${time}` }));
  const pictures = at(1, 2, 3, 4);
  assert.deepEqual(pairOf(pictures, at(1, 2)), { picture: "of 2", overlay: "of 2", apart: 0 });
  assert.deepEqual(pairOf(pictures, at(2.75)), { picture: "of 3", overlay: "of 2.75", apart: -0.25 });
  assert.deepEqual(pairOf(pictures, at(-9, -3)), { picture: "of 4", overlay: "of -3", apart: -7 }, "what it was made of is gone");
  assert.deepEqual(pairOf(at(7), at(6, 7.5, 9)), { picture: "of 7", overlay: "of 7.5", apart: 0.5 });
  assert.deepEqual([pairOf([], at(1)), pairOf(at(1), [])], [null, null]);
});

test("a tile of a map of OpenRTM lies where its column and row say", () => {
  const config = { xScale: 0.5, yScale: 0.5, width: 9, height: 9, origin: { position: { x: -1, y: 2 }, heading: 0 } };
  const map = { column: 4, row: 2, width: 2, height: 1, cells: base64(0, 255) };
  const grid = findGrid({ tm: { sec: 1, nsec: 0 }, config, map });
  assert.deepEqual([grid.width, grid.height, grid.resolution, grid.origin], [2, 1, 0.5, { x: 1, y: 3 }]);
  assert.deepEqual([...gridPixels(grid)], [24, 32, 44, 255, 246, 248, 250, 255]);
  assert.equal(findGrid({ config, map: { ...map, cells: base64(0) } }), null);
  assert.deepEqual(findGrid({ config, map: { ...map, cells: [0, 255] } }).cells, grid.cells);
});

test("a line keeps its last points only", () => {
  const line = new Series(2);
  for (const number of [1, 2, 3]) line.add(number, number * 10);
  assert.deepEqual([line.times, line.values], [[2, 3], [20, 30]]);
});

test("labels of an axis have the figures that tell them apart", () => {
  assert.deepEqual(labels([0, 0.5, 1]), ["0", "0.5", "1"]);
  assert.deepEqual(labels([1013.2, 1013.4]), ["1.0132 k", "1.0134 k"]);
  assert.deepEqual(labels([1796104556, 1796104560, Infinity]), ["1.796104556 G", "1.79610456 G", ""]);
  assert.deepEqual(labels([Infinity, -Infinity]), ["", ""]);
});

test("a value that one points at is as fine as one reads it", () => {
  assert.deepEqual([1013.25, 1796104560.25, 0.1 + 0.2, -2, 3.4e38].map(fine), ["1013.25", "1796104560", "0.3", "-2", "3.4e+38"]);
});

test("numbers and times are short", () => {
  assert.deepEqual([0, 999, 1234, 1.5e6, -2e9, null].map(short), ["0", "999", "1.23 k", "1.5 M", "-2 G", "–"]);
  assert.deepEqual([1e40, -1.7e308, 5e20].map(short), ["1e+40", "-1.7e+308", "500000000000 G"]);
  assert.deepEqual([0.0124, 0.9996, 59, 61, 7200, null].map(span), ["12 ms", "1 s", "59 s", "1 min", "2 h", "–"]);
  assert.equal(rate(24.96), "25/s");
});

test("a long message is cut where it is long", () => {
  const text = pretty({ data: "a".repeat(5000), list: Array(100).fill(0) });
  assert.match(text, /… \(5 k characters\)/);
  assert.match(text, /… 60 more/);
  assert.ok(text.length < 1500);
  assert.equal(pretty(undefined), "nothing");
});

const panel = (name, tab = "", options = {}) => ({ kind: "function", name, tab, options });

test("an address says what is shown, whatever the names", () => {
  const place = { view: "graph", dock: 45, panels: [panel("a/b c#d&e=f", "use", { keep: "1", fields: "x/y,z" }), panel("g")],
    unfolded: ["robot3", "a,b&c"] };
  assert.deepEqual(readAddress(writeAddress(place)), place);
  assert.deepEqual(readAddress("", "list"), { view: "list", dock: 0, panels: [], unfolded: [] });
  assert.deepEqual(readAddress("#/nonsense/%"), { view: "graph", dock: 0, panels: [], unfolded: [] });
  assert.deepEqual(readAddress("#/list/function/a/use").panels, [panel("a", "use")]);
  assert.deepEqual(readAddress("#/graph/script/a&function/a&function/a&dock=99999"),
    { view: "graph", dock: 80, panels: [panel("a")], unfolded: [] });
});

test("what is opened takes the place of the panel that is not kept, or stands beside it", () => {
  const names = (panels) => panels.map(({ name }) => name).join(" ");
  const kept = panel("a", "", { keep: "1" });
  assert.equal(names(withPanel([kept, panel("b")], panel("c"))), "a c");
  assert.equal(names(withPanel([kept], panel("c"))), "a c");
  assert.equal(names(withPanel([panel("a"), kept], panel("a"))), "a a");
  const beside = withPanel([panel("a")], panel("b"), true);
  assert.equal(names(beside), "a b");
  assert.equal(names(withPanel(beside, panel("c"))), "a c");
  assert.equal(names(withMove([panel("a"), panel("b"), panel("c")], "function/a", 1)), "b a c");
  assert.equal(names(withMove([panel("a"), panel("b")], "function/a", -1)), "a b");
  assert.equal(names(withoutPanel([panel("a"), panel("b")], "function/a")), "b");
  assert.deepEqual(withOptions(kept, { keep: "", window: 30 }).options, { window: 30 });
});

test("a line's points since a time begin one before it, and end where it is interrupted", () => {
  const line = new Series();
  for (const [time, value] of [[1, 10], [2, 20], [3, 30]]) line.add(time, value);
  assert.deepEqual(line.since(2.5), [[2, 3], [20, 30]]);
  assert.deepEqual(line.since(9), [[3], [30]]);
  line.interrupt();
  line.add(4, 40);
  assert.deepEqual(line.since(3), [[2, 3, 4 - 1e-6, 4], [20, 30, null, 40]]);
});

test("numbers of one unit are in one plot", () => {
  const schema = { type: "object", properties: { v: { $ref: "#/$defs/v" }, n: { type: "integer" } },
    $defs: { v: { type: "object", properties: { x: { type: "number", "x-unit": "m/s" } } } } };
  assert.deepEqual(byUnit(["v.x", "n", "gone.x"], schema), [["m/s", ["v.x"]], ["", ["n", "gone.x"]]]);
  assert.deepEqual(byUnit(["a", "b"], undefined), [["", ["a", "b"]]]);
});

test("boxes and points are found in what detectors send", () => {
  const size = { width: 200, height: 100 };
  const box = (x, y, width, height, label) => ({ kind: "box", x, y, width, height, label });
  const of = (message) => shapesOf(message, size);
  assert.deepEqual(of({ faces: [{ x: 1, y: 2, width: 3, height: 4, name: "Ada", score: 0.91 }] }), [box(1, 2, 3, 4, "Ada 91 %")]);
  assert.deepEqual(of({ detections: [{ bbox: { center: { position: { x: 50, y: 40 }, theta: 0 }, size_x: 20, size_y: 10 },
    results: [{ hypothesis: { class_id: "cup", score: 0.5 } }] }] }), [box(40, 35, 20, 10, "cup 50 %")]);
  assert.deepEqual(of([{ x1: 10, y1: 20, x2: 30, y2: 60 }]), [box(10, 20, 20, 40, "")]);
  assert.deepEqual(of({ label: "hand", box: [5, 6, 7, 8] }), [box(5, 6, 7, 8, "hand")]);
  assert.deepEqual(of({ nose: { x: 0.5, y: 0.5 } }), [{ kind: "point", x: 100, y: 50, label: "" }]);
  assert.deepEqual(of({ at: { x: 1, y: 2, z: 3 }, picture: { width: 9, height: 9, x: 1, y: 1, encoding: "rgb8", data: "AA" } }), []);
});

test("a scan is points in metres, without what sees nothing; a grid's first row is below", () => {
  const scan = findScan({ scan: { angle_min: 0, angle_increment: Math.PI / 2, range_min: 0.1, range_max: 10, ranges: [2, "Infinity", 3, 11] } });
  assert.deepEqual(scan.points.map((point) => point.map(Math.round)), [[2, 0], [-3, 0]]);
  assert.deepEqual([scan.all, scan.reach], [4, 3]);
  assert.equal(findScan({ ranges: [1, 2], config: { minAngle: -1, maxAngle: 1 } }).points.length, 2);
  assert.equal(findScan({ ranges: [1, 2] }), null);
  assert.deepEqual([0.9, 4, 12, 30].map(ringOf), [0.2, 2, 5, 10]);
  const info = { width: 2, height: 2, resolution: 0.5, origin: { position: { x: -1, y: 0 } } };
  const shades = (data) => [...gridPixels(findGrid({ info, data }))].filter((_, at) => at % 4 === 0);
  assert.deepEqual(shades([100, 0, -1, 0]), [178, 246, 24, 246]);
  assert.deepEqual(shades(btoa("\x64\x00\xff\x00")), [178, 246, 24, 246]);
  assert.equal(findGrid({ info, data: [1] }), null);
});

test("what a person decides about is shown whole, and turns no text around", () => {
  const hidden = { text: `${"go ".repeat(100)}faster`, list: Array.from({ length: 60 }, (_, at) => at) };
  assert.deepEqual(JSON.parse(exact(hidden)), hidden);
  assert.equal(exact({ text: "a\u202e\u009b\u{e0041}é中" }), '{\n  "text": "a\\u{202e}\\u{9b}\\u{e0041}é中"\n}');
  assert.equal(exact({ stamp: { sec: 1, nanosec: 2 } }), '{\n  "stamp": {\n    "sec": 1,\n    "nanosec": 2\n  }\n}');
});
