// The robot's functions as this page uses them.

const NEWEST = { queue: { policy: "latest" } };
const PATIENCE = 60_000;
const ENOUGH = 6;

/** Calls `seen` with each message until it returns a value, which this resolves to. */
async function until(robot, name, options, seen, patience = PATIENCE) {
  const stream = await robot.request(name, options);
  const late = patience && setTimeout(() => stream.kill().catch(() => {}), patience);
  try {
    for await (const message of stream) {
      const found = seen(message);
      if (found !== undefined) return found;
    }
  } finally {
    clearTimeout(late);
  }
  throw new Error(`${name} gave no result`);
}

/** Resolves to the picture of a face once a person stays before the camera. */
export function faceShown(robot) {
  let looks = 0;
  return until(robot, "faceDetection", NEWEST, ({ boxes, face }) => {
    looks = boxes.length ? looks + 1 : 0;
    return looks > 2 ? face : undefined;
  }, 0);
}

/** Resolves to a name, or to null for a person whom the robot does not know. */
export function whoIsIt(robot) {
  const votes = new Map();
  let asked = 0;
  return until(robot, "faceRecognition", NEWEST, ({ persons: [person] }) => {
    asked += 1;
    if (asked > 40) return null;
    if (!person) return undefined;
    const count = (votes.get(person.name) ?? 0) + 1;
    votes.set(person.name, count);
    return count === 3 ? person.name : undefined;
  });
}

/** Resolves to the mean of good readings, rounded; `report` gets the clip's complaints. */
export function steady(robot, name, field, report) {
  let sum = 0;
  let count = 0;
  return until(robot, name, { every: 0.2 }, (message) => {
    const good = message.quality === "good" && message[field] !== undefined;
    report(good ? "good" : message.quality);
    if (!good) return undefined;
    sum += message[field];
    count += 1;
    return count === ENOUGH ? Math.round(sum / count) : undefined;
  });
}

export function pressure(robot) {
  return robot.call("bloodPressure", {}, { timeout: PATIENCE / 1000 });
}

/** Returns a name of a visit that no other visit has. */
export function newVisit() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Puts a measurement of `{ patient, visit }` into the record; resolves to a note for the results. */
export async function record(robot, who, measurement) {
  const time = new Date().toISOString();
  try {
    const { stored } = await robot.call("patientRecord", { ...who, time, ...measurement });
    return stored ? "saved" : "will be saved later";
  } catch (error) {
    console.warn(`not saved: ${error.message}`);
    return "could not be saved";
  }
}
