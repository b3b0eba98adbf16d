// A server that answers what the protocol does not have: the client says so, in its own errors.
import assert from "node:assert/strict";
import { test } from "node:test";
import { UoarmError, connect, findTrouble } from "../../../src/uoarm/server/static/uoarm.js";
import { decode, encode } from "../../../src/uoarm/server/static/uoarm-cbor.js";

const OPENED = { connection: "c1", inputs: ["default"], warnings: [], lifetimes: { default: 1 }, number: 0 };
const COMPONENT = { name: "c", health: "degraded", cause: "", last_error: "e" };
const ROUTE = { producer: "c.default", consumer: "c1", age: 1, refusal: "no" };
const CONNECTION = { id: "c1", components: ["c"], state: "running", cause: "waits" };
const STATUS = { version: 1, components: [COMPONENT], routes: [ROUTE], connections: [CONNECTION] };
const CHANGES = {
  since: 1, elapsed: 0.5, version: 2, components: { changed: [COMPONENT], gone: ["d"] },
  routes: { changed: [ROUTE], gone: [["c.default", "c2"]] }, connections: { gone: ["c2"] },
};
const FUNCTION = {
  name: "f", description: "", service: false, outputs: [], inputs: [],
  components: [{ name: "c", bridge: "python", priority: 0 }],
};
const REVISION = { revision: 1, differences: [], text: "" };
const APPROVAL = { approval: "a1", phase: "pending", requester: "x", function: "f", digest: "d" };
const RECORDING = { recording: "r1", state: "ended", files: [] };
const PLAYER = { bridge: "b", functions: [], may_move: true, cause: "" };
const PLAN = { plan: { steps: [{ component: { name: "c" }, structures: {} }] }, text: "" };

/** Each question, with what answers it: as it should be. */
const QUESTIONS = {
  functions: [(robot) => robot.functions(), [{ functions: [FUNCTION] }]],
  resolve: [(robot) => robot.resolve("f"), [PLAN]],
  discover: [(robot) => robot.discover(), [{ bridges: [{}] }]],
  approvals: [(robot) => robot.approvals(), [{ approvals: [APPROVAL] }]],
  approve: [(robot) => robot.approve("a1"), [APPROVAL]],
  recordings: [(robot) => robot.recordings(), [{ recordings: [RECORDING] }]],
  record: [(robot) => robot.record(["f"]), [RECORDING]],
  stopRecording: [(robot) => robot.stopRecording("r1"), [RECORDING]],
  dumpRecording: [(robot) => robot.dumpRecording("r1"), [RECORDING]],
  players: [(robot) => robot.players(), [{ players: [PLAYER] }]],
  playback: [(robot) => robot.playback("b"), [PLAYER]],
  configure: [(robot) => robot.configure("version: 1"), [REVISION]],
  rollback: [(robot) => robot.rollback(1), [REVISION]],
  stopAll: [(robot) => robot.stopAll(), [{ stopped: true, inputs: [], text: "" }]],
  release: [(robot) => robot.release(), [null]],
  call: [(robot) => robot.call("f", 1), [1]],
  watch: [(robot) => robot.watch(), [STATUS]],
  status: [async (robot) => {
    for (let turn = 0; turn < 2; turn++) findTrouble(await robot.status(), "c1");
  }, [STATUS, CHANGES]],
  request: [async (robot) => {
    const stream = await robot.request("f");
    await stream.send(1);
    await stream.hold(1, { period: 0.001 }).stop();
    await stream.get({ timeout: 0.001 }).catch((error) => {
      if (error.code !== "timeout") throw error;
    });
    await stream.kill();
  }, [OPENED, STATUS]],
};
const CHANGE = { number: 1, time: 1, subject: "bridge a", change: "lost", cause: "", function: "" };
const NOTICES = [
  { op: "Status", type: "hello", jsonMessage: { message_bytes: 4096 } },
  { op: "Status", type: "change", jsonMessage: CHANGE },
  { op: "Data", type: "c1", "x-number": 1, jsonMessage: 1 },
  { op: "Error", type: "c1", jsonMessage: { code: "message", text: "no form" } },
  { op: "Reply", id: "keep", jsonMessage: { key: "k", seconds: 0.01 } },
  { op: "Status", type: "connection", jsonMessage: { connection: "c1", state: "closed", cause: "", number: 1 } },
];

/** A connection to a server that answers with what it is given, after notices; then it ends. */
function serverOf(answers, notices) {
  const left = [...answers];
  let made = 0;
  return class {
    constructor() {
      const isFirst = !made++;
      setImmediate(() => isFirst ? this.deliver({ op: "Status", type: "hello", jsonMessage: {} }) : this.onerror({}));
    }
    deliver(message) {
      this.onmessage?.({ data: JSON.stringify(message) });
    }
    send(text) {
      const { op, type, id } = JSON.parse(text);
      if (op === "Resume") return;
      const isAsked = !["Data", "Kill"].includes(op) && (op !== "Stop" || type === undefined);
      setImmediate(() => {
        for (const notice of notices) this.deliver(notice);
        if (isAsked && !left.length) this.onclose?.({ code: 1006, reason: "" });
        else this.deliver({ op: "Reply", id, type, ...(isAsked && { jsonMessage: left.shift() }) });
      });
    }
    close() {}
  };
}

async function ask(name, answers, notices = []) {
  const WebSocket = serverOf(answers, notices);
  const robot = await connect("ws://x/", { WebSocket, reconnect: 0, timeout: 1 });
  try {
    return await QUESTIONS[name][0](robot);
  } finally {
    robot.close();
  }
}

/** Numbers below 1 that look like chance, and are the same each time. */
function chance(seed) {
  return () => {
    seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
    return seed / 2 ** 32;
  };
}

const STRANGE = [null, true, -1, 1.5, 2 ** 70, "", "c1", [], {}, [null], [[]], { c1: null }, { since: 1 }, [{ op: 1 }]];

/** Values of which one is wrong somewhere: a part is another, or missing. */
function spoilt(right, next) {
  const whole = structuredClone(right);
  const places = [];
  const collect = (value) => {
    for (const key of Object.keys(value ?? {})) {
      places.push([value, key]);
      if (typeof value[key] === "object") collect(value[key]);
    }
  };
  collect(whole);
  const [place, key] = places[Math.floor(next() * places.length)];
  if (next() < 0.3 && !Array.isArray(place)) delete place[key];
  else place[key] = structuredClone(STRANGE[Math.floor(next() * STRANGE.length)]);
  return whole;
}

const isOurs = (error) => {
  assert.ok(error instanceof UoarmError, error.stack);
};

test("what the protocol has is taken, and a wrong answer is an error of ours", async () => {
  for (const name of Object.keys(QUESTIONS)) {
    await ask(name, QUESTIONS[name][1], NOTICES.slice(0, 2));
    const next = chance(7);
    for (let turn = 0; turn < 100; turn++) await ask(name, spoilt(QUESTIONS[name][1], next)).catch(isOurs);
  }
});

test("a wrong notice is an error of ours", async () => {
  const next = chance(8);
  for (let turn = 0; turn < 300; turn++) {
    const name = ["functions", "request", "status"][turn % 3];
    await ask(name, QUESTIONS[name][1], spoilt(NOTICES, next)).catch(isOurs);
  }
});

test("every question of the client is tried", async () => {
  const robot = await connect("ws://x/", { WebSocket: serverOf([], []), reconnect: 0 });
  robot.close();
  const methods = Object.entries(Object.getOwnPropertyDescriptors(Object.getPrototypeOf(robot)));
  const public_ = methods.filter(([, { value }]) => typeof value === "function").map(([name]) => name);
  const others = ["constructor", "start", "close"];
  assert.deepEqual(public_.filter((name) => !others.includes(name)).sort(), Object.keys(QUESTIONS).sort());
});

test("what is wrong with an answer is said", async () => {
  const text = "the server's Reply to List.functions: expected list, got null";
  await assert.rejects(ask("functions", [{ functions: null }]), { code: "unreadable", message: text });
});

test("a server that answers nothing is not waited for without end", async () => {
  const sent = [];
  let socket;
  class WebSocket {
    constructor() {
      socket = this;
      setImmediate(() => this.deliver(NOTICES[0]));
    }
    deliver(message) {
      this.onmessage({ data: JSON.stringify(message) });
    }
    send(text) {
      sent.push(JSON.parse(text));
    }
    close() {}
  }
  const robot = await connect("ws://x/", { WebSocket, answer: 0.01 });
  await assert.rejects(robot.functions(), {
    code: "timeout", message: "the server at ws://x/ has not answered List within 0.01 s",
  });
  await assert.rejects(robot.call("add", 1, { timeout: 0.01 }), { code: "timeout" });
  assert.deepEqual(sent.at(-1).jsonMessage, { call: true });
  await assert.rejects(robot.request("f"), { code: "timeout" });
  const { id } = sent.at(-1);
  socket.deliver({ op: "Reply", type: "f", id, jsonMessage: OPENED }); // too late: it has no user
  assert.deepEqual([sent.at(-1).op, sent.at(-1).type], ["Kill", "c1"]);
  robot.close();
});

test("CBOR that says more than it has takes no memory or time", () => {
  const nested = Uint8Array.from({ length: 5000 }, (_, at) => [0x9a, 1, 0, 0, 0][at % 5]);
  assert.throws(() => decode(nested), /ends too early/);
  const rows = [0xd8, 40, 0x82, 0x82, 0xfb, 0x3e, 0x10, 0, 0, 0, 0, 0, 0, 1, 0x82, 1, 2];
  assert.throws(() => decode(Uint8Array.from(rows)), /not of its sizes/);
  const wide = Uint8Array.from([0xc2, 0x59, 0x10, 0, ...Array(4096).fill(255)]);
  assert.throws(() => decode(wide), /too long/);
});

test("arrays of several dimensions are lists in lists", () => {
  const rows = (sizes, items) => decode(Uint8Array.from([0xd8, 40, 0x82, 0x80 + sizes.length, ...sizes, ...items]));
  assert.deepEqual(rows([1, 2, 3], [0x46, 1, 2, 3, 4, 5, 6]), [[[1, 2, 3], [4, 5, 6]]]);
  assert.deepEqual(rows([2, 1], [0xd8, 72, 0x42, 255, 1]), [[-1], [1]]);
  assert.deepEqual(rows([2], [0x82, 1, 2]), [1, 2]);
  assert.deepEqual(rows([0, 4], [0x40]), []);
});

test("integers of any width are written as CBOR has them", () => {
  const hex = (value) => Buffer.from(encode(value)).toString("hex");
  const vectors = { // of RFC 8949
    "05": 5n, "24": -5n, "1bffffffffffffffff": 2n ** 64n - 1n, "3bffffffffffffffff": -(2n ** 64n),
    c249010000000000000000: 2n ** 64n, c349010000000000000000: -(2n ** 64n) - 1n,
  };
  for (const [written, value] of Object.entries(vectors)) {
    assert.equal(hex(value), written);
    assert.equal(BigInt(decode(encode(value))), value);
  }
});

test("CBOR has what JSON has of each value, and nothing is lost without a word", () => {
  class Own extends Float32Array {}
  const value = {
    date: new Date(0), none: undefined, act() {}, sign: Symbol("s"), list: [undefined, () => {}],
    own: new Own([1.5]), view: new DataView(new ArrayBuffer(1)), node: Buffer.from([1]),
  };
  assert.deepEqual(decode(encode(value)), {
    date: "1970-01-01T00:00:00.000Z", list: [null, null], own: [1.5], view: new Uint8Array(1),
    node: Uint8Array.of(1),
  });
  assert.throws(() => encode({ text: "\ud800" }), /half of a surrogate pair/);
});

test("CBOR that is too deep for the stack is named as such", () => {
  let deep = 0;
  for (let depth = 0; depth < 1e5; depth += 1) deep = [deep];
  assert.throws(() => encode(deep), /more than 512 values within one another/);
  assert.throws(() => decode(new Uint8Array(1e5).fill(0x81)), /more than 512 values within one another/);
});
