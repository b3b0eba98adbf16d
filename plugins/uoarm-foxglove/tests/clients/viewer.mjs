// A viewer of the protocol's own client library: node viewer.mjs URL SUBPROTOCOL PACKAGES
// It prints one line of JSON for each thing that it sees, and publishes and calls once.
import { createRequire } from "node:module";

const [url, subprotocol, packages] = process.argv.slice(2);
const require = createRequire(`${packages}/package.json`);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");
const WebSocket = require("ws");

const say = (what) => console.log(JSON.stringify(what));
const socket = new WebSocket(url, [subprotocol]);
socket.on("open", () => say({ subprotocol: socket.protocol }));
const client = new FoxgloveClient({ ws: socket });
const readers = new Map();
const decode = (channel, data) =>
  channel.encoding === "cdr"
    ? new MessageReader(parse(channel.schema, { ros2: true })).readMessage(data)
    : JSON.parse(new TextDecoder().decode(data));

client.on("serverInfo", (info) => say({ capabilities: info.capabilities.slice().sort() }));
client.on("status", (status) => say({ status: status.level, message: status.message }));
client.on("error", (error) => say({ error: String(error) }));
client.on("advertise", (channels) => {
  for (const channel of channels) {
    if (["/numbers", "/loose"].includes(channel.topic)) {
      readers.set(client.subscribe(channel.id), channel);
    }
  }
  const id = client.advertise({ topic: "/echo", encoding: "json", schemaName: "std_msgs/msg/Int32" });
  client.sendMessage(id, new TextEncoder().encode(JSON.stringify({ data: 7 })));
  say({ topics: channels.map((channel) => [channel.topic, channel.encoding]).sort() });
});
client.on("message", ({ subscriptionId, data }) => {
  const channel = readers.get(subscriptionId);
  say({ topic: channel.topic, message: decode(channel, data) });
});
client.on("advertiseServices", (services) => {
  const add = services.find((service) => service.name === "/add");
  const writer = new MessageWriter(parse(add.request.schema, { ros2: true }));
  const data = new DataView(writer.writeMessage({ a: 1, b: 2 }).buffer);
  client.sendServiceCallRequest({ serviceId: add.id, callId: 5, encoding: "cdr", data });
  client.on("serviceCallResponse", (response) => {
    const reader = new MessageReader(parse(add.response.schema, { ros2: true }));
    say({ call: response.callId, reply: reader.readMessage(response.data) });
  });
});
client.on("connectionGraphUpdate", (update) => {
  say({ published: update.publishedTopics.map((topic) => topic.name).sort() });
});
client.on("open", () => client.subscribeConnectionGraph());
process.stdin.on("end", () => process.exit(0)).resume();
