import assert from "node:assert/strict";
import { test } from "node:test";
import { gather, nodeOf, start } from "../../../src/uoarm/server/static/app/schema.js";

const whole = (schema, draft) => gather(schema, schema, draft);
const GOAL = {
  type: "object",
  properties: {
    x: { type: "number", minimum: -10, maximum: 10 },
    frame: { enum: ["map", "odom"] },
    note: { type: "string" },
  },
  required: ["x", "frame"],
};

test("a form begins with what is required", () => {
  assert.deepEqual(start(GOAL, GOAL), { x: "", frame: 0 });
});

test("a message is gathered as the schema types it", () => {
  assert.deepEqual(whole(GOAL, { x: "-2.5", frame: 1, note: "a" }),
    { value: { x: -2.5, frame: "odom", note: "a" }, problems: [] });
});

test("each problem has its path", () => {
  const list = { type: "object", properties: { goals: { type: "array", items: GOAL } } };
  const { problems } = whole(list, { goals: [{ x: "11", frame: 0 }, { x: "", frame: 0 }] });
  assert.deepEqual(problems, [
    { path: "goals.0.x", text: "at most 10" },
    { path: "goals.1.x", text: "a number is missing" },
  ]);
});

test("integers beyond 53 bits keep their digits", () => {
  const wide = { anyOf: [{ type: "integer" }, { type: "string", pattern: "^-?(0|[1-9][0-9]*)$" }] };
  assert.equal(whole(wide, "9007199254740993").value, "9007199254740993");
  assert.equal(whole(wide, "12").value, 12);
  assert.equal(whole(wide, "1.5").problems.length, 1);
  const whole64 = { type: "integer", maximum: 2 ** 63 };
  assert.equal(whole(whole64, "-0009007199254740993").value, "-9007199254740993");
  assert.equal(whole(whole64, "9223372036854779999").problems.length, 1);
});

test("a number that may be no number can be named", () => {
  const free = { anyOf: [{ type: "number" }, { enum: ["NaN", "Infinity", "-Infinity"] }] };
  assert.equal(whole(free, "NaN").value, "NaN");
  assert.equal(whole(free, "2").value, 2);
  for (const text of ["NaN", "Infinity", "-1e999"]) assert.equal(whole({ type: "number" }, text).problems.length, 1);
});

test("a field may have the name of what every object has", () => {
  const field = { type: "string" };
  const schema = { type: "object", properties: { constructor: field, toString: field }, required: ["constructor", "valueOf"] };
  assert.deepEqual(Object.entries(start(schema, schema)), [["constructor", ""]]);
  assert.deepEqual(whole(schema, {}), { value: {}, problems: [] });
  assert.deepEqual(Object.entries(whole(schema, { toString: "a" }).value), [["toString", "a"]]);
});

test("references are followed, and those in a circle end", () => {
  const tree = { $ref: "#/$defs/node", $defs: { node: { type: "object",
    properties: { next: { $ref: "#/$defs/node" }, name: { type: "string" } }, required: ["name"] } } };
  assert.deepEqual(start(tree, tree), { name: "" });
  assert.deepEqual(whole(tree, { name: "a", next: { name: "b" } }).value, { name: "a", next: { name: "b" } });
  const endless = { $ref: "#/$defs/a", $defs: { a: { $ref: "#/$defs/a" } } };
  assert.equal(nodeOf(endless, endless).kind, "json");
  const winding = { anyOf: [{ $ref: "#" }] };
  assert.equal(nodeOf(winding, winding).kind, "json");
});

test("a schema that requires itself for ever still has a start", () => {
  const self = { type: "object", properties: { me: { $ref: "#" } }, required: ["me"] };
  assert.equal(typeof start(self, self), "object");
});

test("one of several forms is chosen", () => {
  const either = { oneOf: [{ type: "string" }, GOAL] };
  assert.deepEqual(start(either, either), { at: 0, draft: "" });
  assert.deepEqual(whole(either, { at: 1, draft: { x: "1", frame: 0 } }).value, { x: 1, frame: "map" });
});

test("what no form can show is written as JSON", () => {
  assert.deepEqual(whole(true, '{"a": [1]}').value, { a: [1] });
  assert.match(whole(true, "{").problems[0].text, /^not JSON/);
});

test("octets are base64 already", () => {
  const octets = { type: "string", contentEncoding: "base64" };
  assert.equal(nodeOf(octets, octets).kind, "octets");
  assert.equal(whole(octets, "AAE=").value, "AAE=");
});
