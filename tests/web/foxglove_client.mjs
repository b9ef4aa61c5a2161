// Foxglove's own client: subscribes to all channels, and writes what comes to standard output, a
// JSON text a line. `foxglove_client.mjs URL [once]`; once: tells the first message of each
// channel only.
// It calls the service of each line {"callId", "service", "fields"} of its input.
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const require = createRequire(new URL("../../.ci/web/package.json", import.meta.url));
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");

const [url, pace] = process.argv.slice(2);
const socket = new WebSocket(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
const client = new FoxgloveClient({ ws: socket });
const topics = new Map();
const services = new Map();
const tell = (told) => process.stdout.write(`${JSON.stringify(told)}\n`);
const json = (text) => new TextEncoder().encode(text);

client.on("error", (error) => tell({ error: String(error) }));
client.on("close", ({ code }) => {
  tell({ closed: code });
  process.exit(0);
});
client.on("status", ({ message }) => tell({ status: message }));
client.on("serverInfo", ({ sessionId, capabilities }) => tell({ sessionId, capabilities }));
client.on("advertise", (channels) => {
  tell({ channels });
  for (const one of channels) topics.set(client.subscribe(one.id), one.topic);
  client.getParameters([], "all");
});
client.on("advertiseServices", (offered) => {
  for (const { id, name } of offered) services.set(name, id);
  tell({ services: [...services.keys()] });
});
client.on("serviceCallResponse", ({ callId, data }) =>
  tell({ callId, answer: JSON.parse(new TextDecoder().decode(data)) }),
);
client.on("serviceCallFailure", ({ callId, message }) => tell({ callId, failure: message }));
client.on("parameterValues", ({ id, parameters }) => tell({ id, parameters }));
const told = new Set();
client.on("message", ({ subscriptionId, timestamp, data }) => {
  if (pace === "once" && told.has(subscriptionId)) return;
  told.add(subscriptionId);
  const octets = Buffer.from(data.buffer, data.byteOffset, data.byteLength);
  tell({
    topic: topics.get(subscriptionId),
    log_ns: String(timestamp),
    data: octets.toString("base64"),
  });
});
const calls = createInterface(process.stdin);
calls.on("line", (line) => {
  const { callId, service, fields } = JSON.parse(line);
  const data = json(JSON.stringify(fields));
  const serviceId = services.get(service);
  client.sendServiceCallRequest({ serviceId, callId, encoding: "json", data });
});
calls.on("close", () => process.exit(0));
