// Foxglove's own client: subscribes to all channels, and writes what comes to standard output, a
// JSON text a line. `foxglove_client.mjs URL [slow]`; slow: reads nothing after its subscriptions.
import { createRequire } from "node:module";

const require = createRequire(new URL("../../.ci/web/package.json", import.meta.url));
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");

const [url, pace] = process.argv.slice(2);
const socket = new WebSocket(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
const client = new FoxgloveClient({ ws: socket });
const topics = new Map();
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
  if (pace === "slow") setTimeout(() => socket.pause(), 1000);
});
client.on("advertiseServices", (services) => {
  const { id } = services.find(({ name }) => name === "/camera/select");
  for (const [callId, camera] of ["head", "nose"].entries()) {
    const data = json(JSON.stringify({ camera }));
    client.sendServiceCallRequest({ serviceId: id, callId, encoding: "json", data });
  }
});
client.on("serviceCallResponse", ({ callId, data }) =>
  tell({ callId, answer: JSON.parse(new TextDecoder().decode(data)) }),
);
client.on("serviceCallFailure", ({ callId, message }) => tell({ callId, failure: message }));
client.on("parameterValues", ({ id, parameters }) => tell({ id, parameters }));
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const octets = Buffer.from(data.buffer, data.byteOffset, data.byteLength);
  tell({
    topic: topics.get(subscriptionId),
    log_ns: String(timestamp),
    data: octets.toString("base64"),
  });
});
process.stdin.on("end", () => process.exit(0)).resume();
