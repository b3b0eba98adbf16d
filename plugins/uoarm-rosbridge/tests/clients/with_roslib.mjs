// An ordinary roslib program, run against the server: each step fails loudly or passes.
import assert from "node:assert";
import { pathToFileURL } from "node:url";

const [url, folder, seconds] = process.argv.slice(2);
const entry = pathToFileURL(`${folder}/node_modules/roslib/dist/RosLib.js`);
const { Action, Ros, Topic, Service } = await import(entry);

const within = (work, what) =>
  Promise.race([
    work,
    new Promise((_, no) => setTimeout(() => no(new Error(`too late: ${what}`)), 1000 * seconds).unref()),
  ]);

const ros = new Ros({});
const connected = new Promise((yes, no) => { ros.on("connection", yes); ros.on("error", no); });
await ros.connect(url);
await within(connected, "connection");

const topics = await within(new Promise((yes, no) => ros.getTopics(yes, no)), "topics");
assert(topics.topics.includes("/uoarm/numbers"));
const services = await within(new Promise((yes, no) => ros.getServices(yes, no)), "services");
assert(services.includes("/uoarm/add"));
const nodes = await within(new Promise((yes, no) => ros.getNodes(yes, no)), "nodes");
assert(nodes.includes("/adder"));
const details = await within(
  new Promise((yes, no) => ros.getMessageDetails("Picture", yes, no)), "details");
assert.deepEqual(details[0].fieldnames, ["width", "data"]);

const raw = await within(
  new Promise((yes, no) => ros.getTopicsAndRawTypes(yes, no)), "raw types");
assert.match(raw.typedefs_full_text[raw.topics.indexOf("/uoarm/picture")], /^int64 width/);
assert.equal(await within(new Promise((yes, no) =>
  ros.getTopicType("/uoarm/numbers", yes, no)), "type"), "Number");
assert((await within(new Promise((yes, no) =>
  ros.getTopicsForType("Number", yes, no)), "topics of a type")).includes("/uoarm/numbers"));
assert.equal(await within(new Promise((yes, no) =>
  ros.getServiceType("/uoarm/add", yes, no)), "service type"), "Pair");
assert((await within(new Promise((yes, no) =>
  ros.getServicesForType("Pair", yes, no)), "services of a type")).includes("/uoarm/add"));
assert.deepEqual(await within(new Promise((yes, no) => ros.getParams(yes, no)), "params"), []);
assert((await within(new Promise((yes, no) =>
  ros.getServiceRequestDetails("Pair", yes, no)), "request")).typedefs.length);
assert((await within(new Promise((yes, no) =>
  ros.getServiceResponseDetails("Pair", yes, no)), "response")).typedefs.length);

// The test plays three numbers, then a picture, as soon as each topic is open.
const doubled = new Topic({ ros, name: "/uoarm/doubled", messageType: "any/Type", queue_length: 10 });
const numbers = [];
await within(new Promise((yes) => doubled.subscribe((message) => {
  if (numbers.push(message.value) === 3) yes();
})), "numbers");
assert.deepEqual(numbers, [2, 4, 6]);
doubled.unsubscribe();

const picture = new Topic({ ros, name: "/uoarm/picture", messageType: "any/Type", compression: "cbor" });
const shown = await within(new Promise((yes) => picture.subscribe(yes)), "picture");
assert.deepEqual([...shown.data], [...Array(256).keys()]);
picture.unsubscribe();

const packed = new Topic({ ros, name: "/uoarm/picture", messageType: "any/Type", compression: "png" });
const unpacked = await within(new Promise((yes) => packed.subscribe(yes)), "packed picture");
assert.deepEqual([...Buffer.from(unpacked.data, "base64")], [...Array(256).keys()]);
packed.unsubscribe();

const rawTopic = new Topic({ ros, name: "/uoarm/picture", messageType: "any/Type", compression: "cbor-raw" });
const serialised = await within(new Promise((yes) => rawTopic.subscribe(yes)), "serialised picture");
const { bytes, secs } = serialised;
const view = new DataView(bytes.buffer, bytes.byteOffset);
assert.ok(Math.abs(secs - Date.now() / 1000) < seconds);
assert.equal(view.getBigInt64(4, bytes[1] === 1), 16n);
assert.deepEqual([...bytes.slice(16)], [...Array(256).keys()]);
rawTopic.unsubscribe();

const echo = new Topic({ ros, name: "/uoarm/echo", messageType: "any/Type" });
const received = [];
const all = new Promise((yes) => echo.subscribe((message) => {
  received.push(message.value);
  if (message.value === 20) yes();
}));
await within(new Promise((yes, no) => ros.getTopics(yes, no)), "topics");
for (let value = 0; value <= 20; value++) echo.publish({ value });
await within(all, "echo");
echo.unadvertise();

const add = new Service({ ros, name: "/uoarm/add", serviceType: "any/Type" });
const sum = await within(new Promise((yes, no) => add.callService({ a: 2, b: 3 }, yes, no)), "sum");
assert.equal(sum.value, 5);

const half = new Service({ ros, name: "/half", serviceType: "any/Half" });
half.advertise((request, response) => { response.x = request.x / 2; return true; });
// advertise sends later, without saying when.
const listed = async () => {
  while (!(await new Promise((yes, no) => ros.getServices(yes, no))).includes("/half"));
};
await within(listed(), "half is advertised");
const asked = new Service({ ros, name: "/half", serviceType: "any/Half" });
const answer = await within(new Promise((yes, no) => asked.callService({ x: 8 }, yes, no)), "half");
assert.equal(answer.x, 4);
half.unadvertise();

const broken = new Service({ ros, name: "/uoarm/broken", serviceType: "any/Type" });
const error = await within(new Promise((yes, no) =>
  broken.callService({ value: 6 }, () => no(new Error("it answered")), yes)), "error");
assert.match(String(error), /cannot do 6/);

const walk = new Action({ ros, name: "/uoarm/navigate", actionType: "any/Walk" });
const steps = [];
const walked = await within(new Promise((yes, no) =>
  walk.sendGoal({ value: 3 }, yes, (feedback) => steps.push(feedback.step), no)), "result");
assert.deepEqual([walked, steps], [{ walked: 3 }, [0, 1, 2]]);
const cancelled = await within(new Promise((yes, no) => {
  const id = walk.sendGoal({ value: 0 }, () => no(new Error("it ended")), null, yes);
  walk.cancelGoal(id);
}), "cancelled");
assert.match(cancelled, /CANCELED/i);
const allCancelled = await within(new Promise((yes, no) => {
  walk.sendGoal({ value: 0 }, () => no(new Error("it ended")), null, yes);
  walk.cancelAllGoals();
}), "all cancelled");
assert.match(allCancelled, /CANCELED/i);
const rejected = await within(new Promise((yes, no) =>
  walk.sendGoal({ value: -1 }, () => no(new Error("it ended")), null, yes)), "rejected");
assert.match(rejected, /rejected/);

// One connection offers an action, another sends it goals.
const other = new Ros({});
await other.connect(url);
const count = new Action({ ros: other, name: "/count", actionType: "any/Count" });
count.advertise((goal, id) => {
  if (goal.to < 0) { count.setFailed(id); return; }
  count.sendFeedback(id, { at: 1 });
  if (goal.to > 0) count.setSucceeded(id, { at: goal.to });
}, (id) => count.setCanceled(id, { at: 1 }));
const offered = async () => {
  while (!(await new Promise((yes, no) => ros.getActionServers(yes, no))).includes("/count"));
};
await within(offered(), "count is advertised");
const counter = new Action({ ros, name: "/count", actionType: "any/Count" });
const seen = [];
const counted = await within(new Promise((yes, no) =>
  counter.sendGoal({ to: 5 }, yes, (feedback) => seen.push(feedback.at), no)), "counted");
assert.deepEqual([counted, seen], [{ at: 5 }, [1]]);
const stopped = await within(new Promise((yes, no) => {
  const id = counter.sendGoal({ to: 0 }, () => no(new Error("it ended")),
    () => counter.cancelGoal(id), yes);
}), "stopped");
assert.match(stopped, /CANCELED/i);
const failed = await within(new Promise((yes, no) =>
  counter.sendGoal({ to: -1 }, () => no(new Error("it ended")), null, yes)), "failed");
assert.match(failed, /aborted/);
count.unadvertise();
other.close();

ros.close();
console.log("done");
process.exit(0);
