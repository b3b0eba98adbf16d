import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { explainAt, namesUnder, offersAt, pathAt, problemsOf } from "../../../src/uoarm/server/static/app/yaml.js";

const SCHEMA = JSON.parse(readFileSync(new URL("../../../src/uoarm/config/robot.schema.json", import.meta.url)));

/** A text with "|" where one is: the text without it, and the place. */
const at = (marked) => [marked.replace("|", ""), marked.indexOf("|")];
const path = (marked) => {
  const { path: found, isKey } = pathAt(...at(marked));
  return `${found.join(".")}${isKey ? "." : "="}`;
};
const labels = (marked) => offersAt(SCHEMA, ...at(marked)).offers.map((offer) => offer.label);

test("a place in a YAML has a path, by indentation and inside braces", () => {
  assert.equal(path("ver|"), ".");
  assert.equal(path("version: |"), "version=");
  assert.equal(path("functions:\n  camera:\n    |"), "functions.camera.");
  assert.equal(path("functions:\n  camera:\n    components:\n      - name: x\n        bri|"), "functions.camera.components.0.");
  assert.equal(path("functions:\n  camera:\n    components:\n    - name: x\n      bridge: |"), "functions.camera.components.0.bridge=");
  assert.equal(path("functions:\n  a:\n    components:\n      - {name: x, bridge: |"), "functions.a.components.0.bridge=");
  assert.equal(path("functions:\n  a:\n    components:\n      - {name: x, input: {from: c, |"), "functions.a.components.0.input.");
  assert.equal(path("functions:\n  a:\n    # a note\n\n    description: of what\nbridges:\n  |"), "bridges.");
  assert.equal(path("bridges: {lab: {plugin: memory}}\nfunctions:\n  |"), "functions.");
});

test("keys and values are offered as the schema and the text have them", () => {
  assert.ok(labels("|").includes("functions"));
  const keys = labels("functions:\n  camera:\n    components:\n      - {|");
  for (const key of ["name", "bridge", "priority", "output"]) assert.ok(keys.includes(key), key);
  const text = "bridges:\n  ros: {}\n  python: {}\nfunctions:\n  camera: {}\n  faces:\n    components:\n      - bridge: |";
  assert.deepEqual(labels(text), ["ros", "python"]);
  assert.deepEqual(namesUnder(text, "functions"), ["camera", "faces"]);
  assert.deepEqual(namesUnder("bridges: {a: {}, b: {plugin: x}}", "bridges").slice(0, 2), ["a", "b"]);
  assert.deepEqual(labels("lock: |"), ["warn", "enforce"]);
  assert.deepEqual(labels("failover: {enabled: |"), ["true", "false"]);
});

test("a key is explained with its kind, its bounds and what holds without it", () => {
  const text = "failover:\n  limit: 3\n";
  const said = explainAt(SCHEMA, text, text.indexOf("limit") + 2);
  assert.match(said, /^failover.limit {2}integer 1 to 1000\n/);
  assert.match(said, /Without it: 5/);
  assert.equal(explainAt(SCHEMA, "nothing: 1", 2), "");
});

test("mistakes have the line and column that the robot names", () => {
  const error = '<text>:3:1: $: a key is missing\nC:/robot.yaml:6:27: $.a: there is no "y"\n  it has x';
  assert.deepEqual(problemsOf(error), [{ line: 3, column: 1, text: "$: a key is missing" },
    { line: 6, column: 27, text: '$.a: there is no "y"\n  it has x' }]);
  assert.deepEqual(problemsOf("not connected to the server"), []);
});
