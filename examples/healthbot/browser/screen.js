// The page as a set of sentences: show a step, offer choices, show progress and values.

const part = (id) => document.getElementById(id);

/** Show a step. The prompt gets the focus, so that a screen reader begins there. */
export function show({ step, prompt, more = "", face = false }) {
  [...part("steps").children].forEach((item, index) => {
    item.toggleAttribute("aria-current", index === step);
    if (index === step) item.setAttribute("aria-current", "step");
    item.classList.toggle("done", index < step);
  });
  part("prompt").textContent = prompt;
  part("more").textContent = more;
  part("face").hidden = !face;
  part("values").hidden = true;
  part("choices").replaceChildren();
  progress("");
  part("prompt").focus();
}

/** Show what is going on, on the screen and to a screen reader. */
export function progress(text) {
  part("progress").textContent = text;
  part("progress").classList.toggle("busy", text !== "");
}

/** Offer buttons, the first as the clear next step; resolves to the one that was chosen. */
export function choose(...labels) {
  return new Promise((resolve) => {
    const buttons = labels.map((label, index) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = label;
      button.className = index === 0 ? "first" : "";
      button.addEventListener("click", () => {
        part("choices").replaceChildren();
        resolve(label);
      });
      return button;
    });
    part("choices").replaceChildren(...buttons);
  });
}

/** Show values: a list of { title, value, note }; without a value it was not measured. */
export function values(list) {
  const boxes = list.map(({ title, value, note }) => {
    const box = document.createElement("div");
    const name = document.createElement("dt");
    const number = document.createElement("dd");
    const small = document.createElement("small");
    box.className = value ? "" : "missing";
    name.textContent = title;
    small.textContent = note;
    number.append(value ?? "not measured", small);
    box.append(name, number);
    return box;
  });
  part("values").replaceChildren(...boxes);
  part("values").hidden = false;
}

/** Draw a picture of the camera: rows from the top, three octets a pixel, blue first. */
export function draw({ width, height, data }) {
  const canvas = part("face");
  const octets = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const image = new ImageData(width, height);
  for (let from = 0, to = 0; from < octets.length; from += 3, to += 4) {
    image.data[to] = octets[from + 2];
    image.data[to + 1] = octets[from + 1];
    image.data[to + 2] = octets[from];
    image.data[to + 3] = 255;
  }
  canvas.width = width;
  canvas.height = height;
  canvas.getContext("2d").putImageData(image, 0, 0);
}
