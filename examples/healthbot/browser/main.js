// The visit, one screen after the other, and again for the next person.

import { connect } from "./uoarm.js";
import { newVisit, pressure, record, faceShown, steady, whoIsIt } from "./measuring.js";
import { choose, draw, progress, show, values } from "./screen.js";
import { say } from "./voice.js";

const ROBOT = new URLSearchParams(location.search).get("robot") ?? `ws://${location.hostname}:9080/`;
const PAUSE = 3000;
const CLIP = {
  good: "Measuring. Please keep still.",
  searching: "Looking for your pulse. Please keep still.",
  "finger-out": "Please put your finger into the clip.",
};

async function welcome(robot) {
  show({ step: 0, prompt: "Please step in front of me", more: "I am looking for a face." });
  progress("Looking");
  draw(await faceShown(robot));
  show({ step: 0, prompt: "I can see you", face: true });
  progress("Have we met?");
  const name = await whoIsIt(robot);
  const greeting = name ? `Hello ${name}` : "Hello";
  const more = "I would like to measure your pulse, your oxygen and your blood pressure.";
  show({ step: 0, prompt: greeting, more, face: true });
  const choice = choose("Start", ...(name ? [`I am not ${name}`] : []), "Not now");
  say(robot, `${greeting}. ${more} Press start when you are ready.`);
  const chosen = await choice;
  if (chosen === "Not now") return undefined;
  return chosen === "Start" ? name ?? "guest" : "guest";
}

/** Measures with one device; offers to try again when it fails. Resolves to rows of the results. */
async function station(robot, { step, prompt, more, ready, measure, missing }) {
  for (;;) {
    show({ step, prompt, more });
    say(robot, `${prompt}. ${more}`);
    if ((await choose(ready, "Leave this out")) !== ready) return missing;
    try {
      const rows = await measure();
      progress("");
      return rows;
    } catch (error) {
      console.warn(error.message);
      show({ step, prompt: "That did not work", more: "We can try again, or go on without." });
      say(robot, "That did not work. Shall we try again?");
      if ((await choose("Try again", "Go on")) === "Go on") return missing;
    }
  }
}

function finger(robot, who) {
  return station(robot, {
    step: 1,
    prompt: "Put your finger into the clip",
    more: "Any finger will do. Then rest your hand on the table.",
    ready: "My finger is in",
    missing: [{ title: "Pulse", note: "" }, { title: "Oxygen", note: "" }],
    async measure() {
      const show = (quality) => progress(CLIP[quality] ?? "Please keep your hand still.");
      const pulse = await steady(robot, "pulseRate", "pulse", show);
      const oxygen = await steady(robot, "bloodOxygen", "spo2", show);
      const savedPulse = await record(robot, who, { kind: "pulse", value: pulse });
      const savedOxygen = await record(robot, who, { kind: "spo2", value: oxygen });
      return [
        { title: "Pulse", value: `${pulse}`, note: `beats a minute, ${savedPulse}` },
        { title: "Oxygen", value: `${oxygen} %`, note: `in your blood, ${savedOxygen}` },
      ];
    },
  });
}

function arm(robot, who) {
  return station(robot, {
    step: 2,
    prompt: "Put the cuff around your arm",
    more: "Sit upright, rest your arm on the table, and press the button on the cuff.",
    ready: "The cuff is on",
    missing: [{ title: "Blood pressure", note: "" }],
    async measure() {
      progress("Measuring. Please do not talk or move.");
      const { systolic, diastolic } = await pressure(robot);
      const saved = await record(robot, who, { kind: "pressure", systolic, diastolic });
      return [{ title: "Blood pressure", value: `${systolic} / ${diastolic}`, note: `mmHg, ${saved}` }];
    },
  });
}

async function visit(robot) {
  const name = await welcome(robot);
  if (name === undefined) return;
  const who = { patient: name.toLowerCase(), visit: newVisit() };
  const rows = [...(await finger(robot, who)), ...(await arm(robot, who))];
  show({ step: 3, prompt: "Thank you, these are your values", more: "Please ask a nurse what they mean." });
  values(rows);
  say(robot, `Thank you. ${spoken(rows)} Please ask a nurse what these values mean. Goodbye.`);
  await choose("Finish");
}

function spoken(rows) {
  const known = rows.filter(({ value }) => value);
  return known.map(({ title, value }) => `${title}: ${value.replace(" / ", " over ")}.`).join(" ");
}

async function run() {
  for (;;) {
    let robot;
    try {
      robot = await connect(ROBOT);
      for (;;) await visit(robot);
    } catch (error) {
      console.warn(error.message);
      show({ step: 0, prompt: "I need a moment", more: "The robot is not ready. I am trying again." });
      await new Promise((resolve) => setTimeout(resolve, PAUSE));
    } finally {
      robot?.close();
    }
  }
}

run();
