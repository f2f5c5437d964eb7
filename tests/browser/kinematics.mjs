// Reads {robots, qs} from standard input, writes T_world_joint of every joint at every q: for test_modules.py.

const { Kinematics } = await import(`${process.env.DELTAQ_BROWSER_MODULES}/kinematics.js`);
const chunks = [];
for await (const chunk of process.stdin) chunks.push(chunk);
const { robots, qs } = JSON.parse(Buffer.concat(chunks));
const placed = robots.map((robot, index) => {
  const kinematics = new Kinematics(robot);
  return qs[index].map((q) => ({
    joints: kinematics.place(q).map((T) => [...T]),
    tools: robot.tools.map((tool) => [...kinematics.carried(tool.joint, tool.T_joint_tool)]),
  }));
});
process.stdout.write(JSON.stringify(placed));
