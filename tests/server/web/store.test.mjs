import assert from "node:assert/strict";
import { test } from "node:test";
import { Store } from "../../../src/uoarm/server/static/app/store.js";

const STATUS = { bridges: [], components: [], connections: [], routes: [], machines: [], version: 1 };

/** A page in front of a robot that answers when the test says so, and draws as slowly. */
async function show(context) {
  let now = 0;
  const [asked, frames] = [[], []];
  context.mock.timers.enable({ apis: ["setInterval", "setTimeout"] });
  context.mock.method(performance, "now", () => now);
  globalThis.document = { hidden: false };
  class Socket {
    readyState = 1;
    send(text) {
      asked.push(JSON.parse(text));
    }
    deliver(message) {
      this.onmessage({ data: JSON.stringify(message) });
    }
    constructor() {
      Socket.made = this;
    }
  }
  const answers = { List: { functions: [] }, Status: STATUS, Approve: { approvals: [] } };
  const store = new Store("ws://x/", { socket: Socket, frame: (act) => frames.push(act) });
  const page = {
    store,
    answers,
    statuses: () => asked.filter(({ op }) => op === "Status").length,
    async answer() {
      for (const { op, id } of asked.splice(0)) Socket.made.deliver({ op: "Reply", id, jsonMessage: answers[op] });
      await new Promise((resolve) => setImmediate(resolve));
    },
    draw(milliseconds) {
      for (const act of frames.splice(0)) act();
      now += milliseconds;
      context.mock.timers.tick(1);
    },
    pass(milliseconds) {
      now += milliseconds;
      context.mock.timers.tick(milliseconds);
    },
  };
  store.unlock("");
  Socket.made.deliver({ op: "Status", type: "hello", jsonMessage: {} });
  await page.answer();
  return page;
}

test("the status is asked every second, and not again before it was answered", async (context) => {
  const page = await show(context);
  page.pass(1000);
  assert.equal(page.statuses(), 1);
  page.pass(3000);
  assert.equal(page.statuses(), 1);
  await page.answer();
  page.pass(1000);
  assert.equal(page.statuses(), 1);
});

test("whose a connection was is known for as long as an event of it is there", async (context) => {
  const page = await show(context);
  for (let turn = 0; turn < 15; turn += 1) {
    const connections = [...Array(100).keys()].map((at) => ({ id: `c${100 * turn + at}`, function: "f", components: [] }));
    page.answers.Status = { ...STATUS, connections: [{ id: "c", function: "g", components: [] }, ...connections] };
    page.pass(1000);
    await page.answer();
  }
  const { owners } = page.store;
  assert.deepEqual([owners.size, owners.get("c"), owners.has("c399"), owners.has("c400")], [1101, "g", false, true]);
});

test("what takes long to draw is drawn less often", async (context) => {
  const page = await show(context);
  page.draw(700);
  page.pass(2000);
  assert.equal(page.statuses(), 0);
  page.pass(1000);
  assert.equal(page.statuses(), 1);
});

test("and at least every five seconds, before the server is taken for gone", async (context) => {
  const page = await show(context);
  page.draw(60_000);
  page.pass(4000);
  assert.equal(page.statuses(), 0);
  page.pass(2000);
  assert.equal(page.statuses(), 1);
});
