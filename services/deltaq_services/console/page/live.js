// What is known of the cell now: the newest frame and status, how old they are, and whether one may act upon them.

import { readFrame } from "./frame.js";

const STALE_S = 0.4; // a picture older than this is frozen, and nothing is driven by it
const OFFSET_WINDOW_S = 10;

export class Live extends EventTarget {
  /**
   * Events: "frame" of the cell, "shown" with the frame to be drawn, which may be a recording's, "replay" when that
   * changes, "status", "event", "line".
   * @param connection Connection.
   * @param scene what scene.json says of the cell; without robots until that is known.
   */
  constructor(connection, scene = { robots: [] }) {
    super();
    Object.assign(this, { connection, scene, frame: null, shown: null, replay: null, status: null, hello: null, isUndrawn: false, _arrived_s: -Infinity, _late_s: 0 });
    this._offsets = [];
    connection.addEventListener("frame", ({ detail }) => this._takeFrame(detail));
    connection.addEventListener("status", ({ detail }) => this._take("status", detail));
    connection.addEventListener("event", ({ detail }) => this._tell("event", detail));
    connection.addEventListener("up", ({ detail }) => {
      this.hello = detail;
      this.status = null; // what was known before is old: who has which lease, too
      this._offsets = [];
      if (this.replay) this.send("replay", { shown: true });
      this._tell("line");
    });
    connection.addEventListener("down", () => this._tell("line"));
  }

  /** Age of robot `index`'s state as it is seen here now [s]; of the oldest without an index. */
  age_s(index = null) {
    if (!this.frame) return Infinity;
    const ages = this.frame.robots.map((robot) => robot.age_s);
    const age = index === null ? Math.max(...ages) : ages[index];
    return age + this._late_s + (this._now_s() - this._arrived_s);
  }

  isStale(index = null) {
    return !(this.age_s(index) < STALE_S);
  }

  robot(name) {
    return this.status?.robots[name] ?? null;
  }

  indexOf(name) {
    return this.scene.robots.findIndex((robot) => robot.name === name);
  }

  /** Why nothing can be asked of the cell now, in words; empty if it can. */
  locked(name = null) {
    if (this.replay) return "a recording is shown";
    if (this.isUndrawn) return "the cell cannot be shown";
    if (!this.connection.isUp) return "no connection to the console";
    if (this.isStale(name === null ? null : this.indexOf(name))) return "the picture is old";
    if (!this.hello?.operator) return "you are an observer";
    if (this.status && !this.status.hli) return "the HLI is silent";
    return "";
  }

  /** Why robot `name` cannot be driven from here now, in words; empty if it can. */
  cannotDrive(name) {
    const locked = this.locked(name);
    if (locked) return locked;
    const robot = this.robot(name);
    if (!robot?.lease.mine) return "take control of it first";
    if (robot.phase === "held") return "it is held: reset it";
    return robot.phase === "offline" ? "it is offline" : "";
  }

  /** What bound the newest verdict on robot `name`, of what is shown; null if nothing did. */
  bound(name) {
    return this.replay ? this.replay.bound(name) : (this.robot(name)?.bound ?? null);
  }

  /** Show a recording, or with null the cell again. Nothing can be commanded meanwhile but a stop of the cell. */
  showReplay(replay) {
    this.replay = replay;
    this.send("replay", { shown: replay !== null });
    this._tell("replay", replay);
    this._tell("line"); // what is held is let go
    if (!replay && this.frame) this.show(this.frame);
  }

  /** Draw a frame. */
  show(frame) {
    this.shown = frame;
    this._tell("shown", frame);
  }

  send(type, fields, heard) {
    return this.connection.send(type, fields, heard);
  }

  _takeFrame(buffer) {
    const now = this._now_s();
    this.frame = readFrame(buffer);
    this._arrived_s = now;
    // the least difference of the clocks in the last seconds is the shortest way; what is above it, it was late
    const difference = now - this.frame.server_s;
    this._offsets.push([now, difference]);
    while (now - this._offsets[0][0] > OFFSET_WINDOW_S) this._offsets.shift();
    this._late_s = difference - this._offsets.reduce((least, [, one]) => Math.min(least, one), Infinity);
    this._tell("frame", this.frame);
    if (!this.replay) this.show(this.frame);
  }

  _take(kind, message) {
    this[kind] = message;
    this._tell(kind, message);
  }

  _now_s() {
    return this.connection.now() / 1000;
  }

  _tell(kind, detail = null) {
    this.dispatchEvent(Object.assign(new Event(kind), { detail }));
  }
}
