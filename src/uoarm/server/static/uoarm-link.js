// The connection to a server: one WebSocket, and after a drop another one with the same session.
// Where the session is gone, as after a restart of the server, a new one is begun, if that is wanted.

const DROPPED = 1006;
const KEEP = "keep";
const RESUME = "resume";
const ALIVE = "alive";
const LOOK = 5000;
const MOST_SILENCE = 6; // looks without a message, after which the connection is given up
const CLOSING = 2000; // milliseconds that a server has to close, too, as far as this can be held to
const MOST_WAITING = 4096;
const MUCH = 65536; // octets that the network has not taken
const LONGEST_KEPT = 3600; // seconds for which a server is believed to keep a session
const LONGEST_TIMER = 2 ** 31 - 1; // of more milliseconds it ends at once
const FIRST_PAUSE = 50;
const LONGEST_PAUSE = 5000;
// Closed for what this client did or may not do: it would be so again.
const FINAL = new Set([1000, 1002, 1003, 1007, 1008, 1009, 1010]);
// A WebSocket does not say which of these it was.
const REFUSED =
  "nothing listens there, its certificate is not trusted, or it refused the token or the origin";

/** Seconds of a clock that is never set: when a message was sent, by which the server knows its age. */
export const seconds = () => performance.now() / 1000;

/** Calls a function after so many seconds, which may be infinite. */
export const later = (act, seconds) => setTimeout(act, Math.min(seconds * 1000, LONGEST_TIMER));

/**
 * Opens a WebSocket. That of Node.js keeps its program running until the server closes it, too, and has no method that
 * ends it: it gets `terminate`, as others have, by what undici is given to open it with.
 */
export function opened(Socket, url, protocols) {
  const dispatcher = Socket === globalThis.WebSocket ? globalThis[Symbol.for("undici.globalDispatcher.1")] : null;
  if (!dispatcher) return new Socket(url, protocols);
  let below = null;
  const seen = (handler) => Object.assign(Object.create(handler), {
    onUpgrade(status, headers, socket) {
      below = socket;
      return handler.onUpgrade.call(this, status, headers, socket);
    },
  });
  const dispatch = (options, handler) => dispatcher.dispatch(options, seen(handler));
  return Object.assign(new Socket(url, { protocols, dispatcher: { dispatch } }), { terminate: () => below?.destroy() });
}

/** Closes a WebSocket, in the end without its server, where that is possible. */
function shut(socket) {
  socket.close();
  if (!socket.terminate) return; // a page may be left at any time
  const late = setTimeout(() => socket.terminate(), CLOSING);
  socket.addEventListener("close", () => clearTimeout(late));
}

/** Returns a number of seconds; refuses what is none, of which a timer ends at once. */
export function checkSeconds(name, value) {
  if (typeof value === "number" && value >= 0) return value;
  throw new UoarmError("usage", `${name}: expected a number of seconds, got ${JSON.stringify(value) ?? typeof value}`);
}

/** What the server refused, or why the connection ended; `code` is that of the protocol. */
export class UoarmError extends Error {
  constructor(code, text, options) {
    super(text, options);
    this.name = "UoarmError";
    this.code = code;
  }
}

/** Whether a value is of a kind: `text`, `boolean`, `number`, `null`, `object`, `list` or `any`. */
function isKind(value, kind) {
  if (kind === "any") return true;
  if (kind === "null") return value === null;
  if (kind === "list") return Array.isArray(value);
  if (kind === "object") return isObject(value);
  return typeof value === (kind === "text" ? "string" : kind);
}

function isObject(value) {
  return typeof value === "object" && value !== null && !Array.isArray(value) && !ArrayBuffer.isView(value);
}

/**
 * Returns a value that has a shape; throws where it has not. A shape is a kind, or several with `|`
 * between; in a list, that of each item; in an object, that of each field, with `?` behind the name
 * of one that may be missing, and `*` for all names. Whatever else is there is let through.
 */
export function checked(value, shape, place) {
  const wrong = (wanted) => {
    throw new Error(`${place}: expected ${wanted.replaceAll("|", " or ")}, got ${kindOf(value)}`);
  };
  if (typeof shape === "string") {
    if (!shape.split("|").some((kind) => isKind(value, kind))) wrong(shape);
  } else if (Array.isArray(shape)) {
    if (!Array.isArray(value)) wrong("list");
    value.forEach((item, index) => checked(item, shape[0], `${place}.${index}`));
  } else {
    if (!isObject(value)) wrong("object");
    for (const name of "*" in shape ? Object.keys(value) : []) checked(value[name], shape["*"], `${place}.${name}`);
    for (const [field, inner] of "*" in shape ? [] : Object.entries(shape)) {
      const name = field.replace("?", "");
      if (Object.hasOwn(value, name)) checked(value[name], inner, `${place}.${name}`);
      else if (name === field) checked(undefined, inner, `${place}.${name}`);
    }
  }
  return value;
}

function kindOf(value) {
  if (value === undefined) return "nothing";
  if (value === null) return "null";
  return Array.isArray(value) ? "list" : typeof value;
}

const OWN = [{ connection: "text", number: "number|null" }];
const SHAPES = {
  error: { code: "text", text: "text" },
  kept: { key: "text", seconds: "number" },
  resumed: { own: OWN },
};

/** Returns the error that an Error of the server says. */
export function errorOf(message) {
  const { code, text } = checked(message, SHAPES.error, "Error");
  return new UoarmError(code, text);
}

/** How many octets a frame has on the wire; of a text only where it may have more than `most`. */
function octetsOf(frame, most) {
  if (typeof frame !== "string") return frame.byteLength;
  return frame.length * 3 > most ? new TextEncoder().encode(frame).length : frame.length;
}

/**
 * Sends and receives control messages; `take` gets all but those about resuming.
 *
 * Where the session is gone, `lost` is called with the reason and a new one is tried for `reconnect`
 * seconds; `begun` is called when there is one, `ended` with the reason when there is none. `wentOn`
 * is called with the server's counters of this client where the same session goes on.
 */
export class Link {
  #place;
  #open;
  #form;
  #timeout;
  #resume;
  #reconnect;
  #isFinal = false; // whether the last socket was closed for good
  #take;
  #lost;
  #wentOn;
  #begun;
  #ended;
  #socket = null;
  #trying = null;
  #unanswered = new Set();
  #queue = [];
  #key = null;
  #seconds = 0;
  #over = false;
  #wake = () => {};
  #timer = null;
  #silence = 0; // looks since something came
  resumed = 0;
  restarts = 0;
  trouble = "";  // why the connection ended, and is not there again yet
  most = Infinity;  // octets of a message that the server takes

  constructor({ place = "the server", open, form, timeout, resume, reconnect, take, lost, begun, wentOn, ended }) {
    this.#place = place;
    this.#open = open;
    this.#form = form;
    this.#timeout = timeout;
    this.#resume = resume;
    this.#reconnect = reconnect;
    this.#take = take;
    this.#lost = lost;
    this.#begun = begun;
    this.#wentOn = wentOn;
    this.#ended = ended;
  }

  /** Connect; with `resume` the server is asked to keep the session over drops. */
  start() {
    return this.#connect(this.#timeout, (...greeting) => this.#greet(...greeting));
  }

  #greet(socket, received, greeted) {
    this.#begin(socket);
    this.#take(received);
    if (this.#resume) this.#write(socket, { op: "Resume", id: KEEP, "x-sent": seconds() });
    greeted();
  }

  #begin(socket) {
    this.#socket = socket;
    this.#silence = 0;
    clearInterval(this.#timer);
    this.#timer = setInterval(() => this.#look(), LOOK);
    this.#timer.unref?.(); // in Node.js: it keeps no program running
  }

  /** A network may go without a word: where nothing comes, something is asked that has an answer. */
  #look() {
    const socket = this.#socket;
    if (!socket || this.#over) return;
    this.#silence += 1;
    if (this.#silence <= MOST_SILENCE) {
      this.#write(socket, { op: "Kill", type: ALIVE, id: ALIVE }); // refused: there is no such connection
      return;
    }
    this.#leave(socket);
    this.#closed({ code: DROPPED, reason: `nothing came for ${(MOST_SILENCE * LOOK) / 1000} s` });
  }

  /** Whether `send` waits now, behind much that was sent before. */
  get holdsUp() {
    return this.#socket?.bufferedAmount > MUCH;
  }

  /** Take nothing more of a socket. */
  #leave(socket) {
    socket.onmessage = socket.onclose = null;
    this.#socket = null;
    shut(socket);
  }

  /** Send one message that will be answered, at once or when the connection is renewed. */
  send(fields) {
    const frame = this.#written(fields);
    const octets = octetsOf(frame, this.most);
    if (octets > this.most) {  // the server would end the connection for it
      const text = `the message has ${octets} octets; the server takes ${this.most} at most`;
      throw new UoarmError("message", text);
    }
    const received = { id: fields.id, frame };
    if (this.#socket) this.#pass(received);
    else this.#queue.push(received);
  }

  #written(fields) {
    try {
      return this.#form.write(fields);
    } catch (cause) {
      throw new UoarmError("message", `the message cannot be written: ${cause.message}`, { cause });
    }
  }

  close() {
    this.#over = true;
    clearInterval(this.#timer);
    this.#wake();
    const socket = this.#socket ?? this.#trying;
    if (socket) shut(socket);
  }

  /** Open a socket; `greet` gets its first message, and calls `greeted` when all is well. */
  #connect(timeout, greet) {
    return new Promise((resolve, reject) => {
      const socket = this.#open();
      this.#trying = socket;
      socket.binaryType = "arraybuffer";
      let state = "opening";
      const fail = (error) => {
        if (state === "greeted" || state === "failed") return;
        state = "failed";
        clearTimeout(late);
        shut(socket);
        reject(error);
      };
      const late = later(() => fail(new UoarmError("closed", `no answer within ${Number(timeout.toPrecision(3))} s`)), timeout);
      const greeted = () => {
        state = "greeted";
        clearTimeout(late);
        resolve();
      };
      const receive = (received, octets) => {
        if (state === "opening") {
          state = "greeting";
          greet(socket, received, greeted);
        } else if (state === "greeting" && received.id === RESUME) {
          if (received.op === "Reply") greet(socket, received, greeted);
          else fail(new UoarmError("unknown", errorOf(received.jsonMessage).message));
        } else if (state !== "failed") this.#receive(received, octets);
      };
      socket.onmessage = ({ data }) => {
        this.#silence = 0;
        try {
          const frame = typeof data === "string" ? "text" : "binary";
          if (frame !== this.#form.frame) throw new Error(`a ${frame} frame: expected ${this.#form.frame}`);
          receive(checked(this.#form.read(data), "object", "a message"), data.length ?? data.byteLength);
        } catch (error) {
          const strange = new UoarmError("unreadable", `${this.#place} sent what is no message: ${error.message}`);
          if (state !== "greeted") fail(strange);
          else {
            this.#leave(socket);
            this.#end(strange);
          }
        }
      };
      socket.onerror = () => fail(new UoarmError("closed", REFUSED));
      socket.onclose = (event) => {
        this.#isFinal = FINAL.has(event.code);
        if (state === "greeted") this.#closed(event);
        else fail(new UoarmError("closed", event.reason || REFUSED));
      };
    });
  }

  async #closed({ code, reason }) {
    this.#socket = null;
    let error = new UoarmError("closed", `the connection to ${this.#place} ended (${code}) ${reason}`.trimEnd());
    if (code === DROPPED && this.#key) {
      error = await this.#retry(error, this.#seconds, (timeout) => this.#goOn(timeout));
    }
    if (error && this.#reconnect && !this.#isFinal && !this.#over) error = await this.#beginAnew(error);
    if (error) this.#end(error);
  }

  /** Try until it is done, for so many seconds; resolves to why it is not, or null. */
  async #retry(error, limit, attempt) {
    const deadline = seconds() + limit;
    let why = error;
    const trouble = () => `${error.message}; connecting again: ${why.message}`;
    this.trouble = error.message;
    for (let pause = FIRST_PAUSE; seconds() < deadline && !this.#over;
      pause = Math.min(2 * pause, LONGEST_PAUSE)) {
      try {
        await attempt(Math.min(this.#timeout, deadline - seconds()));
        this.trouble = "";
        return null;
      } catch (refused) {
        why = refused;
        this.trouble = trouble();
        if (refused.code !== "closed" || this.#isFinal) break;
      }
      await new Promise((wake) => {
        this.#wake = wake;
        setTimeout(wake, Math.min(pause * (0.5 + Math.random() / 2), (deadline - seconds()) * 1000));
      });
    }
    return new UoarmError("closed", trouble());
  }

  /** What was asked of the session that is gone is not asked of the new one; what is asked meanwhile is. */
  #beginAnew(error) {
    this.#key = null;
    this.#unanswered.clear();
    this.#queue = [];
    this.restarts += 1;
    this.#lost(error);
    return this.#retry(error, this.#reconnect, (timeout) => this.#connect(timeout, (socket, ...greeting) => {
      this.#greet(socket, ...greeting);
      this.#begun();
      this.#passQueued(socket);
    }));
  }

  /** Take the session up over a new connection; what waited to be sent follows. */
  #goOn(timeout) {
    let beyond = [];
    return this.#connect(timeout, (socket, received, greeted) => {
      if (received.id !== RESUME) {
        const waiting = [...this.#unanswered].slice(0, MOST_WAITING);
        beyond = [...this.#unanswered].slice(MOST_WAITING);
        const jsonMessage = { key: this.#key, waiting };
        this.#write(socket, { op: "Resume", id: RESUME, "x-sent": seconds(), jsonMessage });
        return;
      }
      this.#begin(socket);
      this.resumed += 1;
      this.#wentOn(checked(received.jsonMessage, SHAPES.resumed, "Reply to Resume").own);
      greeted();
      const lost = { code: "closed", text: "too much waited when the connection dropped" };
      for (const id of beyond) this.#receive({ op: "Error", id, jsonMessage: lost });
      this.#passQueued(socket);
    });
  }

  #passQueued(socket) {
    if (this.#over) shut(socket);
    else for (const received of this.#queue.splice(0)) this.#pass(received);
  }

  #pass({ id, frame }) {
    this.#unanswered.add(id);
    this.#socket.send(frame);
  }

  #receive(received, octets) {
    if (received.id === ALIVE) return;
    if (received.id !== KEEP) {
      this.#unanswered.delete(received.id);
      this.#take(received, octets);
    } else if (received.op === "Reply") {
      const { key, seconds: kept } = checked(received.jsonMessage, SHAPES.kept, "Reply to Resume");
      [this.#key, this.#seconds] = [key, Math.min(kept, LONGEST_KEPT)];
    }
  }

  #write(socket, fields) {
    socket.send(this.#form.write(fields));
  }

  #end(error) {
    this.#over = true;
    clearInterval(this.#timer);
    this.#ended(error);
  }
}
