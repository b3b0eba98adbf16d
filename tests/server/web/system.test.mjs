import assert from "node:assert/strict";
import { test } from "node:test";
import { makeCards, makeEdges } from "../../../src/uoarm/server/static/app/cards.js";
import { saidOf } from "../../../src/uoarm/server/static/app/timeline.js";
import { endOf, join, sayThrough, search } from "../../../src/uoarm/server/static/app/system.js";

const FUNCTIONS = [
  { name: "camera", description: "pictures", components: [{ name: "cam", bridge: "ros", priority: 1, uses: [] }] },
  { name: "faces", description: "", components: [
    { name: "dnn", bridge: "ros", priority: 2, uses: ["camera"] },
    { name: "haar", bridge: "python", priority: 1, uses: ["camera"] }] },
];
const component = (name, of, users) => ({ name, function: of, bridge: "ros", health: "ok", users, cause: "" });
const route = (producer, consumer, more = {}) => ({ producer, consumer, received: 5, delivered: 5,
  dropped: [], invalid: 0, rate: 10, age: 0.1, last_error: "", native: false, ...more });
const STATUS = {
  bridges: [{ name: "ros", plugin: "ros2", health: "ok", open_channels: 2, cause: "" }],
  components: [component("cam", "camera", ["c1"]), component("haar", "faces", ["c1"])],
  connections: [{ id: "c1", function: "faces", state: "running", components: ["cam", "haar"], cause: "" }],
  routes: [route("cam.default", "haar.default", { dropped: [["queue", 3]] }), route("haar.default", "c1", { rate: 9 })],
  machines: [{ name: "arm", present: false, bridges: ["ros", "rtm"], clock_offset: null, clock_error: null, cause: "waiting" }],
};
const NOTHING = { bridges: [], components: [], connections: [], routes: [], machines: [] };
const all = { folded: () => false, frameworks: false };

test("rates, drops and health are joined to components and applications", () => {
  const system = join(FUNCTIONS, STATUS);
  const [camera, faces] = system.functions;
  assert.deepEqual([camera.rows[0].rate, camera.rows[0].lost, camera.health], [10, 3, "ok"]);
  assert.deepEqual(faces.rows.map((row) => row.open), [false, true]);
  assert.equal(system.connections[0].rate, 9);
});

test("components that play a recording are marked", () => {
  const plugin = { ros: "recording", python: "python" };
  const components = (func) => func.components.map((part) => ({ ...part, plugin: plugin[part.bridge] }));
  const functions = FUNCTIONS.map((func) => ({ ...func, components: components(func) }));
  const system = join(functions, { ...STATUS, bridges: [] }); // none was asked yet
  assert.deepEqual(system.functions.flatMap((func) => func.rows.map((row) => row.recorded)), [true, true, false]);
  assert.equal(sayThrough(system, ["cam", "haar"]), "cam (recorded) → haar");
});

test("what died is shown with its cause until it runs again", () => {
  const events = [{ subject: "component cam", change: "lost", cause: "unplugged" }];
  const dead = join(FUNCTIONS, NOTHING, events).functions[0];
  assert.deepEqual([dead.health, dead.rows[0].cause], ["lost", "unplugged"]);
  assert.equal(join(FUNCTIONS, STATUS, events).functions[0].health, "ok");
});

test("a service that is known as lost does not run", () => {
  const gone = { ...component("haar", "faces", []), health: "lost", cause: "there is no such service", failed: 2 };
  const [, row] = join(FUNCTIONS, { ...NOTHING, components: [gone] }).functions[1].rows;
  assert.deepEqual([row.open, row.health, row.cause, row.failed], [false, "lost", "there is no such service", 2]);
});

test("who raises is marked with its exception, and no neighbour is", () => {
  const thrower = { ...component("haar", "faces", ["c1"]), health: "degraded", cause: "its input raised", failed: 3,
    last_error: "KeyError: 'ranges'" };
  const feed = route("cam.default", "haar.default", { dropped: [["failed", 3]], last_error: "KeyError: 'ranges'" });
  const thrown = route("haar.default", "c1", { dropped: [["failed", 2]], last_error: "its callback f raised OSError" });
  const system = join(FUNCTIONS, { ...STATUS, components: [STATUS.components[0], thrower], routes: [feed, thrown] });
  const [camera, faces] = system.functions;
  assert.deepEqual([camera.health, camera.rows[0].error, camera.rows[0].lost], ["ok", "", 0]);
  const [, row] = faces.rows;
  assert.deepEqual([faces.health, row.failed, row.error, row.lost], ["degraded", 3, "KeyError: 'ranges'", 0]);
  assert.equal(row.cause, "its input raised");
  const [application] = makeCards(system, system.functions, all).filter((card) => card.kind === "connection");
  assert.deepEqual([application.health, application.data.error], ["degraded", "its callback f raised OSError"]);
});

test("who only takes messages, and who only sends them, shows how many", () => {
  const functions = [{ name: "drive", description: "", components: [{ name: "wheels", bridge: "ros", priority: 1 }] }];
  const status = { ...NOTHING, components: [component("wheels", "drive", ["c2"])],
    connections: [{ id: "c2", function: "drive", state: "running", components: ["wheels"], cause: "" }],
    routes: [route("c2", "wheels.default", { dropped: [["queue-full", 3]] })] };
  const { functions: [{ rows: [wheels] }], connections: [application] } = join(functions, status);
  assert.deepEqual([wheels.rate, wheels.age, wheels.lost], [10, 0.1, 0]);
  assert.deepEqual([application.rate, application.age, application.lost], [10, 0.1, 3]);
});

test("edges flow where messages flow, and are wished for elsewhere", () => {
  const running = join(FUNCTIONS, STATUS);
  const edges = makeEdges(running, makeCards(running, running.functions, all));
  assert.deepEqual(edges.map((edge) => [edge.kind, edge.from, edge.to, edge.bad]), [
    ["flows", "function/camera", "function/faces", true],
    ["flows", "function/faces", "connection/c1", false],
  ]);
  const idle = join(FUNCTIONS, NOTHING);
  const wished = makeEdges(idle, makeCards(idle, idle.functions, all));
  assert.deepEqual(wished.map((edge) => edge.kind), ["uses"]);
});

test("frameworks are cards where they are wanted", () => {
  const system = join(FUNCTIONS, STATUS);
  const cards = makeCards(system, system.functions, { ...all, frameworks: true });
  const found = cards.filter((card) => card.kind === "bridge");
  assert.deepEqual(found.map((item_) => [item_.title, item_.data.open, item_.data.all]), [["python", 1, 1], ["ros", 1, 2]]);
});

test("machines are cards beside frameworks that run there", () => {
  const system = join(FUNCTIONS, STATUS);
  const cards = makeCards(system, system.functions, { ...all, frameworks: true });
  const found = cards.filter((card) => card.kind === "machine");
  assert.deepEqual(found.map((item_) => [item_.title, item_.health]), [["arm", "lost"]]);
  const its = makeEdges(system, cards).filter((card) => card.from === "machine/arm");
  assert.deepEqual(its.map((edge) => [edge.kind, edge.to]), [["runs", "bridge/ros"]]);
  assert.equal(makeCards(system, [], { ...all, frameworks: true }).length, 0);
});

test("every word of a search must be found", () => {
  const { functions } = join(FUNCTIONS, STATUS);
  const names = (...asked) => search(functions, ...asked).map((func) => func.name);
  assert.deepEqual(names("PICT"), ["camera"]);
  assert.deepEqual(names("faces haar"), ["faces"]);
  assert.deepEqual(names("faces cam"), []);
  assert.deepEqual(names("", { bridge: "python" }), ["faces"]);
  assert.deepEqual(names("", { running: true }), ["camera", "faces"]);
});

test("a component that has the name of a connection is another", () => {
  const functions = [{ name: "camera", description: "", components: [{ name: "c1", bridge: "ros", priority: 1, uses: [] }] }];
  const connections = ["c1", "c2"].map((id) => ({ id, function: "camera", state: "running", components: ["c1"], cause: "" }));
  const routes = [route("c1.default", "c1", { rate: 3 }), route("c1.default", "c2"), route("c2", "c1.command", { rate: 8 })];
  const system = join(functions, { ...NOTHING, components: [component("c1", "camera", ["c1", "c2"])], connections, routes });
  assert.deepEqual(system.connections.map((connection) => connection.rate), [3, 10]);
  const edges = makeEdges(system, makeCards(system, system.functions, all));
  assert.deepEqual(edges.map((edge) => [edge.from, edge.to, edge.rate]), [
    ["function/camera", "connection/c1", 3],
    ["function/camera", "connection/c2", 10],
    ["connection/c2", "function/camera", 8],
  ]);
});

test("an end of a route is a port of a component, or a connection", () => {
  assert.deepEqual(["a.b.default", "a.default", "c1"].map(endOf), ["component/a.b", "component/a", "connection/c1"]);
});

test("a kill is said to be one, and by whom", () => {
  const said = (cause, session) => Object.values(saidOf({ subject: "connection c1", change: "closed", cause }, session));
  assert.deepEqual(said("killed by session 5f (driver)", "6a"), ["killed", "by session 5f (driver)"]);
  assert.deepEqual(said("killed by session 5f (driver)"), ["killed", "by session 5f (driver)"]);
  assert.deepEqual(said("killed by session 5f (driver)", "5f"), ["killed", "by this page"]);
  assert.deepEqual(said(""), ["killed", "by its own program"]);
  assert.deepEqual(said("the source has finished"), ["closed", "the source has finished"]);
  assert.deepEqual(saidOf({ subject: "component cam", change: "closed", cause: "" }), { word: "closed", cause: "" });
});
