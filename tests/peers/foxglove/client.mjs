// Foxglove's own client library against the live view: every channel must bring a message that can be decoded by the schema which
// the server sends, and a service must answer.
//
//     cd tests/peers/foxglove && npm install && node client.mjs ws://127.0.0.1:8765/ [--arm]
//
// It stops the robot, which makes an event. With --arm it arms it again: a robot then drives on. Exits with 1 if a channel stays silent
// or a message cannot be decoded.

import protocol from "@foxglove/ws-protocol";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";
import { WebSocket } from "ws";

const { FoxgloveClient } = protocol;
const [address = "ws://127.0.0.1:8765/"] = process.argv.slice(2);
const arms = process.argv.includes("--arm");
const SECONDS = 12;

const socket = new WebSocket(address, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
const client = new FoxgloveClient({ ws: socket });
const channels = new Map();
const services = new Map();
const answers = new Map();
let failures = 0;

// A schema comes as a serialized FileDescriptorSet, which protobufjs reads by an extension.
function decoder({ encoding, schema, schemaName }) {
  if (encoding === "json") return (bytes) => JSON.parse(new TextDecoder().decode(bytes));
  const set = descriptor.FileDescriptorSet.decode(Buffer.from(schema, "base64"));
  const type = protobuf.Root.fromDescriptor(set).lookupType(schemaName);
  return (bytes) => type.toObject(type.decode(bytes));
}

client.on("advertise", (advertised) => {
  for (const channel of advertised) {
    const subscription = client.subscribe(channel.id);
    channels.set(subscription, { ...channel, count: 0, bytes: 0, decode: decoder(channel) });
  }
});

client.on("message", ({ subscriptionId, data }) => {
  const channel = channels.get(subscriptionId);
  try {
    channel.last = channel.decode(new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
  } catch (error) {
    failures += 1;
    console.error(`${channel.topic}: ${error.message}`);
  }
  channel.count += 1;
  channel.bytes += data.byteLength;
});

client.on("advertiseServices", (advertised) => {
  for (const service of advertised) services.set(service.name, service.id);
});

client.on("serviceCallResponse", ({ callId, data }) => {
  answers.set(callId, JSON.parse(new TextDecoder().decode(data)));
});

client.on("error", (error) => {
  console.error(`${address}: ${error.message ?? error}`);
  process.exit(1);
});

function call(name, callId) {
  const data = new DataView(new TextEncoder().encode("{}").buffer);
  client.sendServiceCallRequest({ serviceId: services.get(name), callId, encoding: "json", data });
}

const pause = (s) => new Promise((resolve) => setTimeout(resolve, 1000 * s));
const calls = [[1, "/robot/stop"], ...(arms ? [[2, "/robot/arm"]] : [])];
await pause(2);
for (const [callId, name] of calls) {
  call(name, callId);
  await pause(1);
}
await pause(SECONDS - 2 - calls.length);

for (const { topic, schemaName, encoding, count, bytes } of channels.values()) {
  console.log(`${topic.padEnd(20)} ${schemaName.padEnd(26)} ${encoding.padEnd(9)} ${String(count).padStart(5)} messages, ${bytes} bytes`);
  if (count === 0) {
    failures += 1;
    console.error(`${topic}: no message`);
  }
}
if (channels.size === 0) {
  failures += 1;
  console.error("the server has advertised no channel");
}
for (const [callId, name] of calls) {
  const answer = answers.get(callId);
  console.log(`${name}: ${JSON.stringify(answer)}`);
  if (!answer) failures += 1;
}
console.log(failures === 0 ? "everything was decoded" : `${failures} failures`);
process.exit(failures === 0 ? 0 : 1);
