// Brings the cell to life on the page: its description is fetched, drawn, and the panels put around it.

import { jogAxes } from "./axes.js";
import { fetched, part } from "./dom.js";
import { Driven, drivingPanel } from "./driving.js";
import { FollowerPicture } from "./follower.js";
import { Gamepad } from "./gamepad.js";
import { keepsGrip } from "./hands.js";
import { jointBars } from "./joints.js";
import { driveByKeys } from "./keyboard.js";
import { MeshStore } from "./meshes.js";
import { MODES } from "./modes.js";
import { Overlays } from "./overlays.js";
import { padDrawing } from "./pad_drawing.js";
import { livePlots } from "./plots.js";
import { recordings } from "./recordings.js";
import { replayBar } from "./replay_bar.js";
import { Motion, RobotView, StructureView } from "./robots.js";
import { Stage } from "./scene.js";
import { nameCell } from "./status_bar.js";
import { Thumbnails } from "./thumbnails.js";
import { viewBar } from "./views.js";
import { WayPicture, Ways } from "./ways.js";
import { Wish } from "./wish.js";

/** Height of the lowest large flat body: what everything stands on [m]. */
function floorHeight(structure) {
  const floor = structure.find(({ name }) => name === "structure/floor");
  return floor ? floor.T_world[14] + floor.size[2] / 2 : 0;
}

/**
 * Show the cell.
 * @param holder element that the 3D view fills.
 * @param live Live; stop Stop; look the light or dark look, which the room follows.
 * Throws where the cell cannot be fetched or drawn; the message says why.
 */
export async function showCell(holder, live, stop, look) {
  const scene = await (await fetched("/scene.json")).json();
  live.scene = scene;
  nameCell(scene);
  const quality = new URLSearchParams(location.search).get("quality") ?? "auto";
  const stage = new Stage(holder, { floorHeight: floorHeight(scene.structure), quality });
  const store = new MeshStore(async (url) => (await fetched(url)).text(), stage.full);
  const paint = stage.shading.material();
  const views = await Promise.all(scene.robots.map((robot) => RobotView.make(robot, store, paint)));
  views.forEach((view) => view.robot.home && view.place(view.robot.home));
  const standing = scene.structure.filter(({ name }) => name !== "structure/floor");
  const structure = await StructureView.make(standing, store, stage.shading.material({ roughness: 0.7 }));
  stage.solid.add(structure.root, ...views.map(({ root }) => root));
  stage.solid.updateMatrixWorld(true);

  const picture = views.some(({ robot }) => robot.camera) ? new FollowerPicture(stage, live, views) : null;
  part("follower").hidden = !picture;
  const motion = new Motion(live, views, stage);
  const overlays = new Overlays(stage, live, scene, views, structure, picture);
  viewBar(stage, scene, views);
  look.follow((isDark) => {
    overlays.enter(isDark);
    stage.enter(isDark);
  });

  const driven = new Driven(live, scene);
  const wish = new Wish(live, driven);
  const ways = new Ways(live);
  const wayPicture = new WayPicture(stage, views);
  const context = { live, scene, driven, wish, stage, structure, views, ways, picture: wayPicture, thumbnails: new Thumbnails(stage), follower: picture };
  const axes = jogAxes(context);
  const { ask, pose, hands } = drivingPanel(context);
  const player = replayBar(live, scene);
  recordings(live, scene, player.open);
  const bars = jointBars(live, scene, views);
  livePlots(live, scene, picture, views, bars);
  const actions = {
    mode() {
      const shown = [...document.querySelectorAll("[data-mode]:not([hidden])")].map((button) => button.dataset.mode).filter((mode) => mode !== "follow" && keepsGrip(mode, driven.grip));
      const next = shown[(shown.indexOf(driven.mode) + 1) % shown.length] ?? MODES[0][0];
      ask("mode", { mode: next, frame: driven.frame });
    },
    robot() {
      const names = scene.robots.map(({ name }) => name);
      driven.choose(names[(names.indexOf(driven.name) + 1) % names.length]);
    },
    hand: () => hands.next(),
    picture: () => picture?.toggle(),
    frame: () => ask("mode", { mode: driven.mode ?? MODES[0][0], frame: driven.frame === "world" ? "tool" : "world" }),
    output: (index, value) => ask("output", { index, value }),
    distance(change) {
      const name = picture?.view.name;
      const now = live.robot(name)?.view_distance_m ?? picture?.error()?.distance;
      const [least, most] = scene.pad.view_range_m;
      if (now) ask("view_distance", { robot: name, value_m: Math.min(most, Math.max(least, now + change)) });
    },
    stop: () => stop.press(),
  };
  driveByKeys(driven, wish, actions);
  const drawing = padDrawing(scene.pad, driven);
  part("driving").append(drawing.box);
  const gamepad = new Gamepad(scene.pad, driven, wish, actions, drawing.show, () => live.robot(driven.name)?.goes_through ?? 1);

  // for tests and the curious: what is behind the page
  Object.assign(window.deltaq, { scene, stage, views, wish, driven, picture, overlays, motion, gamepad, player, ways, wayPicture, axes, gizmo: pose.gizmo });
}
