// The page's modules that need no browser. Run by test_modules.py.

import assert from "node:assert/strict";
import { mock, test } from "node:test";

const folder = process.env.DELTAQ_BROWSER_MODULES;
const load = (name) => import(`${folder}/${name}.js`);
const [{ Connection }, { Live }, { Stop }, { Wish }, { readFrame }, { Series }, { Gamepad, shaped, wishOf }, { csvCell }, { Player, Replay }, drag, { score }, hands, { Pace }, { framed }, { boxesBeside, roomOf }, { axisOf, axisText }, { modesOf }, { Handover, UNSEEN_MS }, { targetsOf }, { anglesOf, dateText, poseText }, { progressText }] = await Promise.all(
  ["connection", "live", "stop", "wish", "frame", "plots", "gamepad", "event_log", "replay", "drag_math", "advisor_cards", "hands", "pace", "views", "overlays", "plots", "modes", "follower", "look_at", "dom", "routines"].map(load),
);

// what wish.js and stop.js hear from a page
const page = new EventTarget();
globalThis.window = page;
globalThis.document = Object.assign(new EventTarget(), { hidden: false });

/** The far end of a WebSocket, in the hands of the test. */
class Socket {
  static last = null;
  constructor() {
    Object.assign(this, { sent: [], bufferedAmount: 0 });
    Socket.last = this;
  }
  send(text) {
    this.sent.push(JSON.parse(text));
  }
  close() {
    this.onclose?.();
  }
  says(message) {
    this.onmessage?.({ data: message instanceof ArrayBuffer ? message : JSON.stringify(message) });
  }
  commands(type) {
    return this.sent.filter((command) => command.type === type);
  }
}

const hello = (more = {}) => ({ type: "hello", console: "one", client: "desk", operator: true, token_needed: false, ...more });

function connected(t) {
  mock.timers.enable({ apis: ["setInterval", "setTimeout", "Date"], now: 1_000_000 });
  const connection = new Connection("ws://cell/live", { Socket, now: () => Date.now() }).open();
  Socket.last.says(hello());
  t.after(() => {
    connection.close();
    mock.timers.reset();
  });
  return connection;
}

/** A frame of one robot with one joint, as frame.py packs it. */
function frame({ server_s = 0, age_s = 0.01, q = 0.25, version = 2, focus = [NaN, NaN, NaN] } = {}) {
  const view = new DataView(new ArrayBuffer(88));
  const write = { u8: (at, value) => view.setUint8(at, value), u16: (at, value) => view.setUint16(at, value, true), f32: (at, value) => view.setFloat32(at, value, true) };
  write.u8(0, version);
  write.u8(1, 1);
  view.setFloat64(4, server_s, true);
  for (const at of [16, 20, 24, 28, 32, 36, 40, 52]) write.f32(at, NaN);
  for (const at of [12, 14, 56, 58]) write.u16(at, 65535);
  [1, 2, 255, 0].forEach((value, k) => write.u8(44 + k, value));
  [[48, age_s], [60, 0.5], [64, 0.012], [80, q], [84, q]].forEach(([at, value]) => write.f32(at, value));
  focus.forEach((value, k) => write.f32(68 + 4 * k, value));
  return view.buffer;
}

const SCENE = { robots: [{ name: "fr" }] };
const status = (more = {}) => ({ type: "status", hli: true, stop: "none", robots: { fr: { phase: "engaged", lease: { mine: true } } }, ...more });

function driving(t) {
  const connection = connected(t);
  const live = new Live(connection, SCENE);
  live.hello = { operator: true };
  Socket.last.says(frame({ server_s: Date.now() / 1000 }));
  Socket.last.says(status());
  const wish = new Wish(live, { robot: () => "fr", length: () => 1, hand: () => "" });
  return { connection, live, wish, socket: Socket.last };
}

/** In small steps, so that timers that timers set come in their turn. */
function pass(ms) {
  for (let k = 0; k < ms; k += 20) mock.timers.tick(20);
}
/** Time passes while the cell goes on telling. */
function passWithNews(socket, ms) {
  for (let k = 0; k < ms; k += 40) {
    pass(40);
    socket.says(frame({ server_s: Date.now() / 1000 }));
  }
}

test("a command on a line that is down is not sent, then or later", async (t) => {
  const connection = connected(t);
  Socket.last.close();
  assert.equal((await connection.send("mode", { robot: "fr" })).outcome, "not_sent");
  pass(10_000);
  Socket.last.says(hello());
  assert.deepEqual(Socket.last.commands("mode"), []);
});

test("a command on a line that takes nothing any more is not sent", async (t) => {
  const connection = connected(t);
  Socket.last.bufferedAmount = 100_000;
  assert.equal((await connection.send("jog", {})).outcome, "not_sent");
});

test("a line that brings nothing is given up, and what was asked on it is lost", async (t) => {
  const connection = connected(t);
  const dead = Socket.last;
  const answer = connection.send("reset", { robot: "fr" });
  pass(2500);
  assert.equal((await answer).outcome, "lost");
  assert.notEqual(Socket.last, dead);
  assert.equal(connection.isUp, false);
});

test("an answer that is only asked may be followed by done", async (t) => {
  const connection = connected(t);
  const heard = [];
  const first = connection.send("lease", { robot: "fr" }, (ack) => heard.push(ack.outcome));
  const { id } = Socket.last.commands("lease")[0];
  Socket.last.says({ type: "ack", id, outcome: "asked", text: "" });
  Socket.last.says({ type: "ack", id, outcome: "refused", text: "b has it" });
  assert.equal((await first).outcome, "asked");
  assert.deepEqual(heard, ["asked", "refused"]);
});

test("STOP is repeated until it is heard, each time as a command of its own, and then no more", async (t) => {
  const { live, socket } = driving(t);
  const stop = new Stop(live, () => {});
  stop.press();
  passWithNews(socket, 320);
  const sent = socket.commands("stop");
  assert.ok(sent.length >= 3);
  assert.equal(new Set(sent.map(({ id }) => id)).size, sent.length);
  assert.equal(stop.state, "sending");
  socket.says({ type: "ack", id: sent[0].id, outcome: "asked", text: "" });
  await Promise.resolve();
  const count = socket.commands("stop").length;
  passWithNews(socket, 400);
  assert.equal(socket.commands("stop").length, count);
  assert.equal(stop.state, "asked");
  socket.says(status({ stop: "stopping" }));
  assert.equal(stop.state, "stopping");
  socket.says(status({ stop: "at_rest" }));
  assert.equal(stop.state, "at_rest");
});

test("a STOP that nothing confirms within a second says so, and is confirmed late all the same", async (t) => {
  const { live, socket } = driving(t);
  const stop = new Stop(live, () => {});
  stop.press();
  socket.says({ type: "ack", id: socket.commands("stop")[0].id, outcome: "asked", text: "" });
  await Promise.resolve();
  socket.says(status({ stop: "asked" }));
  passWithNews(socket, 960);
  assert.equal(stop.state, "asked");
  passWithNews(socket, 80);
  assert.equal(stop.state, "not_confirmed");
  socket.close();
  pass(50);
  assert.equal(stop.state, "not_confirmed", "the line is lost, too");
  pass(400);
  Socket.last.says(hello());
  Socket.last.says(status({ stop: "asked" }));
  assert.equal(stop.state, "not_confirmed");
  Socket.last.says(status({ stop: "stopping" }));
  assert.equal(stop.state, "stopping");
  Socket.last.says(status({ stop: "none" }));
  assert.equal(stop.state, "ready");
});

test("a STOP that the console itself does not answer within a second is not confirmed, and is sent again and again", (t) => {
  const { live, socket } = driving(t);
  const stop = new Stop(live, () => {});
  stop.press();
  passWithNews(socket, 1040);
  assert.equal(stop.state, "not_confirmed");
  const count = socket.commands("stop").length;
  passWithNews(socket, 400);
  assert.ok(socket.commands("stop").length >= count + 3);
});

test("a page that was loaded from another console than answers now is never up again, and says so", (t) => {
  const { connection, live } = driving(t);
  let replaced = 0;
  connection.addEventListener("replaced", () => replaced++);
  Socket.last.close();
  pass(400);
  Socket.last.says(hello({ console: "another" }));
  assert.equal(replaced, 1);
  assert.equal(live.cannotDrive("fr"), "no connection to the console");
  pass(20_000);
  assert.equal(connection.isUp, false);
  assert.equal(replaced, 1, "it does not try again by itself");
});

test("a STOP that nobody has heard is repeated by the page that is loaded next, until ten seconds after it was pressed", async (t) => {
  const kept = new Map();
  globalThis.sessionStorage = { getItem: (name) => kept.get(name) ?? null, setItem: (name, text) => kept.set(name, text) };
  t.after(() => delete globalThis.sessionStorage);
  const { live, socket } = driving(t);
  socket.close();
  new Stop(live, () => {}).press();
  pass(6000);
  Socket.last.says(hello({ console: "another" }));
  const connection = new Connection("ws://cell/live", { Socket, now: () => Date.now() }).open();
  t.after(() => connection.close());
  const next = new Stop(new Live(connection, SCENE), () => {});
  assert.equal(next.state, "not_sent");
  Socket.last.says(hello({ console: "another" }));
  pass(200);
  const [{ id }] = Socket.last.commands("stop");
  Socket.last.says({ type: "ack", id, outcome: "asked", text: "" });
  await Promise.resolve();
  assert.equal(next.state, "asked");
  assert.equal(new Stop(live, () => {}).pressed, false, "it was heard");
  socket.close();
  new Stop(live, () => {}).press();
  pass(10_100);
  assert.equal(new Stop(live, () => {}).pressed, false, "it is too old");
});

test("STOP without a line says that it is not sent, and is given up after ten seconds", async (t) => {
  const { connection, live, socket } = driving(t);
  const stop = new Stop(live, () => {});
  socket.close();
  stop.press();
  assert.equal(stop.state, "not_sent");
  for (let k = 0; k < 105; k++) pass(100);
  Socket.last.says(hello());
  pass(500);
  assert.equal(connection.isUp, true);
  assert.deepEqual(Socket.last.commands("stop"), []);
});

test("nine seconds without a network: nothing that was held goes on, and a STOP of that time goes out when the line is back", (t) => {
  const { connection, live, wish, socket } = driving(t);
  const stop = new Stop(live, () => {});
  wish.hold("button", { 0: 0.2 });
  passWithNews(socket, 200);
  pass(2000); // nothing comes, and nothing closes either
  assert.equal(connection.isUp, false);
  assert.equal(wish.isActive, false);
  stop.press();
  assert.equal(stop.state, "not_sent");
  pass(7000);
  assert.equal(stop.state, "not_sent");
  Socket.last.says(hello());
  pass(120);
  assert.notEqual(Socket.last, socket);
  assert.ok(Socket.last.commands("stop").length >= 1);
  assert.deepEqual(Socket.last.commands("jog"), []);
  assert.equal(wish.isActive, false);
  Socket.last.says(frame({ server_s: Date.now() / 1000 }));
  Socket.last.says(status());
  pass(120);
  assert.deepEqual(Socket.last.commands("jog"), [], "it has to be pressed anew");
});

test("a tab in the background lets go at once, and holds nothing when it is in front again", (t) => {
  const { wish, socket } = driving(t);
  wish.hold("button", { 0: 0.2 });
  document.hidden = true;
  t.after(() => (document.hidden = false));
  document.dispatchEvent(new Event("visibilitychange"));
  assert.deepEqual(socket.commands("jog").map(({ wish: [speed] }) => speed), [0.2, 0]);
  passWithNews(socket, 2000);
  document.hidden = false;
  document.dispatchEvent(new Event("visibilitychange"));
  passWithNews(socket, 400);
  assert.equal(socket.commands("jog").length, 2);
});

test("a wish is renewed while it is held, and its end is one wish for rest", (t) => {
  const { wish, socket } = driving(t);
  assert.equal(wish.hold("button", { 0: 0.2 }), true);
  passWithNews(socket, 400);
  const held = socket.commands("jog").length;
  assert.ok(held >= 4);
  wish.release("button");
  passWithNews(socket, 400);
  const all = socket.commands("jog");
  assert.equal(all.length, held + 1);
  assert.deepEqual(all.at(-1).wish, [0]);
});

test("a page that loses the focus moves nothing, and what was held has to be pressed anew", (t) => {
  const { wish, socket } = driving(t);
  wish.hold("button", { 0: 0.2 });
  page.dispatchEvent(new Event("blur"));
  passWithNews(socket, 400);
  assert.deepEqual(socket.commands("jog").map(({ wish: [speed] }) => speed), [0.2, 0]);
});

test("nothing is driven by a picture that is old", (t) => {
  const { live, wish, socket } = driving(t);
  wish.hold("button", { 0: 0.2 });
  pass(700);
  assert.equal(live.isStale(), true);
  assert.equal(wish.isActive, false);
  assert.equal(wish.hold("button", { 0: 0.2 }), false);
  assert.match(wish.refused, /old/);
  const count = socket.commands("jog").length;
  pass(300);
  assert.equal(socket.commands("jog").length, count);
});

test("a picture that comes late is old, whatever time the server's clock shows", (t) => {
  const { live, socket } = driving(t);
  const hour = 3600;
  socket.says(frame({ server_s: Date.now() / 1000 + hour }));
  passWithNews(socket, 80);
  live._offsets = []; // the console's clock was set: a new line measures anew
  socket.says(frame({ server_s: Date.now() / 1000 + hour }));
  assert.equal(live.isStale(), false);
  socket.says(frame({ server_s: Date.now() / 1000 + hour - 2 }));
  assert.equal(live.isStale(), true);
});

test("an observer, a lease of somebody else's and a held robot cannot be driven", (t) => {
  const { live, wish, socket } = driving(t);
  socket.says(status({ robots: { fr: { phase: "held", lease: { mine: true } } } }));
  assert.equal(wish.hold("button", { 0: 1 }), false);
  socket.says(status({ robots: { fr: { phase: "ready", lease: { mine: false } } } }));
  assert.equal(wish.hold("button", { 0: 1 }), false);
  socket.says(status());
  live.hello = { operator: false };
  assert.equal(wish.hold("button", { 0: 1 }), false);
  assert.deepEqual(socket.commands("jog"), []);
});

test("a frame of another version is told, not guessed at", () => {
  assert.throws(() => readFrame(frame({ version: 9 })), /version 9/);
  const { robots, nearest } = readFrame(frame({ q: 0.25 }));
  assert.equal(robots[0].phase, "engaged");
  assert.equal(robots[0].outcome, null);
  assert.deepEqual([...robots[0].q], [0.25]);
  assert.equal(robots[0].focus, null);
  assert.equal(nearest, null);
  assert.deepEqual(readFrame(frame({ focus: [1, 2, 3] })).robots[0].focus, [1, 2, 3]);
});

test("a routine is told by its step, and by its end with the reason", () => {
  const routine = { routine: "read_gauge", equipment: "gauge_1", step: 1, steps: 4, text: "look equipment", paused: false, end: "", why: "" };
  assert.equal(progressText(routine), "read gauge gauge_1: step 2 of 4, look equipment");
  assert.equal(progressText({ ...routine, paused: true }), "read gauge gauge_1: paused at step 2 of 4, look equipment");
  assert.equal(progressText({ ...routine, routine: "park", equipment: "", end: "done" }), "park: done");
  assert.equal(progressText({ ...routine, end: "held", why: "step 2 of 4: stopped" }), "read gauge gauge_1: held. step 2 of 4: stopped");
});

test("of the robots that are to be looked at none is asked for twice", () => {
  assert.deepEqual(targetsOf(["gr", "aide"]), ["gr", "aide"]);
  assert.deepEqual(targetsOf(["gr", "gr"]), ["gr"]);
  assert.deepEqual(targetsOf(["", "gr"]), ["gr"]);
  assert.deepEqual(targetsOf(["", ""]), []);
});

test("the camera that is shown is kept while it sees its target, and then handed over to the first that does", () => {
  const handover = new Handover();
  assert.equal(handover.choose([false, false, false], 0), 0);
  assert.equal(handover.choose([true, true, true], 2000), 0);
  assert.equal(handover.choose([false, false, true], 2100), 0);
  assert.equal(handover.choose([true, false, true], 2900), 0, "a glance away is no loss");
  assert.equal(handover.choose([false, false, true], 3000), 0);
  assert.equal(handover.choose([false, false, true], 3000 + UNSEEN_MS), 2);
  assert.equal(handover.choose([true, true, true], 9000), 2, "it is not given back while it sees");
  handover.take(1);
  assert.equal(handover.choose([true, false, true], 9100), 1, "one that was chosen has its time, too");
  assert.equal(handover.choose([true, false, true], 9100 + UNSEEN_MS), 0);
});

test("a series keeps two minutes and knows their range", () => {
  const series = new Series();
  for (let k = 0; k < 2000; k++) series.add(k * 0.125, k === 1500 ? NaN : k);
  assert.equal([...series].length, 1200);
  assert.deepEqual(series.range(200), [1600, 1999]);
});

test("a stick rests in its dead zone and reaches full speed at its end", () => {
  assert.equal(shaped(0.11), 0);
  assert.equal(shaped(-1), -1);
  assert.ok(shaped(0.3) < 0.3 && shaped(0.3) > 0);
});

const layout = JSON.parse(process.env.DELTAQ_PAD);
const place = Object.fromEntries(layout.controls.map((control) => [control.function, control.standard]));
/** A pad as browsers tell it, with that held and the sticks so. */
const pad = (held = [], axes = [0, 0, 0, 0]) => ({ id: "a pad", mapping: "standard", connected: true, index: 0, axes, buttons: Array.from({ length: 17 }, (_, k) => ({ pressed: held.some((what) => place[what] === k), value: Number(held.some((what) => place[what] === k)) })) });

test("sticks count only while a shoulder button is held: move goes along x, y, z, and turn about them", () => {
  const driven = { isByJoints: false, share: 1, mode: "coupled" };
  const sticks = [-0.5, -1, 0, 1];
  assert.equal(wishOf(pad([], sticks), layout, driven, 1), null);
  const moved = wishOf(pad(["move"], sticks), layout, driven, 1);
  assert.deepEqual(Object.keys(moved), ["0", "1", "2"]);
  assert.deepEqual(Object.values(moved).map(Math.sign), [1, 1, -1]);
  assert.deepEqual(Object.keys(wishOf(pad(["turn"], sticks), layout, driven, 1)), ["3", "4", "5"]);
});

test("in a mode of ways the left stick, pushed ahead, goes along the chosen one", () => {
  const driven = { goesAlongWays: true, mode: "advisor", share: 1 };
  assert.deepEqual(wishOf(pad(["turn"], [0, -1, 0, 0]), layout, driven, 3), { option: 3 });
  assert.deepEqual(wishOf(pad(["turn"], [0, -0.3, 0, 0]), layout, driven, 3), {});
  assert.deepEqual(wishOf(pad(["turn"], [0, -1, 0, 0]), layout, { ...driven, mode: "pose" }, 3), { option: 1 });
});

/** The gamepad of a page, before a robot of three joints and two outputs, and what it has asked for. */
function plugged(t, { mode = "coupled", isByJoints = false, held = [], first = pad(held) } = {}) {
  mock.timers.reset(); // the pad before it
  mock.timers.enable({ apis: ["setInterval", "setTimeout"] });
  t.after(() => mock.timers.reset());
  const world = { pad: first, done: [] };
  Object.defineProperty(globalThis, "navigator", { configurable: true, value: { getGamepads: () => [world.pad] } });
  globalThis.document.hasFocus = () => true;
  const done = (what) => (...values) => world.done.push([what, ...values]);
  world.holds = true;
  world.goesThrough = 1;
  const driven = { mode, isByJoints, share: 0.3, joint: 0, length: () => 3, scenery: { outputs: ["gripper", "tool"], joints: [] }, changeShare: done("speed"), chooseJoint: done("joint") };
  const actions = Object.fromEntries(["mode", "frame", "robot", "hand", "picture", "stop", "output", "distance"].map((what) => [what, done(what)]));
  world.gamepad = new Gamepad(layout, driven, { hold: (...values) => (done("hold")(...values), world.holds), release: done("rest") }, actions, () => {}, () => world.goesThrough);
  world.press = (...what) => {
    for (const held of [what, []]) {
      world.pad = pad(held);
      mock.timers.tick(30);
    }
    return world.done.splice(0).filter(([what]) => what !== "rest");
  };
  world.stand = (held, axes) => {
    world.pad = held && pad(held, axes);
    mock.timers.tick(30);
    return world.done.splice(0).map(([what]) => what);
  };
  mock.timers.tick(30);
  return world;
}

/** A pad that the browser does not map: its axes, and which of its buttons are down. */
const raw = (id, count, axes, down = []) => ({ id, mapping: "", connected: true, index: 0, axes, buttons: Array.from({ length: count }, (_, k) => ({ pressed: down.includes(k), value: Number(down.includes(k)) })) });
const PADS = {
  "045e-028e-Microsoft X-Box 360 pad": { count: 11, rest: [0, 0, -1, 0, 0, -1, 0, 0], stop: 1, move: 4, z: 4, on: 5 },
  "Logitech Dual Action (Vendor: 046d Product: c216)": { count: 12, rest: [0, 0, 0, 0, 0, 0], stop: 2, move: 4, z: 3 },
  "54c-9cc-Wireless Controller": { count: 14, rest: [0, 0, 0, -1, -1, 0], stop: 2, move: 4, z: 5, on: 4 },
};

test("a pad of an unknown layout is refused by its name: it moves, switches and stops nothing, whatever is pressed", (t) => {
  const none = [0, 0, 0, -1, -1, 0];
  const unknown = [raw("some pad", 14, none), raw("54c-9cc-Wireless Controller", 14, none.slice(1)), raw("54c-9cc-Wireless Controller", 4, none), { ...pad(), axes: [0, 0] }];
  for (const one of unknown) {
    const world = plugged(t, { first: one });
    const shown = [];
    world.gamepad.show = (...values) => shown.push(values);
    for (const button of one.buttons.keys()) {
      world.pad = { ...one, buttons: one.buttons.map((each, k) => (k === button ? { pressed: true, value: 1 } : each)) };
      mock.timers.tick(30);
    }
    assert.deepEqual(world.done, [], one.id);
    assert.deepEqual(shown[0].slice(0, 2), [{ ...one, buttons: shown[0][0].buttons }, null]);
  }
});

for (const [id, { count, rest, stop, move, z, on }] of Object.entries(PADS)) {
  test(`${id}: its own layout counts, and its triggers rest at -1`, (t) => {
    const world = plugged(t, { first: raw(id, count, rest) });
    const at = (axis, value) => rest.map((each, k) => (k === axis ? value : each));
    const stand = (axes, down) => {
      world.pad = raw(id, count, axes, down);
      mock.timers.tick(30);
      return world.done.splice(0).filter(([what]) => what !== "rest");
    };
    assert.deepEqual(stand(rest, [move]).flat(), [], "the sticks are not touched");
    const [[, , wish]] = stand(at(z, -1), [move]);
    assert.ok(wish[2] > 0 && !wish[0] && !wish[1], "the right stick, pushed ahead, lifts");
    assert.deepEqual(stand(rest, [stop]), [["stop"]]);
    if (on !== undefined) assert.deepEqual(stand(at(on, 1), []), [["output", 0, true]]);
  });
}

test("until each axis was seen at rest nothing but STOP counts, also on a pad whose layout is not what its browser says", (t) => {
  const world = plugged(t, { first: pad([], [0, 0, 0, -1]) });
  const ahead = [0, -1, 0, -1];
  assert.match(world.gamepad.waitsFor(world.pad), /axis 3 stands at -1.00/);
  assert.deepEqual([...world.stand(["move"], ahead), ...world.stand([], ahead), ...world.stand(["move", "mode"], ahead)].filter((what) => what !== "rest"), []);
  assert.deepEqual(world.stand(["stop"], ahead).includes("stop"), true);
  world.stand(["move"], [0, 0, 0, 0]);
  assert.deepEqual(world.stand(["move"], [0, -1, 0, 0]), ["rest"], "the button was held as the pad was armed");
  world.stand([], [0, -1, 0, 0]);
  assert.deepEqual(world.stand(["move"], [0, -1, 0, 0]), ["hold"]);
});

test("a known pad is taken in the place of an unknown one", (t) => {
  const world = plugged(t, { first: raw("some pad", 14, [0, 0]) });
  world.pad = pad();
  page.dispatchEvent(Object.assign(new Event("gamepadconnected"), { gamepad: world.pad }));
  mock.timers.tick(30);
  assert.deepEqual(world.press("mode"), [["mode"]]);
});

test("each button of the layout does what the layout says, once", (t) => {
  const { press } = plugged(t);
  for (const what of ["mode", "frame", "robot", "hand", "picture", "stop"]) assert.deepEqual(press(what), [[what]]);
  assert.deepEqual(press("nearer"), [["distance", -layout.view_step_m]]);
  assert.deepEqual(press("farther"), [["distance", layout.view_step_m]]);
  assert.deepEqual([press("on"), press("output"), press("off")], [[["output", 0, true]], [], [["output", 1, false]]]);
  assert.deepEqual([press("next"), press("previous")].flat().map(([what, step]) => [what, Math.sign(step)]), [["speed", 1], ["speed", -1]]);
  assert.deepEqual([press("move"), press("turn")], [[], []]);
});

test("the cross chooses among the joints in a mode of joints, and among the options in the advisor's", (t) => {
  const joints = plugged(t, { mode: "joint", isByJoints: true });
  assert.deepEqual([joints.press("next"), joints.press("previous")], [[["joint", 1]], [["joint", 2]]]);
  const advised = plugged(t, { mode: "advisor" });
  advised.press("next");
  assert.equal(advised.gamepad.option, 2);
  advised.press("previous"), advised.press("previous");
  assert.equal(advised.gamepad.option, 9);
});

test("what is held as a pad is plugged in does nothing until it is pressed anew, but a stop is one", (t) => {
  const held = plugged(t, { held: ["mode", "on", "stop"] });
  assert.deepEqual(held.done.splice(0).map(([what]) => what), ["rest", "stop"]);
  assert.deepEqual(held.press("mode"), [], "it was not let go in between");
  assert.deepEqual(held.press("mode"), [["mode"]]);
});

test("a stick that is held while nothing can be driven, or a pad that is pulled out, has to be pressed anew", (t) => {
  const world = plugged(t);
  const ahead = [0, -1, 0, 0];
  world.stand([]);
  assert.deepEqual(world.stand(["move"], ahead), ["hold"]);
  world.holds = false; // the picture is old
  assert.deepEqual(world.stand(["move"], ahead), ["hold"]);
  world.holds = true;
  assert.deepEqual(world.stand(["move"], ahead), ["rest"]);
  world.stand([], ahead);
  assert.deepEqual(world.stand(["move"], ahead), ["hold"]);
  assert.deepEqual(world.stand(null), ["rest"]);
});

test("a pad that can rumbles while a limit holds the hand back, the more the less goes through, and only then", (t) => {
  const world = plugged(t);
  const felt = [];
  const stands = (...held) => {
    world.pad = { ...pad(held, [0, -1, 0, 0]), vibrationActuator: { playEffect: (kind, { strongMagnitude }) => (felt.push([kind, strongMagnitude]), Promise.reject(new Error("not this one"))) } };
    mock.timers.tick(30);
    return felt.splice(0);
  };
  stands();
  assert.deepEqual(stands("move"), [], "all of it goes through");
  world.goesThrough = 0.25;
  assert.deepEqual(stands("move"), [["dual-rumble", 0.75]]);
  assert.deepEqual(stands(), [], "nothing is wished for");
  assert.deepEqual(world.stand(["move"], [0, -1, 0, 0]).includes("hold"), true, "a pad that cannot moves the robot all the same");
});

test("a tool's pose is told as on a pendant", () => {
  const [c, s] = [Math.cos(Math.PI / 6), Math.sin(Math.PI / 6)];
  assert.equal(poseText([c, s, 0, 0, -s, c, 0, 0, 0, 0, 1, 0, 0.5, -1.25, 2, 1]), "X 500  Y -1250  Z 2000 mm\nA 30.0  B 0.0  C 0.0 °");
});

test("a saved event cannot become a formula of a spreadsheet", () => {
  assert.equal(csvCell("=1+1"), "'=1+1");
  assert.equal(csvCell(-0.5), "-0.5");
  assert.equal(csvCell('say "a, b"'), '"say ""a, b"""');
});

const RECORDED = {
  name: "run.mcap", begin_s: null, period_s: 0.04, notices: [], pictures: { fr: [[0.02, "fr-0000001.jpg"], [0.06, "fr-0000002.jpg"]] },
  robots: { fr: { q: [[0], [1], [1], null], phase: [2, 2, 4, -1], outcome: [0, 2, null, null], clearance_m: [0.1, null, null, null], focus: [[1, 2, 3], [1, 3, 3], null, null] } },
  nearest: [[0, "fr/link_1", "tank", 0.2, [0, 0, 0], [0, 0, 1]]],
  verdicts: [
    { time_s: 0.03, until_s: 0.05, count: 2, robot: "fr", outcome: "scaled", code: "velocity_limit", what: "a1", text: "too fast (a1)" },
    { time_s: 0.07, until_s: 0.09, count: 1, robot: "fr", outcome: "held", code: "clearance", what: "fr/link_1 tank", text: "too near" },
  ],
};
const replay = () => new Replay(RECORDED, { robots: [{ name: "fr", home: [0], joints: [{}] }], bodies: ["fr/link_1", "tank"] });

test("a recording is played between its steps, and silence in it is shown", () => {
  const shown = replay();
  assert.deepEqual(shown.frame(0.01).robots[0].q, [0.25]);
  assert.equal(shown.frame(0.01).robots[0].phase, "engaged");
  assert.deepEqual(shown.frame(0.01).nearest, { a: 0, b: 1, distance: 0.2, points: [[0, 0, 0], [0, 0, 1]] });
  assert.equal(shown.frame(99).robots[0].isStale, true);
  assert.equal(shown.frame(99).server_s, shown.length_s);
  assert.equal(shown.frame(-1).server_s, 0);
});

test("what a camera looked at is marked as it was recorded, and not where that is unknown", () => {
  const shown = replay();
  assert.deepEqual(shown.frame(0.01).robots[0].focus, [1, 2.25, 3]);
  assert.deepEqual(shown.frame(0.06).robots[0].focus, [1, 3, 3]);
  assert.equal(shown.frame(0.09).robots[0].focus, null);
});

test("a recording tells the picture that was the newest at each moment", () => {
  const shown = replay();
  shown.frame(0.01);
  assert.equal(shown.picture("fr"), null);
  shown.frame(0.05);
  assert.equal(shown.picture("fr").url, "/recordings/run.mcap/fr-0000001.jpg");
  assert.equal(Math.round(shown.picture("fr").age_ms), 30);
  assert.deepEqual([shown.hasPictures("fr"), shown.hasPictures("gr"), shown.picture("gr")], [true, false, null]);
});

test("the next refusal is found from wherever one is, and what binds is told then only", () => {
  const shown = replay();
  shown.frame(0);
  assert.equal(shown.nextRefusal(), 0.07);
  assert.equal(shown.bound("fr"), null);
  shown.frame(0.04);
  assert.deepEqual(shown.bound("fr").joint, "a1");
  shown.frame(shown.nextRefusal());
  assert.deepEqual(shown.bound("fr").bodies, ["fr/link_1", "tank"]);
  assert.equal(shown.nextRefusal(), null);
});

test("a recording plays at its speed, waits while it is paused, and ends at its end", () => {
  const player = new Player(10);
  player.advance(100);
  player.toggle(100);
  assert.equal(player.advance(101), 1);
  player.speed = 8;
  assert.equal(player.advance(101.5), 5);
  player.toggle(101.5);
  assert.equal(player.advance(200), 5);
  player.toggle(200);
  assert.equal(player.advance(300), 10);
  assert.equal(player.isPlaying, false);
  player.toggle(301);
  assert.equal(player.advance(301), 0);
});

test("while a recording is shown nothing is driven, the cell's frames are not drawn, and stop goes out", async (t) => {
  const { live, wish, socket } = driving(t);
  const drawn = [];
  live.addEventListener("shown", ({ detail }) => drawn.push(detail));
  assert.equal(wish.hold("button", { 0: 0.2 }), true);
  live.showReplay(replay());
  assert.equal(wish.isActive, false, "what is held is let go");
  assert.deepEqual(socket.commands("replay").map(({ shown }) => shown), [true]);
  assert.equal(wish.hold("button", { 0: 0.2 }), false);
  assert.equal(live.cannotDrive("fr"), "a recording is shown");
  drawn.length = 0;
  socket.says(frame({ server_s: Date.now() / 1000 }));
  assert.deepEqual(drawn, []);
  const stop = new Stop(live, () => {});
  stop.press();
  assert.equal(socket.commands("stop").length, 1);
  live.showReplay(null);
  assert.equal(drawn.at(-1), live.frame);
  assert.equal(live.cannotDrive("fr"), "");
});

test("a line that comes back while a recording is shown is told so", (t) => {
  const { live } = driving(t);
  live.showReplay(replay());
  Socket.last.close();
  pass(400);
  Socket.last.says(hello());
  assert.deepEqual(Socket.last.commands("replay").map(({ shown }) => shown), [true]);
});

test("a pointer that looks along an axis, or along a ring's plane, drags nothing", () => {
  const ray = { origin: [0, 0, 5], direction: [0, 0, -1] };
  assert.equal(drag.alongAxis(ray, [0, 0, 0], [0, 0, 1]), null);
  assert.equal(drag.aboutAxis(ray, [0, 0, 0], [1, 0, 0], [0, 1, 0]), null);
  assert.equal(drag.aboutAxis(ray, [0, 0, 9], [0, 0, 1], [1, 0, 0]), null, "what lies behind the eye is not met");
});

test("a pointer drags along an axis to where its ray passes nearest, and about one to where it meets the plane", () => {
  const ray = { origin: [0.3, 0.7, 5], direction: [0, 0, -1] };
  assert.ok(Math.abs(drag.alongAxis(ray, [0.1, 0, 0], [1, 0, 0]) - 0.2) < 1e-12);
  assert.ok(Math.abs(drag.alongAxis(ray, [0.1, 0, 0], [0, 1, 0]) - 0.7) < 1e-12);
  assert.ok(Math.abs(drag.aboutAxis(ray, [0.3, 0, 1], [0, 0, 1], [1, 0, 0]) - Math.PI / 2) < 1e-12);
});

test("a pose that is turned about any axis has the quaternion of that turn, whatever part is the largest", () => {
  const upright = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.1, 0.2, 0.3, 1];
  for (const axis of [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0, -0.8]]) {
    for (const angle of [0, 0.4, 3.1, -3.1, Math.PI]) {
      const T = drag.turned(upright, axis, angle);
      const half = [Math.cos(angle / 2), ...axis.map((part) => part * Math.sin(angle / 2))];
      const q = drag.quaternionOf(T);
      const same = Math.abs(q.reduce((sum, part, k) => sum + part * half[k], 0));
      assert.ok(Math.abs(same - 1) < 1e-9, `${axis} ${angle}: ${q}`);
      assert.deepEqual([...T.slice(12)], upright.slice(12));
    }
  }
});

test("a cost is a score of a hundred, and never more or less", () => {
  assert.deepEqual([0, 0.28, 1, 7, -1].map(score), [100, 72, 0, 0, 100]);
});

test("a line that brings pictures and never a greeting is given up, and another is opened", (t) => {
  const connection = connected(t);
  Socket.last.close();
  pass(400);
  const half = Socket.last;
  for (let k = 0; k < 70; k++) {
    half.says(frame({ server_s: Date.now() / 1000 }));
    pass(100);
  }
  assert.notEqual(Socket.last, half);
  assert.equal(connection.isUp, false);
  Socket.last.says(hello());
  assert.equal(connection.isUp, true);
});

test("a way is gone along while it is held; letting go is rest", (t) => {
  const { wish, socket } = driving(t);
  assert.equal(wish.hold("card", { option: 2 }), true);
  wish.release("card");
  assert.deepEqual(socket.commands("jog").map(({ option, wish: speeds }) => [option, speeds]), [[2, undefined], [undefined, [0]]]);
});

test("in a mode that goes along ways keys and sticks move nothing", (t) => {
  const { wish, socket } = driving(t);
  wish.target.jogs = () => false;
  assert.equal(wish.hold("stick", { 0: 0.2 }), false);
  assert.match(wish.refused, /another mode/);
  assert.equal(wish.hold("card", { option: 1 }), true);
  assert.deepEqual(socket.commands("jog").map(({ option }) => option), [1]);
});

test("of one hand nothing is chosen; of two the key goes from both to each and to the object, where the mode lets them hold one", () => {
  assert.deepEqual(hands.handChoices(["tool"]), []);
  assert.deepEqual(hands.handChoices(["left", "right"]), ["*", "left", "right", "object"]);
  const round = (mode) => ["*", "left", "right"].map((now) => hands.nextChoice(["left", "right"], now, mode));
  assert.deepEqual(round("coupled"), ["left", "right", "object"]);
  assert.equal(hands.nextChoice(["left", "right"], "object", "coupled"), "*");
  for (const mode of ["joint", "pose", "follow"]) {
    assert.deepEqual(round(mode), ["left", "right", "*"]);
    assert.equal(hands.keepsGrip(mode, "object"), false);
    assert.equal(hands.keepsGrip(mode, "free"), true);
  }
  assert.equal(hands.keepsGrip("advisor", "object"), true);
});

test("it is told whether an object is held, and by how much the hands are off", () => {
  assert.match(hands.gripWords("object", null, "object"), /take the object once/);
  assert.equal(
    hands.gripWords("object", { distance_m: 0.0012, angle_rad: 0.01 }, "object"),
    "Object held. The hands have slipped by 1.2 mm, 0.57°.",
  );
  assert.doesNotMatch(hands.gripWords("free", null, "left"), /held/);
});

test("a hand is led while the button is held, by no speed of its own, and one wish for rest ends it", (t) => {
  const { live, socket } = driving(t);
  const wish = new Wish(live, { robot: () => "fr", length: () => 6, hand: () => "tool" });
  assert.equal(wish.hold("master", { led: true }), true);
  passWithNews(socket, 200);
  const held = socket.commands("jog");
  assert.ok(held.length >= 2);
  for (const jog of held) assert.deepEqual([jog.led, jog.hand, jog.wish], [true, "tool", undefined]);
  page.dispatchEvent(new Event("blur"));
  passWithNews(socket, 200);
  assert.equal(socket.commands("jog").length, held.length + 1);
  const rest = socket.commands("jog").at(-1);
  assert.deepEqual([rest.led, rest.wish], [undefined, [0, 0, 0, 0, 0, 0]]);
});

/** WebGL as far as a pace needs it: `done()` finishes all that was begun. */
class Drawing {
  SYNC_STATUS = 1;
  UNSIGNALED = 2;
  SIGNALED = 3;
  isLost = false;
  finished = 0;
  begun = 0;
  fenceSync() {
    return ++this.begun;
  }
  getSyncParameter(fence) {
    if (this.isLost) return null;
    return fence <= this.finished ? this.SIGNALED : this.UNSIGNALED;
  }
  deleteSync() {}
  flush() {}
  done() {
    this.finished = this.begun;
  }
}

/** A pace after `count` pictures that took `took_ms` each, and the time after them. */
function paced(count, took_ms) {
  const drawing = new Drawing();
  const pace = new Pace(drawing, 1, true);
  let now = 0;
  for (let k = 0; k < count; k++) {
    pace.next();
    pace.begun(now);
    drawing.done();
    now += took_ms;
    pace.isFinished(now);
  }
  return { drawing, pace, now };
}

test("a picture is finished when all that was told for it is done, and the next is not due at once", () => {
  const { drawing, pace, now } = paced(1, 20);
  pace.begun(now);
  assert.equal(pace.isFinished(now + 500), false);
  drawing.done();
  assert.equal(pace.isFinished(now + 5), true);
  assert.equal(pace.isDue(now + 5), false);
  assert.equal(pace.isDue(now + 30), true);
});

test("a picture that was lost with the graphics hardware is not waited for", () => {
  const { drawing, pace, now } = paced(1, 20);
  pace.begun(now);
  drawing.isLost = true;
  assert.equal(pace.isFinished(now + 30), true);
});

test("pictures that take long become coarser, down to a bound, and finer again when they are quick", () => {
  const { drawing, pace, now } = paced(40, 60);
  assert.equal(pace.next(), 0.4);
  let later = now;
  for (let k = 0; k < 60; k++) {
    pace.next();
    pace.begun(later);
    drawing.done();
    later += 10;
    pace.isFinished(later);
  }
  assert.equal(pace.next(), 1);
});

test("graphics hardware draws as fine as the screen, and for every frame of it", () => {
  const pace = new Pace(new Drawing(), 2, false);
  pace.begun(0);
  assert.equal(pace.next(), 2);
  assert.equal(pace.isDue(1), true);
  assert.equal(pace.isStill(10_000), false);
});

test("a camera stands where it sees all that it is to see, and as near as that allows", () => {
  const points = [[0, 0, 0], [2, 0, 0.3], [1, 1.5, 2], [-1, 0.2, 1]];
  const from = [0.7, 0.6, 0.3];
  const [wide, high] = [0.5, 0.3];
  const { eye, target } = framed(points, from, wide, high);
  const minus = (a, b) => a.map((value, k) => value - b[k]);
  const dot = (a, b) => a.reduce((sum, value, k) => sum + value * b[k], 0);
  const length = Math.hypot(...from);
  const back = from.map((value) => value / length);
  const right = [-back[1], back[0], 0].map((value) => value / Math.hypot(back[0], back[1]));
  const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2], back[0] * right[1] - back[1] * right[0]];
  assert.ok(Math.abs(dot(minus(eye, target), right)) < 1e-9 && Math.abs(dot(minus(eye, target), up)) < 1e-9, "it looks along the direction");
  const shares = points.map((point) => minus(point, eye)).map((line) => [Math.abs(dot(line, right)) / -dot(line, back) / wide, Math.abs(dot(line, up)) / -dot(line, back) / high]);
  assert.ok(Math.max(...shares.flat()) < 1 + 1e-9, "all are in the picture");
  assert.ok(Math.max(...shares.flat()) > 1 - 1e-9, "one is at its edge");
});

test("words stand beside a place, within the picture, and know how much room they leave to others", () => {
  const boxes = boxesBeside([10, 50], [80, 20], [400, 300]);
  assert.ok(boxes.every(([left, top]) => left >= 6 && left + 80 <= 394 && top >= 6 && top + 20 <= 294));
  assert.equal(boxes[0][0], 36);
  assert.equal(roomOf([36, 40, 80, 20], [[36, 70], [300, 300]]), 10);
  assert.equal(roomOf([36, 40, 80, 20], [[50, 50]]), 0);
});

test("an axis has the range of its values and is no narrower than is worth looking at", () => {
  const series = new Series();
  [[0, 4], [1, 4.2], [2, NaN], [130, 4.1]].forEach(([time, value]) => series.add(time, value));
  assert.deepEqual(axisOf({ lines: [{ series }], least: 1, from: 0 }, 10), [0, 4.1]);
  assert.deepEqual(axisOf({ lines: [{ series }], least: 1 }, 0).map((value) => value.toFixed(2)), ["3.60", "4.60"]);
  assert.deepEqual(axisOf({ lines: [{ series: new Series() }], least: 20, from: 0 }, 0), [0, 20]);
  assert.deepEqual([axisText(7.38, [0, 7.38]), axisText(100, [0, 100]), axisText(1.31, [1.31, 1.51])], ["7", "100", "1.31"]);
});

test("modes are offered to robots that have the joints for them", () => {
  const robot = (joints, hands, camera = null) => ({ joints: Array(joints).fill({ kind: "revolute" }), tools: Array(hands).fill({}), camera });
  const those = (...given) => modesOf(robot(...given)).filter((mode) => ["self-motion", "advisor", "follow"].includes(mode));
  assert.deepEqual(those(5, 1), []); // its hand has poses that cannot be kept
  assert.deepEqual(those(6, 1, {}), ["advisor", "follow"]); // the hand leaves its pose on the way
  assert.deepEqual(those(7, 1), ["self-motion", "advisor"]); // though no joint slides
  assert.deepEqual(those(12, 2), ["advisor"]);
  assert.deepEqual(those(17, 2), ["self-motion", "advisor"]);
  assert.deepEqual(modesOf(robot(4, 1)), ["joint", "decoupled", "coupled", "pose"]);
});

test("dates are told in one form, on the reader's clock", () => {
  const noon = new Date(2026, 10, 8, 12, 5, 9);
  assert.equal(dateText(noon / 1000), "2026-11-08 12:05:09");
});

test("a pose that is turned to angles has them, and keeps its position", () => {
  const T = drag.withAngles([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1], [30, -40, 110]);
  for (const [k, angle] of anglesOf(T).entries()) assert.ok(Math.abs(angle - [30, -40, 110][k]) < 1e-9);
  assert.deepEqual([...T.slice(12)], [4, 5, 6, 1]);
});
