import assert from "node:assert/strict";
import { test } from "node:test";
import { Watches } from "../../../src/uoarm/server/static/app/watches.js";
import { Refusal, Wire } from "../../../src/uoarm/server/static/app/wire.js";

/** A socket whose other end is the test. */
class Socket {
  static made = [];
  constructor(url, forms) {
    Object.assign(this, { url, forms, readyState: 1, sent: [] });
    Socket.made.push(this);
  }
  send(text) {
    this.sent.push(JSON.parse(text));
  }
  close() {
    this.isClosed = true;
  }
  deliver(message) {
    this.onmessage({ data: JSON.stringify(message) });
  }
}

function open(options = {}) {
  const received = [];
  const wire = new Wire("ws://x/", (...asked_) => received.push(asked_), { socket: Socket, ...options });
  wire.open();
  return { wire, received, socket: Socket.made.at(-1) };
}

test("answers find their askers, in any order", async () => {
  const { wire, socket } = open();
  const [list, call] = [wire.ask("List"), wire.ask("Call", "add", { a: 1 })];
  assert.deepEqual(socket.sent[1], { op: "Call", type: "add", id: "2", jsonMessage: { a: 1 } });
  socket.deliver({ op: "Reply", id: "2", jsonMessage: 3 });
  socket.deliver({ op: "Reply", id: "1", jsonMessage: { functions: [] } });
  assert.deepEqual([await list, await call], [{ functions: [] }, 3]);
});

test("an error is a refusal with its code and what was rejected", async () => {
  const { wire, socket } = open();
  const asked = wire.ask("Resolve", "f");
  socket.deliver({ op: "Error", id: "1", jsonMessage: { code: "resolution", text: "no", rejected: [1] } });
  await assert.rejects(asked, { message: "no", code: "resolution", rejected: [1] });
});

test("what was not asked for is received", () => {
  const { received, socket } = open();
  socket.deliver({ op: "Status", type: "hello", jsonMessage: { protocol: 1 } });
  socket.deliver({ op: "Data", type: "c1", "x-number": 1, jsonMessage: 7 });
  assert.deepEqual(received, [["link", "open", { protocol: 1 }], ["Status", "hello", { protocol: 1 }], ["Data", "c1", 7]]);
});

test("a broken connection refuses what was asked, and is opened again", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const { wire, received, socket } = open();
  const asked = wire.ask("List");
  socket.readyState = 3;
  socket.onclose();
  await assert.rejects(asked, Refusal);
  await assert.rejects(wire.ask("List"), { code: "closed" });
  assert.deepEqual(received.at(-1), ["link", "closed"]);
  const before = Socket.made.length;
  context.mock.timers.tick(500);
  assert.equal(Socket.made.length, before + 1);
});

test("a connection over which nothing comes any more is given up, whatever the network says", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  let answer;
  const { wire, received, socket } = open({ isLocked: () => new Promise((resolve) => { answer = resolve; }) });
  const look = () => {
    for (let second = 0; second < 15; second += 1) wire.look();
  };
  look();
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  look();
  assert.equal(received.length, 2);
  const asked = wire.ask("Stop");
  look();
  assert.ok(socket.isClosed);
  await assert.rejects(asked, { code: "closed" });
  assert.deepEqual(received.at(-1), ["link", "closed"]); // before it is known whether it is locked
  const before = Socket.made.length;
  answer(false);
  await new Promise(setImmediate);
  context.mock.timers.tick(500);
  assert.equal(Socket.made.length, before + 1);
});

test("a server that takes a connection and says nothing is left, and tried again", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const { received, socket } = open();
  context.mock.timers.tick(10_000);
  assert.ok(socket.isClosed);
  assert.deepEqual(received, [["link", "closed"]]);
  await new Promise(setImmediate);
  context.mock.timers.tick(500);
  const second = Socket.made.at(-1);
  assert.notEqual(second, socket);
  second.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  context.mock.timers.tick(60_000);
  assert.equal(Socket.made.at(-1), second);
  assert.ok(!second.isClosed);
});

test("a server that wants a token is not asked again without one", async () => {
  const { wire, received, socket } = open({ isLocked: async (token) => token === "" });
  socket.onclose();
  await new Promise(setImmediate);
  assert.deepEqual(received.at(-1), ["link", "locked"]);
  wire.token = "secret";
  wire.open();
  assert.deepEqual(Socket.made.at(-1).forms, ["uoarm.v1.json", "uoarm.token.secret"]);
});

test("a watch has the latest message, lines of numbers, and its end", async () => {
  let time = 0;
  const asked_ = [];
  const wire = { ask: async (...asked) => (asked_.push(asked), { connection: "c1", components: ["a"], inputs: [], warnings: [] }) };
  const watches = new Watches(wire, () => {}, () => time);
  const watch = await watches.open("f", { every: 0.1 });
  for (time = 1; time <= 3; time += 1) watches.take("c1", { x: time * 2 });
  assert.deepEqual([watch.latest, watch.taken, watches.rate(watch)], [{ x: 6 }, 3, 1]);
  assert.deepEqual(watch.series.get("x").values, [2, 4, 6]);
  time = 3 + 3;
  assert.equal(watches.rate(watch), 1);
  time = 3 + 3.1;
  assert.equal(watches.rate(watch), 0);
  for (let at = 0; at < 500; at += 1) watches.take("c1", { [`name${at}`]: at });
  assert.ok(watch.series.size <= 48);
  watches.ended({ connection: "c1", state: "failed", cause: "unplugged" });
  watches.take("c1", { x: 9 });
  assert.deepEqual([watch.end, watch.taken], [{ state: "failed", cause: "unplugged", word: "failed" }, 503]);
  await watches.close("f");
  assert.deepEqual(asked_, [["Request", "f", { every: 0.1 }]]);
});

test("a watch is opened again when the connection is back, with the gap marked", async () => {
  const asked_ = [];
  const answers = [];
  const wire = { ask: async (...asked) => {
    asked_.push(asked);
    const answer = answers.shift();
    if (answer instanceof Refusal) throw answer;
    return { components: ["a"], inputs: [], warnings: [], connection: answer };
  } };
  const watches = new Watches(wire, () => {}, () => 0);
  answers.push("c1", "c2");
  const watch = await watches.open("f", { every: 2 });
  const stopped = await watches.open("g", {});
  watches.take("c1", { x: 1 });
  watches.see({ connections: [{ id: "c1", components: ["b", "c"] }] });
  assert.deepEqual(watch.components, ["b", "c"]);
  watches.refused(watch.connection, { text: "the server is closing" });
  watches.broken();
  assert.deepEqual([watch.away, watch.end], [true, null]);
  await watches.close("g"); // sends the server nothing: it knows no such connection any more
  watches.take("c1", { x: 2 }); // another one's, by now
  assert.equal(watch.taken, 1);
  answers.push(new Refusal({ code: "closed", text: "it broke once more" }), "c1");
  await watches.again();
  assert.deepEqual([watch.away, watch.end], [true, null]);
  await watches.again();
  assert.deepEqual([watch.away, watch.gaps, watch.components, watch.note], [false, 1, ["a"], ""]);
  watches.take("c1", { x: 3 });
  assert.deepEqual(watch.series.get("x").starts, [true, true]);
  watches.broken();
  answers.push(new Refusal({ code: "resolution", text: "it is not in the configuration" }));
  await watches.again();
  assert.deepEqual(watch.end, { state: "failed", cause: "it is not in the configuration", word: "failed" });
  assert.deepEqual(asked_.map(([op, name]) => `${op} ${name}`),
    ["Request f", "Request g", "Request f", "Request f", "Request f"]);
  assert.equal(stopped.gaps, 0);
});
