// Modes that a robot is driven in, and which of them it has the joints for.

export const MODES = [
  ["joint", "Joint", "move one joint at a time, also back from beyond a limit"],
  ["decoupled", "Decoupled", "move the hand with the arm alone; the base stands still"],
  ["coupled", "Coupled", "move the hand with all joints"],
  ["self-motion", "Self-motion", "move any joint; the hand keeps its pose"],
  ["advisor", "Advisor", "drive to one of the advisor's options; the hand keeps its pose, or returns to it"],
  ["pose", "Pose", "drag the hand to a pose in the picture; the path is shown first"],
  ["follow", "Follow", "hold to begin: the camera keeps the leader's hand in view"],
];

const ARM_JOINTS = 6; // that hold one hand where it is

/** Modes that a robot of scene.json can be driven in, whoever drives it. */
export function modesOf({ joints, tools, camera }) {
  const spare = joints.length - ARM_JOINTS * tools.length;
  const cannot = { "self-motion": spare < 1, advisor: spare < 0, follow: !camera };
  return MODES.map(([mode]) => mode).filter((mode) => !cannot[mode]);
}
