// A body thermometer in Node.js, written from plugins/uoarm-rocos/docs/profile.md alone: no package, no uoarm.
//
//   node thermometer.js --tcp 7201          listens on loopback, prints its URL
//   node thermometer.js --serial /dev/tty…  speaks on a serial port that is already set up
'use strict';
const fs = require('fs');
const net = require('net');

const CATALOGUE = (id, seq) =>
  `<catalogue profile="1" device="thermometer.js" revision="1" heartbeat="1.0" id="${id}" seq="${seq}">` +
  '<api name="bodyTemperature" kind="flow" period="0.25"><text>Modelled: 36.8 degrees and a slow swing.</text>' +
  '<output><number name="temperature" unit="Cel" minimum="20" maximum="45"/>' +
  '<string name="place"><choice>ear</choice><choice>mouth</choice></string></output></api>' +
  '<api name="choosePlace" kind="service"><text>Say where the thermometer is held.</text>' +
  '<input><string name="place"><choice>ear</choice><choice>mouth</choice></string></input>' +
  '<output><string name="before"><choice>ear</choice><choice>mouth</choice></string></output></api>' +
  '</catalogue>';
const PERIOD = 250, HEARTBEAT = 1000, LIMIT = 65536;

const TABLE = Array.from({ length: 256 }, (_, n) => {
  for (let bit = 0; bit < 8; bit++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n >>> 0;
});
function crc32(octets) {
  let crc = 0xffffffff;
  for (const octet of octets) crc = TABLE[(crc ^ octet) & 255] ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

class LengthFrames {                       // section 1, TCP
  constructor() { this.buffer = Buffer.alloc(0); }
  frame(message) {
    const head = Buffer.alloc(4);
    head.writeUInt32BE(message.length);
    return Buffer.concat([head, message]);
  }
  feed(data) {
    this.buffer = Buffer.concat([this.buffer, data]);
    const found = [];
    while (this.buffer.length >= 4) {
      const size = this.buffer.readUInt32BE(0);
      if (size === 0 || size > LIMIT) throw new Error(`a frame of ${size} octets`);
      if (this.buffer.length < 4 + size) break;
      found.push(this.buffer.subarray(4, 4 + size));
      this.buffer = this.buffer.subarray(4 + size);
    }
    return found;
  }
}

class StuffedFrames {                      // section 1, serial
  constructor() { this.octets = []; this.escaped = false; }
  frame(message) {
    const crc = Buffer.alloc(4);
    crc.writeUInt32BE(crc32(message));
    const out = [0x7e];
    for (const octet of Buffer.concat([message, crc])) {
      if ([0x7e, 0x7d, 0x11, 0x13].includes(octet)) out.push(0x7d, octet ^ 0x20);
      else out.push(octet);
    }
    return Buffer.from([...out, 0x7e]);
  }
  feed(data) {
    const found = [];
    for (const octet of data) {
      if (octet === 0x7e) {
        const whole = Buffer.from(this.octets);
        const good = !this.escaped && whole.length > 4 && whole.length <= LIMIT + 4 &&
          crc32(whole.subarray(0, -4)) === whole.readUInt32BE(whole.length - 4);
        if (good) found.push(whole.subarray(0, -4));
        this.octets = [];
        this.escaped = false;
      } else if (octet === 0x7d) this.escaped = true;
      else if (this.octets.length <= LIMIT + 4) {
        this.octets.push(this.escaped ? octet ^ 0x20 : octet);
        this.escaped = false;
      }
    }
    return found;
  }
}

class Thermometer {
  constructor(frames, write, fresh) {
    this.frames = frames; this.write = write; this.fresh = fresh;
    this.seq = 0; this.place = 'ear'; this.flows = new Set(); this.spoken = performance.now();
    this.timer = setInterval(() => this.tick(), PERIOD);
  }
  say(build) {
    this.write(this.frames.frame(Buffer.from(build(this.seq), 'utf8')));
    this.seq = (this.seq + 1) >>> 0;
    this.spoken = performance.now();
  }
  tick() {
    const seconds = Date.now() / 1000;
    const degrees = 36.8 + 0.3 * Math.sin((2 * Math.PI * seconds) / 60);
    for (const id of this.flows) {
      this.say((seq) => `<data id="${id}" seq="${seq}" time="${seconds}">` +
        `<number name="temperature">${degrees.toFixed(2)}</number>` +
        `<string name="place">${this.place}</string></data>`);
    }
    if (performance.now() - this.spoken >= HEARTBEAT) this.say((seq) => `<heartbeat seq="${seq}"/>`);
  }
  take(data) {
    for (const frame of this.frames.feed(data)) this.answer(frame.toString('utf8'));
  }
  answer(text) {
    const [, tag, head] = /^<([a-z]+)((?: [a-z]+="[^"<]*")*)\s*\/?>/.exec(text) || [];
    if (!tag) return;
    const { id, seq, api, direction, profile } =
      Object.fromEntries([...head.matchAll(/([a-z]+)="([^"]*)"/g)].map((one) => one.slice(1)));
    if (seq === '0' && this.fresh) this.flows.clear();   // section 5: another host
    const error = (code, why) => this.say((n) => `<error id="${id}" seq="${n}" code="${code}">${why}</error>`);
    if (tag === 'describe') {
      if (profile !== '1') error('profile', 'this device speaks 1');
      else this.say((n) => CATALOGUE(id, n));
    } else if (tag === 'open') {
      if (api !== 'bodyTemperature' || direction !== 'output') return error('unknown-api', 'no such flow');
      this.say((n) => `<open id="${id}" seq="${n}" api="${api}" direction="output"/>`);
      this.flows.add(id);
    } else if (tag === 'close') {
      if (this.flows.delete(id)) this.say((n) => `<close id="${id}" seq="${n}"/>`);
    } else if (tag === 'call') {
      if (api !== 'choosePlace') return error('unknown-api', 'no such service');
      const asked = /<string name="place">(ear|mouth)<\/string>/.exec(text);
      if (!asked) return error('bad-input', 'place is ear or mouth');
      const before = this.place;
      this.place = asked[1];
      this.say((n) => `<result id="${id}" seq="${n}"><string name="before">${before}</string></result>`);
    }
  }
  end() { clearInterval(this.timer); }
}

const [, , kind, where] = process.argv;
if (kind === '--tcp') {
  const server = net.createServer((socket) => {
    socket.setNoDelay(true);
    const device = new Thermometer(new LengthFrames(), (octets) => socket.write(octets), false);
    socket.on('data', (data) => { try { device.take(data); } catch { socket.destroy(); } });
    socket.on('close', () => device.end());
    socket.on('error', () => socket.destroy());
  });
  server.listen(Number(where), '127.0.0.1', () => console.log(`tcp://127.0.0.1:${server.address().port}`));
} else if (kind === '--serial') {
  const port = fs.openSync(where, fs.constants.O_RDWR | fs.constants.O_NOCTTY);
  const device = new Thermometer(new StuffedFrames(), (octets) => fs.writeSync(port, octets), true);
  fs.createReadStream('', { fd: port }).on('data', (data) => device.take(data)).on('error', () => process.exit(0));
  console.log(where);
} else {
  console.error('say --tcp PORT or --serial PATH');
  process.exit(2);
}
