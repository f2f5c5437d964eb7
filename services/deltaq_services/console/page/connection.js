// The live WebSocket. A command is sent now or not at all: nothing waits for a line that is down.

const SILENT_MS = 1500; // frames come every 40 ms: a line that brings nothing for so long is taken for dead
const OPENING_MS = 5000;
const PING_MS = 500;
const ANSWER_MS = 1000;
const RETRY_MS = [200, 400, 800, 1600];
const CLOCKS_MS = 10000;
const MOST_BUFFERED_BYTES = 4096; // more means that the line does not take what is sent

export class Connection extends EventTarget {
  /**
   * Events: "frame" (ArrayBuffer), each text message by its type, "up", "down", and "replaced": another console answers
   * than the one that this page was loaded from, maybe for another cell. Then it is never up again; load the page anew.
   * @param url of the WebSocket.
   * @param Socket class to use, now() a clock in ms: others in tests.
   */
  constructor(url, { Socket = globalThis.WebSocket, now = () => performance.timeOrigin + performance.now() } = {}) {
    super();
    Object.assign(this, { url, Socket, now, isUp: false, roundTrip_ms: NaN });
    this._clocks = [];
    this._session = Math.random().toString(36).slice(2, 10);
    this._count = 0;
    this._waiting = new Map();
    this._attempt = 0;
  }

  open() {
    this._connect();
    this._pulse = setInterval(() => this.pulse(), PING_MS);
    return this;
  }

  close() {
    clearInterval(this._pulse);
    clearTimeout(this._retry);
    this._closed = true;
    this._socket?.close();
  }

  /** Go on at this address, as another. */
  renew(url) {
    this.url = url;
    if (this._socket) this._drop();
  }

  /**
   * Send a command. Resolves with the newest answer {outcome, text}: the server's, "lost" if none came in time, or
   * "not_sent" at once if the line is down. `heard` is called with each answer: "asked" may be followed by "done".
   */
  send(type, fields = {}, heard = null) {
    const id = `${this._session}-${++this._count}`;
    if (!this.canSend()) return Promise.resolve({ id, outcome: "not_sent", text: "no connection to the console" });
    this._socket.send(JSON.stringify({ type, id, sent_ms: this.now(), ...fields }));
    return new Promise((resolve) => {
      const timer = setTimeout(() => this._answer({ id, outcome: "lost", text: "no answer from the console" }, true), ANSWER_MS);
      this._waiting.set(id, { resolve, heard, timer });
    });
  }

  /** How far the console's clock is ahead of `now()`, as NTP estimates it: by the quickest answer of the last seconds [ms]. */
  get ahead_ms() {
    return this._clocks.reduce((best, one) => (one.trip < best.trip ? one : best), { trip: Infinity, ahead: NaN }).ahead;
  }

  canSend() {
    return this.isUp && this._socket.bufferedAmount < MOST_BUFFERED_BYTES;
  }

  /** Ask for the time, and give up a line that is silent. */
  pulse() {
    if (!this._socket) return;
    // until it is greeted a line counts for nothing, whatever else it brings
    const isDead = this.isUp ? this.now() - this._heardAt > SILENT_MS : this.now() - this._openedAt > OPENING_MS;
    if (isDead) {
      this._drop();
      return;
    }
    if (this.isUp) {
      this._socket.send(JSON.stringify({ type: "ping", id: `${this._session}-p${++this._count}`, sent_ms: this.now() }));
    }
  }

  _connect() {
    const socket = new this.Socket(this.url);
    this._socket = socket;
    this._openedAt = this.now();
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => socket === this._socket && this._hear(data);
    socket.onclose = () => socket === this._socket && this._drop();
  }

  _hear(data) {
    this._heardAt = this.now();
    if (typeof data !== "string") {
      this._tell("frame", data);
      return;
    }
    const message = JSON.parse(data);
    if (message.type === "hello") {
      this._console ??= message.console;
      if (this._console !== message.console) {
        this.close();
        this._tell("replaced");
        return;
      }
      this.isUp = true;
      this._attempt = 0;
      this._clocks = [];
      this._tell("up", message);
      this.pulse();
    } else if (message.type === "ack") {
      this._answer(message, message.outcome !== "asked");
    } else if (message.type === "pong") {
      const now = this.now();
      this.roundTrip_ms = now - message.sent_ms;
      this._clocks.push({ now, trip: this.roundTrip_ms, ahead: message.server_ms - (now + message.sent_ms) / 2 });
      while (now - this._clocks[0].now > CLOCKS_MS) this._clocks.shift();
    }
    this._tell(message.type, message);
  }

  _answer(ack, isLast) {
    const waiting = this._waiting.get(ack.id);
    if (!waiting) return;
    waiting.heard?.(ack);
    clearTimeout(waiting.timer);
    waiting.resolve(ack);
    if (isLast || !waiting.heard) this._waiting.delete(ack.id);
  }

  _drop() {
    const socket = this._socket;
    this._socket = null;
    socket.onclose = socket.onmessage = null;
    socket.close();
    for (const id of [...this._waiting.keys()]) this._answer({ id, outcome: "lost", text: "the connection was lost" }, true);
    if (this.isUp) {
      this.isUp = false;
      this._tell("down");
    }
    if (this._closed) return;
    const wait = RETRY_MS[Math.min(this._attempt++, RETRY_MS.length - 1)];
    this._retry = setTimeout(() => this._connect(), wait);
  }

  _tell(kind, detail = null) {
    this.dispatchEvent(Object.assign(new Event(kind), { detail }));
  }
}
