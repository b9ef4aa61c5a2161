/**
 * One WebRTC connection to the server of this page, by WHIP (RFC 9725) or WHEP.
 *
 * It restarts ICE when the way breaks, and connects again, ever later, when that does not help.
 */

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 15_000;
/** A way that stays broken for this long gets a restart of ICE; a restart, a new connection. */
const BROKEN_MS = 3_000;
const GATHER_MS = 3_000;

/** Splits Link header values into ICE servers. @param {string | null} header @returns {RTCIceServer[]} */
function serversOf(header) {
  const found = [];
  for (const [, url, rest] of (header ?? "").matchAll(/<([^<>]+)>((?:\s*;\s*[a-z-]+=(?:"[^"]*"|[^\s",;]+))*)/g)) {
    const values = Object.fromEntries([...(rest ?? "").matchAll(/([a-z-]+)=(?:"([^"]*)"|([^\s",;]+))/g)].map(([, name, quoted, bare]) => [name, quoted ?? bare]));
    if (values.rel !== "ice-server" || url === undefined) continue;
    found.push(values.username === undefined ? { urls: url } : { urls: url, username: values.username, credential: values.credential ?? "" });
  }
  return found;
}

/** Returns ICE's user name and password of a description. @param {string} sdp */
function credentialsOf(sdp) {
  return {
    ufrag: /^a=ice-ufrag:(\S+)/m.exec(sdp)?.[1] ?? "",
    password: /^a=ice-pwd:(\S+)/m.exec(sdp)?.[1] ?? "",
  };
}

/** Returns an answer with other addresses: those of a restart. @param {string} answer @param {string} fragment */
export function restarted(answer, fragment) {
  const { ufrag, password } = credentialsOf(fragment);
  const candidates = fragment.split(/\r?\n/).filter((line) => /^a=(candidate:|end-of-candidates)/.test(line));
  return answer
    .split(/\r?\n/)
    .filter((line) => !/^a=(candidate:|end-of-candidates)/.test(line))
    .flatMap((line) => {
      if (line.startsWith("a=ice-ufrag:")) return [...candidates, `a=ice-ufrag:${ufrag}`];
      if (line.startsWith("a=ice-pwd:")) return [`a=ice-pwd:${password}`];
      return [line];
    })
    .join("\r\n");
}

export class WhipExchange extends EventTarget {
  /** @type {RTCPeerConnection | null} */
  peer = null;
  /** Why it is not connected; "" while it is. */
  fault = "";
  #path;
  #token;
  #fill;
  /** @type {string | null} */
  #session = null;
  #wait = FIRST_WAIT_MS;
  #wanted = true;
  #answer = "";
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  #timer;

  /**
   * @param {string} path Of the endpoint.
   * @param {string} token
   * @param {(peer: RTCPeerConnection) => void} fill Adds tracks or transceivers to a new connection.
   */
  constructor(path, token, fill) {
    super();
    this.#path = path;
    this.#token = token;
    this.#fill = fill;
    addEventListener("pagehide", () => this.#leave(true));
    void this.#connect();
  }

  /** Ends it for good. */
  close() {
    this.#wanted = false;
    clearTimeout(this.#timer);
    this.#leave(false);
  }

  async #connect() {
    try {
      const links = await this.#ask("OPTIONS", this.#path);
      if (!this.#wanted) return;
      const peer = new RTCPeerConnection({ iceServers: serversOf(links.headers.get("Link")), bundlePolicy: "max-bundle" });
      this.peer = peer;
      this.#fill(peer);
      peer.addEventListener("connectionstatechange", () => this.#look(peer));
      await peer.setLocalDescription(await peer.createOffer());
      await gathered(peer);
      const answer = await this.#ask("POST", this.#path, "application/sdp", peer.localDescription?.sdp);
      this.#session = answer.headers.get("Location");
      this.#answer = await answer.text();
      await peer.setRemoteDescription({ type: "answer", sdp: this.#answer });
    } catch (error) {
      this.#again(String(error instanceof Error ? error.message : error));
    }
    this.#tell();
  }

  /** @param {RTCPeerConnection} peer */
  #look(peer) {
    if (peer !== this.peer) return;
    clearTimeout(this.#timer);
    if (peer.connectionState === "connected") {
      this.fault = "";
      this.#wait = FIRST_WAIT_MS;
    } else if (peer.connectionState === "disconnected") {
      this.#timer = setTimeout(() => void this.#restart(peer), BROKEN_MS);
    } else if (peer.connectionState === "failed" || peer.connectionState === "closed") {
      this.#again("the connection broke");
    }
    this.#tell();
  }

  /** @param {RTCPeerConnection} peer */
  async #restart(peer) {
    if (this.#session === null || peer !== this.peer) return;
    try {
      await peer.setLocalDescription(await peer.createOffer({ iceRestart: true }));
      await gathered(peer);
      const sdp = peer.localDescription?.sdp ?? "";
      const { ufrag, password } = credentialsOf(sdp);
      const lines = sdp.split(/\r?\n/).filter((line) => line.startsWith("a=candidate:"));
      const mid = /^a=mid:(\S+)/m.exec(sdp)?.[1] ?? "0";
      const fragment = [`a=ice-ufrag:${ufrag}`, `a=ice-pwd:${password}`, "m=audio 9 RTP/AVP 0", `a=mid:${mid}`, ...new Set(lines), "a=end-of-candidates", ""].join("\r\n");
      const told = await this.#ask("PATCH", this.#session, "application/trickle-ice-sdpfrag", fragment, { "If-Match": "*" });
      this.#answer = restarted(this.#answer, await told.text());
      await peer.setRemoteDescription({ type: "answer", sdp: this.#answer });
      this.#timer = setTimeout(() => peer.connectionState !== "connected" && this.#again("no way was found"), 2 * BROKEN_MS);
    } catch (error) {
      this.#again(String(error instanceof Error ? error.message : error));
    }
  }

  /** @param {string} fault */
  #again(fault) {
    if (!this.#wanted) return;
    this.fault = fault;
    this.#leave(false);
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => void this.#connect(), this.#wait);
    this.#wait = Math.min(this.#wait * 2, LONGEST_WAIT_MS);
    this.#tell();
  }

  /** @param {boolean} keepalive The page ends, the request must not. */
  #leave(keepalive) {
    const session = this.#session;
    this.#session = null;
    const peer = this.peer;
    this.peer = null;
    peer?.close();
    if (session !== null) fetch(session, { method: "DELETE", headers: this.#headers(), keepalive }).catch(() => undefined);
  }

  #headers() {
    return { Authorization: `Bearer ${this.#token}` };
  }

  /**
   * @param {string} method
   * @param {string} path
   * @param {string} [type]
   * @param {string} [body]
   * @param {Record<string, string>} [more]
   */
  async #ask(method, path, type, body, more = {}) {
    const headers = { ...this.#headers(), ...(type === undefined ? {} : { "Content-Type": type }), ...more };
    const answer = await fetch(path, { method, headers, ...(body === undefined ? {} : { body }) });
    if (!answer.ok) throw new Error(`the server answers ${answer.status}`);
    return answer;
  }

  #tell() {
    this.dispatchEvent(new Event("change"));
  }
}

/** Waits until all addresses are found, but not for long. @param {RTCPeerConnection} peer */
function gathered(peer) {
  return new Promise((resolve) => {
    const look = () => peer.iceGatheringState === "complete" && resolve(undefined);
    peer.addEventListener("icegatheringstatechange", look);
    setTimeout(resolve, GATHER_MS);
    look();
  });
}
