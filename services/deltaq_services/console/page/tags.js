// Words over the picture, beside the place in the cell that they are about.

import { el, part, say } from "./dom.js";

const AWAY = 26; // px from the place to the words
const BETTER = 24; // px: words change their side only for so much more room
const SIDES = [[1, 0], [-1, 0], [1, -1], [-1, -1], [1, 1], [-1, 1]];

/** How far the nearest of some points is from a box [px]. */
export function roomOf([left, top, width, height], points) {
  return points.reduce((least, [x, y]) => {
    const [aside, above] = [Math.max(left - x, 0, x - left - width), Math.max(top - y, 0, y - top - height)];
    return Math.min(least, Math.hypot(aside, above));
  }, Infinity);
}

/** Left and top of words of that size beside (x, y), on each side, kept within the width and height of the picture. */
export function boxesBeside([x, y], [width, height], [wide, high]) {
  return SIDES.map(([aside, above]) => {
    const left = aside > 0 ? x + AWAY : x - AWAY - width;
    const top = y - height / 2 + above * (height + AWAY);
    return [Math.min(Math.max(6, left), wide - width - 6), Math.min(Math.max(6, top), high - height - 6), width, height];
  });
}

export class Tag {
  /** @param kind class of its element. */
  constructor(stage, kind) {
    this.stage = stage;
    this.box = el("div", { class: kind, hidden: true });
    this._texts = [el("b"), el("span")];
    this._side = 0;
    this.box.append(...this._texts);
    part("stage").append(this.box);
  }

  say(title, text) {
    say(this._texts[0], title);
    say(this._texts[1], text);
  }

  /** Stand beside `at` (Vector3 in the world, null for nowhere), away from `kept`; returns whether it is seen. */
  place(at, kept) {
    const { clientWidth: wide, clientHeight: high } = this.stage.holder;
    const onScreen = (point) => {
      const seen = point.clone().project(this.stage.camera);
      return seen.z < 1 ? [(0.5 + seen.x / 2) * wide, (0.5 - seen.y / 2) * high] : null;
    };
    const place = at && onScreen(at);
    const isSeen = !!place && place[0] > 0 && place[0] < wide && place[1] > 0 && place[1] < high;
    this.box.hidden = !isSeen;
    if (!isSeen) return false;
    const points = [...kept.map(onScreen).filter(Boolean), place];
    const boxes = boxesBeside(place, [this.box.offsetWidth, this.box.offsetHeight], [wide, high]);
    const rooms = boxes.map((box) => Math.min(120, roomOf(box, points)));
    const best = rooms.indexOf(Math.max(...rooms));
    if (rooms[best] > rooms[this._side] + BETTER) this._side = best;
    this.box.style.transform = `translate(${boxes[this._side][0]}px, ${boxes[this._side][1]}px)`;
    return true;
  }
}
