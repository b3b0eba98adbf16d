// Speech: the robot's voice says the prompt; where it has no loudspeaker, the page plays the sound.

const LIMIT = 15;
const button = document.getElementById("sound");
let on = true;
let playing = null;

button.addEventListener("click", () => {
  on = !on;
  button.textContent = on ? "Sound on" : "Sound off";
  button.setAttribute("aria-pressed", String(on));
  if (!on) playing?.pause();
});

/** Say a text and resolve when it was said; never rejects, since every prompt is also shown. */
export async function say(robot, text) {
  if (!on) return;
  try {
    const { audio, played } = await robot.call("speechGeneration", { text }, { timeout: LIMIT });
    if (!played && audio && on) await play(audio);
  } catch (error) {
    console.warn(`not spoken: ${error.message}`);
  }
}

function play(audio) {
  playing?.pause();
  playing = new Audio(`data:audio/wav;base64,${audio}`);
  return new Promise((resolve) => {
    for (const end of ["ended", "pause", "error"]) playing.addEventListener(end, resolve);
    playing.play().catch(resolve);  // a browser may want a touch before the first sound
  });
}
