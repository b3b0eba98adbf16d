// A program whose connection is cut by the test when it says so.
import assert from "node:assert";
import { connect } from "../../../src/uoarm/server/static/uoarm.js";

const [url, form, seconds] = process.argv.slice(2);
const timeout = Number(seconds);
const say = (line) => process.stdout.write(`${line}\n`);

const robot = await connect(url, { binary: form === "cbor", timeout });
const numbers = await robot.request("numbers");
say("ready");
assert.deepEqual(await numbers.get(), { value: 1 });
const slow = robot.call("slow", { value: 7 });
await robot.status();
say("cut");
assert.deepEqual(await slow, { value: 7 });
assert.deepEqual([await numbers.get(), await numbers.get()], [{ value: 2 }, { value: 3 }]);
assert.equal(robot.resumed, 1);
assert.equal(numbers.lost, 0);
assert.deepEqual(await robot.call("add", { a: 1, b: 2 }), { value: 3 });
robot.close();

const other = await connect(url, { binary: form === "cbor", timeout, resume: false, reconnect: 0.5 });
const stream = await other.request("numbers");
say("end");
await assert.rejects(stream.get(), { code: "closed" });
say("done");
