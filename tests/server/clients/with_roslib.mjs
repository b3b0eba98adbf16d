// An ordinary roslib program, run against the server: each step fails loudly or passes.
import assert from "node:assert";
import { pathToFileURL } from "node:url";

const [url, folder] = process.argv.slice(2);
const entry = pathToFileURL(`${folder}/node_modules/roslib/dist/RosLib.js`);
const { Ros, Topic, Service } = await import(entry);

const within = (work, what) =>
  Promise.race([
    work,
    new Promise((_, no) => setTimeout(() => no(new Error(`too late: ${what}`)), 20000).unref()),
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

const echo = new Topic({ ros, name: "/uoarm/echo", messageType: "any/Type" });
const heard = [];
const all = new Promise((yes) => echo.subscribe((message) => {
  heard.push(message.value);
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

ros.close();
console.log("done");
process.exit(0);
