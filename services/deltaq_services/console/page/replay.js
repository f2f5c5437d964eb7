// A recording as the console's replay tells it, turned into frames like those of the cell. Knows no page and no clock.

import { OUTCOMES, PHASES } from "./frame.js";

const NEAREST_S = 0.5; // nearest bodies that are older are not shown
const NEAR = ["clearance", "retreat", "slow_down"];
const OF_JOINT = ["position_limit", "velocity_limit", "acceleration_limit"];
export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];

/** How many of the sorted `times` are not after `time`. */
function countUntil(times, time) {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle + 1;
    else high = middle;
  }
  return low;
}

const between = (from, to, share) => from.map((value, k) => value + share * (to[k] - value));

export class Replay {
  /** @param document as /recordings/NAME has it; scene of the cell. */
  constructor(document, scene) {
    const { name, begin_s, period_s, robots, nearest, verdicts, pictures, notices } = document;
    Object.assign(this, { name, begin_s, period_s, nearest, verdicts, notices, scene, time_s: 0 });
    this._robots = scene.robots.map(({ name: robot }) => robots[robot]);
    this._places = new Map(scene.bodies.map((body, place) => [body, place]));
    this._nearestTimes = nearest.map(([time]) => time);
    this._pictures = new Map(Object.entries(pictures).map(([stream, rows]) => [stream, { rows, times: rows.map(([time]) => time) }]));
    this._verdictTimes = verdicts.map(({ time_s }) => time_s);
    this.length_s = Math.max(0, (this._robots[0].q.length - 1) * period_s);
  }

  /** The frame at a time [s] from the recording's beginning; joints between two of its steps are in between. */
  frame(time_s) {
    this.time_s = Math.min(this.length_s, Math.max(0, time_s));
    const step = this.time_s / this.period_s;
    const [k, share] = [Math.floor(step), step % 1];
    const robots = this._robots.map((robot, index) => this._robot(robot, index, k, share));
    return { server_s: this.time_s, nearest: this._nearest(), robots };
  }

  _robot({ q, phase, outcome, clearance_m, focus, coupled }, index, k, share) {
    const home = this.scene.robots[index].home ?? this.scene.robots[index].joints.map(() => 0);
    const from = q[k] ?? home;
    const to = q[k + 1] ?? from;
    const at = between(from, to, share);
    const looked = focus[k];
    return {
      phase: PHASES[phase[k]] ?? "offline",
      outcome: OUTCOMES[outcome[k]] ?? null,
      isStale: phase[k] < 0,
      isBraking: PHASES[phase[k]] === "braking",
      age_s: 0,
      clearance_m: clearance_m[k] ?? NaN,
      pair: [null, null],
      admission: NaN,
      longest_s: NaN,
      focus: looked && between(looked, focus[k + 1] ?? looked, share),
      coupled: coupled?.[k],
      q: at,
      rest: at, // what braking would have done was not recorded
    };
  }

  _nearest() {
    const row = this.nearest[countUntil(this._nearestTimes, this.time_s) - 1];
    if (!row || this.time_s - row[0] > NEAREST_S) return null;
    const [, first, second, distance, from, to] = row;
    const [a, b] = [this._places.get(first), this._places.get(second)];
    return a === undefined || b === undefined ? null : { a, b, distance, points: [from, to] };
  }

  hasPictures(stream) {
    return this._pictures.has(stream);
  }

  /** The picture of a live stream that was the newest then: its address, and its age [ms]; null before the first. */
  picture(stream) {
    const { rows, times } = this._pictures.get(stream) ?? { rows: [], times: [] };
    const row = rows[countUntil(times, this.time_s) - 1];
    return row ? { url: `/recordings/${encodeURIComponent(this.name)}/${row[1]}`, age_ms: 1000 * (this.time_s - row[0]) } : null;
  }

  /** Lines of the list whose verdicts are given now, by their places. */
  current() {
    const end = countUntil(this._verdictTimes, this.time_s);
    const places = [];
    for (let place = 0; place < end; place++) {
      if (this.verdicts[place].until_s >= this.time_s - this.period_s) places.push(place);
    }
    return places;
  }

  /** Time of the next line after now whose verdict was held or refused [s]; null if none follows. */
  nextRefusal() {
    const from = countUntil(this._verdictTimes, this.time_s + 1e-6);
    return this.verdicts.slice(from).find(({ outcome }) => outcome === "held" || outcome === "refused")?.time_s ?? null;
  }

  /** What binds robot `name` now, as a status of the cell tells it. */
  bound(name) {
    const line = this.current().map((place) => this.verdicts[place]).findLast(({ robot, outcome }) => robot === name && outcome !== "note");
    if (!line) return null;
    const { outcome, code, what, text } = line;
    return {
      outcome, code, text: `${outcome}: ${text}`,
      bodies: NEAR.includes(code) ? what.split(" ") : [], joint: OF_JOINT.includes(code) ? what : null,
    };
  }
}

/** Where a recording is played, by a clock that is handed in [s]. */
export class Player {
  constructor(length_s) {
    Object.assign(this, { length_s, time_s: 0, speed: 1, isPlaying: false, _at_s: 0 });
  }

  /** The time to be shown; playing ends at the end. */
  advance(now_s) {
    if (this.isPlaying) this.seek(this.time_s + this.speed * Math.max(0, now_s - this._at_s));
    this._at_s = now_s;
    if (this.time_s >= this.length_s) this.isPlaying = false;
    return this.time_s;
  }

  /** Play or pause; at the end it begins anew. */
  toggle(now_s) {
    this.advance(now_s);
    if (!this.isPlaying && this.time_s >= this.length_s) this.seek(0);
    this.isPlaying = !this.isPlaying;
  }

  seek(time_s) {
    this.time_s = Math.min(this.length_s, Math.max(0, time_s));
  }
}
