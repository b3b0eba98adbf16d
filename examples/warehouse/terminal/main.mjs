// Orders from a terminal: places some, and shows what becomes of them.
//
//   node --experimental-websocket main.mjs ws://127.0.0.1:9080/ [shelf:kg ...]
//
// Without orders it shows the vehicles until Ctrl-C. Ends by itself: 0 when all is done, 1 when an
// order is refused or the robot goes, 2 without a robot.
// (The flag is for Node 20; from 22 on WebSocket is there without it.)

import { connect } from "../../../src/uoarm/server/static/uoarm.js";

const [ROBOT = "ws://127.0.0.1:9080/", ...wanted] = process.argv.slice(2);
const begun = Date.now();
const say = (text) => console.log(`${((Date.now() - begun) / 1000).toFixed(1).padStart(6)} s  ${text}`);

async function place(robot) {
  const open = new Map();
  for (const [number, one] of wanted.entries()) {
    const [source, load = "5"] = one.split(":");
    const order = `terminal-${begun.toString(36)}-${number + 1}`;
    await robot.call("transport", { order, source, target: "", load: Number(load) });
    open.set(order, "placed");
    say(`${order}: placed, ${load} kg from ${source}`);
  }
  return open;
}

function show({ name, condition, x, y, battery, order }) {
  const where = `${x.toFixed(1)}, ${y.toFixed(1)}`;
  say(`${name.padEnd(16)} ${condition.padEnd(9)} ${where.padEnd(11)} ${Math.round(battery)} %  ${order}`);
}

/** Follow the orders until all are done; without any, show the vehicles. */
async function follow(robot, open) {
  const every = open.size ? 0 : 2;
  for await (const { orders, vehicles } of await robot.request("floor", { every })) {
    if (!open.size) vehicles.forEach(show);
    for (const { order, status, vehicle, mass, why } of orders) {
      const weighed = mass ? `weighs ${mass.toFixed(2)} kg` : "";
      const now = [status, vehicle, weighed, why].filter(Boolean).join(" ");
      if (open.has(order) && open.get(order) !== now) say(`${order}: ${now}`);
      if (open.has(order)) open.set(order, now);
      if (status === "done") open.delete(order);
    }
    if (wanted.length && !open.size) return 0;
  }
  return 1;
}

let robot;
try {
  robot = await connect(ROBOT);
} catch (error) {
  say(`There is no robot: ${error.message}`);
  process.exit(2);
}
try {
  process.exitCode = await follow(robot, await place(robot));
} catch (error) {
  say(`It had to end: ${error.message}`);
  process.exitCode = 1;
} finally {
  robot.close();
}
