// A visit at the HealthBot in a terminal: waits for a face, greets, measures, stores, reports.
//
//   node --experimental-websocket main.mjs [ws://127.0.0.1:9080/]
//
// Ends by itself: 0 when all was measured and kept, 1 when something was missing, 2 without a robot.
// (The flag is for Node 20; from 22 on WebSocket is there without it.)

import { connect } from "../../../src/uoarm/server/static/uoarm.js";
import { reading, recognise, waitForFace } from "./measure.mjs";
import { line, table } from "./screen.mjs";

const ROBOT = process.argv[2] ?? "ws://127.0.0.1:9080/";
const VISIT = crypto.randomUUID();
const HINTS = { searching: "The clip is looking for your pulse.", "finger-out": "Put your finger into the clip." };
const SPOKEN_SECONDS = 20;
const PRESSURE_SECONDS = 60;

async function say(robot, text) {
  line("robot", text);
  try {
    await robot.call("speechGeneration", { text }, { timeout: SPOKEN_SECONDS });
  } catch (error) {
    line("note", `not spoken: ${error.message}`);
  }
}

async function keep(robot, patient, measured) {
  const request = { patient, visit: VISIT, time: new Date().toISOString(), ...measured };
  try {
    const { stored, waiting } = await robot.call("patientRecord", request);
    return stored ? "stored" : `kept, ${waiting} waiting to be sent`;
  } catch (error) {
    return `not stored: ${error.message}`;
  }
}

/** Measures one thing; a failure is a row of the report, not the end of the visit. */
async function step(title, measure, store) {
  try {
    const { shown, measured } = await measure();
    line("measured", `${title}: ${shown}`);
    return { title, shown, outcome: await store(measured) };
  } catch (error) {
    return { title, shown: "not measured", outcome: error.message };
  }
}

async function visit(robot) {
  line("wait", "Looking for a face ...");
  await waitForFace(robot);
  const name = await recognise(robot);
  const patient = (name ?? "guest").toLowerCase();
  await say(robot, name ? `Hello ${name}, good to see you.` : "Hello. I do not know you yet; you are my guest.");

  const hint = (quality) => line("robot", HINTS[quality] ?? `The clip says: ${quality}.`);
  const store = (measured) => keep(robot, patient, measured);
  const number = async (name, field, kind, unit) => {
    const value = await reading(robot, name, field, hint);
    return { shown: `${value} ${unit}`, measured: { kind, value } };
  };
  const rows = [];
  await say(robot, "Please put your finger into the clip.");
  rows.push(await step("Pulse", () => number("pulseRate", "pulse", "pulse", "a minute"), store));
  rows.push(await step("Oxygen", () => number("bloodOxygen", "spo2", "spo2", "%"), store));
  await say(robot, "Now rest your arm in the cuff, and press its button.");
  rows.push(await step("Blood pressure", async () => {
    const { systolic, diastolic } = await robot.call("bloodPressure", {}, { timeout: PRESSURE_SECONDS });
    return {
      shown: `${systolic} over ${diastolic} mmHg`,
      measured: { kind: "pressure", systolic, diastolic },
    };
  }, store));
  await say(robot, "That was all. Thank you, and goodbye.");
  table(`Visit of ${name ?? "a guest"}`, rows.map(({ title, shown, outcome }) => [title, shown, outcome]));
  return rows.every(({ outcome }) => outcome === "stored" || outcome.startsWith("kept")) ? 0 : 1;
}

let robot;
try {
  robot = await connect(ROBOT);
} catch (error) {
  line("note", `There is no robot: ${error.message}`);
  process.exit(2);
}
try {
  process.exitCode = await visit(robot);
} catch (error) {
  line("note", `The visit had to end: ${error.message}`);
  process.exitCode = 1;
} finally {
  robot.close();
}
