// A program whose server is stopped and started again by the test, which answers each line with one.
import assert from "node:assert";
import { createInterface } from "node:readline";
import { connect } from "../../../src/uoarm/server/static/uoarm.js";

const [url, form, seconds] = process.argv.slice(2);
const options = { binary: form === "cbor", timeout: Number(seconds), reconnect: Number(seconds) };
const input = createInterface({ input: process.stdin });
const answers = input[Symbol.asyncIterator]();
const say = async (line) => {
  process.stdout.write(`${line}\n`);
  await answers.next();
};
const until = async (condition) => {
  while (!condition()) await new Promise((wake) => setTimeout(wake, 5));
};

for (const resume of [true, false]) {
  const robot = await connect(url, { ...options, resume });
  const numbers = await robot.request("numbers");
  const echo = await robot.request("echo");
  const given = await robot.request("picture");
  const changes = (await robot.watch())[Symbol.asyncIterator]();
  await say("put 1");
  assert.deepEqual(await numbers.get(), { value: 1 });
  const slow = assert.rejects(robot.call("slow", { value: 7 }), { code: "closed" });
  await robot.status();
  await say("stop");
  await slow;
  await until(() => robot.restarts === 1);
  await assert.rejects(echo.send({ value: 5 }), /nothing was sent/);
  await given.kill();
  const call = robot.call("add", { a: 1, b: 2 }); // asked of the server that comes
  await say("start");
  assert.deepEqual(await call, { value: 3 });
  await until(() => numbers.gaps === 1 && echo.gaps === 1);
  await say("put 2");
  assert.deepEqual(await numbers.get(), { value: 2 });
  assert.deepEqual([numbers.lost, numbers.state, robot.restarts, robot.resumed], [0, "open", 1, 0]);
  await echo.send({ value: 7 });
  assert.deepEqual(await echo.get(), { value: 7 });
  // What ran before the new session watches is in no event: others are requested until one is.
  let watches = false;
  const running = (async () => {
    while ((await changes.next()).value.change !== "running");
    watches = true;
  })();
  while (!watches) await (await robot.request("picture")).kill();
  await running;
  const names = (await robot.status()).own.map((connection) => connection.connection).sort();
  assert.deepEqual(names, [echo.connection, numbers.connection].sort());
  await numbers.kill();
  await echo.kill();
  robot.close();
}

// Without reconnecting; a server that does not come back; one that is closed meanwhile.
for (const reconnect of [0, 0.3]) {
  const robot = await connect(url, { ...options, reconnect });
  const stream = await robot.request("numbers");
  await say("stop");
  await assert.rejects(stream.get(), { code: "closed" });
  assert.equal(stream.state, "failed");
  assert.match(stream.cause, reconnect ? /connecting again: / : /the connection to the server at ws:.* ended/);
  await say("start");
}
const robot = await connect(url, { ...options, reconnect: 1e6 });
const stream = await robot.request("numbers");
await say("stop");
await until(() => robot.restarts === 1);
robot.close();
assert.equal(await stream.get().catch((error) => error.message), "the client was closed");
input.close();
process.stdout.write("done\n");
