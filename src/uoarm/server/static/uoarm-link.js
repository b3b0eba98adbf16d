// The connection to a server: one WebSocket, and after a drop another one with the same session.

const DROPPED = 1006;
const KEEP = "keep";
const RESUME = "resume";
const MOST_WAITING = 4096;
const FIRST_PAUSE = 50;
const LONGEST_PAUSE = 5000;
// A WebSocket does not say which of these it was.
const REFUSED =
  "nothing listens there, its certificate is not trusted, or it refused the token or the origin";

/** What the server refused, or why the connection ended; `code` is that of the protocol. */
export class UoarmError extends Error {
  constructor(code, text) {
    super(text);
    this.name = "UoarmError";
    this.code = code;
  }
}

/** Sends and receives control messages; `take` gets all but those about resuming. */
export class Link {
  #open;
  #form;
  #take;
  #ended;
  #timeout;
  #socket = null;
  #unanswered = new Set();
  #queue = [];
  #key = null;
  #seconds = 0;
  #over = false;
  resumed = 0;

  constructor({ open, form, timeout, take, ended }) {
    this.#open = open;
    this.#form = form;
    this.#timeout = timeout;
    this.#take = take;
    this.#ended = ended;
  }

  /** Connect; with `resume` the server is asked to keep the session over drops. */
  start(resume) {
    return this.#connect(this.#timeout, (socket, told, greeted) => {
      this.#socket = socket;
      this.#take(told);
      if (resume) this.#write(socket, { op: "Resume", id: KEEP });
      greeted();
    });
  }

  /** Send one message that will be answered, at once or when the connection is renewed. */
  send(fields) {
    const told = { id: fields.id, frame: this.#form.write(fields) };
    if (this.#socket) this.#pass(told);
    else this.#queue.push(told);
  }

  close() {
    this.#over = true;
    this.#socket?.close();
  }

  /** Open a socket; `greet` gets its first message, and calls `greeted` when all is well. */
  #connect(timeout, greet) {
    return new Promise((resolve, reject) => {
      const socket = this.#open();
      socket.binaryType = "arraybuffer";
      let state = "opening";
      const fail = (error) => {
        if (state === "greeted" || state === "failed") return;
        state = "failed";
        clearTimeout(late);
        socket.close();
        reject(error);
      };
      const late = setTimeout(
        () => fail(new UoarmError("closed", `no answer within ${timeout} s`)), timeout * 1000);
      const greeted = () => {
        state = "greeted";
        clearTimeout(late);
        resolve();
      };
      socket.onmessage = ({ data }) => {
        const told = this.#form.read(data);
        if (state === "opening") {
          state = "greeting";
          greet(socket, told, greeted);
        } else if (state === "greeting" && told.id === RESUME) {
          if (told.op === "Reply") greet(socket, told, greeted);
          else fail(new UoarmError("unknown", told.jsonMessage.text));
        } else if (state !== "failed") this.#hear(told);
      };
      socket.onerror = () => fail(new UoarmError("closed", REFUSED));
      socket.onclose = (event) => {
        if (state === "greeted") this.#closed(event);
        else fail(new UoarmError("closed", event.reason || REFUSED));
      };
    });
  }

  #closed({ code, reason }) {
    this.#socket = null;
    const error = new UoarmError("closed", `the connection ended (${code}) ${reason}`);
    if (code === DROPPED && this.#key && !this.#over) this.#renew(error);
    else this.#end(error);
  }

  async #renew(error) {
    const deadline = Date.now() + this.#seconds * 1000;
    let why = error;
    for (let pause = FIRST_PAUSE; Date.now() < deadline && !this.#over;
      pause = Math.min(2 * pause, LONGEST_PAUSE)) {
      try {
        await this.#goOn(Math.min(this.#timeout, (deadline - Date.now()) / 1000));
        return;
      } catch (refused) {
        why = refused;
        if (refused.code === "unknown") break;
      }
      await new Promise((wake) => setTimeout(wake, pause * (0.5 + Math.random() / 2)));
    }
    this.#end(new UoarmError("closed", `${error.message}; connecting again: ${why.message}`));
  }

  /** Take the session up over a new connection; what waited to be sent follows. */
  #goOn(timeout) {
    let beyond = [];
    return this.#connect(timeout, (socket, told, greeted) => {
      if (told.id !== RESUME) {
        const waiting = [...this.#unanswered].slice(0, MOST_WAITING);
        beyond = [...this.#unanswered].slice(MOST_WAITING);
        const jsonMessage = { key: this.#key, waiting };
        this.#write(socket, { op: "Resume", id: RESUME, jsonMessage });
        return;
      }
      this.#socket = socket;
      this.resumed += 1;
      greeted();
      const lost = { code: "closed", text: "too much waited when the connection dropped" };
      for (const id of beyond) this.#hear({ op: "Error", id, jsonMessage: lost });
      if (this.#over) socket.close();
      else for (const told of this.#queue.splice(0)) this.#pass(told);
    });
  }

  #pass({ id, frame }) {
    this.#unanswered.add(id);
    this.#socket.send(frame);
  }

  #hear(told) {
    if (told.id !== KEEP) {
      this.#unanswered.delete(told.id);
      this.#take(told);
    } else if (told.op === "Reply") {
      this.#key = told.jsonMessage.key;
      this.#seconds = told.jsonMessage.seconds;
    }
  }

  #write(socket, fields) {
    socket.send(this.#form.write(fields));
  }

  #end(error) {
    this.#over = true;
    this.#ended(error);
  }
}
