// A program that closes its client when a line comes, towards a server that may hang.

import { connect } from "../../../src/uoarm/server/static/uoarm.js";

const robot = await connect(process.argv[2], { timeout: Number(process.argv[3]) });
process.stdin.once("data", () => {
  robot.close();
  process.stdin.destroy();
});
console.log("open");
