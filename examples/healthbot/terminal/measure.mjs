// From streams of messages to one value each: who is there, the pulse, the oxygen saturation.

const LOOKS = 3;
const READINGS = 5;
const NO_FACE_MEANS_GONE = 50;

/** Resolves once a face has been seen in a few pictures in a row. */
export async function waitForFace(robot) {
  const pictures = await robot.request("faceDetection", { queue: { policy: "latest" } });
  let row = 0;
  for await (const { boxes } of pictures) {
    row = boxes.length ? row + 1 : 0;
    if (row === LOOKS) return;
  }
  throw new Error("the camera's pictures have ended");
}

/** The name that most of a few looks agree on; null for a stranger. */
export async function recognise(robot) {
  const looks = await robot.request("faceRecognition", { queue: { policy: "latest" } });
  const seen = [];
  let empty = 0;
  for await (const { persons } of looks) {
    if (persons.length) seen.push(persons[0].name);
    else empty += 1;
    if (seen.length === LOOKS) return mostFrequent(seen);
    if (empty === NO_FACE_MEANS_GONE) return null;
  }
  throw new Error("recognition has ended");
}

/** The median of a few good readings of one field. */
export async function reading(robot, name, field, hint, { seconds = 45 } = {}) {
  const stream = await robot.request(name, { every: 0.2 });
  const limit = setTimeout(() => stream.kill().catch(() => {}), seconds * 1000);
  const values = [];
  let shown = "";
  try {
    for await (const message of stream) {
      if (message.quality === "good" && message[field] !== undefined) values.push(message[field]);
      else if (message.quality !== shown) hint((shown = message.quality));
      if (values.length === READINGS) return median(values);
    }
  } finally {
    clearTimeout(limit);
  }
  throw new Error(`no good reading of ${name} within ${seconds} s`);
}

function median(values) {
  const sorted = values.toSorted((a, b) => a - b);
  return sorted[Math.floor(sorted.length / 2)];
}

function mostFrequent(values) {
  const count = (value) => values.filter((each) => each === value).length;
  return values.toSorted((a, b) => count(b) - count(a))[0];
}
