// The JavaScript client while a button is held: it renews, stops, and learns who else commands.
import assert from "node:assert";
import { connect } from "../../../src/uoarm/server/static/uoarm.js";

const [url] = process.argv.slice(2);
const late = setTimeout(() => { console.log("too late"); process.exit(1); }, 40000);
const robot = await connect(url);
const other = await connect(url);
const drive = await robot.request("drive");
assert.deepEqual(drive.lifetimes, { default: 3600 });

async function received(count) {
  for (;;) {
    const [route] = (await robot.status()).routes;
    if (route?.received >= count) return;
  }
}

const held = drive.hold(1, { period: 0.001 });
await received(3);
const refused = (await other.request("drive")).hold(9);
await assert.rejects(refused.done, (error) => error.code === "leased" && /holds its lease/.test(error.message));
held.message = 2;
await received(4);
await held.stop();
await held.stop();
await held.done;

const pressed = drive.hold(5); // let go before the first answer
await pressed.stop();
await pressed.done;

const warnings = [];
console.warn = (text) => warnings.push(text);
await drive.hold(6, { period: 3600 }).stop();
assert.match(warnings[0], /commands live for 3600 s, and are renewed every 3600 s/);
robot.close();
other.close();
clearTimeout(late);
console.log("done");
