// The JavaScript client against the server, in both forms: each step fails loudly or passes.
// The test that runs it ends it when it is late, and says how long it may connect.
import assert from "node:assert";
import { connect, UoarmError } from "../../../src/uoarm/server/static/uoarm.js";
import { decode, encode } from "../../../src/uoarm/server/static/uoarm-cbor.js";

const [url, seconds] = process.argv.slice(2);
const timeout = Number(seconds);
const refused = (work, code) =>
  assert.rejects(work, (error) => error instanceof UoarmError && error.code === code);

for (const value of [
  0, 23, 24, 255, 256, 65535, 65536, 2 ** 32, 2 ** 53 - 1, -1, -24, -25, -(2 ** 40), 1.5, -0.25,
  Infinity, 2n ** 60n, -(2n ** 60n), "", "höß", true, false, null, [], [1, [2]], { a: { b: [1] } },
  new Uint8Array(300), new Float64Array([1, 2]), new Int16Array([-1, 5]), new BigUint64Array([5n]),
]) assert.deepEqual(decode(encode(value)), value);
assert(Number.isNaN(decode(encode(NaN))));
assert.deepEqual(decode(Uint8Array.of(0xd8, 0x52, 0x48, 0x3f, 0xf0, 0, 0, 0, 0, 0, 0)), new Float64Array([1]));
assert.throws(() => decode(Uint8Array.of(0x61)), RangeError);
assert.equal(Object.getPrototypeOf(decode(encode(JSON.parse('{"__proto__": 1}')))), Object.prototype);

for (const binary of [false, true]) {
  const robot = await connect(url, { binary, timeout });
  assert.equal(robot.hello.protocol, 1);
  const names = (await robot.functions()).map((func) => func.name);
  assert(names.includes("numbers"));
  assert.deepEqual(await robot.call("add", { a: 2, b: 3 }), { value: 5 });
  await refused(robot.call("broken", { value: 6 }), "bridge");
  await refused(robot.call("slow", { value: 6 }, { timeout: 0.05 }), "timeout");
  await refused(robot.request("missing"), "resolution");
  await refused(robot.call("add", { a: "x".repeat(robot.hello.message_bytes) }), "message");
  await refused(robot.call("add", { a: "☃".repeat(robot.hello.message_bytes / 3) }), "message");

  // The test plays three numbers and a picture as soon as they are open.
  const doubled = await robot.request("doubled");
  const numbers = [];
  for await (const { value } of doubled) if (numbers.push(value) === 3) break;
  assert.deepEqual(numbers, [2, 4, 6]);
  assert.equal(doubled.lost, 0);
  const picture = await robot.request("picture");
  const { data } = await picture.get();
  assert.deepEqual([...(binary ? data : Buffer.from(data, "base64"))], [...Array(256).keys()]);
  await picture.kill();

  const mute = await robot.request("echo", { receive: false });
  await refused(mute.get(), "usage");
  await refused(mute[Symbol.asyncIterator]().next(), "usage");
  await mute.kill();
  const echo = await robot.request("echo", { queue: { length: 100 } });
  for (let value = 0; value < 20; value++) echo.send({ value });
  for (let value = 0; value < 20; value++) assert.deepEqual(await echo.get(), { value });
  await refused(echo.get({ timeout: 0.01 }), "timeout");
  await refused(echo.send({ value: 300 }), "message");
  await refused(echo.send({ value: 1 }, "other"), "usage");
  const waiting = echo.get();
  robot.close();
  await refused(waiting, "closed");
  await refused(robot.status(), "closed");
  await refused(echo.send({ value: 1 }), "closed");
}
await refused(connect(url.replace(/:\d+/, ":1"), { timeout }), "closed");
console.log("done");
