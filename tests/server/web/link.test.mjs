import assert from "node:assert/strict";
import { test } from "node:test";
import { connect, findTrouble } from "../../../src/uoarm/server/static/uoarm.js";

/** A socket whose other end is the test. */
class Socket {
  static made = [];
  constructor() {
    Object.assign(this, { sent: [], closed: false });
    Socket.made.push(this);
  }
  send(text) {
    this.sent.push(JSON.parse(text));
  }
  deliver(message) {
    this.onmessage({ data: JSON.stringify(message) });
  }
  close() {
    this.closed = true;
  }
}

/** A robot whose connection has dropped, and the socket over which it tries to go on. */
async function dropped(meanwhile = () => {}, before = () => {}) {
  const connecting = connect("ws://x/", { WebSocket: Socket });
  const first = Socket.made.at(-1);
  first.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  first.deliver({ op: "Reply", id: "keep", jsonMessage: { key: "key", seconds: 5 } });
  before(robot);
  first.onclose({ code: 1006, reason: "" });
  meanwhile(robot);
  const second = Socket.made.at(-1);
  assert.notEqual(second, first);
  second.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  return { robot, second };
}

const RESUMED = { op: "Reply", id: "resume", jsonMessage: { own: [] } };

test("what a drop took is counted as the session goes on, and at the end", async () => {
  let opening;
  const { robot, second } = await dropped(() => {}, (robot) => {
    opening = robot.request("numbers");
    const opened = { connection: "c1", inputs: [], warnings: [], number: 4 };
    Socket.made.at(-1).deliver({ op: "Reply", id: "1", jsonMessage: opened });
  });
  const stream = await opening;
  second.deliver({ ...RESUMED, jsonMessage: { own: [{ connection: "c1", number: 7 }] } });
  assert.equal(stream.lost, 3);
  second.deliver({ op: "Data", type: "c1", "x-number": 8, jsonMessage: 1 });
  const ended = { connection: "c1", state: "closed", cause: "finished", number: 10 };
  second.deliver({ op: "Status", type: "connection", jsonMessage: ended });
  assert.deepEqual([await stream.get(), await stream.get(), stream.lost], [1, undefined, 5]);
  robot.close();
});

test("what is not read is bounded as asked, and counted", async () => {
  const { robot, second } = await dropped();
  second.deliver(RESUMED);
  for (const [queue, left] of [
    [undefined, [1, 2, 3, 4, 5]],
    [{ length: 2 }, [4, 5]],
    [{ policy: "latest" }, [5]],
  ]) {
    const opening = robot.request("numbers", { queue });
    const opened = { connection: "c1", inputs: [], warnings: [], number: 0 };
    second.deliver({ op: "Reply", id: second.sent.at(-1).id, jsonMessage: opened });
    const stream = await opening;
    for (let number = 1; number <= 5; number += 1) {
      second.deliver({ op: "Data", type: "c1", "x-number": number, jsonMessage: number });
    }
    const ended = { connection: "c1", state: "closed", cause: "finished", number: 5 };
    second.deliver({ op: "Status", type: "connection", jsonMessage: ended });
    const read = [];
    for await (const message of stream) read.push(message);
    assert.deepEqual([read, stream.lost], [left, 5 - left.length]);
  }
  robot.close();
});

test("messages that are not read hold no more than so many octets", async () => {
  let opening;
  const { robot, second } = await dropped(() => {}, (robot) => {
    opening = robot.request("numbers");
    const opened = { connection: "c1", inputs: [], warnings: [], number: 0 };
    Socket.made.at(-1).deliver({ op: "Reply", id: "1", jsonMessage: opened });
  });
  second.deliver(RESUMED);
  const stream = await opening;
  const long = "x".repeat(2 ** 25);
  for (let number = 1; number <= 4; number += 1) {
    second.deliver({ op: "Data", type: "c1", "x-number": number, jsonMessage: long });
  }
  assert.equal(stream.lost, 3);
  assert.equal((await stream.get()).length, 2 ** 25);
  robot.close();
});

test("a network that goes without a word is noticed", async (context) => {
  context.mock.timers.enable({ apis: ["setInterval"] });
  const connecting = connect("ws://x/", { WebSocket: Socket });
  const first = Socket.made.at(-1);
  first.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  first.deliver({ op: "Reply", id: "keep", jsonMessage: { key: "key", seconds: 5 } });
  for (let look = 0; look < 20; look += 1) {
    context.mock.timers.tick(5000);
    assert.deepEqual(first.sent.at(-1), { op: "Kill", type: "alive", id: "alive" });
    first.deliver({ op: "Error", id: "alive", jsonMessage: { code: "unknown", text: "no such connection" } });
  }
  assert.equal(Socket.made.at(-1), first);
  const asked = robot.call("add", 1);
  context.mock.timers.tick(35000);
  assert(first.closed);
  const second = Socket.made.at(-1);
  second.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  assert.deepEqual(second.sent[0].jsonMessage, { key: "key", waiting: ["1"] });
  second.deliver(RESUMED);
  second.deliver({ op: "Reply", id: "1", jsonMessage: 3 });
  assert.equal(await asked, 3);
  robot.close();
});

test("why a connection ended has no empty reason", async () => {
  const connecting = connect("ws://x/", { WebSocket: Socket, resume: false, reconnect: 0 });
  const socket = Socket.made.at(-1);
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const waiting = (await connecting).status();
  socket.onclose({ code: 1006, reason: "" });
  await assert.rejects(waiting, { code: "closed", message: "the connection to the server at ws://x/ ended (1006)" });
});

test("what runs out of time while the connection is down says why it is", async () => {
  const connecting = connect("ws://x/", { WebSocket: Socket, answer: 0.05 });
  const first = Socket.made.at(-1);
  first.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  first.deliver({ op: "Reply", id: "keep", jsonMessage: { key: "key", seconds: 5 } });
  first.onclose({ code: 1006, reason: "" });
  Socket.made.at(-1).onerror();
  const text = "the server at ws://x/ has not answered Status within 0.05 s; the connection to the server at ws://x/ ended (1006); connecting again: ";
  await assert.rejects(robot.status(), ({ code, message }) => code === "timeout" && message.startsWith(text));
  robot.close();
});

test("giving back what has just ended at the server is no failure", async () => {
  const connecting = connect("ws://x/", { WebSocket: Socket, resume: false, reconnect: 0 });
  const socket = Socket.made.at(-1);
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  const opening = robot.request("numbers");
  const opened = { connection: "c1", inputs: [], warnings: [], number: 0 };
  socket.deliver({ op: "Reply", id: "1", jsonMessage: opened });
  const giving = (await opening).kill();
  const unknown = { code: "unknown", text: "this client has no connection 'c1'" };
  socket.deliver({ op: "Error", type: "c1", id: "2", jsonMessage: unknown });
  await giving;
  robot.close();
});

test("a limit that no timer can have is none", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const connecting = connect("ws://x/", { WebSocket: Socket, timeout: Infinity });
  const socket = Socket.made.at(-1);
  context.mock.timers.tick(60_000);
  assert.equal(socket.closed, false);
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  robot.call("add", 1, { timeout: Infinity }).catch(() => {});
  assert.deepEqual(socket.sent.at(-1), { op: "Call", type: "add", id: "1", jsonMessage: 1 });
  robot.close();
});

test("a limit is named in three figures: the rest of one is seldom round", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const connecting = connect("ws://x/", { WebSocket: Socket, timeout: 10 / 3 });
  context.mock.timers.tick(4000);
  await assert.rejects(connecting, { code: "closed", message: "ws://x/: no answer within 3.33 s" });
});

test("what is no URL is an error of ours, without the token", async () => {
  class Refusing {
    constructor(url) {
      throw new DOMException(`The URL '${url}' is invalid.`, "SyntaxError");
    }
  }
  const message = /^http\/\/\?token=\*\*\*: expected a URL such as ws:/;
  await assert.rejects(connect("http//?token=secret", { WebSocket: Refusing }), { name: "UoarmError", code: "usage", message });
});

test("what is no number of seconds is refused, and is no time that has run out", async () => {
  const usage = (name) => ({ code: "usage", message: new RegExp(`^${name}: expected a number of seconds, got `) });
  for (const name of ["timeout", "reconnect", "answer"]) {
    await assert.rejects(connect("ws://x/", { WebSocket: Socket, [name]: "5" }), usage(name));
  }
  const connecting = connect("ws://x/", { WebSocket: Socket });
  const socket = Socket.made.at(-1);
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  const opening = robot.request("drive");
  socket.deliver({ op: "Reply", id: "1", jsonMessage: { connection: "c1", inputs: ["default"], warnings: [] } });
  const stream = await opening;
  await assert.rejects(stream.get({ timeout: NaN }), usage("timeout"));
  for (const period of ["0.5", NaN, -1]) assert.throws(() => stream.hold(1, { period }), usage("period"));
  const calling = robot.call("add", 1, { timeout: "x" });
  await new Promise((wake) => { setTimeout(wake); });
  const refusal = { code: "unreadable", text: "Call: x-timeout: 'x' is not of type 'number'" };
  socket.deliver({ op: "Error", id: "2", jsonMessage: refusal });
  await assert.rejects(calling, { code: "unreadable" });
  robot.close();
});

test("a command with a period that no timer can have is sent once", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const connecting = connect("ws://x/", { WebSocket: Socket });
  const socket = Socket.made.at(-1);
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  const opening = robot.request("drive");
  const opened = { connection: "c1", inputs: ["default"], warnings: [] };
  socket.deliver({ op: "Reply", id: "1", jsonMessage: opened });
  (await opening).hold(1, { period: Infinity });
  socket.deliver({ op: "Reply", id: "2", jsonMessage: {} });
  await new Promise(setImmediate);
  context.mock.timers.tick(60_000);
  await new Promise(setImmediate);
  assert.equal(socket.sent.filter(({ op }) => op === "Data").length, 1);
  robot.close();
});

test("numbers and octets that JSON has no form for are written as the protocol says", async () => {
  const connecting = connect("ws://x/", { WebSocket: Socket });
  const socket = Socket.made.at(-1);
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  const message = { wide: 2n ** 60n, off: NaN, far: -Infinity, near: 0.5, none: null };
  const arrays = { octets: new Uint8Array([0, 255]), floats: new Float32Array([0.5, NaN]) };
  const buffers = { node: Buffer.from([1]), bare: new ArrayBuffer(2), view: new DataView(new ArrayBuffer(1)) };
  robot.call("add", { ...message, ...arrays, ...buffers }).catch(() => {});
  assert.deepEqual(socket.sent.at(-1).jsonMessage, {
    wide: "1152921504606846976", off: "NaN", far: "-Infinity", near: 0.5, none: null,
    octets: [0, 255], floats: [0.5, "NaN"], node: [1], bare: [0, 0], view: [0],
  });
  robot.close();
});

test("what cannot be written fails alone, also while the connection is down", async () => {
  const answers = [];
  const { robot, second } = await dropped((robot) => {
    const round = {};
    round.round = round;
    answers.push(robot.call("add", round), robot.call("add", 2));
  });
  await assert.rejects(answers[0], { code: "message", message: /^the message cannot be written: .*circular/s });
  second.deliver(RESUMED);
  assert.deepEqual(second.sent.slice(1), [{ op: "Call", type: "add", id: "2", jsonMessage: 2 }]);
  second.deliver({ op: "Reply", id: "2", jsonMessage: 3 });
  assert.equal(await answers[1], 3);
  robot.close();
});

test("of more than can be asked for after a drop, the rest fails", async () => {
  const calls = [];
  const { robot, second } = await dropped(() => {}, (robot) => {
    for (let number = 0; number < 4100; number += 1) calls.push(robot.call("add", number));
  });
  assert.equal(second.sent[0].jsonMessage.waiting.length, 4096);
  second.deliver(RESUMED);
  for (const call of calls.slice(4096)) await assert.rejects(call, { code: "closed" });
  robot.close();
  for (const call of calls.slice(0, 4096)) await assert.rejects(call, { code: "closed" });
});

test("a robot that is closed while it connects again stays closed", async () => {
  const { robot, second } = await dropped();
  robot.close();
  second.deliver(RESUMED);
  assert(second.closed);
  await assert.rejects(robot.status(), { code: "closed" });
});

test("what was asked during a drop fails where a new session is begun, and is not asked of that", async () => {
  const lost = [];
  const { robot, second } = await dropped((robot) => lost.push(robot.call("add", 1)));
  second.deliver({ op: "Error", id: "resume", jsonMessage: { code: "unknown", text: "begin anew" } });
  await assert.rejects(lost[0], { code: "closed" });
  const asked = robot.call("add", 2);
  const third = Socket.made.at(-1);
  third.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const { "x-sent": sent, ...keep } = third.sent[0];
  assert.equal(typeof sent, "number");
  assert.deepEqual([keep, ...third.sent.slice(1)], [
    { op: "Resume", id: "keep" }, { op: "Call", type: "add", id: "2", jsonMessage: 2 }]);
  third.deliver({ op: "Reply", id: "2", jsonMessage: 3 });
  assert.equal(await asked, 3);
  robot.close();
});

test("a client that was closed for what it did does not come again", async () => {
  const connecting = connect("ws://x/", { WebSocket: Socket });
  const socket = Socket.made.at(-1);
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  socket.onclose({ code: 1008, reason: "its rights have changed" });
  await assert.rejects(robot.status(), /its rights have changed/);
  assert.equal(Socket.made.at(-1), socket);
});

test("a client that is refused for good as it comes again does not come once more", async () => {
  for (const begins of [0, 1]) {
    const connecting = connect("ws://x/", { WebSocket: Socket });
    const first = Socket.made.at(-1);
    first.deliver({ op: "Status", type: "hello", jsonMessage: {} });
    const robot = await connecting;
    if (begins) first.deliver({ op: "Reply", id: "keep", jsonMessage: { key: "key", seconds: 5 } });
    first.onclose({ code: 1006, reason: "" });
    const second = Socket.made.at(-1);
    second.onclose({ code: 1008, reason: "its rights have changed" });
    await assert.rejects(robot.status(), /connecting again: its rights have changed/);
    assert.equal(Socket.made.at(-1), second);
  }
});

test("a clock that is set meanwhile ends no attempt to connect again", async (context) => {
  let ahead = 0;
  const now = Date.now;
  context.mock.method(Date, "now", () => now() + ahead);
  const { robot, second } = await dropped(() => { ahead = 1e9; });
  second.onclose({ code: 1006, reason: "" });
  while (Socket.made.at(-1) === second) await new Promise(setImmediate);
  const third = Socket.made.at(-1);
  third.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  assert.equal(third.sent[0].op, "Resume");
  third.deliver(RESUMED);
  robot.close();
});

test("connecting again ends at its limit, also between two attempts", async (context) => {
  let now = 0;
  context.mock.method(performance, "now", () => now);
  context.mock.method(Math, "random", () => 1);
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const connecting = connect("ws://x/", { WebSocket: Socket, reconnect: 60 });
  Socket.made.at(-1).deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  let ended = 0;
  Socket.made.at(-1).onclose({ code: 1006, reason: "" });
  const asked = robot.status().catch(() => { ended = now; });
  for (let last = null; !ended && now < 120_000; now += 50) {
    if (Socket.made.at(-1) !== last) (last = Socket.made.at(-1)).onerror();
    for (let turn = 0; turn < 5; turn += 1) await new Promise(setImmediate);
    context.mock.timers.tick(50);
    await new Promise(setImmediate);
  }
  await asked;
  assert(ended <= 60_000, `${ended}`);
});

test("a stop waits for nothing that was sent before", async () => {
  const connecting = connect("ws://x/", { WebSocket: Socket });
  const first = Socket.made.at(-1);
  first.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  first.bufferedAmount = 1e6;
  for (const isRefused of [false, true]) {
    const stopping = robot.stopAll();
    const second = Socket.made.at(-1);
    assert.notEqual(second, first);
    if (isRefused) second.onerror();
    else second.deliver({ op: "Status", type: "hello", jsonMessage: {} });
    await new Promise(setImmediate);
    const asked = isRefused ? first : second;
    const { op, id } = asked.sent.at(-1);
    assert.equal(op, "Stop");
    asked.deliver({ op: "Reply", id, jsonMessage: { stopped: true, inputs: [], text: "" } });
    assert.equal((await stopping).stopped, true);
    assert(second.closed);
  }
  first.bufferedAmount = 100;
  robot.stopAll().catch(() => {});
  assert.equal(first.sent.at(-1).op, "Stop");
  robot.close();
});

test("a server that sends what is no message is left, with the reason", async () => {
  for (const data of ["no JSON", "null", "[".repeat(1e6)]) {
    const connecting = connect("ws://x/", { WebSocket: Socket });
    const socket = Socket.made.at(-1);
    socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
    const robot = await connecting;
    const asked = robot.status();
    socket.onmessage({ data });
    await assert.rejects(asked, { code: "unreadable" });
    assert(socket.closed);
    const refused = connect("ws://x/", { WebSocket: Socket });
    Socket.made.at(-1).onmessage({ data });
    await assert.rejects(refused, { code: "closed" });
  }
});

test("a frame of the other kind is named as such", async () => {
  for (const [binary, data, text] of [
    [false, new ArrayBuffer(2), /what is no message: a binary frame: expected text$/],
    [true, "{}", /what is no message: a text frame: expected binary$/],
  ]) {
    const refused = connect("ws://x/", { WebSocket: Socket, binary });
    Socket.made.at(-1).onmessage({ data });
    await assert.rejects(refused, text);
  }
});

test("of a function that is silent it is said what keeps messages from coming", async () => {
  const connecting = connect("ws://x/", { WebSocket: Socket });
  const socket = Socket.made.at(-1);
  const reply = (jsonMessage) => socket.deliver({ op: "Reply", id: socket.sent.at(-1).id, jsonMessage });
  const isAsked = async (op) => {
    while (socket.sent.at(-1).op !== op) await new Promise(setImmediate);
  };
  socket.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  const robot = await connecting;
  const opening = robot.request("numbers");
  reply({ connection: "c1", inputs: [], warnings: [], number: 0 });
  const stream = await opening;
  const lost = { name: "a", health: "lost", cause: "killed", last_error: "" };
  const status = { connections: [{ id: "c1", components: ["a"], state: "running", cause: "" }], components: [lost], routes: [] };
  const refused = "the server could not send the last message: no value";

  let silent = stream.get({ timeout: 0.001 });
  socket.deliver({ op: "Error", type: "c1", jsonMessage: { code: "message", text: "no value" } });
  await isAsked("Status");
  reply(status);
  await assert.rejects(silent, {
    code: "timeout", message: `no message within 0.001 s; a is lost: killed; ${refused}`,
  });
  assert.deepEqual(stream.trouble, ["a is lost: killed", refused]);

  socket.deliver({ op: "Data", type: "c1", "x-number": 2, jsonMessage: 5 });
  assert.equal(await stream.get({ timeout: 60 }), 5);
  assert.deepEqual(stream.trouble, []);

  socket.sent.push({});
  silent = stream.get({ timeout: 0.001 });
  await isAsked("Status");
  socket.deliver({ op: "Data", type: "c1", "x-number": 3, jsonMessage: 6 });
  reply(status);
  assert.equal(await silent, 6);
  await assert.rejects(stream.get({ timeout: 0 }), { code: "timeout", message: "no message within 0 s" });

  const last = stream.get({ timeout: 1e9 });
  socket.deliver({ op: "Status", type: "connection", jsonMessage: { connection: "c1", state: "closed", cause: "", number: 3 } });
  assert.equal(await last, undefined);
  robot.close();
});

test("trouble of a connection is found as in Python", () => {
  const connections = [{ id: "c1", components: ["a", "b"], cause: "b has no peer", state: "waiting" }];
  const components = [
    { name: "a", health: "degraded", cause: "", last_error: "it raised" },
    { name: "b", health: "ok" },
    { name: "other", health: "lost", cause: "killed" },
  ];
  const routes = [
    { producer: "a.out", consumer: "c1", refusal: "no number" },
    { producer: "a.out", consumer: "b.in", refusal: "" },
    { producer: "a.out", consumer: "b.in", refusal: "too long" },
    { producer: "a.out", consumer: "b.in", refusal: "it raised" },
    { producer: "a.out", consumer: "other.in", refusal: "wrong" },
  ];
  assert.deepEqual(findTrouble({ connections, components, routes }, "c1"), [
    "the connection is waiting: b has no peer",
    "a is degraded: it raised",
    "the last message of a.out -> c1 was refused: no number",
    "the last message of a.out -> b.in was refused: too long",
  ]);
  assert.deepEqual(findTrouble({ connections, components, routes }, "c2"), []);
});
