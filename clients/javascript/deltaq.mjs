// A client of a running cell for Node: lines of JSON over TCP, and no dependencies.
//
//   const lab = await Client.connect({ port: 5210 });
//   await lab.acquire("fr");
//   for await (const state of lab.states()) await lab.send([5e-4, 0, 0, 0, 0, 0]); // rad in one cycle
//
// `deltaq schema` prints the fields of all messages. No verdict is waited for: newVerdicts() returns what has come.
// An `error` of the server ends the connection, and the robot comes to rest.
import { createHmac } from "node:crypto";
import { EventEmitter, once } from "node:events";
import { readFileSync } from "node:fs";
import net from "node:net";
import { InFlight } from "./in_flight.mjs";

const SILENCE_MS = 2000;

/** The token in the file that DELTAQ_CLIENT_TOKEN_FILE names, or in DELTAQ_CLIENT_TOKEN; empty if neither is set. */
export function givenToken() {
  const { DELTAQ_CLIENT_TOKEN_FILE: file, DELTAQ_CLIENT_TOKEN: given = "" } = process.env;
  if (!file) return given;
  let text;
  try {
    text = readFileSync(file, "utf8").trim();
  } catch (error) {
    throw new Error(`DELTAQ_CLIENT_TOKEN_FILE: ${file} cannot be read: ${error.message}`);
  }
  if (!text) throw new Error(`DELTAQ_CLIENT_TOKEN_FILE: ${file} holds no text`);
  return text;
}

export class Client {
  #socket; #address; #failure; #received = ""; #newest = {}; #answers = []; #verdicts = []; #seq = 0;
  #heard = new EventEmitter().on("error", () => {}); #timer; #silent_ms = 0; #inFlight;

  /** Connect; the token is needed where the cell asks for one, and is by default that of the environment. */
  static async connect({ host = "127.0.0.1", port = 5210, token = givenToken(), name = "node" } = {}) {
    const client = new Client(host, port);
    const hello = { type: "hello", protocol: 3, client: name };
    if (token) { // it is shown and not sent: somebody else may listen at this port
      const { challenge } = await client.#ask({ type: "challenge" }, (answer) => answer.type === "challenge");
      hello.challenge = challenge;
      hello.proof = createHmac("sha256", token).update(`deltaq hello ${challenge}`).digest("hex");
    }
    client.welcome = await client.#ask(hello, (answer) => answer.type === "welcome");
    return client;
  }
  constructor(host, port) {
    this.#address = `${host}:${port}`;
    this.#socket = net.connect({ host, port, noDelay: true }).setEncoding("utf8");
    this.#socket.on("data", (text) => this.#take(text));
    const closed = `${this.#address} has closed the connection; the robot comes to rest`;
    this.#socket.on("close", () => this.#fail("unreachable", closed));
    this.#socket.on("error", (error) => { // who is asked for more after the server has closed hears of it as an error
      const isClosed = ["ECONNRESET", "EPIPE"].includes(error.code);
      this.#fail("unreachable", isClosed ? closed : `${this.#address} cannot be reached: ${error.message}`);
    });
    this.#tick(SILENCE_MS / 4);
  }
  /** Take the lease of a robot; it is renewed until the connection is closed. With a jitter buffer from far away. */
  async acquire(robot, { playout = false } = {}) {
    const { cell, robots } = this.welcome;
    if (!(robot in robots)) throw new Error(`unknown_robot: cell ${cell} has no robot '${robot}'; it has ${Object.keys(robots).join(", ")}`);
    const { granted, code, holder, expires_s } = await this.#ask({ type: "lease", robot, action: "acquire", playout }, (m) => m.type === "lease");
    if (!granted) throw new Error(`${code}: the lease of ${robot} ${holder ? `is held by ${holder}` : "needs a controller's token"}`);
    this.robot = robot;
    this.#inFlight = playout ? new InFlight() : undefined;
    this.#tick(300 * expires_s);
  }
  /** States of the leased robot as they come, the newest only: whoever is slow misses some. */
  async *states() {
    for (let seen; ; yield seen) {
      while (!this.#isDue(seen)) await this.#next();
      seen = this.newest(this.robot);
      this.#inFlight?.takeState(seen);
    }
  }
  /** With a jitter buffer: the setpoint (n) that the next increment is added to [rad or m], for a state of `states`. */
  ahead(state) { return this.#inFlight.ahead(state); }
  /** With a jitter buffer: the cycles for which to `send` now. */
  cyclesToAnswer() { return this.#inFlight.cyclesToAnswer(); }
  /** The newest state of any robot; undefined before the first. */
  newest(robot) { return this.#newest[robot]; }
  /** Ask for an increment [rad or m] in answer to the state of a cycle, or to the newest however long it was computed. */
  async send(dq, answered) {
    for (let turn = 0; turn < 2; turn++) await new Promise(setImmediate); // a whole turn of the loop reads what has come
    if (this.#failure) throw this.#failure;
    const { cycle } = this.newest(this.robot), seq = ++this.#seq;
    this.#inFlight?.sent(seq, answered ?? cycle, dq);
    this.#say({ type: "increment", robot: this.robot, seq, cycle: answered ?? cycle, dq });
    return seq;
  }
  /** Verdicts since the last call. */
  newVerdicts() { return this.#verdicts.splice(0); }
  /** Give the lease back, and disconnect once that was answered: otherwise the robot would be held. */
  async close() {
    const { robot } = this;
    this.robot = undefined; // its lease is renewed no more
    if (robot && !this.#failure) await this.#ask({ type: "lease", robot, action: "release" }, (answer) => answer.type === "lease" && !answer.holder);
    this.#fail("unreachable", "this client is closed");
  }
  #tick(period_ms) {
    clearInterval(this.#timer);
    this.#timer = setInterval(() => {
      if (this.robot) this.#say({ type: "lease", robot: this.robot, action: "renew" });
      if ((this.#silent_ms += period_ms) > SILENCE_MS) this.#fail("unreachable", `${this.#address} does not answer any more`);
    }, period_ms);
  }
  #isDue(seen) { // the first states of a lease may be of before it
    const newest = this.newest(this.robot);
    return newest !== undefined && newest !== seen && !(this.#inFlight && newest.playout === null);
  }
  #say(message) { if (!this.#failure) this.#socket.write(`${JSON.stringify(message)}\n`); }
  async #ask(message, isAnswer) {
    this.#answers = [];
    this.#say(message);
    while (!this.#answers.some(isAnswer)) await this.#next();
    return this.#answers.find(isAnswer);
  }
  async #next() { if (this.#failure) throw this.#failure; else await once(this.#heard, "lines"); }
  #take(text) {
    this.#silent_ms = 0;
    const lines = (this.#received + text).split("\n");
    this.#received = lines.pop(); // the end of this line has not come yet
    for (const message of lines.map((line) => JSON.parse(line))) {
      if (message.type === "state") this.#newest[message.robot] = message;
      else if (message.type === "verdict") {
        this.#verdicts.push(message);
        this.#inFlight?.takeVerdict(message);
      }
      else if (message.type === "error") this.#fail(message.code, `${message.message}; ${message.hint}`);
      else this.#answers.push(message);
    }
    this.#heard.emit("lines");
  }
  #fail(code, message) {
    clearInterval(this.#timer);
    this.#socket.destroy();
    this.#heard.emit("error", this.#failure ??= new Error(`${code}: ${message}`));
  }
}
